"""Sparse factorisation of a symmetric stiffness: solves, and tells whether the matrix is positive definite."""

from functools import cached_property
from typing import Literal

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from relax.arrays import Floats, Ints
from relax.errors import EquilibriumError

VANISHED = 1e-13  # of a diagonal entry: a pivot below it is what cancellation leaves of zero
REFINEMENTS = 8  # solves that a refinement may take; a factorisation costs some twenty
CONTRACTION = 0.1
EPSILON = float(np.finfo(float).eps)


class Factor:
    """One factorisation of a sparse symmetric matrix, made when it is first asked for.

    Parameters
    ----------
    matrix : (m, m) sparse, symmetric
    order : (m,) int, optional
        An elimination order that is known to fill little, so that none need be looked for (`block_order`).
    """

    def __init__(self, matrix: csc_array, order: Ints | None = None) -> None:
        self.matrix, self.order = matrix, order

    @cached_property
    def _symmetric(self) -> SuperLU | None:
        """K = L D L^T by SuperLU kept on the diagonal; None where a pivot vanished or a diagonal entry shows it must."""
        if (self.matrix.diagonal() <= 0).any():
            return None
        try:
            if self.order is None:
                return _symmetric_lu(self.matrix, "MMD_AT_PLUS_A")
            return _symmetric_lu(csc_array(self.matrix[self.order][:, self.order]), "NATURAL")
        except RuntimeError:
            return None

    @cached_property
    def positive_definite(self) -> bool:
        """Whether every pivot is positive (Sylvester: the signs of D are the inertia as long as the order was kept).

        A pivot that is round-off beside its own diagonal entry counts as zero: the matrix is singular.
        """
        factor = self._symmetric
        if factor is None or not np.array_equal(factor.perm_r, factor.perm_c):
            return False
        diagonal = self.matrix.diagonal()
        own = diagonal if self.order is None else diagonal[self.order]
        return bool((factor.U.diagonal()[factor.perm_c] > VANISHED * own).all())

    @cached_property
    def _engine(self) -> SuperLU | None:
        if self.positive_definite:
            return self._symmetric
        try:  # without a definite matrix the diagonal order is not safe: pivot by rows
            return splu(self.matrix)
        except RuntimeError:
            return None

    @cached_property
    def singular(self) -> bool:
        """Whether the matrix has no usable inverse: a pivot vanished, or a trial solve leaves a residual."""
        if self._engine is None:
            return True
        if self.positive_definite:
            return False
        # a fixed pseudo-random right-hand side: no seed to choose, no state
        trial = np.cos(np.arange(self.matrix.shape[0]) * 1.7)
        answer = self._engine.solve(trial)
        return not (np.isfinite(answer).all() and np.linalg.norm(self.matrix @ answer - trial) < 1e-6 * np.linalg.norm(trial))

    def solve(self, right: Floats) -> Floats:
        """K^-1 @ right for (m,) or (m, k); any (n, 3) with 3 n = m is taken vertex-major and given back in that shape."""
        if self._engine is None:
            raise EquilibriumError(
                "the stiffness is singular (a mechanism, a slack region, or numbers too far apart): raise the prestress"
            )
        columns = right if right.shape[0] == self.matrix.shape[0] else right.reshape(-1)
        if self.order is None or not self.positive_definite:
            return self._engine.solve(columns).reshape(right.shape)
        answer = np.empty_like(columns, dtype=float)
        answer[self.order] = self._engine.solve(columns[self.order])
        return answer.reshape(right.shape)

    def inverse_columns(self, rows: Ints) -> Floats:
        """Columns of K^-1 (m, k) that belong to the unit forces in `rows` (k,)."""
        right = np.zeros((self.matrix.shape[0], len(rows)))
        right[rows, np.arange(len(rows))] = 1.0
        return self.solve(right)

    def refine(self, matrix: csc_array, right: Floats) -> Floats | None:
        """A^-1 @ right for a matrix A near this one, to the last digits, by iterative refinement; right is (m,).

        None where a step does not shrink the residual at least tenfold: A has moved too far, factorise it.
        """
        if self.singular:
            return None
        answer = np.zeros_like(right)
        residual, size = right, float(np.linalg.norm(right))
        norm = float(abs(matrix).sum(axis=0).max())
        for _ in range(REFINEMENTS):
            answer = answer + self.solve(residual)
            residual = right - matrix @ answer
            before, size = size, float(np.linalg.norm(residual))
            # backward stable: a factorisation of the matrix itself would leave no less
            if size <= EPSILON * (norm * float(np.linalg.norm(answer)) + float(np.linalg.norm(right))):
                return answer
            if size > CONTRACTION * before:
                return None
        return None


def _symmetric_lu(matrix: csc_array, order: Literal["MMD_AT_PLUS_A", "NATURAL"]) -> SuperLU:
    """L D L^T in effect: SuperLU told to stay on the diagonal."""
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False})


def block_order(graph: csr_array, block: int = 3) -> Ints:
    """An elimination order for matrices with `block` unknowns a vertex of `graph` (n, n): minimum degree on the vertices.

    Computed once a mesh on n vertices instead of each time on 3 n unknowns (experiments/factors.py: what that saves).
    """
    degree = np.asarray(abs(graph).sum(axis=1)).ravel()
    dominant = csc_array(abs(graph) + diags_array(degree + 1.0))
    vertices = np.argsort(_symmetric_lu(dominant, "MMD_AT_PLUS_A").perm_c)
    order: Ints = (block * vertices[:, None] + np.arange(block)).ravel()
    return order
