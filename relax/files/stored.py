"""Result folders read back: arrays and settings checked one by one, so that a damaged or edited one gives one sentence."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relax.arrays import Floats, Mask, lock_arrays
from relax.errors import InputError
from relax.files.archives import RESULT, TRACE, Arrays, read_arrays
from relax.files.bytes import read_bytes
from relax.files.checks import RefusedError, shown
from relax.files.schema import SCHEMA, Settings, resolve
from relax.membrane.mesh import Mesh
from relax.membrane.scene import Scene

if TYPE_CHECKING:
    from relax.design.problem import Problem
    from relax.design.solve import Design
    from relax.design.trace import Trace

SCENE_ARRAYS = (
    *("target", "clean_target", "start", "rest_length", "spring_constant", "loads", "fixed", "candidates", "metric"),
    "support_weight",
)
# what result.json says of the run itself
RUN: dict[str, Any] = {
    "stop": str,
    "iterations": int,
    "factorizations": int,
    "seconds": (int, float),
    "skipped": list,
    "interrupted": bool,
}


@dataclass(frozen=True)
class StoredResult:
    """A result as its folder holds it.

    Parameters
    ----------
    scene : Scene
        Rebuilt from result.npz and the settings alone.
    positions : (V, 3) metres
    forces : (V, 3) newtons
    figures : content of result.json, its settings completed by their defaults
    folder : where it was read
    """

    scene: Scene
    positions: Floats
    forces: Floats
    figures: Mapping[str, Any] = field(repr=False)
    folder: Path

    def __post_init__(self) -> None:
        lock_arrays(self)

    def design(self) -> "Design":
        """The design as `relax.solve` returned it: judged anew, with the trace of trace.npz, or none where that is not there.

        Raises
        ------
        InputError
            trace.npz cannot be used, or result.json lacks a figure of the run.
        """
        from relax.design.optimality import judge
        from relax.design.problem import Problem
        from relax.design.solve import Design

        problem = Problem(self.scene)
        run = _run_figures(self.figures, self.folder / "result.json")
        certificate = judge(problem, self.positions, self.forces, refit=self.scene.settings["rounding"]["refit"])
        trace = _read_trace(self.folder / "trace.npz", problem, self)
        return Design(problem, self.scene.settings, self.positions, self.forces, certificate, **run, trace=trace)


def load_result(folder: str | os.PathLike[str]) -> StoredResult:
    """The result in `folder`, from its result.json and result.npz alone.

    Raises
    ------
    InputError
        One sentence that starts with `folder` and names the file and the key that cannot be used.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "this is a file, and a result folder is expected" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {what}: give one that relax solve wrote")
    if not (folder / "result.json").exists() and not (folder / "result.npz").exists():
        raise InputError(f"{folder}: this folder holds no result: give one that relax solve wrote")
    try:
        name = "result.json"
        figures, settings = _read_figures(folder / name)
        name = "result.npz"
        arrays = read_arrays(folder / name, RESULT)
        _check_mesh(arrays)
        _check_springs(arrays)
        _check_places(arrays, settings["supports"]["always"])
    except InputError as error:
        raise InputError(f"{folder / name}: {error}") from None
    mesh = Mesh(len(arrays["positions"]), arrays["faces"], arrays["edges"])
    scene = Scene(mesh=mesh, settings=settings, **{name: arrays[name] for name in SCENE_ARRAYS})
    return StoredResult(scene, arrays["positions"], arrays["forces"], figures, folder)


