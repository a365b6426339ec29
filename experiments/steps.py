"""One convex step by every back-end, and which is the fastest for how many supports of which kind.

Question: what do the working set, Clarabel, OSQP and cvxpy make of the same convex steps, in value, gap and seconds?

    python experiments/steps.py               about a minute
    python experiments/steps.py --size small  some seconds

The steps are linearised at the membrane without supports, towards a planted tent with noise, under constant weights that let
more and more supports stand (`share` of the largest useful weight). `reach` says what a support can do: act in any direction,
vertically, lean at most 10 degrees, or vertically with at most 0.05 newtons. Value and gap are recomputed from the step's
data and never taken from a solver; `apart` is the difference to the best value, relative; seconds are those of all cores. Exit
status 1 if two differ by more than 1e-6.

Finding: they agree to the last digits, gaps below 1e-12. At 2,304 free vertices and supports in any direction the working set is
some 70 times faster than the cone program with 3 supports standing, three times with 42 and no faster with 64. With vertical
supports, one column a candidate instead of three, it is 57 times faster with 20 standing and 16 times with 46. Cones and largest
forces cost it little. OSQP takes two to four times as long as Clarabel on most vertical steps.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rows import measured

import relax
from relax.convex.backends import BACKENDS
from relax.convex.subproblem import Subproblem, certify
from relax.convex.working_set import solve_on_working_set
from relax.design.problem import Problem
from relax.design.starts import unsupported
from relax.membrane.mesh import grid_mesh
from relax.sparsity.reach import ANYTHING, Reach

SHARES = {"small": (0.5, 0.1), "full": (0.5, 0.1, 0.02, 0.005, 0.002)}
LIMITED = {"small": (0.1,), "full": (0.1, 0.01)}  # shares of the steps in which supports cannot do everything
SIDES = {"small": (14,), "full": (22, 50)}
REACHES = {
    "any": ANYTHING,
    "vertical": Reach((2,)),
    "lean 10": Reach(tangent=float(np.tan(np.radians(10)))),
    "vertical, capped": Reach((2,), largest=0.05),
}
SMALL = 30  # vertices a side up to which cvxpy and OSQP take part: beyond, each takes longer than all the rest of this table
NO_LIMIT = 10**6


def noisy_tent(side: int) -> Problem:
    """A unit square of `side` x `side` vertices raised by one off-centre mast, with noise of 5 mm."""
    mesh = grid_mesh(side, side, "alternating")
    row, column = np.divmod(np.arange(side * side), side)
    flat = np.column_stack([column, row, 0 * row]) / (side - 1)
    settings = relax.load_scene(Path(__file__).parent.parent / "data" / "tent.toml").settings
    planted = relax.build_scene(settings, mesh, flat, flat)
    forces = np.zeros_like(flat)
    forces[(side // 3) * side + 2 * side // 5] = 0.02, 0.0, 0.3
    shape = relax.form(Problem(planted), forces).positions
    noisy = {**settings, "target": {**settings["target"], "noise": {"sigma": 0.005, "seed": 0}}}
    return Problem(relax.build_scene(noisy, mesh, shape, flat))


def step_of(problem: Problem, reach: Reach, share: float) -> tuple[Subproblem, np.ndarray]:
    """The convex step of supports with that reach at the membrane without supports, and the start."""
    shape = unsupported(problem)
    ones = np.ones(len(problem.supports.weights))
    whole = problem.linearised(shape.positions, problem.factor_at(shape.positions), ones)
    step = replace(whole, rows=whole.rows[:, list(reach.axes)], reach=reach)
    largest = reach.pull(certify(step, step.nothing).dual).max()
    return replace(step, weights=share * largest * ones), step.nothing


def measure(side: int, name: str, share: float) -> list[dict[str, object]]:
    """One row a back-end for one step."""
    step, start = step_of(noisy_tent(side), REACHES[name], share)
    methods = {"working set": lambda step, start: solve_on_working_set(step, start, NO_LIMIT), "clarabel": BACKENDS["clarabel"]}
    if side <= SMALL:
        methods |= {name: BACKENDS[name] for name in ("osqp", "cvxpy") if name != "osqp" or step.rows.shape[1] == 1}
    rows = []
    for method, solve in methods.items():
        begin = time.process_time()
        solution = solve(step, start)
        seconds = time.process_time() - begin
        stands = int(solution.standing.sum())
        rows.append(
            {"vertices": side**2, "reach": name, "share": share, "back-end": method, "supports": stands, "seconds": seconds}
        )
        rows[-1] |= {"value": solution.value, "gap": solution.gap}
    best = min(row["value"] for row in rows)
    return [{**row, "apart": row["value"] / best - 1} for row in rows]


def cases(size: str) -> list[tuple[int, str, float]]:
    """Side, reach and share of every step."""
    return [
        (side, name, share) for side in SIDES[size] for name in REACHES for share in (SHARES if name == "any" else LIMITED)[size]
    ]


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__, SHARES, lambda size: [row for case in cases(size) for row in measure(*case)])
    return 0 if all(row["apart"] <= 1e-6 for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
