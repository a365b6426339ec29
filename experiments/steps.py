"""One convex step by every back-end, and which is the fastest for how many supports.

Question: what do the working set, Clarabel and cvxpy make of the same second-order-cone programs, in value, gap and seconds?

    python experiments/steps.py               about two minutes
    python experiments/steps.py --size small  some seconds

The steps are linearised at the membrane without supports, towards a planted tent with noise, under constant weights that let
more and more supports stand (`share` of the largest useful weight). Value and gap are recomputed from the step's data and
never taken from a solver; `apart` is the difference to the best value, relative. Exit status 1 if two differ by more than 1e-6.

Finding: they agree to the last digits, gaps below 1e-12. At 2,304 free vertices the working set is some 60 times faster than the
cone program with 3 supports standing, twice as fast with 57 and no faster with 64.
"""

import sys
import time
from pathlib import Path

import numpy as np
from rows import measured

import relax
from relax.convex.backends import BACKENDS
from relax.convex.working_set import solve_on_working_set
from relax.design.problem import Problem
from relax.design.starts import largest_weight, unsupported
from relax.membrane.mesh import grid_mesh

SHARES = {"small": (0.5, 0.1), "full": (0.5, 0.1, 0.02, 0.005, 0.002)}
SIDES = {"small": (14,), "full": (22, 50)}
CVXPY_UP_TO = 30  # vertices a side: beyond, building the model takes longer than all the rest of this table
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


def measure(side: int, share: float) -> list[dict[str, object]]:
    """One row a back-end for one step."""
    problem = noisy_tent(side)
    shape = unsupported(problem)
    weights = share * largest_weight(problem, shape) * problem.supports.weights
    step = problem.linearised(shape.positions, problem.factor_at(shape.positions), weights)
    methods = {"working set": lambda step, start: solve_on_working_set(step, start, NO_LIMIT)}
    methods |= {name: BACKENDS[name] for name in ("clarabel", "cvxpy") if name != "cvxpy" or side <= CVXPY_UP_TO}
    rows = []
    for name, solve in methods.items():
        begin = time.perf_counter()
        solution = solve(step, shape.amplitudes)
        seconds = time.perf_counter() - begin
        stands = int(solution.standing.sum())
        rows.append({"vertices": side**2, "share": share, "back-end": name, "supports": stands, "seconds": seconds})
        rows[-1] |= {"value": solution.value, "gap": solution.gap}
    best = min(row["value"] for row in rows)
    return [{**row, "apart": row["value"] / best - 1} for row in rows]


def main() -> int:
    """Measure and print."""
    rows = measured(
        __doc__, SHARES, lambda size: [row for side in SIDES[size] for share in SHARES[size] for row in measure(side, share)]
    )
    return 0 if all(row["apart"] <= 1e-6 for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
