"""The convex step as a second-order-cone program given to Clarabel directly.

With the supports eliminated, s = K d - h sits inside the cones, and only the displacement d and one bound t_g a group are
unknown:

    min over d, t   d^T M d + 2 r^T M d + w^T t + sum_g b_g |s_g|^2     s.t.   |s_g| <= t_g <= F,   s_g in C,
                    (K d - h)_i = 0 where nothing may stand
"""

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy.sparse import block_diag, csc_array, csc_matrix, csr_array, diags_array, eye_array, hstack, triu, vstack

from relax.arrays import Floats
from relax.convex.subproblem import Subproblem
from relax.errors import BackendError
from relax.sparsity.reach import Reach

TOLERANCE = 1e-10  # the working set polishes further; tighter than this Clarabel often runs out of digits
LARGE = 6_000  # unknowns from which on the multi-threaded factorisation wins over qdldl (measured at 3,844 vertices: equal)

Piece = tuple[csr_array, Floats, list[object]]  # A, b and cones: A z + b lies in them


@dataclass(frozen=True)
class ConeProgram:
    """Minimise x^T Q x + 2 q^T x + sum_g w_g |s_g| over x, the amplitudes s = S x - h within what a support can do.

    Parameters
    ----------
    quadratic : (k, k) sparse
        Q.
    linear : (k,)
        q.
    place : (cm, k) sparse
        S, group after group.
    shift : (cm,)
        h.
    weights : (m,)
    reach : Reach
    """

    quadratic: csc_array
    linear: Floats
    place: csr_array
    shift: Floats
    weights: Floats
    reach: Reach

    def solve(self, settings: "clarabel.DefaultSettings", zeros: tuple[csr_array, Floats] | None = None) -> Floats:
        """The point x (k,), where A x + b = 0 for `zeros` = (A, b), as accurate as the settings say.

        Raises
        ------
        BackendError
            Clarabel ended without a point.
        """
        size = len(self.linear)
        bounded = np.flatnonzero((self.weights > 0) | np.isfinite(self.reach.largest))
        bounds = csr_array((len(bounded), len(bounded)))
        pieces = [*self._norms(bounded), *self._leans(len(bounded))]
        if zeros is not None and len(zeros[1]):
            level = hstack([zeros[0], csr_array((len(zeros[1]), len(bounded)))], format="csr")
            pieces.append((level, zeros[1], [clarabel.ZeroConeT(len(zeros[1]))]))
        matrix = csc_matrix(-vstack([piece[0] for piece in pieces], format="csc"))
        right = np.concatenate([piece[1] for piece in pieces])
        cones = [cone for piece in pieces for cone in piece[2]]
        quadratic = csc_matrix(triu(block_diag([2 * self.quadratic, bounds], format="csc")))
        linear = np.concatenate([2 * self.linear, self.weights[bounded]])
        result = clarabel.DefaultSolver(quadratic, linear, matrix, right, cones, settings).solve()
        point = np.asarray(result.x)[:size]
        if not np.isfinite(point).all():
            raise BackendError(f"Clarabel gave no solution of a convex step (status {result.status})")
        return point

    def _norms(self, bounded: np.ndarray) -> list[Piece]:
        """|s_g| <= t_g, and t_g <= F where there is one."""
        width, count, size = len(self.shift) // len(self.weights), len(bounded), len(self.linear)
        rows = (width * bounded[:, None] + np.arange(width)).ravel()
        if width == 1:  # t + s and t - s
            bound, inside = np.array([[1.0], [1.0]]), np.array([[1.0], [-1.0]])
            cones = [clarabel.NonnegativeConeT(2 * count)]
        else:
            bound, inside = np.eye(1 + width)[:, :1], np.eye(1 + width)[:, 1:]
            cones = [clarabel.SecondOrderConeT(1 + width)] * count
        lifted = _repeated(inside, count)
        both = hstack([lifted @ self.place[rows], _repeated(bound, count)], format="csr")
        pieces: list[Piece] = [(both, -(lifted @ self.shift[rows]), cones)]
        if np.isfinite(self.reach.largest):
            caps = hstack([csr_array((count, size)), -eye_array(count)], format="csr")
            pieces.append((caps, np.full(count, self.reach.largest), [clarabel.NonnegativeConeT(count)]))
        return pieces

    def _leans(self, bounds: int) -> list[Piece]:
        """|s_xy| cos <= s_z sin of the largest lean, or s_z >= 0."""
        if self.reach.tangent is None:
            return []
        count = len(self.weights)
        width, lean = len(self.shift) // count, np.arctan(self.reach.tangent)
        if width == 1 or self.reach.flat:
            turned, cones = np.eye(width)[-1:], [clarabel.NonnegativeConeT(count)]
        else:
            turned = np.roll(np.diag([np.cos(lean)] * (width - 1) + [np.sin(lean)]), 1, axis=0)
            cones = [clarabel.SecondOrderConeT(width)] * count
        lifted = _repeated(turned, count)
        placed = hstack([lifted @ self.place, csr_array((lifted.shape[0], bounds))], format="csr")
        return [(placed, -(lifted @ self.shift), cones)]


def _repeated(block: Floats, count: int) -> csr_array:
    """The block along a diagonal, so many times."""
    row, column = np.nonzero(block)
    turn, (high, wide) = np.arange(count)[:, None], block.shape
    entries = np.tile(block[row, column], count)
    return csr_array((entries, ((turn * high + row).ravel(), (turn * wide + column).ravel())), shape=(count * high, count * wide))


def solve_with_clarabel(step: Subproblem) -> Floats:
    """Amplitudes (m, c) newtons of the step, accurate to what an interior point gives: zeros are small, not exact.

    Raises
    ------
    BackendError
        Clarabel ended without a point.
    """
    inner, unit = step.scaled()
    stiffness = csr_array(inner.stiffness)
    free = np.setdiff1d(np.arange(len(inner.offset)), inner.rows)
    place, shift = stiffness[inner.rows.ravel()], inner.load[inner.rows.ravel()]
    quadratic, linear = inner.metric, inner.metric @ inner.offset
    if inner.curvature is not None:
        bent = place.T @ diags_array(np.repeat(inner.curvature, inner.rows.shape[1]))
        quadratic, linear = csc_array(quadratic + bent @ place), linear - bent @ shift
    program = ConeProgram(quadratic, linear, place, shift, inner.weights, inner.reach)
    settings = clarabel_settings(TOLERANCE)
    settings.direct_solve_method = "faer" if len(linear) > LARGE else "qdldl"
    point = program.solve(settings, (stiffness[free], -inner.load[free]))
    return unit * (place @ point - shift).reshape(inner.rows.shape)


def clarabel_settings(tolerance: float) -> "clarabel.DefaultSettings":
    """Silent, and all tolerances alike."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return settings
