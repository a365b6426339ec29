"""The engine rslab: L D L^T with Bunch-Kaufman pivots by supernodes, its inertia, and one analysis for any number of factors."""

import numpy as np
import rslab
from scipy.sparse import csc_array

from relax.arrays import Floats
from relax.factor.engine import Numeric, SingularMatrixError

THREADS = 1  # the same digits on every machine, and runs side by side do not fight; two threads gain little


class RslabAnalysis:
    """Order, elimination tree and supernodes: found once, read by every factorisation."""

    def __init__(self, pattern: csc_array, block: int) -> None:
        self.symbolic = rslab.analyze(pattern, path="ldlt", threads=THREADS)

    def factorise(self, matrix: csc_array, pivot_bound: float) -> Numeric:
        try:
            return _Numeric(self.symbolic.factor(matrix))
        except RuntimeError as error:  # "matrix is numerically rank-deficient"
            raise SingularMatrixError from error


class _Numeric:
    def __init__(self, factor: "rslab.Ldlt") -> None:
        self.factor = factor

    @property
    def definite(self) -> bool:
        return self.factor.inertia[0] == self.factor.n

    @property
    def fill(self) -> int:
        return self.factor.factor_nnz

    def solve(self, right: Floats) -> Floats:
        # a block in Fortran order is solved in two thirds of the time
        return self.factor.solve(right) if right.ndim == 1 else self.factor.solve_many(np.asfortranarray(right))

    def pivoted(self, matrix: csc_array) -> Numeric:
        return self
