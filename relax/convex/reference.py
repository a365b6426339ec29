"""The convex step in cvxpy, as it stands on paper: slow, readable, and the one that the fast ones must agree with."""

import numpy as np

from relax.arrays import Floats
from relax.convex.subproblem import Subproblem
from relax.errors import BackendError


def solve_with_cvxpy(step: Subproblem, solver: str = "CLARABEL") -> Floats:
    """Amplitudes (m, c) newtons of the step by any solver that cvxpy knows.

    Raises
    ------
    BackendError
        The solver did not solve it.
    """
    import cvxpy as cp  # half a second that a run without it must not pay

    inner, unit = step.scaled()
    d = cp.Variable(len(inner.offset))
    s = cp.Variable(inner.rows.shape)
    sizes = cp.norm(s, 2, axis=1)

    distance = cp.quad_form(d + inner.offset, cp.psd_wrap(inner.metric))
    masts = inner.weights @ sizes + inner.bends @ cp.sum(cp.square(s), axis=1)
    constraints = [inner.stiffness @ d == inner.load + inner.basis @ cp.vec(s, order="C")]
    if inner.reach.tangent is not None:
        lean = np.arctan(inner.reach.tangent)
        constraints += [np.cos(lean) * cp.norm(s[:, :-1], 2, axis=1) <= np.sin(lean) * s[:, -1], s[:, -1] >= 0]
    if np.isfinite(inner.reach.largest):
        constraints += [sizes <= inner.reach.largest]

    problem = cp.Problem(cp.Minimize(distance + masts), constraints)
    try:
        problem.solve(solver=solver)
    except cp.SolverError as error:
        raise BackendError(f"cvxpy's solver {solver} failed on a convex step: {error}") from error
    if s.value is None:
        raise BackendError(f"cvxpy's solver {solver} gave no solution of a convex step (status {problem.status})")
    return unit * np.asarray(s.value)
