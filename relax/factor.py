"""Sparse factorisation of a symmetric stiffness: solves, and tells whether the matrix is positive definite."""

from functools import cached_property

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from relax.arrays import Floats
from relax.errors import EquilibriumError


class Factor:
    """One factorisation of a sparse symmetric matrix, made when it is first asked for.

    Parameters
    ----------
    matrix : (m, m) sparse, symmetric
    """

    def __init__(self, matrix: csc_array) -> None:
        self.matrix = matrix

    @cached_property
    def _symmetric(self) -> SuperLU | None:
        """K = L D L^T by SuperLU kept on the diagonal; None where a pivot vanished or a diagonal entry shows it must."""
        if (self.matrix.diagonal() <= 0).any():
            return None
        try:
            return splu(
                self.matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
            )
        except RuntimeError:
            return None

    @cached_property
    def positive_definite(self) -> bool:
        """Whether every pivot is positive (Sylvester: the signs of D are the inertia as long as the order was kept)."""
        factor = self._symmetric
        if factor is None or not np.array_equal(factor.perm_r, factor.perm_c):
            return False
        return bool((factor.U.diagonal() > 0).all())

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
        return self._engine.solve(columns).reshape(right.shape)
