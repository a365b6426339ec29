"""The convex step as a quadratic program given to OSQP, where it is one; as a linear system where only squares are left.

    min over d, s, t   (d + r)^T M (d + r) + w^T t + sum_g b_g |s_g|^2     s.t.   K d - B s = h,   |s| <= t,   0 or -F <= s <= F

That covers supports along one axis, l1 norms component by component (`Subproblem.components`) and reweighted least squares. The
norm of several components is a second-order cone, which OSQP does not take.
"""

from typing import Any

import numpy as np
import osqp
from scipy.sparse import block_array, block_diag, csc_array, csc_matrix, csr_array, diags_array, eye_array, triu, vstack

from relax.arrays import Floats
from relax.convex.subproblem import Subproblem
from relax.errors import BackendError, UnsupportedError
from relax.factor import Factor

TOLERANCE = 1e-9  # OSQP's own polishing and ours make the last digits
LIMIT = 20_000  # iterations; beyond, the gap decides whether the point serves
OTHERS = "use working-set, clarabel or cvxpy, or supports along one axis"


def solve_with_osqp(step: Subproblem, sides: int | None = None) -> Floats:
    """Amplitudes (m, c) newtons of the step.

    Parameters
    ----------
    step : Subproblem
    sides : int, optional
        Replace a round cone by a pyramid of so many sides inside it, 3 or more. The answer leans no further than it may, but
        is that of another problem: its gap, computed with the round cone, says how far off that is.

    Raises
    ------
    BackendError
        The step holds a second-order cone, or OSQP ended without a point.
    """
    _refuse_cones(step, sides)
    if step.curvature is not None and not step.weights.any() and not step.reach.constrained:
        return solve_least_squares(step)
    inner, unit = step.scaled()
    size, (count, width), reach = len(inner.offset), inner.rows.shape, inner.reach
    pushes = width == 1 and reach.tangent is not None  # then |s| is s, and t is not needed
    priced = np.zeros(0, dtype=np.int64) if pushes else np.flatnonzero(inner.weights)
    amplitude, bound, still = eye_array(count * width, format="csr"), eye_array(len(priced)), csr_array((len(priced), size))
    quadratic = [2 * inner.metric, diags_array(np.repeat(2 * inner.bends, width)), csc_array((len(priced), len(priced)))]
    along = inner.weights if pushes else np.zeros(count * width)
    linear = np.concatenate([2 * (inner.metric @ inner.offset), along, inner.weights[priced]])
    rows = [
        (block_array([[inner.stiffness, -inner.basis, csr_array((size, len(priced)))]]), inner.load, inner.load),
        (block_array([[still, amplitude[priced], bound]]), np.zeros(len(priced)), np.full(len(priced), np.inf)),
        (block_array([[still, -amplitude[priced], bound]]), np.zeros(len(priced)), np.full(len(priced), np.inf)),
    ]
    for matrix, low, high in _limits(inner, sides):
        right = csr_array((matrix.shape[0], len(priced)))
        rows.append((block_array([[csr_array((matrix.shape[0], size)), matrix, right]]), low, high))
    solver = osqp.OSQP()
    solver.setup(
        csc_matrix(triu(block_diag(quadratic))),
        linear,
        csc_matrix(vstack([row[0] for row in rows])),
        np.concatenate([row[1] for row in rows]),
        np.concatenate([row[2] for row in rows]),
        eps_abs=TOLERANCE,
        eps_rel=TOLERANCE,
        max_iter=LIMIT,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    point = np.asarray(result.x, dtype=float)[size : size + count * width]
    if not np.isfinite(point).all():
        raise BackendError(f"OSQP gave no solution of a convex step (status {result.info.status})")
    return unit * point.reshape(count, width)


def solve_least_squares(step: Subproblem) -> Floats:
    """Amplitudes (m, c) newtons of a step without weights and limits, b alone: the stationary point, from one linear system.

    Its certificate says more than its value: sum_g b_g |s_g - s*_g|^2 is at most value minus bound.

    Raises
    ------
    BackendError
        The step has weights or limits, or its solution is not unique.
    """
    if step.weights.any() or step.reach.constrained:
        raise BackendError("a step with weights or limits is no linear system: use osqp, working-set, clarabel or cvxpy")
    inner, unit = step.scaled()
    size, (count, width) = len(inner.offset), inner.rows.shape
    bends = diags_array(np.repeat(2 * inner.bends, width))
    stiffness, basis = inner.stiffness, inner.basis
    blocks: list[list[Any]] = [[2 * inner.metric, None, stiffness], [None, bends, -basis.T], [stiffness, -basis, None]]
    factor = Factor(csc_array(block_array(blocks)))
    if factor.singular:
        raise BackendError("the solution of a convex step is not unique: some forces cost nothing and are not seen by the metric")
    right = np.concatenate([-2 * (inner.metric @ inner.offset), np.zeros(count * width), inner.load])
    return unit * factor.solve(right)[size : size + count * width].reshape(count, width)


def _refuse_cones(step: Subproblem, sides: int | None) -> None:
    """Raise where the step needs a second-order cone; UnsupportedError."""
    width, reach = step.rows.shape[1], step.reach
    if width == 1:
        return
    lacking = "OSQP takes no second-order cones, so not the {} of a force with several components: {}"
    if step.weights.any():
        raise UnsupportedError(lacking.format("norm", OTHERS))
    if np.isfinite(reach.largest):
        raise UnsupportedError(lacking.format("largest size", OTHERS))
    if reach.tangent is not None and not reach.flat and sides is None:
        raise UnsupportedError(lacking.format("largest lean", f"{OTHERS}, or a pyramid of some `sides` inside the cone"))
    if sides is not None and sides < 3:
        raise UnsupportedError(f"a pyramid of {sides} sides holds no space: expected 3 or more")


def _limits(inner: Subproblem, sides: int | None) -> list[tuple[csr_array, Floats, Floats]]:
    """Matrix, lower and upper bounds of what the amplitudes may be."""
    (count, width), reach = inner.rows.shape, inner.reach
    limits = []
    if width == 1 and reach.constrained:
        low = 0.0 if reach.tangent is not None else -reach.largest
        limits.append((eye_array(count, format="csr"), np.full(count, low), np.full(count, reach.largest)))
    elif reach.tangent is not None:
        if reach.flat:
            normals = np.eye(width)[-1:]
        else:
            assert sides is not None
            angle = 2 * np.pi * np.arange(sides) / sides
            apothem = reach.tangent * np.cos(np.pi / sides)
            normals = np.column_stack([-np.cos(angle), -np.sin(angle), np.full(sides, apothem)])
        matrix = csr_array(block_diag([normals] * count))
        limits.append((matrix, np.zeros(matrix.shape[0]), np.full(matrix.shape[0], np.inf)))
    return limits
