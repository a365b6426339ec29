"""Symmetry of a scene: the rotations about a vertical axis and the mirrors in vertical planes that map all of it onto itself.

A scene without symmetry is seen to have none by a sort of its vertices; only one that looks symmetric is compared in full.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from relax.arrays import Floats, Ints, lock_arrays
from relax.membrane.scene import Scene

SAME = 1e-7  # of the size: what the digits of a mesh file leave; the whole problem has the last word, so nothing hangs on it
OFF_AXIS = 0.05  # of the largest radius: nearer to the axis a direction is not sharp
LARGEST_ORDER = 32  # of rotations: with more the images take more memory than there is to save
WHOLE = 1e-14  # nearer to a whole number a cosine is one
MIRRORS_TRIED = 8  # where more could be, a ring has many vertices and next to no symmetry
FIRST_LOOK = 16  # vertices that are compared before all are


@dataclass(frozen=True)
class Symmetry:
    """The group of maps x -> axis + Q (x - axis) that take a scene to itself.

    Parameters
    ----------
    axis : (3,) metres
        A point of the vertical axis, at height 0.
    turns : (G, 3, 3)
        Q, orthogonal, the identity first; vertical directions stay.
    images : (G, V) int
        The vertex that each map takes each vertex to.
    representatives : (r,) int
        One vertex of each orbit, ascending, all in one sector of the plan.
    """

    axis: Floats
    turns: Floats
    images: Ints
    representatives: Ints

    def __post_init__(self) -> None:
        lock_arrays(self)

    @property
    def order(self) -> int:
        """Number of maps G."""
        return len(self.turns)

    def __str__(self) -> str:
        rotations = int((np.linalg.det(self.turns) > 0).sum())
        mirrors = self.order - rotations
        said = [f"{rotations} rotations"] if rotations > 1 else []
        said += ["1 mirror" if mirrors == 1 else f"{mirrors} mirrors"] if mirrors else []
        return " and ".join(said)

    @cached_property
    def element(self) -> Ints:
        """A map that takes the representative of its orbit to each vertex (V,); of a representative the identity."""
        element = np.zeros(self.images.shape[1], dtype=np.int64)
        for index in reversed(range(self.order)):
            element[self.images[index, self.representatives]] = index
        return element

    @cached_property
    def orbit(self) -> Ints:
        """Orbit of each vertex (V,), its place among the representatives."""
        orbit = np.zeros(self.images.shape[1], dtype=np.int64)
        orbit[self.images[:, self.representatives]] = np.arange(len(self.representatives))
        return orbit

    @cached_property
    def _staying(self) -> Floats:
        """1 where a map leaves a representative in its place (G, r)."""
        return np.asarray(self.images[:, self.representatives] == self.representatives, dtype=float)

    @cached_property
    def share(self) -> Floats:
        """Vertices of each orbit over the order (r,): 1, but less on a mirror and on the axis."""
        return 1 / self._staying.sum(axis=0)

    @cached_property
    def invariant(self) -> Floats:
        """Projection (r, 3, 3) on the directions that the maps which leave a representative in place leave alone."""
        return _tidied(np.einsum("gr,gij->rij", self._staying, self.turns) * self.share[:, None, None])

    def mean(self, vectors: Floats) -> Floats:
        """The symmetric part of a field (V, 3), at the representatives (r, 3)."""
        return np.einsum("gji,grj->ri", self.turns, vectors[self.images[:, self.representatives]]) / self.order

    def mean_blocks(self, blocks: Floats) -> Floats:
        """The same of matrices (V, 3, 3)."""
        there = blocks[self.images[:, self.representatives]]
        return np.einsum("gji,grjk,gkl->ril", self.turns, there, self.turns, optimize=True) / self.order

    def whole(self, vectors: Floats) -> Floats:
        """The symmetric field (V, 3) with these values at the representatives (r, 3)."""
        return np.einsum("vij,vj->vi", self.turns[self.element], vectors[self.orbit])


def find_symmetry(scene: Scene) -> Symmetry | None:
    """The symmetry of target, start, springs, loads, metric, candidates and supports' weights; None where there is none."""
    size = float(np.linalg.norm(np.ptp(scene.target, axis=0)))
    axis = scene.target.mean(axis=0) * [1.0, 1.0, 0.0]
    centred = scene.target - axis
    ring = _rarest_ring(centred, SAME * size)
    if ring is None:
        return None
    same = _Comparison(scene, axis, SAME * size)
    angle = np.arctan2(centred[ring, 1], centred[ring, 0])
    turns, images = _rotations(same, len(ring))
    plane, image = _mirror_plane(same, angle, 2 * np.pi / len(turns))
    if image is not None:
        images = np.concatenate([images, images[:, image]])
        turns = np.concatenate([turns, _tidied(turns @ _mirror(plane))])
    if len(turns) == 1:
        return None
    # a direction in the middle of a sector, but for a little lest images of a vertex lie equally far along it
    middle = plane + 1.1 * np.pi / len(turns)
    along = centred[:, 0] * np.cos(middle) + centred[:, 1] * np.sin(middle)
    return Symmetry(axis, turns, images, _representatives(images, along))


def _rotations(same: "_Comparison", most: int) -> tuple[Floats, Ints]:
    """All rotations of the scene (k, 3, 3) with their images (k, V), the identity first; k divides the `most` there can be."""
    images = [np.arange(same.scene.mesh.vertices)]
    for count in range(min(most, LARGEST_ORDER), 1, -1):
        image = same.image(_rotation(2 * np.pi / count)) if most % count == 0 else None
        if image is not None:
            for _ in range(1, count):
                images.append(image[images[-1]])
            break
    turns = [_rotation(2 * np.pi * step / len(images)) for step in range(len(images))]
    return np.array(turns), np.array(images)


