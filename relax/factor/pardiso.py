"""The engine PARDISO of Intel's MKL, by the wheel of py-mkl-pardiso: L D L^T with Bunch-Kaufman pivots, and its inertia.

A PARDISO handle holds an analysis together with one factorisation. The handle of a factorisation that nobody holds any more
goes back to its analysis, where the next one finds it and refactors; so as many analyses are made as factorisations are alive
at the same time. Spare handles are released down to the last one.
"""

import weakref
from threading import Lock

import numpy as np
import pymklpardiso
from scipy.sparse import coo_array, csc_array, csr_array

from relax.arrays import Floats, Ints
from relax.factor.engine import Numeric, SingularMatrixError

# zero-based positions in MKL's iparm: our own values, METIS, pivots perturbed below 1e-13 of the norm, entries counted,
# Bunch-Kaufman; no scaling and no matching, which would be those of the first matrix for ever
OPTIONS = {0: 1, 1: 2, 9: 13, 10: 0, 12: 0, 17: -1, 20: 1}
PERTURBED, ENTRIES, POSITIVE = 13, 17, 21


class PardisoAnalysis:
    """The upper triangle of the pattern, where its values stand in the whole, and handles that are not in use."""

    def __init__(self, pattern: csc_array, block: int) -> None:
        size, numbers = pattern.shape[0], np.arange(1, pattern.nnz + 1)
        column = np.repeat(np.arange(size), np.diff(pattern.indptr))
        lower = pattern.indices >= column
        # PARDISO wants every diagonal entry: those that the pattern lacks are entry 0, which is zero
        rows: Ints = np.append(pattern.indices[lower], np.arange(size))
        columns = np.append(column[lower], np.arange(size))
        whole = coo_array((np.append(numbers[lower], np.zeros(size, dtype=int)), (rows, columns)), shape=pattern.shape).tocsc()
        self.shape, self.pointer, self.column, self.source = whole.shape, whole.indptr, whole.indices, whole.data
        self.spare: list[pymklpardiso.PardisoSolver] = []

    def factorise(self, matrix: csc_array, pivot_bound: float) -> Numeric:
        values = np.append(0.0, matrix.data)[self.source]
        try:
            handle = self._handle(values)
        except RuntimeError as error:
            raise SingularMatrixError from error
        numeric = _Numeric(handle)
        weakref.finalize(numeric, _give_back, handle, weakref.ref(self))
        return numeric

    def _handle(self, values: Floats) -> "pymklpardiso.PardisoSolver":
        try:
            handle = self.spare.pop()
        except IndexError:
            upper = csr_array((values, self.column, self.pointer), shape=self.shape)
            return pymklpardiso.PardisoSolver(upper, pymklpardiso.MTYPE_REAL_SYM_INDEF, OPTIONS)
        handle.refactor(values)
        return handle


def _give_back(handle: "pymklpardiso.PardisoSolver", analysis: "weakref.ref[PardisoAnalysis]") -> None:
    owner = analysis()
    if owner is not None and not owner.spare:
        owner.spare.append(handle)
    else:
        handle.release()


class _Numeric:
    def __init__(self, handle: "pymklpardiso.PardisoSolver") -> None:
        self.handle, self.lock = handle, Lock()  # a handle solves one block at a time

    @property
    def definite(self) -> bool:
        return self.handle.get_iparm_value(PERTURBED) == 0 and self.handle.get_iparm_value(POSITIVE) == self.handle.n

    @property
    def fill(self) -> int:
        return self.handle.get_iparm_value(ENTRIES)

    def solve(self, right: Floats) -> Floats:
        with self.lock:
            return self.handle.solve(right if right.ndim == 1 else np.asfortranarray(right))

    def pivoted(self, matrix: csc_array) -> Numeric:
        return self
