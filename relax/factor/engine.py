"""What an engine is: an analysis of a sparsity pattern that gives numeric factorisations of matrices with that pattern.

A new engine is a function like those of superlu.py, rslab.py and pardiso.py, and its line in symbolic.py; the tests of the seam
run over every engine that is listed there.
"""

from collections.abc import Callable
from typing import Protocol

from scipy.sparse import csc_array

from relax.arrays import Floats

VANISHED = 1e-13  # of a diagonal entry: a pivot below it is what cancellation leaves of zero


class SingularMatrixError(ArithmeticError):
    """The elimination ended at a pivot that is zero."""


class Numeric(Protocol):
    """One numeric factorisation."""

    @property
    def definite(self) -> bool:
        """Whether every pivot is positive: the inertia, as far as round-off lets the engine see it."""
        ...

    @property
    def fill(self) -> int:
        """Entries of the triangular factor."""
        ...

    def solve(self, right: Floats) -> Floats:
        """K^-1 @ right, for (m,) and for (m, k) in either memory order."""
        ...

    def pivoted(self, matrix: csc_array) -> "Numeric":
        """A factorisation of the same matrix that is accurate although it is not definite; raises SingularMatrixError."""
        ...


class Analysis(Protocol):
    """What the factorisations of one pattern share."""

    def factorise(self, matrix: csc_array, pivot_bound: float) -> Numeric:
        """Factorise a symmetric matrix of this pattern; raises SingularMatrixError.

        `pivot_bound` is proven: no pivot is less, as a part of its diagonal entry. Above VANISHED none need be looked at.
        """
        ...


Engine = Callable[[csc_array, int], Analysis]  # from a pattern, and how many neighbouring unknowns share each vertex
