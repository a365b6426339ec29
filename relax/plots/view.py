"""What the panels of a picture share: the box around a design, its distances as colours, its supports as lines."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba

from relax.arrays import Floats, Ints
from relax.design.masts import Mast
from relax.membrane.scene import Scene
from relax.plots.perspective import Colour

if TYPE_CHECKING:
    from relax.design.solve import Design

# one hue, light to dark, from a part of the map that stands out from white paper and leaves black struts readable
ERROR = LinearSegmentedColormap.from_list("error", colormaps["YlGnBu"](np.linspace(0.12, 0.85, 256)))
MAST, TIE_DOWN, STAY = to_rgba("#1a1a1a"), to_rgba("#d55e00"), to_rgba("#cc4499")

REACH = 0.2  # a foot farther out than this share of the scene is cut off, else one flat mast would shrink all the rest
ARROW = 0.08  # length of a stay's arrow, a share of the scene


@dataclass(frozen=True)
class Look:
    """How a kind of support is drawn: colour, line width in points, marks at its foot and, in plan, at its head."""

    colour: Colour
    width: float
    foot: str
    head: str


LOOKS = {
    "mast": Look(MAST, 2.2, "s", "o"),
    "tie-down": Look(TIE_DOWN, 1.5, "v", "v"),
    "stay": Look(STAY, 1.8, ">", "d"),
}


@dataclass(frozen=True)
class Strut:
    """A support from head to end (3,) metres; `whole` where its end is its foot."""

    kind: str
    head: Floats
    end: Floats
    whole: bool

    @property
    def look(self) -> Look:
        return LOOKS[self.kind]


@dataclass(frozen=True)
class View:
    """A design in its box from `low` to `high` (3,) metres, which holds membrane, wanted shape, ground and struts."""

    design: "Design"
    low: Floats
    high: Floats
    struts: tuple[Strut, ...]

    @property
    def scene(self) -> Scene:
        return self.design.problem.scene

    @property
    def size(self) -> float:
        """Diagonal of the box, metres."""
        return float(np.linalg.norm(self.high - self.low))

    @cached_property
    def corners(self) -> Ints:
        """Faces (F, 4); a triangle repeats its first corner."""
        return full_corners(self.scene.mesh.faces)

    @cached_property
    def triangles(self) -> Ints:
        """Faces as triangles (T, 3): quads are cut along a diagonal."""
        faces = self.scene.mesh.faces
        quads = faces[faces[:, 3] >= 0]
        return np.vstack([faces[:, :3], quads[:, [0, 2, 3]]])

    @cached_property
    def distance(self) -> Floats:
        """Distance of each vertex to its wanted place (V,), metres."""
        away: Floats = np.linalg.norm(self.design.positions - self.scene.target, axis=1)
        return away

    @cached_property
    def scale(self) -> ScalarMappable:
        """From distance to colour; distances below round-off are one colour, not a pattern."""
        return ScalarMappable(Normalize(0.0, max(float(self.distance.max()), 1e-9 * self.size)), ERROR)

    @cached_property
    def colours(self) -> Floats:
        """Colour of each face (F, 4): the mean distance of its corners."""
        return np.array(self.scale.to_rgba(self.distance[self.corners].mean(axis=1)))

    @cached_property
    def held_sides(self) -> Ints:
        """Sides (k, 2) on the outline whose ends are both fixed."""
        sides = np.sort(np.stack([self.corners, np.roll(self.corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        unique, count = np.unique(sides[sides[:, 0] < sides[:, 1]], axis=0, return_counts=True)
        held: Ints = unique[(count == 1) & self.scene.fixed[unique].all(axis=1)]
        return held

    @cached_property
    def held_points(self) -> Ints:
        """Fixed vertices that no held side shows."""
        return np.setdiff1d(np.flatnonzero(self.scene.fixed), self.held_sides)


def full_corners(faces: Ints) -> Ints:
    """Faces (F, 4) without the padding: a triangle repeats its first corner."""
    return np.where(faces < 0, faces[:, :1], faces)


def look_at(design: "Design") -> View:
    """Put the box around a design; supports that run far out of it are cut off."""
    scene = design.problem.scene
    shapes = np.vstack([design.positions, scene.target])
    low, high = shapes.min(axis=0), shapes.max(axis=0)
    low[2] = min(low[2], scene.ground)
    extent = float((high - low)[:2].max())
    room = low - REACH * extent, high + REACH * extent
    struts = tuple(_strut(mast, *room, ARROW * extent) for mast in design.supports)
    ends = np.array([strut.end for strut in struts]).reshape(-1, 3)
    return View(design, np.vstack([ends, low]).min(axis=0), np.vstack([ends, high]).max(axis=0), struts)


def _strut(mast: Mast, low: Floats, high: Floats, arrow: float) -> Strut:
    head = np.array(mast.head)
    if mast.foot is None:
        return Strut(mast.kind, head, head + arrow * np.array(mast.force) / mast.magnitude, whole=False)
    run = np.array(mast.foot) - head
    # the share of the way to the foot that stays in the box, in plan
    room = np.where(run > 0, high - head, low - head)[:2]
    moves = run[:2] != 0
    share = min([1.0, *(room[moves] / run[:2][moves]).tolist()])
    return Strut(mast.kind, head, head + share * run, whole=share == 1.0)
