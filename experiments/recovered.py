"""One planted scene, one formulation, one weight: what `recovery.py` measures. Everything follows from the case's plain values.

A square membrane of fabric, side 1 m, 1 N/m, edge fixed, is brought to rest under masts at known vertices; that shape with noise
is the target. The weight is such that a typical mast (the median planted force) costs `level` times the variance of the noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

import relax
from relax.arrays import Floats, Ints
from relax.design.methods import method_by_name
from relax.design.refit import refit
from relax.design.shape import Shape
from relax.errors import RelaxError
from relax.files.schema import resolve

FORCE, LEAN = (0.2, 0.4), 15.0  # newtons; degrees at most
MARGIN = 2  # edges between a mast and the fixed edge: nearer, the edge carries most of it
FLOOR = 0.001  # of the mast height: what counts as noise where there is none
MANY = 40  # supports: with more nothing was found that could be refitted
SCALES = {
    "log-sum": ("scale", 0.1),
    "mcp": ("knee", 1.0),
    "scad": ("knee", 1 / 3.7),
}  # of a typical force, as relax.compare has them
COLUMNS = (
    *(
        "vertices",
        "height",
        "sigma",
        "nearest",
        "supports",
        "hits",
        "near",
        "precision",
        "recall",
        "near_precision",
        "near_recall",
    ),
    *("force_error", "debiased_error", "rms", "rms_clean", "debiased_rms", "debiased_clean", "objective", "stationarity"),
    *("off_support", "converged", "stop"),
)


@dataclass(frozen=True)
class Planted:
    """A scene with noise, the forces (V, 3) that made it, their height in metres and the standard deviation of the noise."""

    scene: relax.Scene
    forces: Floats
    height: float
    sigma: float

    @property
    def vertices(self) -> Ints:
        """Where masts stand."""
        return np.flatnonzero(self.forces.any(axis=1))


def measure(case: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a case: seed, edges, masts, spacing, noise; penalty, exponent, method, level."""
    planted = plant(case["seed"], case["edges"], case["masts"], case["spacing"], case["noise"])
    typical = float(np.median(np.linalg.norm(planted.forces[planted.vertices], axis=1)))
    penalty = penalty_of(case["penalty"], case["exponent"], typical)
    spread = max(planted.sigma, FLOOR * planted.height)
    weight = case["level"] * spread**2 / float(penalty.value(np.array([typical]))[0])
    problem = relax.Problem(planted.scene, penalty=penalty, weight=weight)
    design = relax.solve(problem, method=method_by_name(case["method"]))
    said = design.certificate
    figures = ("objective", "stationarity", "off_support", "converged")
    return {
        "vertices": problem.scene.mesh.vertices,
        "height": planted.height,
        "sigma": spread,
        "nearest": nearest(planted.vertices, case["edges"]),
        **agreement(planted, design.forces),
        "force_error": force_error(planted, design.forces),
        "rms": said.rms_distance,
        "rms_clean": root_mean_square(design.positions - planted.scene.clean_target),
        **debiased(problem, planted, design),
        **{name: getattr(said, name) for name in figures},
        "stop": design.stop,
    }


def penalty_of(name: str, exponent: float, typical: float) -> Any:
    """A penalty by name, its scale that of a typical force in newtons."""
    if name == "power":
        return relax.Power(exponent=exponent)
    key, share = SCALES.get(name, ("", 0.0))
    kinds = {"group-lasso": relax.GroupLasso, "log-sum": relax.LogSum, "mcp": relax.MCP, "scad": relax.SCAD, "count": relax.Count}
    return kinds[name](**({key: share * typical} if key else {}))


