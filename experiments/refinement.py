"""Refinement: whether the answer stays as the mesh gets finer.

Question: are the masts, their forces and the objective those of the scene or those of its mesh, and what do area weights and the
material have to do with it?

    python experiments/refinement.py               under a minute
    python experiments/refinement.py --size small  some seconds

Two smooth hills, h (1 - d^2 / r^2)^2, on the unit square with a fixed edge, sampled at 13 x 13 vertices and with half the mesh
width each time. `fabric` weighs each vertex by its plan area; `no area weights` counts vertices, with the weight that means the
same on the coarsest mesh; `net` has area weights and edges of one EA, as stiff as the fabric on the coarsest mesh. `off` is how
far the nearest support is from a support of the coarsest mesh, at most, in cells of that mesh. Besides, one force of 0.14 N under
the flat membrane at (1/4, 1/3): `tip` is how high it lifts its vertex, `beside` how high a point one coarse cell from it. Exit
status 1 if a run does not converge, or if with fabric a mast comes, goes or moves by more than a coarse cell.

Finding: with fabric and area weights both masts stay within three quarters of a coarse cell, and from 169 to 9,409 vertices the
objective moves by 0.4 % in all, by 0.02 % in the last step. Without area weights the distance grows with the number of vertices
and the penalty does not: the objective about doubles at each halving, and 2 masts become 4 and 14. A net of one EA doubles in
stiffness instead: so do the forces, more or less, and then masts are given up. A point force on a membrane has a logarithmic
singularity: in the last steps the tip rises by 1.2 cm at each halving and does not settle, while one coarse cell away the height
moves by less than 0.1 %. The area of the tip vanishes faster than it rises, so that supports, forces and objective settle; the
heights of mast heads do not.
"""

import sys
import time
from pathlib import Path

import numpy as np
from price import square
from rows import measured

import relax

DATA = Path(__file__).parent.parent / "data"
COARSE = 13  # vertices a side
SIDES = {"small": (13, 25), "full": (13, 25, 49, 97)}
HILLS = ((0.3, 0.35, 0.25, 0.20), (0.7, 0.6, 0.22, 0.25))  # x, y, height h, radius r
WEIGHT = 1e-3  # with area weights, m4 / N^(1/2)
CELL = 1 / (COARSE - 1)
CASES = {  # what differs from data/bumps.toml: [target], [membrane], the weight, the most vertices a side
    "fabric": ({"area_weights": True}, {}, WEIGHT, 97),
    "no area weights": ({}, {}, WEIGHT / CELL**2, 49),  # beyond, dozens of supports and minutes
    "net": ({"area_weights": True}, {"material": "cables", "stiffness": CELL}, WEIGHT, 97),
}
LIFT = 0.14  # newtons: about what a mast carries in the answers
LIFTED = (0.25, 1 / 3)  # a vertex of every mesh


def hills(side: int, case: str) -> relax.Problem:
    """The two hills on `side` x `side` vertices."""
    target, membrane, weight, _ = CASES[case]
    mesh, positions = square(side)
    for x, y, height, radius in HILLS:
        away = ((positions[:, 0] - x) ** 2 + (positions[:, 1] - y) ** 2) / radius**2
        positions[:, 2] += height * np.maximum(1 - away, 0) ** 2
    settings = relax.load_scene(DATA / "bumps.toml").settings
    settings = {**settings, "target": {**settings["target"], **target}, "membrane": {**settings["membrane"], **membrane}}
    return relax.Problem(relax.build_scene(settings, mesh, positions, None), weight=weight)


def lifted(problem: relax.Problem, side: int) -> tuple[float, float]:
    """How high one force lifts its own vertex and one beside it, metres."""
    column, row = (round(place * (side - 1)) for place in LIFTED)
    forces = np.zeros_like(problem.scene.target)
    forces[row * side + column, 2] = LIFT
    height = relax.form(problem, forces).positions[:, 2]
    return float(height[row * side + column]), float(height[row * side + column + round(CELL * (side - 1))])


def measure(side: int, case: str) -> tuple[dict[str, object], np.ndarray]:
    """One row, and where the supports stand in the plan of the target (k, 2)."""
    problem = hills(side, case)
    begin = time.perf_counter()
    design = relax.solve(problem)
    seconds = time.perf_counter() - begin
    said = design.certificate
    tip, beside = lifted(problem, side)
    row = {
        "case": case,
        "vertices": side**2,
        "supports": said.supports,
        "largest force, N": max((mast.magnitude for mast in design.supports), default=0.0),
        "objective": said.objective,
        "distance": said.distance,
        "rms distance, m": said.rms_distance,
        "tip, m": tip,
        "beside, m": beside,
        "converged": said.converged,
        "seconds": seconds,
    }
    return row, problem.scene.clean_target[[mast.vertex for mast in design.supports], :2]


def off(coarse: np.ndarray, fine: np.ndarray) -> float:
    """Largest distance from a support of the coarsest mesh to the nearest one here, in coarse cells."""
    if not len(fine):
        return np.inf
    apart = np.linalg.norm(coarse[:, None] - fine[None], axis=2)
    return float(apart.min(axis=1).max(initial=0.0)) / CELL


def all_rows(size: str) -> list[dict[str, object]]:
    """The rows of each case, from coarse to fine."""
    rows = []
    for case, (*_, finest) in CASES.items():
        coarse = None
        for side in (side for side in SIDES[size] if side <= finest):
            row, places = measure(side, case)
            coarse = places if coarse is None else coarse
            rows.append({**row, "off": off(coarse, places)})
    return rows


def stays(rows: list[dict[str, object]]) -> bool:
    """Whether fabric keeps its masts, each within a coarse cell."""
    fabric = [row for row in rows if row["case"] == "fabric"]
    return len({row["supports"] for row in fabric}) == 1 and all(row["off"] <= 1 for row in fabric)


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__, SIDES, all_rows)
    return 0 if all(row["converged"] for row in rows) and stays(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
