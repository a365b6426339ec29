"""Penalties on the size t = |p_g| of a support force: profiles phi(t), t >= 0, without the weight k_sparse.

A profile is three functions of t and one of reweighting; `phi' >= 0` is all that the solver needs. The reweighting weight is
one rule for all of them, the largest slope from t on:

    w(t) = sup of phi'(s) over s >= t,

which is phi' itself where phi is concave. It is the slope of psi(t) = integral of w from 0 to t, concave, so each convex
step with weights w(|p|) majorises psi; and psi differs from phi by a constant once t is past the point of largest slope, so
what reweighted l1 settles on is stationary for phi too, and where nothing stands its test is the judge's own (off_support).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError


class Penalty(Protocol):
    """A profile phi with phi(0) = 0, of force magnitudes t >= 0 in newtons; arrays in, arrays of the same shape out."""

    @property
    def name(self) -> str:
        """As in a scene's penalty.name."""
        ...

    def value(self, size: Floats) -> Floats:
        """phi(t)."""
        ...

    def slope(self, size: Floats) -> Floats:
        """phi'(t), t > 0, and its limit at 0."""
        ...

    def curvature(self, size: Floats) -> Floats:
        """phi''(t), t > 0."""
        ...

    def weight(self, size: Floats) -> Floats:
        """w(t): the largest slope from t on, and so the largest of all at t = 0."""
        ...

    @property
    def resolution(self) -> float:
        """The size in newtons up to which a force counts as none: where phi is not yet concave; 0 for concave profiles."""
        ...


@dataclass(frozen=True)
class GroupLasso:
    """phi(t) = t: the sum of force magnitudes (equation 3 of the paper with alpha = 1), convex, biased towards small forces."""

    name: str = "group-lasso"

    def value(self, size: Floats) -> Floats:
        return np.asarray(size, dtype=float)

    def slope(self, size: Floats) -> Floats:
        return np.ones_like(size)

    def curvature(self, size: Floats) -> Floats:
        return np.zeros_like(size)

    def weight(self, size: Floats) -> Floats:
        return np.ones_like(size)

    @property
    def resolution(self) -> float:
        return 0.0


@dataclass(frozen=True)
class Power:
    """phi(t) = (t^2 + eps)^(alpha/2) - eps^(alpha/2): the paper's smoothed l2^alpha (section 3.1), zero at zero.

    Parameters
    ----------
    exponent : float
        alpha, 0 < alpha <= 1.
    smoothing : float
        eps in newtons squared; 0 only with alpha = 1, else the slope at 0 is infinite.

    Raises
    ------
    InputError
        A parameter out of its range.

    Notes
    -----
    phi is convex up to t1 = sqrt(eps / (1 - alpha)), where its slope is largest, and concave from there on (alpha = 1:
    convex throughout). So a force smaller than t1 is one that the smoothing made, not a support.
    """

    exponent: float = 0.5
    smoothing: float = 1e-6
    name: str = "power"

    def __post_init__(self) -> None:
        if not 0 < self.exponent <= 1:
            raise InputError(f"penalty.exponent is {self.exponent}: expected a number above 0 and at most 1")
        if not (self.smoothing > 0 or (self.smoothing == 0 and self.exponent == 1)):
            raise InputError(
                f"penalty.smoothing is {self.smoothing}: expected a number above 0 (0 only with exponent 1, else the slope at 0 "
                "is infinite)"
            )

    def value(self, size: Floats) -> Floats:
        half = self.exponent / 2
        if self.smoothing == 0:
            return np.asarray(size, dtype=float)
        # the difference of the two powers without its cancellation at small forces
        return self.smoothing**half * np.expm1(half * np.log1p(np.square(size) / self.smoothing))

    def slope(self, size: Floats) -> Floats:
        if self.smoothing == 0:
            return np.ones_like(size)
        return self.exponent * size * (np.square(size) + self.smoothing) ** (self.exponent / 2 - 1)

    def curvature(self, size: Floats) -> Floats:
        if self.smoothing == 0:
            return np.zeros_like(size)
        square = np.square(size)
        factor = self.exponent * (square + self.smoothing) ** (self.exponent / 2 - 2)
        return factor * (self.smoothing - (1 - self.exponent) * square)

    def weight(self, size: Floats) -> Floats:
        if self.exponent == 1:
            return np.ones_like(size)
        return self.slope(np.maximum(size, self.resolution))

    @property
    def resolution(self) -> float:
        if self.exponent == 1:
            return 0.0
        return float(np.sqrt(self.smoothing / (1 - self.exponent)))


def make_penalty(name: str, exponent: float | None, smoothing: float | None) -> Penalty:
    """The penalty of a scene's [penalty] section.

    Raises
    ------
    InputError
        No penalty of this name can be made from a file alone.
    """
    if name == "group-lasso":
        return GroupLasso()
    if name == "power":
        return Power(exponent if exponent is not None else 0.5, smoothing if smoothing is not None else 1e-6)
    raise InputError(f'penalty.name is {name!r}: expected "group-lasso" or "power", or hand a penalty of your own to Problem')
