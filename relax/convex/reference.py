"""The convex step in cvxpy, as it stands on paper: slow, readable, and the one that the fast ones must agree with."""

import numpy as np

from relax.arrays import Floats
from relax.convex.subproblem import Subproblem
from relax.errors import BackendError


def solve_with_cvxpy(step: Subproblem, solver: str = "CLARABEL") -> Floats:
    """Amplitudes (m, 3) newtons of the step by any solver that cvxpy knows.

    Raises
    ------
    BackendError
        The solver did not solve it.
    """
    import cvxpy as cp  # half a second that a run without it must not pay

    inner, unit = step.scaled()
    d = cp.Variable(len(inner.offset))
    s = cp.Variable(inner.rows.shape)

    distance = cp.quad_form(d + inner.offset, cp.psd_wrap(inner.metric))
    masts = inner.weights @ cp.norm(s, 2, axis=1)
    equilibrium = inner.stiffness @ d == inner.load + inner.basis @ cp.vec(s, order="C")

    problem = cp.Problem(cp.Minimize(distance + masts), [equilibrium])
    try:
        problem.solve(solver=solver)
    except cp.SolverError as error:
        raise BackendError(f"cvxpy's solver {solver} failed on a convex step: {error}") from error
    if s.value is None:
        raise BackendError(f"cvxpy's solver {solver} gave no solution of a convex step (status {problem.status})")
    return unit * np.asarray(s.value)
