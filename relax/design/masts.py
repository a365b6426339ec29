"""Supports as things that are built: masts, tie-downs and stays with head, foot, length and lean (MATHEMATICS.md, "Masts")."""

from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats


@dataclass(frozen=True)
class Mast:
    """One support.

    `kind` is "mast" (pushes up), "tie-down" (pulls down) or "stay" (horizontal, or its head is below ground: no foot, no
    length). Metres, newtons, degrees; `lean` is the angle between force and vertical.
    """

    vertex: int
    head: tuple[float, float, float]
    force: tuple[float, float, float]
    magnitude: float
    kind: str
    foot: tuple[float, float, float] | None
    length: float | None
    lean: float


def standing_masts(positions: Floats, forces: Floats, ground: float) -> tuple[Mast, ...]:
    """A record for each vertex of `positions` (V, 3) whose support force in `forces` (V, 3) is not zero, ascending.

    The axis of a mast is the line through its head along its force; its foot is where that line meets z = `ground`.
    """
    masts = []
    for vertex in np.flatnonzero(forces.any(axis=1)):
        head, force = positions[vertex], forces[vertex]
        magnitude = float(np.linalg.norm(force))
        rise = head[2] - ground
        kind, foot, length = "stay", None, None
        if force[2] != 0 and rise >= 0:
            kind = "mast" if force[2] > 0 else "tie-down"
            base = head - force * (rise / force[2])
            foot, length = _point(base), float(np.linalg.norm(head - base))
        lean = float(np.degrees(np.arccos(min(1.0, abs(force[2]) / magnitude))))
        masts.append(Mast(int(vertex), _point(head), _point(force), magnitude, kind, foot, length, lean))
    return tuple(masts)


def _point(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
