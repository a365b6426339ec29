"""Surrogates: convex functions of a force that touch a penalty from above, whose minimum lowers it; weights on |p| or |p|^2."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import ClassVar, Protocol

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.sparsity.penalties import Penalty, is_convex, steepest

LEAST = 1e-150  # newtons: no force at all, though its square is still a number


class Surrogate(Protocol):
    """coefficient * |p|^degree + a constant; sizes and smoothing in newtons, arrays of one shape.

    `smoothing` tau keeps the coefficient of small forces bounded; 0 is the penalty as it is.
    """

    @property
    def name(self) -> str:
        """What it is called in tables."""
        ...

    @property
    def degree(self) -> int:
        """The power of |p| that it weights."""
        ...

    def coefficient(self, penalty: Penalty, size: Floats, smoothing: float = 0.0) -> Floats:
        """The weight of |p|^degree that touches at `size`."""
        ...

    def majorised(self, penalty: Penalty, size: Floats, smoothing: float = 0.0) -> Floats:
        """What it touches and lies above, 0 at 0: what its iterations descend."""
        ...

    def touching(self, penalty: Penalty, size_at: Floats, size: Floats, smoothing: float = 0.0) -> Floats:
        """Its value at `size`, touching at `size_at`."""
        ...


@dataclass(frozen=True)
class ReweightedL1:
    """w(t + tau) |p|: a tangent of psi(t + tau) - psi(tau), psi(t) the integral of the weight w from 0 to t.

    Candes, Wakin, Boyd 2008 with phi's largest slope from t on in place of its slope; psi is phi where phi is concave, and
    phi and a constant beyond the resolution. Count cannot be reweighted so: its weight is 0 or infinite, whatever the force.
    """

    name: ClassVar[str] = "reweighted-l1"
    degree: ClassVar[int] = 1

    def coefficient(self, penalty: Penalty, size: Floats, smoothing: float = 0.0) -> Floats:
        return penalty.weight(size + smoothing)

    def majorised(self, penalty: Penalty, size: Floats, smoothing: float = 0.0) -> Floats:
        psi = _psi(penalty, size + smoothing)
        return psi - _psi(penalty, np.full(1, smoothing)) if smoothing else psi

    def touching(self, penalty: Penalty, size_at: Floats, size: Floats, smoothing: float = 0.0) -> Floats:
        gap = size - size_at
        # an infinite weight costs nothing where nothing moves
        weight = np.where(gap == 0, 0.0, self.coefficient(penalty, size_at, smoothing))
        return self.majorised(penalty, size_at, smoothing) + weight * gap


@dataclass(frozen=True)
class ReweightedL2:
    """phi'(h) / (2 h) |p|^2, h = sqrt(t^2 + tau^2): touches phi(h) - phi(tau), which with tau = 0 is phi (IRLS).

    It lies above because phi(sqrt u) is concave in u (Daubechies, DeVore, Fornasier, Gunturk 2010 for powers). A penalty
    with a `parabola(size, smoothing)` and a `smoothed(size, smoothing)` of its own (count, MCP, SCAD) is taken by these.
    """

    name: ClassVar[str] = "reweighted-l2"
    degree: ClassVar[int] = 2

    def coefficient(self, penalty: Penalty, size: Floats, smoothing: float = 0.0) -> Floats:
        own = getattr(penalty, "parabola", None)
        if own is not None:
            return own(size, smoothing)
        reach = np.maximum(np.hypot(size, smoothing), LEAST)
        return penalty.slope(reach) / (2 * reach)

    def majorised(self, penalty: Penalty, size: Floats, smoothing: float = 0.0) -> Floats:
        own = getattr(penalty, "smoothed", None)
        if own is not None:
            return own(size, smoothing)
        return penalty.value(np.hypot(size, smoothing)) - penalty.value(np.full(1, float(smoothing)))

    def touching(self, penalty: Penalty, size_at: Floats, size: Floats, smoothing: float = 0.0) -> Floats:
        rise = self.coefficient(penalty, size_at, smoothing) * (size - size_at) * (size + size_at)
        return self.majorised(penalty, size_at, smoothing) + rise


REWEIGHTED_L1 = ReweightedL1()
REWEIGHTED_L2 = ReweightedL2()


def _psi(penalty: Penalty, size: Floats) -> Floats:
    """The integral of the weight: straight up to the resolution, where the slope is largest, then phi and a constant."""
    if is_convex(penalty):
        return steepest(penalty) * size
    known = penalty.resolution
    if known == 0:
        return penalty.value(size)
    beyond = penalty.value(np.maximum(size, known)) - penalty.value(np.full(1, known))
    return steepest(penalty) * np.minimum(size, known) + beyond


@dataclass(frozen=True)
class Continuation:
    """Smoothings that shrink from one reweighting to the next: at first all groups look alike, in the end few are left.

    Parameters
    ----------
    first : float
        The first smoothing as a share of the largest force, above `least`.
    shrink : float
        Each over the one before, between 0 and 1.
    least : float
        The share where it ends, above 0: the last one is larger.

    Raises
    ------
    InputError
        Numbers of which no falling sequence can be made.
    """

    first: float = 1.0
    shrink: float = 0.6
    least: float = 2e-4

    def __post_init__(self) -> None:
        if not 0 < self.least < self.first < inf:
            raise InputError(
                f"continuation from {self.first} to {self.least}: expected a first smoothing above the least, and that above 0"
            )
        if not 0 < self.shrink < 1:
            raise InputError(f"continuation.shrink is {self.shrink}: expected a number between 0 and 1")

    def smoothings(self, largest: float) -> Iterator[float]:
        """Smoothings tau in newtons beside a largest force of `largest` newtons."""
        width = self.first
        while width > self.least:
            yield width * largest
            width *= self.shrink