def plant(seed: int, edges: int, masts: int, spacing: int, noise: float) -> Planted:
    """Masts at random, each `spacing` edges (or up to one more) from the nearest before it; noise as a share of their height."""
    generator = np.random.default_rng(seed)
    side = edges + 1
    forces = np.zeros((side * side, 3))
    for vertex in places(generator, edges, masts, spacing):
        size, lean, turn = generator.uniform([FORCE[0], 0, 0], [FORCE[1], np.radians(LEAN), 2 * np.pi])
        forces[vertex] = size * np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])
    row, column = np.divmod(np.arange(side * side), side)
    mesh, flat = relax.grid_mesh(side, side, "alternating"), np.column_stack([column, row, 0 * row]) / edges
    said = resolve({"target": {"mesh": "planted.obj"}, "membrane": {"rest": "flat.obj"}}, "planted")
    said["supports"]["ground"] = 0.0
    shape = relax.form(relax.Problem(relax.build_scene(said, mesh, flat, flat), weight=1.0), forces)
    if not shape.certificate.equilibrium < 1e-10:
        raise RuntimeError(f"no rest under the planted forces: {shape.stop}")
    height = float(np.mean(shape.positions[forces.any(axis=1), 2]))
    sigma = noise * height
    said["target"]["noise"] = {"sigma": sigma, "seed": seed} if sigma else None
    scene = relax.build_scene(said, mesh, shape.positions, flat)
    # the one engine that is always there, so that rows do not depend on what else is installed
    return Planted(replace(scene, engine="superlu"), forces, height, sigma)


def places(generator: np.random.Generator, edges: int, masts: int, spacing: int) -> list[int]:
    """Vertices of the masts; where there is no room they stand closer, an edge at a time."""
    inside = np.arange(MARGIN, edges - MARGIN + 1)
    room = np.stack(np.meshgrid(inside, inside), axis=-1).reshape(-1, 2)
    chosen = [room[generator.integers(len(room))]]
    while len(chosen) < masts:
        apart = np.min([np.hypot(*(room - one).T) for one in chosen], axis=0)
        may = np.flatnonzero((apart >= spacing) & (apart < spacing + 1))
        if not len(may):
            return places(generator, edges, masts, spacing - 1)
        chosen.append(room[generator.choice(may)])
    return [int(y * (edges + 1) + x) for x, y in chosen]


def nearest(vertices: Ints, edges: int) -> float:
    """The smallest distance between two masts, in edges; infinite for one."""
    at = np.column_stack(np.divmod(vertices, edges + 1)).astype(float)
    apart = np.hypot(*(at[:, None] - at[None, :]).transpose(2, 0, 1))
    return float(apart[~np.eye(len(at), dtype=bool)].min(initial=np.inf))


def agreement(planted: Planted, forces: Floats) -> dict[str, Any]:
    """How the supports found agree with the planted ones: at the very vertex, and one to one within an edge of the mesh."""
    true, found = planted.vertices, np.flatnonzero(forces.any(axis=1))
    hits = len(np.intersect1d(true, found))
    beside = np.eye(len(forces), dtype=bool)
    one, other = planted.scene.mesh.edges.T
    beside[one, other] = beside[other, one] = True
    close = beside[np.ix_(true, found)]
    near = int(close[linear_sum_assignment(close, maximize=True)].sum())
    shares = {"precision": hits, "near_precision": near}
    return {
        "supports": len(found),
        "hits": hits,
        "near": near,
        **{name: count / len(found) if len(found) else None for name, count in shares.items()},
        "recall": hits / len(true),
        "near_recall": near / len(true),
    }


def force_error(planted: Planted, forces: Floats) -> float | None:
    """|p - p*| / |p*| over the masts that were found at their vertices; nothing where none was."""
    both = planted.forces.any(axis=1) & forces.any(axis=1)
    true = np.linalg.norm(planted.forces[both])
    return float(np.linalg.norm((forces - planted.forces)[both]) / true) if both.any() else None


def debiased(problem: relax.Problem, planted: Planted, design: relax.Design) -> dict[str, Any]:
    """The same supports with the penalty dropped: forces, and distances to the noisy and to the clean shape."""
    names = ("debiased_error", "debiased_rms", "debiased_clean")
    amplitudes = problem.supports.amplitudes(design.forces[problem.membrane.free])
    if not 0 < design.certificate.supports <= MANY:
        return dict.fromkeys(names)
    try:
        shape = refit(problem, Shape(design.positions, amplitudes, None, 0), "debiased")
    except RelaxError:
        return dict.fromkeys(names)
    scene, forces = problem.scene, problem.all_forces(shape.amplitudes)
    noisy, clean = (root_mean_square(shape.positions - target) for target in (scene.target, scene.clean_target))
    return dict(zip(names, (force_error(planted, forces), noisy, clean), strict=True))


def root_mean_square(offset: Floats) -> float:
    """Of the lengths of vectors (V, 3)."""
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))
