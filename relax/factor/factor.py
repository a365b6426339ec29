"""One factorisation of a symmetric matrix: solves, and tells whether the matrix is positive definite or has no inverse."""

from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from relax.arrays import Floats, Ints
from relax.errors import EquilibriumError
from relax.factor.engine import VANISHED, Numeric, SingularMatrixError
from relax.factor.symbolic import Symbolic

ROUND_OFF = 1e12  # size of the inverse beside the diagonal's from which on it is made of round-off
UNSOLVED = 1e-6  # part of a trial right-hand side that an answer of any use does not leave
UNEVEN = 1e6  # ratio of diagonal entries from which on a matrix is scaled before it is factorised
REFINEMENTS = 8  # solves that a refinement may take; a factorisation costs six to twenty-five
CONTRACTION = 1e-3  # of the residual by each, so that five do
EPSILON = float(np.finfo(float).eps)


class Factor:
    """One factorisation of a sparse symmetric matrix, made when it is first asked for.

    Parameters
    ----------
    matrix : (m, m) sparse, symmetric
    symbolic : Symbolic, optional
        What factorisations of the same sparsity pattern share; without it the pattern is analysed for this one.
    pivot_bound : float, optional
        A proven lower bound of every pivot as a part of its diagonal entry, 0 if none is known. Above round-off it
        is a proof that the matrix is positive definite, and neither pivots nor a trial are looked at.
    """

    def __init__(self, matrix: csc_array, symbolic: Symbolic | None = None, pivot_bound: float = 0.0) -> None:
        self.matrix, self.pivot_bound = matrix, pivot_bound
        self.symbolic = symbolic or Symbolic()

    @cached_property
    def _scale(self) -> Floats | None:
        """Powers of two (m,), exact, that even out a diagonal of very different sizes; None where nothing need or can be done."""
        diagonal = self.matrix.diagonal()
        if (diagonal <= 0).any() or diagonal.max() <= UNEVEN * diagonal.min():
            return None
        scale = np.exp2(-np.round(np.log2(diagonal) / 2))
        # beside its diagonal a definite matrix has no larger entries; where there are, this would be no evening out
        with np.errstate(over="ignore", invalid="ignore"):
            return scale if abs(self._times(scale)).max() <= 2 else None

    def _times(self, scale: Floats) -> Floats:
        """Entries of the matrix with rows and columns scaled."""
        columns = np.repeat(np.arange(len(scale)), np.diff(self.matrix.indptr))
        return scale[self.matrix.indices] * self.matrix.data * scale[columns]

    def _scaled(self) -> csc_array:
        matrix = self.matrix
        if self._scale is None:
            return matrix
        return csc_array((self._times(self._scale), matrix.indices, matrix.indptr), shape=matrix.shape)

    @cached_property
    def _elimination(self) -> Numeric | None:
        """The factorisation as a definite matrix; None where it broke down."""
        if not np.isfinite(self.matrix.data).all():
            return None
        try:
            return self.symbolic.factorise(self._scaled(), self.pivot_bound)
        except SingularMatrixError:
            return None

    @cached_property
    def _numeric(self) -> Numeric | None:
        """The factorisation that solves."""
        if self._elimination is None or self.positive_definite:
            return self._elimination
        try:
            return self._elimination.pivoted(self._scaled())
        except SingularMatrixError:
            return None

    @cached_property
    def positive_definite(self) -> bool:
        """Whether every pivot is positive, by their signs and a trial solve that would show one that is round-off."""
        if (self.matrix.diagonal() <= 0).any() or self._elimination is None or not self._elimination.definite:
            return False
        return self.proven or self._trial(self._elimination)[0] < ROUND_OFF

    @property
    def proven(self) -> bool:
        """Whether the pivots are known to be positive before one is looked at."""
        return self.pivot_bound > VANISHED

    @cached_property
    def singular(self) -> bool:
        """Whether the matrix has no usable inverse: a pivot vanished, or a trial solve leaves a residual."""
        if self.positive_definite:
            return False
        return self._numeric is None or not self._trial(self._numeric)[1] < UNSOLVED

    @property
    def fill(self) -> int:
        """Entries of the triangular factor; 0 where there is none."""
        return 0 if self._numeric is None else self._numeric.fill

    def _trial(self, numeric: Numeric) -> tuple[float, float]:
        """Size of the inverse beside the diagonal's, and the residual, of one solve: numbers without units.

        The right-hand side is fixed and pseudo-random: no seed to choose, no state.
        """
        size = np.sqrt(abs(self.matrix.diagonal()))
        size[size == 0] = 1.0
        wave = np.cos(1.7 * np.arange(len(size)))
        norm = np.linalg.norm(wave)
        with np.errstate(over="ignore", invalid="ignore"):  # a pivot of next to nothing
            answer = self._solve_by(numeric, size * wave)
            if not np.isfinite(answer).all():
                return np.inf, np.inf
            residual = (self.matrix @ answer) / size - wave
            return float(np.linalg.norm(size * answer) / norm), float(np.linalg.norm(residual) / norm)

    def _solve_by(self, numeric: Numeric, right: Floats) -> Floats:
        if right.size == 0:  # no columns, which not every engine takes
            return np.zeros_like(right)
        if self._scale is None:
            return numeric.solve(right)
        scale = self._scale.reshape(-1, *[1] * (right.ndim - 1))
        return scale * numeric.solve(scale * right)

    def solve(self, right: Floats) -> Floats:
        """K^-1 @ right for (m,) or (m, k); any (n, 3) with 3 n = m is taken vertex-major and given back in that shape."""
        if self._numeric is None or self.singular:
            raise EquilibriumError(
                "the stiffness is singular (a mechanism, a slack region, or numbers too far apart): raise the prestress"
            )
        columns = right if right.shape[0] == self.matrix.shape[0] else right.reshape(-1)
        return self._solve_by(self._numeric, columns).reshape(right.shape)

    def inverse_columns(self, rows: Ints) -> Floats:
        """Columns of K^-1 (m, k) that belong to the unit forces in `rows` (k,)."""
        right = np.zeros((self.matrix.shape[0], len(rows)), order="F")  # as all engines want a block
        right[rows, np.arange(len(rows))] = 1.0
        return self.solve(right)

    def refine(self, matrix: csc_array, right: Floats, start: Floats | None = None) -> Floats | None:
        """A^-1 @ right for a matrix A near this one, to the last digits, by iterative refinement; right and start are (m,).

        None where a step does not shrink the residual a thousandfold: A has moved too far, factorise it.
        """
        if self.singular:
            return None
        answer = np.zeros_like(right) if start is None else start
        residual = right if start is None else right - matrix @ start
        size = float(np.linalg.norm(residual))
        for _ in range(REFINEMENTS):
            answer = answer + self.solve(residual)
            residual = right - matrix @ answer
            before, size = size, float(np.linalg.norm(residual))
            # backward stable: a factorisation of the matrix itself would leave no less
            if size <= EPSILON * (self._norm * float(np.linalg.norm(answer)) + float(np.linalg.norm(right))):
                return answer
            if size > CONTRACTION * before:
                return None
        return None

    @cached_property
    def _norm(self) -> float:
        """The largest column sum of the matrix, about that of any matrix nearby."""
        return float(abs(self.matrix).sum(axis=0).max())

    def __getstate__(self) -> dict[str, Any]:
        """Without the factorisation, which cannot be pickled and is made again where it is needed."""
        kept = ("matrix", "symbolic", "pivot_bound")
        return {key: self.__dict__[key] for key in kept}


