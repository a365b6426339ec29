"""How far the heuristics are from the true optimum, where that can be had.

Question: on small force-density nets, how far from the fewest and best supports of all do the formulations and methods end?

    python experiments/optimum.py               five minutes
    python experiments/optimum.py --size small  some seconds

Nets of 8 x 8 and 10 x 10 vertices with a fixed edge, three supports planted at random, 36 or 60 candidates, noise of 5 % of the
height, several seeds. Two objectives, each with the method `exact` as reference:

- counted: E_dist + k count. Every formulation is solved at weights from heavy to light, its supports are refitted without penalty
  and what is best in E_dist + k count is taken; `greedy` also minimises the count itself.
- power: the paper's objective (alpha = 0.5), in which value, lower bound and gap are those of the best point known.

A row is one formulation and method over all seeds: in how many scenes it is at the optimum (the best point known), and how far
above it, in the middle and at worst. Exit status 1 if any value is below a lower bound, or a counted optimum is not proven.

Finding: in all 16 scenes the counted optimum is proven, in 0.1 s in the middle. The power penalty over ten weights has the
supports of that optimum in every one of them, by either method; the group lasso in 2, and ends 20 to 40 % too high in the
middle, twice as high at worst; greedy on the count itself, without a penalty that guides it, is there in 11 and up to 34 % too
high. For the paper's own objective both methods end at the best point known in 15 scenes; in the other one the tree finds one
7 % lower. It proves that none is more than 0.4 % lower still in the middle, 2 % at worst.
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
from rows import measured

import relax
from relax.design.methods.exact import best_subset
from relax.design.methods.greedy import greedy
from relax.design.methods.quadratic import Quadratic, quadratic_of
from relax.sparsity.penalties import PENALTIES, Count, Penalty

DATA = Path(__file__).parent.parent / "data"
CANDIDATES = {"small": (25,), "full": (36, 60)}  # of 7 x 7, 8 x 8 and 10 x 10 vertices
SIDES = {25: 7, 36: 8, 60: 10}
SEEDS = {"small": 1, "full": 8}
SHARES = {"small": (0.3, 0.05), "full": tuple(np.geomspace(0.6, 0.005, 10))}  # of the largest useful weight
SECONDS = {"small": 3.0, "full": 30.0}
COUNTED = 2e-3  # square metres a support
PAPER = 4e-3
SAME = 2e-6  # relative: what the tree's own tolerance leaves
METHODS = {"sequential": None, "greedy": greedy}
PARAMETERS = {
    "group-lasso": {},
    "power": {"exponent": 0.5},
    "log-sum": {"scale": 0.02},
    "mcp": {"knee": 0.3},
    "scad": {"knee": 0.1},
}


def formulations() -> dict[str, Penalty]:
    """The penalties that stand for the count, by name."""
    return {name: PENALTIES[name](**chosen) for name, chosen in PARAMETERS.items()}


def net(candidates: int, seed: int) -> relax.Problem:
    """A net brought to rest under three forces at random candidates, with noise."""
    side = SIDES[candidates]
    row, column = np.divmod(np.arange(side * side), side)
    flat = np.column_stack([column, row, 0 * row]) / (side - 1)
    mesh = relax.grid_mesh(side, side, "alternating")
    inside = np.flatnonzero((row > 0) & (row < side - 1) & (column > 0) & (column < side - 1))
    said = relax.load_scene(DATA / "tent.toml").settings
    springs = {**said["membrane"], "springs": "force-density", "stiffness": 1.0}
    some = {**said["supports"], "candidates": [int(vertex) for vertex in inside[:candidates]]}
    settings = {**said, "membrane": springs, "supports": some}
    rng = np.random.default_rng(seed)
    forces = np.zeros_like(flat)
    chosen = rng.choice(inside[:candidates], 3, replace=False)
    forces[chosen] = rng.normal(0, 0.03, (3, 3)) + np.outer(rng.choice([-1, 1], 3) * rng.uniform(0.2, 0.5, 3), [0, 0, 1])
    shape = relax.form(relax.Problem(relax.build_scene(settings, mesh, flat, flat), weight=1.0), forces).positions
    noise = {"sigma": 0.05 * float(np.abs(shape[:, 2]).max()), "seed": seed}
    noisy = {**settings, "target": {**settings["target"], "noise": noise}}
    return relax.Problem(relax.build_scene(noisy, mesh, shape, flat), weight=1.0)


def counted(quadratic: Quadratic, standing: np.ndarray, price: float) -> float:
    """E_dist + price * count with the forces refitted without a penalty."""
    members = np.flatnonzero(standing)
    index = (3 * members[:, None] + np.arange(3)).ravel()
    forces = np.zeros_like(quadratic.linear)
    if len(members):
        fitted = np.linalg.solve(quadratic.gram[np.ix_(index, index)], -quadratic.linear.ravel()[index])
        forces[members] = fitted.reshape(-1, 3)
    return quadratic.distance(forces) + price * len(members)


def standing(problem: relax.Problem, design: relax.Design) -> np.ndarray:
    """Which candidates carry a force (m,)."""
    forces: np.ndarray = design.forces[problem.membrane.free][problem.supports.vertices]
    return forces.any(axis=1)


@dataclass(frozen=True)
class Result:
    """What one formulation and method came to in one scene."""

    label: tuple[str, str, str]  # objective, formulation, method
    value: float
    bound: float  # of the exact method
    best: float  # the best point known
    seconds: float


def in_counts(problem: relax.Problem, size: str) -> list[Result]:
    """E_dist + k count by everything."""
    quadratic = quadratic_of(problem)
    exact_problem = problem.replace(penalty=Count(), weight=COUNTED)
    found = best_subset(exact_problem, SECONDS[size])
    results = [Result(("counted", "count", "exact"), found.value, found.bound, found.value, found.seconds)]
    design = relax.solve(exact_problem, method=greedy)
    value = counted(quadratic, standing(problem, design), COUNTED)
    results.append(Result(("counted", "count", "greedy"), value, found.bound, found.value, design.seconds))
    for name, penalty in formulations().items():
        for method, function in METHODS.items():
            begin, values = time.perf_counter(), []
            for share in SHARES[size]:
                design = relax.solve(weighed(problem.replace(penalty=penalty), share), method=function)
                values.append(counted(quadratic, standing(problem, design), COUNTED))
            seconds = time.perf_counter() - begin
            results.append(Result(("counted", name, method), min(values), found.bound, found.value, seconds))
    return results


def weighed(problem: relax.Problem, share: float) -> relax.Problem:
    """With a share of the largest useful weight."""
    said = problem.scene.settings
    priced = {**said, "penalty": {**said["penalty"], "weight": None, "weight_fraction": share}}
    return relax.Problem(replace(problem.scene, settings=priced), penalty=problem.penalty)


def in_powers(problem: relax.Problem, size: str) -> list[Result]:
    """The paper's objective by the exact method and the others."""
    problem = problem.replace(penalty=relax.Power(exponent=0.5), weight=PAPER)
    found = best_subset(problem, SECONDS[size])
    results = [(("power", "power", "exact"), found.value, found.seconds)]
    for method, function in METHODS.items():
        design = relax.solve(problem, method=function)
        results.append((("power", "power", method), design.certificate.objective, design.seconds))
    best = min(value for _, value, _ in results)
    return [Result(label, value, found.bound, best, seconds) for label, value, seconds in results]


