"""Tiny scenes whose answers are known by hand, by a linear solve, or because they were planted."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, csc_array, diags_array, eye_array
from scipy.spatial import Delaunay

from relax.convex.subproblem import Subproblem, certify
from relax.factor import Factor
from relax.files.schema import resolve
from relax.membrane.equilibrium import find_equilibrium
from relax.membrane.membrane import Membrane
from relax.membrane.mesh import Mesh, grid_mesh, mesh_from_faces
from relax.membrane.scene import Scene, build_scene
from relax.membrane.springs import Hookean
from relax.sparsity.reach import ANYTHING, Reach


def settings(**changes):
    """All defaults of the format, ground 0, and `section__key=value` changes, unchecked."""
    whole = resolve({"target": {"mesh": "zoo.obj"}}, "zoo")
    whole["supports"]["ground"] = 0.0
    for name, value in changes.items():
        section, key = name.split("__")
        assert key in whole[section], name
        whole[section][key] = value
    return whole


def grid(n, diagonals="alternating", span=1.0):
    """Mesh and flat positions of n x n vertices over a square of side `span`; vertex = row * n + column."""
    y, x = np.divmod(np.arange(n * n), n)
    return grid_mesh(n, n, diagonals), np.column_stack([x, y, np.zeros(n * n)]) * (span / (n - 1))


def grid_scene(n, height=None, diagonals="alternating", **changes):
    """A square of n x n vertices, edge fixed, lifted to z = height(x, y)."""
    mesh, target = grid(n, diagonals)
    if height is not None:
        target[:, 2] = height(*target.T[:2])
    return build_scene(settings(**changes), mesh, target, None)


def hill(x, y):
    """Smooth, zero on the edge of the unit square."""
    return 0.3 * (np.sin(np.pi * x) * np.sin(np.pi * y)) ** 2


def bumps(x, y):
    """Three paraboloids that no membrane follows exactly."""
    tops = ((0.3, 0.3, 0.2), (0.7, 0.35, 0.25), (0.45, 0.72, 0.22))
    return np.maximum(0, np.max([h * (1 - ((x - a) ** 2 + (y - b) ** 2) / 0.04) for a, b, h in tops], axis=0))


@dataclass(frozen=True)
class Planted:
    """A scene whose clean target is the equilibrium under `forces` (V, 3): zero distance, those supports."""

    scene: Scene
    forces: np.ndarray
    positions: np.ndarray

    @property
    def vertices(self):
        """Where the planted supports stand."""
        return np.flatnonzero(self.forces.any(axis=1))


ONE_MAST = (((0.5, 0.5), (0.0, 0.0, 0.3)),)
TWO_MASTS = (((0.25, 0.25), (0.0, 0.0, 0.25)), ((0.75, 0.5), (0.05, 0.0, 0.3)))


def planted(n, masts=ONE_MAST, sigma=None, seed=0, **changes):
    """Forces at plan positions (u, v) of the unit square of n x n vertices; noise only with `sigma`."""
    mesh, flat = grid(n)
    forces = np.zeros_like(flat)
    for (u, v), force in masts:
        forces[round(v * (n - 1)) * n + round(u * (n - 1))] += force
    bare = build_scene(settings(**changes), mesh, flat, None)
    found = find_equilibrium(bare.membrane, flat, (forces + bare.loads)[bare.membrane.free])
    assert found.found, found.stop
    # rest lengths, areas and loads are those of the flat shape, whatever the plan of the tent
    noise = None if sigma is None else {"sigma": sigma, "seed": seed}
    scene = build_scene(settings(target__noise=noise, **changes), mesh, found.positions, flat)
    return Planted(replace(scene, loads=bare.loads), forces, found.positions)


# The pyramid: four spokes of plan length 1, rest length 3/4 and k = 1 from the held corners to one free vertex.
# Lifted by 3/4 the spokes are 5/4 long: each pulls 1/2, of which 3/5 is vertical: 4 x 1/2 x 3/5 = 6/5 newtons hold it.
PYRAMID_HEIGHT = 0.75
PYRAMID_FORCE = 1.2
PYRAMID_TENSION = 0.5
PYRAMID_AREA = 2 / 3  # a third of the plan area, square metres, is the top's


def pyramid(height=PYRAMID_HEIGHT, **changes):
    """Scene of the square pyramid: vertex 4 is the top; fabric and cables alike give k = 1 with the stiffness set here."""
    target = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, height]])
    mesh = mesh_from_faces(5, np.array([[0, 1, 4, -1], [1, 2, 4, -1], [2, 3, 4, -1], [3, 0, 4, -1]]))
    return build_scene(settings(**{"membrane__rest_scale": 0.75, **changes}), mesh, target, None)


class Line(NamedTuple):
    """Two springs in a row between walls at x = 0 and x = 2, the vertex between them free."""

    membrane: Membrane
    start: np.ndarray
    stiffness: float

    def answer(self, pull):
        """Where the free vertex rests under `pull` along x: k1 (x - L1) - k2 (2 - x - L2) = pull."""
        (k1, k2), (l1, l2) = self.membrane.spring_constant, self.membrane.rest_length
        return (pull + k1 * l1 + k2 * (2 - l2)) / (k1 + k2)


def line(springs=None):
    """Constants 1 and 3 N/m, rest lengths 0.5 and 0.4 m."""
    membrane = Membrane(
        np.array([[0, 1], [1, 2]]),
        np.array([0.5, 0.4]),
        np.array([1.0, 3.0]),
        Hookean() if springs is None else springs,
        np.array([True, False, True]),
    )
    return Line(membrane, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), 4.0)


def force_density_net(n=6, **changes):
    """A loaded force-density net of n x n vertices, q = 2: its shape is one linear solve (naive.force_density_shape)."""
    chosen = {"membrane__springs": "force-density", "membrane__stiffness": 2.0, "membrane__loads": [0.1, 0.0, -1.0]}
    return grid_scene(n, hill, **{**chosen, **changes})


def irregular(count=5, seed=0):
    """Mesh and positions of a square of jittered vertices, triangulated by Delaunay, with uneven heights; edge in plane."""
    rng = np.random.default_rng(seed)
    y, x = np.divmod(np.arange(count**2), count)
    inside = (x > 0) & (x < count - 1) & (y > 0) & (y < count - 1)
    positions = np.column_stack([x, y, np.zeros(count**2)]) / (count - 1)
    positions[inside] += rng.uniform(-0.25, 0.25, (inside.sum(), 3)) / (count - 1)
    triangles = Delaunay(positions[:, :2]).simplices
    return mesh_from_faces(count**2, np.column_stack([triangles, np.full(len(triangles), -1)])), positions


def irregular_scene(count=5, seed=0, **changes):
    """A scene on the irregular mesh; with the default rest_scale all edges are taut at the target."""
    mesh, positions = irregular(count, seed)
    return build_scene(settings(**changes), mesh, positions, None)


def mixed() -> tuple[Mesh, np.ndarray]:
    """A unit-square quad with a triangle of area 1/4 on its right side, all at z = 0: vertices 0 to 4."""
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.5, 0.5, 0]])
    return mesh_from_faces(5, np.array([[0, 1, 2, 3], [1, 4, 2, -1]])), positions


def convex_step(scene=None, fraction=0.2, at=None, candidates=None, **asked):
    """The convex step of a scene linearised at `at` (default: its flat start), weights a fraction of the largest useful one.

    `candidates`: how many, at random. Asked for may be a `metric`, (3n, 3n) sparse, a `spread` of the weights, a lognormal's
    sigma, and a `reach`.
    """
    reach, spread, metric = asked.get("reach", ANYTHING), asked.get("spread", 0.0), asked.get("metric")
    scene = planted(6, TWO_MASTS, 0.02).scene if scene is None else scene
    rng = np.random.default_rng(3)
    x = scene.start if at is None else at
    free = scene.membrane.free
    count = len(free)
    vertices = np.arange(count) if candidates is None else np.sort(rng.permutation(count)[:candidates])
    step = Subproblem(
        Factor(scene.membrane.stiffness(x)),
        csc_array(eye_array(3 * count)) if metric is None else metric,
        (x - scene.target)[free].ravel(),
        (scene.membrane.forces(x) + scene.loads[free]).ravel(),
        3 * vertices[:, None] + np.array(reach.axes),
        np.exp(spread * rng.normal(size=len(vertices))),
        reach,
    )
    largest = reach.pull(certify(step, step.nothing).dual) / step.weights
    return replace(step, weights=fraction * largest.max() * step.weights)


def convex_steps():
    """Small steps of every kind, by name; 16 free vertices each."""
    noisy = planted(6, TWO_MASTS, 0.02).scene
    loaded = planted(6, ONE_MAST, 0.02, membrane__loads=[0.0, 0.0, -0.2]).scene
    rng = np.random.default_rng(4)
    roots = rng.normal(size=(16, 3, 3))
    steps = {
        "heavy": convex_step(noisy, 0.7),
        "medium": convex_step(noisy, 0.2),
        "light": convex_step(noisy, 0.01),
        "nothing stands": convex_step(noisy, 1.01),
        "at the target": convex_step(noisy, 0.2, at=noisy.target),
        "loaded": convex_step(loaded, 0.1),
        "uneven weights": convex_step(noisy, 0.1, spread=1.0),
        "few candidates": convex_step(noisy, 0.1, candidates=5),
        "one candidate": convex_step(noisy, 0.1, candidates=1),
        "height alone": convex_step(noisy, 0.2, metric=csc_array(diags_array(np.tile([0.0, 0.0, 1.0], 16)))),
        "skewed metric": convex_step(noisy, 0.2, metric=csc_array(block_diag(list(roots @ roots.transpose(0, 2, 1))))),
        "damped": convex_step(noisy, 0.2).damped(0.5),
        "cones": convex_step(grid_scene(6, bumps, membrane__rest_scale=0.9), 0.05),
    }
    at = steps["at the target"]
    steps["a hair off the target"] = replace(at, offset=1e-12 * rng.normal(size=48))
    steps["millimetres"] = in_millimetres(steps["medium"])
    return steps | reach_steps()


def reach_steps():
    """Steps in which supports cannot do everything that they would, or some cost nothing; 16 free vertices each."""
    scene = planted(6, PULLED, 0.02).scene
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(16, 3))
    along_normals = csc_array(block_diag([np.outer(n, n) / (n @ n) for n in normals]))
    height = csc_array(diags_array(np.tile([0.0, 0.0, 1.0], 16)))
    lean = Reach(tangent=float(np.tan(np.pi / 6)))
    sideways = Reach(tangent=float(np.tan(np.pi / 2)))
    up = Reach((2,), 0.0)
    medium = convex_step(scene, 0.2)
    steps = {
        "vertical": convex_step(scene, 0.2, reach=Reach((2,))),
        "vertical, uneven weights": convex_step(scene, 0.05, spread=1.0, reach=Reach((2,))),
        "up": convex_step(scene, 0.1, reach=up),
        "lean 30": convex_step(scene, 0.1, reach=lean),
        "lean 30 along normals": convex_step(scene, 0.1, metric=along_normals, reach=lean),
        "lean 90": convex_step(scene, 0.02, reach=sideways),
        "capped": convex_step(scene, 0.1, reach=Reach(largest=CAP)),
        "vertical, capped": convex_step(scene, 0.1, reach=Reach((2,), largest=CAP)),
        "up, capped": convex_step(scene, 0.1, reach=replace(up, largest=CAP)),
        "lean 30, capped": convex_step(scene, 0.1, reach=replace(lean, largest=CAP)),
        "lean 90, capped": convex_step(scene, 0.05, reach=replace(sideways, largest=CAP)),
        "along normals": convex_step(scene, 0.2, metric=along_normals),
        "vertical, height alone": convex_step(scene, 0.1, metric=height, reach=Reach((2,))),
    }
    for name, count, base in [
        ("one kept", 1, medium),
        ("three kept, height alone", 3, convex_step(scene, 0.2, metric=height)),
        ("two kept, vertical", 2, steps["vertical"]),
        ("three kept, lean 30", 3, steps["lean 30"]),
        ("three kept, capped", 3, steps["capped"]),
        ("three kept, lean 30, capped", 3, steps["lean 30, capped"]),
        ("three kept, up", 3, steps["up"]),
    ]:
        weights = base.weights.copy()
        weights[rng.permutation(16)[:count]] = 0.0
        steps[name] = replace(base, weights=weights)
    bends = rng.uniform(0.2, 2, 16) * np.trace(medium.factor.solve(medium.factor.solve(np.eye(48)))) / 48
    steps["least squares"] = replace(medium, weights=0 * bends, curvature=bends)
    steps["bent, capped"] = replace(steps["vertical, capped"], curvature=0.1 * bends)
    return steps


PULLED = (((0.25, 0.25), (0.25, 0.1, 0.2)), ((0.75, 0.5), (0.1, 0.0, -0.25)), ((0.5, 0.75), (0.0, -0.3, 0.1)))
CAP = 0.08  # newtons: some of the supports in the steps above would carry more


def in_millimetres(step):
    """The same step, its metres and newtons written as millimetres and kilonewtons."""
    return replace(
        step,
        factor=Factor(csc_array(1e-6 * step.stiffness)),
        offset=1e3 * step.offset,
        load=1e-3 * step.load,
        weights=1e9 * step.weights,
    )


UNEVEN = {
    "hookean": {},
    "loads": {"membrane__loads": [0.02, 0.0, -0.05]},
    "force density": {"membrane__springs": "force-density"},
    "tension-only": {"membrane__springs": "tension-only"},
    "vertical": {"supports__direction": "vertical"},
    "group lasso": {"penalty__name": "group-lasso"},
}


def uneven(name, every=5, **changes):
    """Two masts on a target that they cannot reach (noise), at uneven costs; with `every` some vertices are no candidates."""
    wanted = {"penalty__weight": 5e-3, **UNEVEN[name], **changes}
    scene = planted(6, TWO_MASTS, sigma=0.02, **wanted).scene
    candidates = scene.candidates & ((np.arange(scene.mesh.vertices) % every != 0) if every else True)
    return replace(scene, support_weight=np.linspace(0.6, 1.4, scene.mesh.vertices), candidates=candidates)


def floating(n=7, sigma=None, seed=0, **changes):
    """A square of n x n vertices without a fixed one, pulled out and down at its corners and pushed up in the middle.

    Loads in `changes` are shared out among the corners, so that the forces balance.
    """
    mesh, flat = grid(n)
    bare = build_scene(settings(supports__fixed="none", **changes), mesh, flat, None)
    forces, corners = np.zeros_like(flat), [0, n - 1, n * n - n, n * n - 1]
    forces[corners] = np.sign(flat[corners] - 0.5) * [1.0, 1.0, 0.0] - [0.0, 0.0, 0.15]
    forces[n * n // 2, 2] = 0.6
    forces[corners] -= bare.loads.sum(axis=0) / 4
    found = find_equilibrium(bare.membrane, flat, forces + bare.loads)
    assert found.found, found.stop
    noise = None if sigma is None else {"sigma": sigma, "seed": seed}
    scene = build_scene(settings(supports__fixed="none", target__noise=noise, **changes), mesh, found.positions, flat)
    return Planted(replace(scene, loads=bare.loads), forces, found.positions)


def loose(law):
    """Three vertices in a row that nothing holds, their two springs stretched, and where they are."""
    membrane = Membrane(np.array([[0, 1], [1, 2]]), np.array([0.8, 0.8]), np.ones(2), law, np.zeros(3, dtype=bool))
    return membrane, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])


LOST, BALANCED = np.array([[0.0, 0, 1], [0, 0, 0], [0, 0, 0]]), np.array([[-0.5, 0, 0], [0, 0, 0], [0.5, 0, 0]])


def rest_in_millimetres(membrane, start, applied):
    """A membrane, where it begins and what is applied, written in millimetres and kilonewtons."""
    other = replace(membrane, rest_length=1e3 * membrane.rest_length, spring_constant=1e-6 * membrane.spring_constant)
    return other, 1e3 * start, 1e-3 * applied


# what a method meets on the way to planted masts, without noise
PLANTED = [{}, {"membrane__springs": "force-density"}, {"membrane__loads": [0.0, 0.0, -0.02]}, {"penalty__exponent": 0.8}]
