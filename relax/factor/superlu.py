"""SciPy's SuperLU kept on the diagonal, L D L^T in effect, in an order found on the vertices: the engine that is always there."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from relax.arrays import Floats, Ints
from relax.factor.engine import VANISHED, Numeric, SingularMatrixError

try:
    import pymetis
except ModuleNotFoundError:  # it has no wheel for this platform
    pymetis = None

DIAGONAL = {"SymmetricMode": True, "Equil": False}
# backward errors: where refinement ends, and what a trial without pivoting may leave; pivoting leaves some 1e-16
REFINED, ACCURATE = 1e-15, 1e-14
REFINEMENTS = 3


class SuperLUAnalysis:
    """The elimination order, found on the graph of the vertices instead of each time on all unknowns."""

    def __init__(self, pattern: csc_array, block: int, ordering: Callable[[csc_array], Ints] | None = None) -> None:
        graph = csc_array(pattern[::block, ::block])
        vertices = (ordering or default_ordering())(graph)
        self.order: Ints = (block * vertices[:, None] + np.arange(block)).ravel()

    def factorise(self, matrix: csc_array, pivot_bound: float) -> Numeric:
        permuted = csc_array(matrix[self.order][:, self.order])
        try:
            factor = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options=DIAGONAL)
        except RuntimeError:  # a pivot is zero, which an indefinite matrix may survive
            return _pivoted(matrix)
        if not np.array_equal(factor.perm_r, factor.perm_c):  # rows were swapped: a pivot was zero on the way
            return _pivoted(matrix)
        return _Diagonal(factor, self.order, permuted.diagonal(), pivot_bound)


class _Diagonal:
    """K = L D L^T with the rows and columns of K in a fixed order."""

    def __init__(self, factor: SuperLU, order: Ints, diagonal: Floats, pivot_bound: float) -> None:
        self.factor, self.order, self.diagonal, self.pivot_bound = factor, order, diagonal, pivot_bound

    @cached_property
    def definite(self) -> bool:
        """By the signs of D (Sylvester); one that is round-off beside its diagonal entry of K counts as zero."""
        if self.pivot_bound > VANISHED:  # to show D SciPy copies L and U for good: half as much memory again
            return True
        return bool((self.factor.U.diagonal()[self.factor.perm_c] > VANISHED * self.diagonal).all())

    @property
    def fill(self) -> int:
        return self.factor.nnz // 2

    def solve(self, right: Floats) -> Floats:
        answer = np.empty_like(right, dtype=float)
        answer[self.order] = self.factor.solve(right[self.order])
        return answer

    def pivoted(self, matrix: csc_array) -> Numeric:
        refined = _Refined(self, matrix)
        trial = np.cos(1.7 * np.arange(len(self.order)))
        with np.errstate(over="ignore", invalid="ignore"):  # a pivot of next to nothing
            answer = refined.solve(trial)
            accurate = refined.error(answer, trial - matrix @ answer, trial) <= ACCURATE
        return refined if accurate else _pivoted(matrix)


class _Refined:
    """L D L^T of a matrix that is not definite, where L grew so little that a few steps of refinement make good for it."""

    definite = False

    def __init__(self, plain: _Diagonal, matrix: csc_array) -> None:
        self.plain, self.matrix, self.fill = plain, matrix, plain.fill
        self.norm = float(abs(matrix).sum(axis=0).max())

    def error(self, answer: Floats, residual: Floats, right: Floats) -> float:
        """Backward error, the largest of the columns."""
        size = self.norm * np.linalg.norm(answer, axis=0) + np.linalg.norm(right, axis=0)
        return float(np.max(np.linalg.norm(residual, axis=0) / np.where(size == 0, 1.0, size)))

    def solve(self, right: Floats) -> Floats:
        answer = self.plain.solve(right)
        for _ in range(REFINEMENTS):
            residual = right - self.matrix @ answer
            if self.error(answer, residual, right) <= REFINED:
                break
            answer += self.plain.solve(residual)
        return answer

    def pivoted(self, matrix: csc_array) -> Numeric:
        return self


class _Pivoted:
    """P K Q = L U: accurate for any matrix, with four times the fill."""

    definite = False

    def __init__(self, factor: SuperLU) -> None:
        self.factor = factor

    @property
    def fill(self) -> int:
        return self.factor.nnz // 2

    def solve(self, right: Floats) -> Floats:
        return self.factor.solve(right)

    def pivoted(self, matrix: csc_array) -> Numeric:
        return self


def _pivoted(matrix: csc_array) -> Numeric:
    try:
        return _Pivoted(splu(matrix))
    except RuntimeError as error:
        raise SingularMatrixError from error


def default_ordering() -> Callable[[csc_array], Ints]:
    """Nested dissection, or minimum degree where METIS is not installed."""
    return nested_dissection if pymetis else minimum_degree


def nested_dissection(graph: csc_array) -> Ints:
    """An elimination order (n,) by METIS: separators last, so that what is eliminated before them falls apart."""
    count = graph.shape[0]
    column = np.repeat(np.arange(count), np.diff(graph.indptr))
    other = graph.indices != column
    pointer = np.concatenate([[0], np.cumsum(np.bincount(column[other], minlength=count))])
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(pointer, graph.indices[other]))
    return np.asarray(order, dtype=np.int64)


def minimum_degree(graph: csc_array) -> Ints:
    """An elimination order (n,) by SuperLU's minimum degree."""
    ones = csr_array((np.ones(graph.nnz), graph.indices, graph.indptr), shape=graph.shape)
    dominant = csc_array(ones + diags_array(ones.sum(axis=1) + 1.0))
    factor = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=DIAGONAL)
    return np.argsort(factor.perm_c)