def _run_figures(figures: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """What result.json says of the run itself, which no judge can say again."""
    seconds = figures.get("seconds")
    found = {**figures, "seconds": seconds.get("solve") if isinstance(seconds, dict) else None}
    for name, kind in RUN.items():
        if not isinstance(found.get(name), kind):
            raise InputError(f"{path}: {name} is missing or is no such figure: write the result again with relax solve")
    return {**{name: found[name] for name in RUN}, "skipped": tuple(map(str, found["skipped"]))}


def _read_trace(path: Path, problem: "Problem", stored: StoredResult) -> "Trace":
    """The trace of a run, its stationarity as it was judged when it was written."""
    from relax.design.trace import Trace

    if not path.exists():
        nothing = np.zeros((0, *stored.positions.shape))
        return Trace(problem, nothing, nothing, np.zeros(0), np.zeros(0), (), stored.positions, stored.forces)
    try:
        arrays = read_arrays(path, TRACE, {"V": len(stored.positions)})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    stationarity = arrays.pop("stationarity")
    trace = Trace(problem, **{**arrays, "notes": tuple(arrays["notes"].tolist())})
    vars(trace)["stationarity"] = stationarity  # instead of judging every step once more
    return trace


def _read_figures(path: Path) -> tuple[Mapping[str, Any], Settings]:
    """Content of result.json, and its settings, checked."""

    def refuse(name: str) -> Any:
        raise InputError(f"it holds {name}, which JSON does not know: write the result again with relax solve")

    try:
        figures = json.loads(read_bytes(path).decode(), parse_constant=refuse)
    except InputError:
        raise
    except (ValueError, RecursionError):  # text that is no JSON or no UTF-8, or a number of thousands of digits
        raise InputError("this is not valid JSON: write the result again with relax solve") from None
    if not isinstance(figures, dict) or not isinstance(figures.get("settings"), dict):
        raise InputError("it has no settings: write the result again with relax solve")
    settings = figures["settings"]
    try:
        complete = resolve(_given(settings))
    except InputError as error:
        raise InputError(f"settings: {error}") from None
    if complete["supports"]["ground"] is None:
        raise InputError("settings: supports.ground is missing: give the height of the ground in metres")
    penalty = settings.get("penalty", {})  # a table, else it would have been refused above
    if penalty.get("weight") is None:
        raise InputError("settings: penalty.weight is missing: give the weight that was used, a number above 0")
    if penalty.get("weight_fraction") is not None:
        complete["penalty"]["weight_fraction"] = _fraction(penalty["weight_fraction"])
    return {**figures, "settings": complete}, complete


def _fraction(value: Any) -> Any:
    key = SCHEMA["penalty"]["weight_fraction"]
    try:
        return key.check(value)
    except RefusedError:
        raise InputError(f"settings: penalty.weight_fraction = {shown(value)}: expected {key.possible}") from None


def _given(settings: Settings) -> Settings:
    """Settings without what is absent; the weight that was used stands for the fraction that it came from."""
    given: Settings = {}
    for section, keys in settings.items():
        given[section] = {key: value for key, value in keys.items() if value is not None} if isinstance(keys, dict) else keys
    penalty = given.get("penalty")
    if isinstance(penalty, dict) and "weight" in penalty:
        penalty.pop("weight_fraction", None)
    return given


def _check_mesh(arrays: Arrays) -> None:
    vertices, faces, edges = len(arrays["positions"]), arrays["faces"], arrays["edges"]
    if not len(edges) or not len(faces):
        raise InputError("it has no edges or no faces")
    bad = np.argwhere((edges < 0) | (edges >= vertices))
    if len(bad):
        raise InputError(f"edges: edge {bad[0][0]} names vertex {edges[tuple(bad[0])]}; there are vertices 0 to {vertices - 1}")
    if not (edges[:, 0] < edges[:, 1]).all():
        raise InputError(f"edges: edge {np.argmin(edges[:, 0] < edges[:, 1])} is not in the order a < b")
    if len(np.unique(edges, axis=0)) != len(edges):
        raise InputError("edges: an edge is there twice")
    padding = (faces == -1) & (np.arange(4) == 3)
    bad = np.argwhere(((faces < 0) & ~padding) | (faces >= vertices))
    if len(bad):
        raise InputError(f"faces: face {bad[0][0]} names vertex {faces[tuple(bad[0])]}; there are vertices 0 to {vertices - 1}")


def _check_springs(arrays: Arrays) -> None:
    for name in ("rest_length", "spring_constant"):
        _refuse_where(name, arrays[name] <= 0, arrays[name], "a number above 0")


def _check_places(arrays: Arrays, always: list[int]) -> None:
    """Refuse held vertices, candidates and weights that contradict each other or the vertices where supports always stand."""
    fixed, candidates, weight = arrays["fixed"], arrays["candidates"], arrays["support_weight"]
    if fixed.all():
        raise InputError("fixed: every vertex is fixed, so there is no membrane")
    if (fixed & candidates).any():
        raise InputError(f"candidates: vertex {np.argmax(fixed & candidates)} is fixed, so no support can act there")
    listed = np.zeros(len(fixed), dtype=bool)
    if always and max(always) >= len(fixed):
        raise InputError(
            f"supports.always in result.json names vertex {max(always)}, but there are vertices 0 to {len(fixed) - 1} here"
        )
    listed[always] = True
    if (listed & ~candidates).any():
        raise InputError(
            f"candidates: vertex {np.argmax(listed & ~candidates)} is none, but supports.always in result.json lists it"
        )
    _refuse_where("support_weight", weight < 0, weight, "a number 0 or above")
    _refuse_where("support_weight", listed & (weight != 0), weight, "0, as supports.always lists that vertex")
    _refuse_where("support_weight", (weight == 0) & candidates & ~listed, weight, "a number above 0 where a support may stand")


def _refuse_where(name: str, bad: Mask, values: Floats, wanted: str) -> None:
    if bad.any():
        raise InputError(f"{name}: entry {np.argmax(bad)} is {values[np.argmax(bad)]}, expected {wanted}")


def differing(stored: Mapping[str, Any], judged: Mapping[str, Any]) -> list[str]:
    """Names of the figures in `judged` that result.json, `stored`, gives otherwise or not at all."""
    tolerance = stored["settings"]["solver"]["tolerance"]
    # residuals are noise of the last digits, which another machine rolls anew: they agree well below what they are held to
    slight = {
        "equilibrium": 1e-11,
        "stationarity": 0.1 * tolerance,
        "off_support": 1e-9,
        "tension_min": 1e-9 * abs(judged["tension_max"]),
    }
    return [name for name, value in judged.items() if not _agree(stored.get(name), value, slight.get(name, 1e-14))]


def _agree(one: Any, other: Any, slight: float) -> bool:
    plain = [_float(value) for value in (one, other) if isinstance(value, int | float) and not isinstance(value, bool)]
    if len(plain) < 2 or not np.isfinite(plain).all():
        return (
            one is other
            or (type(one) is type(other) and one == other)
            or (one is None and len(plain) == 1 and not np.isfinite(plain[0]))
        )
    return bool(abs(plain[0] - plain[1]) <= slight + 1e-6 * max(abs(plain[0]), abs(plain[1])))


def _float(value: float) -> float:
    """`value`, infinite where it is a whole number of hundreds of digits."""
    try:
        return float(value)
    except OverflowError:
        return np.inf
