"""Who solves a convex step: named functions Subproblem -> Solution, every answer certified here by the step's own data."""

from collections.abc import Callable

import numpy as np

from relax.arrays import Floats
from relax.convex.cone import solve_with_clarabel
from relax.convex.reference import solve_with_cvxpy
from relax.convex.subproblem import Solution, Subproblem, certify
from relax.convex.working_set import GAP, solve_on_working_set
from relax.errors import BackendError

Backend = Callable[[Subproblem, Floats], Solution]
MANY = 120  # groups that the working set may look at; beyond, the full cone program is faster (experiments/steps.py)
COARSE = 0.01  # relative gap at which the first supports of a start are known well enough
WRONG = 1e-4  # relative gap above which a point is no solution


def clarabel(step: Subproblem, start: Floats) -> Solution:
    """The full cone program, its zeros made exact on the groups that its dual certificate lets stand."""
    del start  # an interior point takes no warm start
    return polish(step, solve_with_clarabel(step), "clarabel")


def cvxpy(step: Subproblem, start: Floats) -> Solution:
    """The readable model, its zeros made exact in the same way."""
    del start
    return polish(step, solve_with_cvxpy(step), "cvxpy")


def working_set(step: Subproblem, start: Floats) -> Solution:
    """The working set; where too many candidates matter for it, the full cone program."""
    solution = solve_on_working_set(step, start, MANY)
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
    return solve_on_working_set(step, start, MANY, COARSE)


def polish(step: Subproblem, raw: Floats, name: str) -> Solution:
    """A solver's amplitudes (m, 3) with their certificate, zeros made exact by the dual and the last digits by the working set.

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
    stands = np.linalg.norm(rough.dual, axis=1) >= (1 - margin) * step.weights
    exact = np.where(stands[:, None], raw, 0.0)
    if stands.sum() > MANY:
        return certify(step, exact, name)
    fine = solve_on_working_set(step, exact, MANY)
    best = fine if fine.gap <= rough.gap else certify(step, exact, name)
    return Solution(best.amplitudes, best.displacement, best.dual, best.value, best.bound, name)


BACKENDS: dict[str, Backend] = {"working-set": working_set, "quick": quick, "clarabel": clarabel, "cvxpy": cvxpy}