class ScalarFactor(Factor):
    """A factorisation of K = S (x) I_3, three equal and independent directions, by one of S, (n, n): a ninth of the entries.

    Parameters
    ----------
    matrix : (3n, 3n) sparse
        K.
    scalar : Factor
        Of S.
    """

    def __init__(self, matrix: csc_array, scalar: Factor) -> None:
        super().__init__(matrix, scalar.symbolic, scalar.pivot_bound)
        self.scalar = scalar

    @cached_property
    def positive_definite(self) -> bool:
        """Whether S is."""
        return self.scalar.positive_definite

    @cached_property
    def singular(self) -> bool:
        """Whether S is."""
        return self.scalar.singular

    @property
    def fill(self) -> int:
        """That of S."""
        return self.scalar.fill

    def solve(self, right: Floats) -> Floats:
        """K^-1 @ right as in `Factor`: each column is three of S."""
        count = self.scalar.matrix.shape[0]
        return self.scalar.solve(right.reshape(count, -1)).reshape(right.shape)

    def inverse_columns(self, rows: Ints) -> Floats:
        """Columns of K^-1 (m, k); one solve with S for each vertex that stands in `rows`."""
        vertices, which = np.unique(rows // 3, return_inverse=True)
        columns = np.zeros((self.scalar.matrix.shape[0], 3, len(rows)))
        columns[:, rows % 3, np.arange(len(rows))] = self.scalar.inverse_columns(vertices)[:, which]
        return columns.reshape(-1, len(rows))

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "scalar": self.scalar}
