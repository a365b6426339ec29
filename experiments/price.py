"""The price of inverse design: a whole inverse run beside one forward form-finding of the same membrane.

Question: what does the run from the target to judged supports cost, in units of one forward form-finding from flat under the
supports that it found?

    python experiments/price.py               a quarter of an hour
    python experiments/price.py --size small  some seconds

- planted: square membranes of fabric with a fixed edge, prestressed by rest_scale 0.7, brought to rest under one or five masts;
  without noise, and with noise of 2 % of the height; alpha = 0.5. Weights grow with the number of vertices, so that the
  penalty keeps its share of the objective. `exact` says whether the supports found are the planted vertices.
- bumps: the scene of data/ with its formula sampled more finely; terrain: the scene of data/ as it is, some 25 supports.

Forward and inverse take turns in one process with the same factorisation engine; reading and writing are left out; medians. Each
row runs in a process of its own, so that `peak, GB` is its own. `engine` is the one that is always there, up to 100 x 100
vertices, and the fastest that is installed. Exit status 1 if a run does not converge or costs more than `at most`.

Finding: every planted mast is found and no other, and every row holds `at most` (one run; a few per cent are the clock's).
Without noise the inverse run costs 0.9 to 1.5 forward runs; with noise 2.2 to 2.5 with SuperLU and 2.5 to 3.3 with rslab, whose
forward run gains more than the inverse one, at 90,000 vertices too, where the noise is larger than an edge. Bumps cost 5.6 to
7.7, terrain 10 to 14.
"""

import statistics
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from make_data import BUMPS
from rows import in_own_processes, measured, peak_gigabytes

import relax
from relax.factor import available_engines

DATA = Path(__file__).parent.parent / "data"
MASTS = {
    1: [(0.40, 0.35, (0.02, 0.0, 0.3))],
    5: [
        (0.30, 0.30, (0.02, 0.0, 0.3)),
        (0.70, 0.30, (0.0, 0.05, -0.2)),
        (0.50, 0.70, (0.05, 0.0, 0.3)),
        (0.25, 0.75, (0.0, -0.05, 0.2)),
        (0.80, 0.75, (0.03, 0.0, -0.25)),
    ],
}
NOISE = 0.005  # metres: about 2 % of the height of a mast
SIDES = {"small": (21,), "full": (50, 100, 200, 300)}
BUMPS_SIDES = {"small": (21,), "full": (50, 100)}
ALWAYS_UP_TO = 100  # vertices a side: beyond, the engine that is always there is left to scale.py
ROUNDS = {"small": 1, "full": 5}


def square(side: int) -> tuple[relax.Mesh, np.ndarray]:
    """Mesh and flat positions of `side` x `side` vertices over the unit square."""
    row, column = np.divmod(np.arange(side * side), side)
    return relax.grid_mesh(side, side, "alternating"), np.column_stack([column, row, 0 * row]) / (side - 1)


def planted(side: int, masts: int, sigma: float) -> tuple[relax.Problem, np.ndarray]:
    """A membrane brought to rest under known forces, as the target, and those forces (V, 3)."""
    mesh, flat = square(side)
    settings = relax.load_scene(DATA / "tent.toml").settings
    forces = np.zeros_like(flat)
    for x, y, force in MASTS[masts]:
        forces[round(y * (side - 1)) * side + round(x * (side - 1))] = force
    shape = relax.form(relax.Problem(relax.build_scene(settings, mesh, flat, flat)), forces).positions
    noise = {"sigma": sigma, "seed": 0} if sigma else None
    noisy = {**settings, "target": {**settings["target"], "noise": noise}}
    weight = (0.02 if sigma else 0.001) * (side / 21) ** 2
    return relax.Problem(relax.build_scene(noisy, mesh, shape, flat), weight=weight), forces


def bumps(side: int) -> relax.Problem:
    """The scene `bumps` on `side` x `side` vertices."""
    mesh, target = square(side)
    for x, y, radius, height in BUMPS:
        cap = height * (1 - ((target[:, 0] - x) ** 2 + (target[:, 1] - y) ** 2) / radius**2)
        target[:, 2] = np.maximum(target[:, 2], cap)
    settings = relax.load_scene(DATA / "bumps.toml").settings
    scene = relax.build_scene(settings, mesh, target, None)
    return relax.Problem(scene, weight=settings["penalty"]["weight"] * (side / 26) ** 2)


@dataclass(frozen=True)
class Case:
    """One row to be measured, and what its run may cost in forward runs."""

    kind: str
    side: int
    masts: int
    sigma: float
    at_most: float
    aim: float


def measure(case: Case, engine: str, rounds: int) -> dict[str, object]:
    """One row."""
    forces = None
    if case.kind == "planted":
        problem, forces = planted(case.side, case.masts, case.sigma)
    else:
        problem = bumps(case.side) if case.kind == "bumps" else relax.Problem(relax.load_scene(DATA / f"{case.kind}.toml"))
    problem = problem.replace(scene=replace(problem.scene, engine=engine))
    design = relax.solve(problem)  # once before the clock: imports, and what is analysed once a mesh
    forward, inverse = [], []
    for _ in range(rounds):
        forward.append(relax.form(problem, design.forces).seconds)
        inverse.append(relax.solve(problem).seconds)
    said = design.certificate
    return {
        "case": case.kind + (f", {case.masts}" if case.masts else ""),
        "vertices": problem.scene.mesh.vertices,
        "noise, m": case.sigma,
        "engine": engine,
        "forward, s": statistics.median(forward),
        "inverse, s": statistics.median(inverse),
        "inverse / forward": statistics.median(inverse) / statistics.median(forward),
        "at most": case.at_most,
        "aim": case.aim,
        "supports": said.supports,
        "exact": "" if forces is None else bool(np.array_equal(design.forces.any(axis=1), forces.any(axis=1))),
        "objective": said.objective,
        "stationarity": said.stationarity,
        "converged": said.converged,
        "peak, GB": peak_gigabytes(),
    }


def all_rows(size: str) -> list[dict[str, object]]:
    """Every row of one size, for the engine that is always there and the fastest."""
    planted_cases = [
        Case("planted", side, masts, sigma, *bounds)
        for sigma, bounds in ((0.0, (1.5, 1.0)), (NOISE, (4.0, 2.0)))
        for side in SIDES[size]
        for masts in MASTS
    ]
    others = [Case("bumps", side, 0, 0.0, 8.0, 4.0) for side in BUMPS_SIDES[size]]
    cases = [*planted_cases, *others, Case("terrain", 0, 0, 0.0, 15.0, 6.0)]
    fastest = available_engines()[0]
    always = [case for case in cases if case.side <= ALWAYS_UP_TO] if fastest != "superlu" else []
    work = [(case, "superlu") for case in always] + [(case, fastest) for case in cases]
    return in_own_processes(measure, [(case, engine, ROUNDS[size]) for case, engine in work])


def main() -> int:
    """Measure and print; what is too dear counts at full size only, where the clock can tell."""
    rows = measured(__doc__, SIDES, all_rows)
    dear = [row for row in rows if row["inverse / forward"] > row["at most"]]
    small = rows[0]["vertices"] < 2500
    return 0 if all(row["converged"] for row in rows) and (small or not dear) else 1


if __name__ == "__main__":
    sys.exit(main())
