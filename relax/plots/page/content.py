"""What the page knows of a design, as JSON: figures as numbers, arrays as base64 of little-endian bytes."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import ArrayLike

from relax.arrays import Floats
from relax.plots.style import ERROR
from relax.plots.view import LOOKS, View

if TYPE_CHECKING:
    from relax.design.solve import Design
    from relax.design.trace import Trace

MOST_STEPS = 200  # a slider is some hundreds of pixels wide
MOST_BYTES = 5_500_000  # of all steps together: base64 makes 7.3 MB of them, and a page of 10,000 vertices stays under 10 MB
LEVELS = 32767  # a displacement is a whole number of steps, each this share of the largest: finer than any colour


def page_content(design: "Design", view: View) -> dict[str, Any]:
    """All that the page's script reads; lengths in metres from `origin`, forces in newtons."""
    scene = view.scene
    origin = 0.5 * (view.low + view.high)
    starts, ends = view.slices
    return {
        "ground": scene.ground - origin[2],
        "origin": origin.tolist(),
        "low": (view.low - origin).tolist(),
        "high": (view.high - origin).tolist(),
        "room": [(corner - origin).tolist() for corner in view.room],
        "arrow": view.arrow,
        "turn": -62.0 if np.ptp(scene.target[:, 0]) >= np.ptp(scene.target[:, 1]) else -28.0,  # degrees, as in picture.png
        "colours": packed(ERROR(np.arange(ERROR.N), bytes=True)[:, :3], "u1"),
        "kinds": {kind: to_hex(look.colour) for kind, look in LOOKS.items()},
        "widths": {kind: look.width for kind, look in LOOKS.items()},
        "target": packed(scene.target - origin, "<f4"),
        "faces": packed(scene.mesh.faces, "<i4"),
        "free": int((~scene.fixed).sum()),
        "slices": packed(np.stack([starts, ends], axis=1) - origin, "<f4"),
        "held": packed(view.held_sides, "<i4"),
        "points": packed(view.held_points, "<i4"),
        "cables": packed(view.cables, "<i4"),
        **_run(design),
    }


def packed(values: ArrayLike, kind: str) -> str:
    """Values as base64 of `kind`, little-endian."""
    return b64encode(np.ascontiguousarray(values).astype(kind).tobytes()).decode()


def _run(design: "Design") -> dict[str, Any]:
    """The steps that are shown: the last is the result, and the state before rounding is among them."""
    trace, positions, forces, target = design.trace, design.positions, design.forces, design.problem.scene.target
    shapes = [(x, p, {"note": note, **_figures(trace, step)}) for step, (x, p, note) in _steps(trace)]
    if _find(positions, forces, shapes[-1:]) is None:  # an empty trace, or a run that went on in silence
        said = design.certificate
        figures = {"objective": said.objective, "stationarity": said.stationarity, "seconds": design.seconds}
        shapes.append((positions, forces, {"note": "result", **_numbers(figures)}))
    before = _find(trace.unrounded_positions, trace.unrounded_forces, shapes)
    if before is None:  # a method that does not show it as a step
        before = len(shapes) - 1
        shapes.insert(before, (trace.unrounded_positions, trace.unrounded_forces, {"note": "before rounding"}))
    vertices = [np.flatnonzero(p.any(axis=1)) for _, p, _ in shapes]
    chosen = thinned([6 * len(target) + 16 * len(who) for who in vertices], {0, before, len(shapes) - 1})
    offset = np.array([shapes[step][0] - target for step in chosen])
    unit = np.abs(offset).max(axis=(1, 2)) / LEVELS
    whole = np.rint(offset / np.where(unit > 0, unit, 1.0)[:, None, None])
    return {
        "total": len(shapes),
        "before": chosen.index(before),
        "steps": [{"step": step, **shapes[step][2]} for step in chosen],
        "unit": unit.tolist(),
        "offsets": packed(whole, "<i2"),
        "counts": [len(vertices[step]) for step in chosen],
        "heads": packed(np.concatenate([vertices[step] for step in chosen]), "<i4"),
        "forces": packed(np.concatenate([shapes[step][1][vertices[step]] for step in chosen]), "<f4"),
    }


def _steps(trace: "Trace") -> Any:
    return enumerate(zip(trace.positions, trace.forces, trace.notes, strict=True))


def _figures(trace: "Trace", step: int) -> dict[str, float | None]:
    return _numbers({name: float(getattr(trace, name)[step]) for name in ("objective", "stationarity", "seconds")})


def _numbers(figures: Mapping[str, float | None]) -> dict[str, float | None]:
    """Figures as numbers; null where there is none, since JSON has no other word for it."""
    return {name: None if value is None or not np.isfinite(value) else float(value) for name, value in figures.items()}


def _find(positions: Floats, forces: Floats, shapes: Sequence[Any]) -> int | None:
    same = (np.array_equal(x, positions) and np.array_equal(p, forces) for x, p, _ in shapes)
    return next((index for index, equal in enumerate(same) if equal), None)


def thinned(sizes: Sequence[int], needed: set[int]) -> list[int]:
    """Steps of `sizes` bytes at even distances, as many as fit, and those that are `needed` whatever their size."""
    steps = len(sizes)
    for count in range(min(steps, MOST_STEPS), 1, -1):
        chosen = sorted(needed | set(np.linspace(0, steps - 1, count).round().astype(int).tolist()))
        if sum(sizes[step] for step in chosen) <= MOST_BYTES:
            return chosen
    return sorted(needed)
