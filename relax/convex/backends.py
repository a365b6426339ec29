"""Who solves a convex step: named functions Subproblem -> Solution, every answer certified here by the step's own data.

A solver of its own is one file with a function that makes amplitudes (m, c) of a step, and a line in `BACKENDS`; the scene
format takes its names from there. It is imported when it is used.
"""

from collections.abc import Callable
from importlib import import_module

import numpy as np

from relax.arrays import Floats
from relax.convex.subproblem import Solution, Subproblem, certify
from relax.convex.working_set import GAP, solve_on_working_set
from relax.errors import BackendError

Backend = Callable[[Subproblem, Floats], Solution]
MANY = 360  # columns of K^-1 that the working set may make; beyond, the full cone program is faster (experiments/steps.py)
COARSE = 0.01  # relative gap at which the first supports of a start are known well enough
WRONG = 1e-4  # relative gap above which a point is no solution


def solver(name: str, where: str) -> Backend:
    """A back-end from the solver at "module:function": its answer polished, whatever the start."""

    def backend(step: Subproblem, start: Floats) -> Solution:
        del start  # neither an interior point nor an operator splitting gains from one
        module, function = where.split(":")
        return polish(step, getattr(import_module(module), function)(step), name)

    return backend


clarabel = solver("clarabel", "relax.convex.cone:solve_with_clarabel")


def working_set(step: Subproblem, start: Floats) -> Solution:
    """The working set; where too many candidates matter for it, or supports must balance, the full cone program."""
    if step.resultants is not None:
        return clarabel(step, start)
    solution = solve_on_working_set(step, start, _many(step))
    if solution.gap <= 10 * GAP:
        return solution
    try:
        return clarabel(step, start)
    except BackendError:
        if solution.gap <= WRONG:
            return solution
        raise


def quick(step: Subproblem, start: Floats) -> Solution:
    """The working set alone, to a coarse gap or as far as it got: for a step whose only use is to start a sequence."""
    if step.resultants is not None:
        return clarabel(step, start)
    return solve_on_working_set(step, start, _many(step), COARSE)


BACKENDS: dict[str, Backend] = {
    "working-set": working_set,
    "clarabel": clarabel,
    "osqp": solver("osqp", "relax.convex.quadratic:solve_with_osqp"),
    "cvxpy": solver("cvxpy", "relax.convex.reference:solve_with_cvxpy"),
}


def polish(step: Subproblem, raw: Floats, name: str) -> Solution:
    """A solver's amplitudes (m, c) with their certificate, zeros made exact by the dual and the last digits by the working set.

    Raises
    ------
    BackendError
        The duality gap, computed here, says that they are no solution.
    """
    rough = certify(step, raw, name)
    if not rough.gap <= WRONG:
        raise BackendError(f"{name} left a duality gap of {rough.gap:.1e} on a convex step, which is no solution")
    # by strong convexity the dual is known to about the root of the gap
    margin = max(1e-6, np.sqrt(max(rough.gap, 0.0)))
    stands = step.reach.pull(rough.dual) >= (1 - margin) * step.weights
    exact = np.where(stands[:, None], raw, 0.0)
    if stands.sum() > _many(step) or step.resultants is not None:
        return certify(step, exact, name)
    fine = solve_on_working_set(step, exact, _many(step))
    best = fine if fine.gap <= rough.gap else certify(step, exact, name)
    return Solution(best.amplitudes, best.displacement, best.dual, best.value, best.bound, name)


def _many(step: Subproblem) -> int:
    """Groups that the working set may look at."""
    return MANY // step.rows.shape[1]