def _mirror_plane(same: "_Comparison", angles: Floats, sector: float) -> tuple[float, Ints | None]:
    """A mirror's direction in plan, radians, and its image (V,): it takes the first of the ring to one in a sector from it."""
    away = (angles - angles[0]) % (2 * np.pi)
    for plane in angles[0] + away[away < sector - SAME][:MIRRORS_TRIED] / 2:
        image = same.image(_mirror(plane))
        if image is not None:
            # the plane through one pair of vertices is sharpened by all
            plan = same.centred[:, 0] + 1j * same.centred[:, 1]
            return float(np.angle((plan[image] * plan).sum())) / 2, image
    return float(angles[0]), None


def _rotation(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return _tidied(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


def _mirror(plane: float) -> Floats:
    c, s = np.cos(2 * plane), np.sin(2 * plane)
    return _tidied(np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]]))


def _tidied(turns: Floats) -> Floats:
    """Without the round-off in zeros and ones, which quarter turns and the axis would carry on."""
    whole = np.round(turns)
    return np.where(np.abs(turns - whole) < WHOLE, whole, turns)


def _representatives(images: Ints, along: Floats) -> Ints:
    """Of each orbit the vertex that lies farthest along, ascending."""
    label = images.min(axis=0)
    order = np.lexsort((-along, label))
    return np.sort(order[np.concatenate([[True], np.diff(label[order]) > 0])])


def _rarest_ring(centred: Floats, tolerance: float) -> Ints | None:
    """The fewest vertices off the axis with one radius and one height: maps can only take them to each other.

    None where vertices that have no equal do not lie in one vertical plane through the axis: then nothing maps.
    """
    radius = np.hypot(centred[:, 0], centred[:, 1])
    first, second = _clusters(radius, tolerance), _clusters(centred[:, 2], tolerance)
    _, ring, count = np.unique(first * (second.max() + 1) + second, return_inverse=True, return_counts=True)
    off = radius > OFF_AXIS * radius.max()
    alone = np.flatnonzero(off & (count[ring] == 1))
    if alone.size:
        plan = centred[alone, :2]
        across = plan[:, 0] * plan[0, 1] - plan[:, 1] * plan[0, 0]
        if np.abs(across).max() > 10 * tolerance * radius.max():
            return None
    candidates = np.flatnonzero(off)
    few = candidates[count[ring[candidates]] == count[ring[candidates]].min()]
    return np.flatnonzero(ring == ring[few[np.argmax(radius[few])]])


def _clusters(values: Floats, tolerance: float) -> Ints:
    """A number for each value (V,), the same for those that differ by round-off."""
    order = np.argsort(values)
    label = np.zeros(len(values), dtype=np.int64)
    label[order[1:]] = np.cumsum(np.diff(values[order]) > tolerance)
    return label


@dataclass(frozen=True)
class _Comparison:
    """Whether an isometry maps a scene onto itself."""

    scene: Scene
    axis: Floats
    tolerance: float

    @cached_property
    def centred(self) -> Floats:
        """Target relative to the axis (V, 3)."""
        return self.scene.target - self.axis

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.centred)

    @cached_property
    def _keys(self) -> tuple[Ints, Ints]:
        """Edges as numbers, sorted, and the edge of each."""
        key = self._key(self.scene.mesh.edges)
        order = np.argsort(key)
        return key[order], order

    def _key(self, edges: Ints) -> Ints:
        return edges.min(axis=1) * self.scene.mesh.vertices + edges.max(axis=1)

    def image(self, turn: Floats) -> Ints | None:
        """The vertex that each vertex comes to lie on (V,); None where something does not come to lie on its like."""
        scene, points = self.scene, self.centred @ turn.T
        if self._nearest(points[:: max(1, len(points) // FIRST_LOOK)]) is None:
            return None
        image = self._nearest(points)
        if image is None or (np.bincount(image, minlength=len(points)) != 1).any():
            return None
        start = scene.start - self.axis
        alike = (
            np.array_equal(scene.fixed[image], scene.fixed)
            and np.array_equal(scene.candidates[image], scene.candidates)
            and np.abs(start[image] - start @ turn.T).max() <= self.tolerance
            and _close(scene.loads[image], scene.loads @ turn.T)
            and _close(scene.metric[image], turn @ scene.metric @ turn.T)
            and _close(scene.support_weight[image], scene.support_weight)
            and self._edges_map(image)
        )
        return image if alike else None

    def _nearest(self, points: Floats) -> Ints | None:
        """The vertex at each point (k,); None where there is none."""
        distance, vertex = self._tree.query(points, distance_upper_bound=self.tolerance)
        return np.asarray(vertex, dtype=np.int64) if np.isfinite(distance).all() else None

    def _edges_map(self, image: Ints) -> bool:
        """Whether edges come to lie on edges with their springs."""
        scene = self.scene
        keys, edge = self._keys
        wanted = self._key(image[scene.mesh.edges])
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        if not np.array_equal(keys[place], wanted):
            return False
        onto = edge[place]
        return _close(scene.rest_length[onto], scene.rest_length) and _close(scene.spring_constant[onto], scene.spring_constant)


def _close(one: Floats, other: Floats) -> bool:
    """Whether values are the same but for the digits that a file keeps."""
    return bool(np.abs(one - other).max(initial=0.0) <= SAME * np.abs(other).max(initial=0.0))
