"""What the panels of a picture share: the box around a shape, its distances as colours, its supports as lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from relax.arrays import Floats, Ints
from relax.design.masts import Mast, standing_masts
from relax.membrane.scene import Scene
from relax.plots.perspective import Colour, slice_surface
from relax.plots.style import ERROR, MAST, STAY, TIE_DOWN

if TYPE_CHECKING:
    from relax.design.solve import Design

REACH = 0.2  # a foot farther out than this share of the scene is cut off, else one flat mast would shrink all the rest
SLICES = 13  # of the wanted shape along its longer side
ARROW = 0.08  # length of a stay's arrow, a share of the scene


@dataclass(frozen=True)
class Look:
    """How a kind of support is drawn: colour, line width in points, marks at its foot and, in plan, at its head."""

    colour: Colour
    width: float
    foot: str
    head: str


LOOKS = {
    "mast": Look(MAST, 1.6, "s", "o"),
    "tie-down": Look(TIE_DOWN, 1.1, "v", "v"),
    "stay": Look(STAY, 1.3, ">", "d"),
}


@dataclass(frozen=True)
class Strut:
    """A support of `magnitude` newtons from head to end (3,) metres; `whole` where its end is its foot."""

    kind: str
    magnitude: float
    head: Floats
    end: Floats
    whole: bool

    @property
    def look(self) -> Look:
        return LOOKS[self.kind]


@dataclass(frozen=True)
class View:
    """A shape in its box from `low` to `high` (3,) metres, which holds membrane, wanted shape, ground and struts.

    `positions` are (V, 3) metres; struts are cut off where they leave `room`, its lowest and highest places; a stay's arrow is
    `arrow` metres long; the colours of distances reach at least to `top` metres.
    """

    scene: Scene
    positions: Floats
    low: Floats
    high: Floats
    struts: tuple[Strut, ...]
    room: tuple[Floats, Floats]
    arrow: float
    top: float = 0.0

    @property
    def size(self) -> float:
        """Diagonal of the box, metres."""
        return float(np.linalg.norm(self.high - self.low))

    @property
    def flat(self) -> Floats:
        """The vertices from above (V, 2)."""
        return self.positions[:, :2]

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
        away: Floats = np.linalg.norm(self.positions - self.scene.target, axis=1)
        return away

    @cached_property
    def scale(self) -> ScalarMappable:
        """From distance to colour; distances below round-off are one colour, not a pattern."""
        return ScalarMappable(Normalize(0.0, max(float(self.distance.max()), self.top, 1e-9 * self.size)), ERROR)

    @cached_property
    def colours(self) -> Floats:
        """Colour of each face (F, 4): the mean distance of its corners."""
        return np.array(self.scale.to_rgba(self.distance[self.corners].mean(axis=1)))

    @cached_property
    def slices(self) -> tuple[Floats, Floats]:
        """Lines of the wanted shape at equal steps of x and y, as dense on any mesh: starts and ends (k, 3)."""
        target = self.scene.target
        low, high = target.min(axis=0), target.max(axis=0)
        step = float((high - low)[:2].max()) / SLICES
        found = []
        for axis in (0, 1):
            count = int((high - low)[axis] / step)
            for level in 0.5 * (low + high)[axis] + step * (np.arange(count) - 0.5 * (count - 1)):
                found.append(slice_surface(target, self.triangles, axis, float(level)))
        starts, ends = zip(*found, strict=True)
        return np.concatenate(starts), np.concatenate(ends)

    @cached_property
    def counted(self) -> str:
        """How many supports of each kind, in words."""
        kinds = [strut.kind for strut in self.struts]
        named = [(kinds.count(kind), kind) for kind in LOOKS if kind in kinds]
        return ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for count, kind in named) or "no support"

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

    @cached_property
    def cables(self) -> Ints:
        """Edges (k, 2) along which cables run."""
        paths = [np.asarray(cable["path"], dtype=np.int64) for cable in self.scene.settings["membrane"]["cables"]]
        return np.vstack([np.zeros((0, 2), dtype=np.int64), *(np.column_stack([path[:-1], path[1:]]) for path in paths)])


def objective_unit(scene: Scene) -> str:
    """Of E_dist and the objective: square metres, times the areas that weigh them where that is asked for."""
    return "m\u2074" if scene.settings["target"]["area_weights"] else "m\u00b2"


def full_corners(faces: Ints) -> Ints:
    """Faces (F, 4) without the padding: a triangle repeats its first corner."""
    return np.where(faces < 0, faces[:, :1], faces)


def look_at(design: "Design") -> View:
    """Put the box around a design; supports that run far out of it are cut off."""
    return look_at_shape(design.problem.scene, design.positions, design.supports)


def look_at_state(scene: Scene, positions: Floats, forces: Floats) -> View:
    """The same of a shape under forces (V, 3)."""
    return look_at_shape(scene, positions, standing_masts(positions, forces, scene.ground))


def look_at_shape(scene: Scene, positions: Floats, supports: Sequence[Mast] = ()) -> View:
    """The same of positions (V, 3) and supports."""
    shapes = np.vstack([positions, scene.target])
    low, high = shapes.min(axis=0), shapes.max(axis=0)
    low[2] = min(low[2], scene.ground)
    extent = float((high - low)[:2].max())
    room = low - REACH * extent, high + REACH * extent
    arrow = ARROW * extent
    struts = tuple(_strut(mast, *room, arrow) for mast in supports)
    ends = np.array([strut.end for strut in struts]).reshape(-1, 3)
    low, high = np.vstack([ends, low]).min(axis=0), np.vstack([ends, high]).max(axis=0)
    return View(scene, positions, low, high, struts, room, arrow)


def _strut(mast: Mast, low: Floats, high: Floats, arrow: float) -> Strut:
    head = np.array(mast.head)
    if mast.foot is None:
        return Strut(mast.kind, mast.magnitude, head, head + arrow * np.array(mast.force) / mast.magnitude, whole=False)
    run = np.array(mast.foot) - head
    # the share of the way to the foot that stays in the box, in plan
    room = np.where(run > 0, high - head, low - head)[:2]
    moves = run[:2] != 0
    share = min([1.0, *(room[moves] / run[:2][moves]).tolist()])
    return Strut(mast.kind, mast.magnitude, head, head + share * run, whole=share == 1.0)
