"""What the forces of a part without a fixed vertex must add up to: minus its loads, else nothing holds it where it is.

sum of s_g over the groups g of part q  =  t_q,     an equality E s = t on the amplitudes, three numbers a part
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.sparsity.reach import sizes

ROUND_OFF = 1e-9  # of the largest force: what a sum that was made to fit may leave


@dataclass(frozen=True)
class Resultants:
    """The conditions on amplitudes (m, 3) of forces that can point anywhere.

    Parameters
    ----------
    part : (m,) int
        The part q that each group is of; -1 where a fixed vertex takes what is left over.
    total : (q, 3) newtons
        t.
    """

    part: Ints
    total: Floats

    def __post_init__(self) -> None:
        lock_arrays(self)

    def of(self, groups: Ints) -> "Resultants":
        """The same conditions on some groups, the others being zero."""
        return Resultants(self.part[groups], self.total)

    def sums(self, amplitudes: Floats) -> Floats:
        """E s (q, 3)."""
        sums = np.zeros_like(self.total)
        bound = self.part >= 0
        np.add.at(sums, self.part[bound], amplitudes[bound])
        return sums

    def met(self, amplitudes: Floats) -> bool:
        """Whether every part is held, by forces that add up to what they must."""
        standing = amplitudes.any(axis=1)
        held = np.isin(np.arange(len(self.total)), self.part[standing]).all()
        missing = sizes(self.sums(amplitudes) - self.total).max(initial=0.0)
        return bool(held and missing <= ROUND_OFF * sizes(amplitudes).max(initial=0.0))

    def repaired(self, amplitudes: Floats) -> Floats | None:
        """The forces that stand, changed in proportion to their sizes so that they add up; None where too few stand for that."""
        size = sizes(amplitudes) * (self.part >= 0)
        whole = np.bincount(self.part[self.part >= 0], size[self.part >= 0], minlength=len(self.total))
        if (whole == 0).any():
            return None
        share = np.divide(size, whole[self.part], out=np.zeros_like(size), where=size > 0)
        repaired = amplitudes
        for _ in range(2):  # the second for the round-off of the first
            missing = self.total - self.sums(repaired)
            repaired = repaired + share[:, None] * missing[self.part]
        return repaired if self.met(repaired) else None

    def multiplier(self, gradient: Floats, counts: Floats | Mask) -> Floats:
        """Of each part's condition (q, 3), from a gradient (m, 3): minus its mean over the part, each group as it counts (m,).

        Along forces that keep their sums the gradient is only known up to a vector a part; where they are stationary this one
        makes it vanish on all that stand.
        """
        chosen = np.flatnonzero(np.asarray(counts, dtype=float) * (self.part >= 0))
        weight = np.asarray(counts, dtype=float)[chosen]
        total, whole = np.zeros_like(self.total), np.zeros(len(self.total))
        np.add.at(total, self.part[chosen], weight[:, None] * gradient[chosen])
        np.add.at(whole, self.part[chosen], weight)
        minus_mean: Floats = -total / np.where(whole > 0, whole, 1.0)[:, None]
        return minus_mean

    def spread(self, vectors: Floats) -> Floats:
        """A vector of each part (q, 3), at its groups (m, 3); zero at the others."""
        return np.where(self.part[:, None] >= 0, vectors[self.part], 0.0)

    @cached_property
    def matrix(self) -> Floats:
        """E (3q, 3m), of the parts that have a group here."""
        parts = np.unique(self.part[self.part >= 0])
        return np.kron((self.part == parts[:, None]).astype(float), np.eye(3))

    @cached_property
    def directions(self) -> Floats:
        """An orthonormal basis (3m, r) of the changes that keep the sums."""
        if not len(self.matrix):
            return np.eye(3 * len(self.part))
        basis = np.linalg.qr(self.matrix.T, mode="complete")[0]
        return basis[:, len(self.matrix) :]

    def constrained(self, inverse: Floats) -> Floats:
        """The inverse (3m, 3m) of a quadratic where only changes that keep the sums count."""
        across = inverse @ self.matrix.T
        reduced: Floats = inverse - across @ np.linalg.solve(self.matrix @ across, across.T)
        return reduced

    def fitted_by(self, inverse: Floats, linear: Floats) -> Floats:
        """The minimiser (m, 3) of s^T A s + 2 b^T s under the conditions, from A's inverse (3m, 3m) and b (m, 3)."""
        return self.fitted(-(inverse @ linear.ravel()).reshape(linear.shape), inverse @ self.matrix.T)

    def fitted(self, free: Floats, response: Floats) -> Floats:
        """Of a quadratic A: its minimiser under the conditions, from the free one (m, 3) and response = A^-1 E^T (3m, 3q)."""
        wanted = self.total[np.unique(self.part[self.part >= 0])].ravel()
        if not wanted.size:
            return free
        excess = self.matrix @ free.ravel() - wanted
        moved = free.ravel() - response @ np.linalg.solve(self.matrix @ response, excess)
        return moved.reshape(free.shape)