def rows_of(size: str) -> list[dict[str, object]]:
    """One row a formulation and method, over the seeds."""
    rows = []
    for candidates in CANDIDATES[size]:
        results: dict[tuple[str, str, str], list[Result]] = {}
        for seed in range(SEEDS[size]):
            problem = net(candidates, seed)
            for result in (*in_counts(problem, size), *in_powers(problem, size)):
                results.setdefault(result.label, []).append(result)
        rows += [{"candidates": candidates, **summary(label, each)} for label, each in results.items()]
    return rows


def summary(label: tuple[str, str, str], results: list[Result]) -> dict[str, object]:
    """One row."""
    above = [result.value / result.best - 1 for result in results]
    gaps = [1 - result.bound / result.value for result in results]
    return {
        "objective": label[0],
        "formulation": label[1],
        "method": label[2],
        "scenes": len(results),
        "at the optimum": sum(each <= SAME for each in above),
        "above it, median": max(median(above), 0.0),
        "above it, worst": max(*above, 0.0),
        "above the bound, median": median(gaps),
        "above the bound, worst": max(gaps),
        "below the bound": sum(gap < -SAME for gap in gaps),
        "seconds": median(result.seconds for result in results),
    }


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__, CANDIDATES, rows_of)
    proven = [row["above the bound, worst"] <= SAME for row in rows if (row["objective"], row["method"]) == ("counted", "exact")]
    return 0 if all(proven) and not any(row["below the bound"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
