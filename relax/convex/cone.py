"""The convex step as a second-order-cone program given to Clarabel directly.

With the supports eliminated, s = K d - h sits inside the cones, and only the displacement d and one bound t_g a group are
unknown:

    min over d, t   d^T M d + 2 r^T M d + w^T t     s.t.   |(K d - h)_g| <= t_g,   (K d - h)_i = 0 where nothing may stand
"""

import clarabel
import numpy as np
from scipy.sparse import block_diag, csc_array, csc_matrix, csr_array, hstack, triu, vstack

from relax.arrays import Floats
from relax.convex.subproblem import Subproblem
from relax.errors import BackendError

TOLERANCE = 1e-10  # the working set polishes further; tighter than this Clarabel often runs out of digits
LARGE = 6_000  # unknowns from which on the multi-threaded factorisation wins over qdldl (measured at 3,844 vertices: equal)


def solve_with_clarabel(step: Subproblem) -> Floats:
    """Amplitudes (m, 3) newtons of the step, accurate to what an interior point gives: zeros are small, not exact.

    Raises
    ------
    BackendError
        Clarabel ended without a point.
    """
    inner, unit = step.scaled()
    size, groups = len(inner.offset), len(inner.weights)
    free = np.setdiff1d(np.arange(size), inner.rows)
    stiffness = csr_array(inner.stiffness)
    bounds = csr_array((-np.ones(groups), (4 * np.arange(groups), np.arange(groups))), shape=(4 * groups, groups))
    inside = (4 * np.arange(groups)[:, None] + np.arange(1, 4)).ravel()
    place = csr_array((np.ones(inside.size), (inside, np.arange(inside.size))), shape=(4 * groups, inside.size))
    rows = inner.rows.ravel()
    constraints = vstack(
        [hstack([stiffness[free], csr_array((free.size, groups))]), hstack([-(place @ stiffness[rows]), bounds])], format="csc"
    )
    right = np.concatenate([inner.load[free], -(place @ inner.load[rows])])
    quadratic = block_diag([2 * inner.metric, csc_array((groups, groups))], format="csc")
    linear = np.concatenate([2 * (inner.metric @ inner.offset), inner.weights])
    cones = [clarabel.ZeroConeT(free.size)] * bool(free.size) + [clarabel.SecondOrderConeT(4)] * groups
    result = clarabel.DefaultSolver(
        csc_matrix(triu(quadratic)), linear, csc_matrix(constraints), right, cones, _settings(size)
    ).solve()
    point = np.asarray(result.x)[:size]
    if not np.isfinite(point).all():
        raise BackendError(f"Clarabel gave no solution of a convex step (status {result.status})")
    return unit * (inner.stiffness @ point - inner.load)[inner.rows]


def _settings(size: int) -> "clarabel.DefaultSettings":
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.direct_solve_method = "faer" if size > LARGE else "qdldl"
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    return settings
