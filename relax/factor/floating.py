"""The inverse of a stiffness that leaves translations free: right under balanced forces, the translation chosen by a metric.

    d = W G W^T r,     W = I - N (N^T M N)^+ N^T M,     G = (K + ground)^-1

N are the translations of the parts that nothing holds, K N = 0, and the ground is a spring at one vertex of each. Where N^T r = 0
that spring does not stretch: K d = r, and N^T M d = 0, so that M d is balanced again. The operator is symmetric, so
columns, duals and the models made of them agree with each other under forces that are not balanced too, where they mean nothing.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from relax.arrays import Floats, Ints, lock_arrays
from relax.factor.factor import Factor

UNSEEN = 1e-12  # of the largest eigenvalue of N^T M N: directions in which the metric does not see a translation


@dataclass(frozen=True)
class Translations:
    """The translations of floating parts, and which of them a metric prefers.

    Parameters
    ----------
    modes : (m, k) sparse
        N.
    metric : (m, m) sparse, positive semidefinite
        M.
    """

    modes: csc_array
    metric: csc_array

    def __post_init__(self) -> None:
        lock_arrays(self)

    @cached_property
    def pulls(self) -> csc_array:
        """M N (m, k)."""
        return csc_array(self.metric @ self.modes)

    @cached_property
    def _inverse(self) -> Floats:
        """(N^T M N)^+ (k, k), part by part in fact: a translation that the metric does not see stays what it is."""
        return np.linalg.pinv((self.modes.T @ self.pulls).toarray(), rcond=UNSEEN, hermitian=True)

    def shift(self, displacement: Floats) -> Floats:
        """The translation (k,) or (k, c) that is in displacements (m,) or (m, c), as the metric measures it."""
        shift: Floats = self._inverse @ (self.pulls.T @ displacement)
        return shift

    def left_out(self, displacement: Floats) -> Floats:
        """W d: without that translation."""
        return displacement - self.modes @ self.shift(displacement)

    def balanced(self, forces: Floats) -> Floats:
        """W^T r: balanced by forces in proportion to the metric."""
        return forces - self.pulls @ (self._inverse @ (self.modes.T @ forces))


def translations(parts: tuple[Ints, ...], metric: csc_array) -> Translations:
    """Those of parts, each given by its vertices, of a membrane of as many vertices as the metric (3n, 3n) has."""
    row, column = [], []
    for index, vertices in enumerate(parts):
        for axis in range(3):
            row.append(3 * vertices + axis)
            column.append(np.full(len(vertices), 3 * index + axis))
    rows, columns = np.concatenate(row), np.concatenate(column)
    modes = csc_array((np.ones(len(rows)), (rows, columns)), shape=(metric.shape[0], 3 * len(parts)))
    return Translations(modes, metric)


class FloatingFactor(Factor):
    """A factorisation of K by that of K + ground; definite and singular as K is off the translations.

    Parameters
    ----------
    grounded : Factor
        Of K + ground.
    ground : (m, m) sparse
    free : Translations
    """

    def __init__(self, grounded: Factor, ground: csc_array, free: Translations) -> None:
        super().__init__(csc_array(grounded.matrix - ground), grounded.symbolic, grounded.pivot_bound)
        self.grounded, self.ground, self.free = grounded, ground, free

    @cached_property
    def positive_definite(self) -> bool:
        """Whether K is, off the translations."""
        return self.grounded.positive_definite

    @cached_property
    def singular(self) -> bool:
        """Whether K is, off the translations."""
        return self.grounded.singular

    @property
    def fill(self) -> int:
        """That of K + ground."""
        return self.grounded.fill

    def solve(self, right: Floats) -> Floats:
        """W G W^T @ right as in `Factor`."""
        size = self.matrix.shape[0]
        columns = right if right.shape[0] == size else right.reshape(-1)
        return self.free.left_out(self.grounded.solve(self.free.balanced(columns))).reshape(right.shape)

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "grounded": self.grounded, "ground": self.ground, "free": self.free}
