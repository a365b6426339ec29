"""The paper's penalties: the sum of force magnitudes, and its smoothed power l2^alpha."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relax.arrays import Floats, Mask
from relax.errors import InputError
from relax.sparsity.parameters import Numbers, check_parameters

NEWTON = 200  # steps to a root; some 10 as a rule, 70 seen where a smoothing of 1e-15 meets a force of 1e300
FAR = 1e150  # its square is still a number
ULPS = 4 * np.finfo(float).eps  # relative: a root that moves by less has been found


@dataclass(frozen=True)
class GroupLasso:
    """phi(t) = t: the sum of force magnitudes (equation 3 of the paper with alpha = 1), convex, biased towards small forces."""

    name: ClassVar[str] = "group-lasso"
    resolution: ClassVar[float] = 0.0

    def value(self, size: Floats) -> Floats:
        return np.asarray(size, dtype=float)

    def slope(self, size: Floats) -> Floats:
        return np.ones(np.shape(size))

    def curvature(self, size: Floats) -> Floats:
        return np.zeros(np.shape(size))

    def weight(self, size: Floats) -> Floats:
        return np.ones(np.shape(size))

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """Soft threshold: size - step, not below 0."""
        return np.maximum(np.asarray(size, dtype=float) - step, 0.0)


@dataclass(frozen=True)
class Power:
    """phi(t) = (t^2 + eps)^(alpha/2) - eps^(alpha/2): the paper's smoothed l2^alpha (section 3.1), zero at zero.

    Parameters
    ----------
    exponent : float
        alpha, 0 < alpha <= 1.
    smoothing : float
        eps in newtons squared; 0 only with alpha = 1, else the slope at 0 is infinite. alpha = 1 with eps = 0 is the group lasso.

    Raises
    ------
    InputError
        A parameter out of its range.

    Notes
    -----
    phi is convex up to t1 = sqrt(eps / (1 - alpha)), where its slope is largest, and concave from there on (alpha = 1:
    convex throughout). So a force smaller than t1 is one that the smoothing made, not a support.
    """

    exponent: Annotated[float, Numbers("a number above 0 and at most 1", lambda alpha: 0 < alpha <= 1)] = 0.5
    smoothing: Annotated[
        float, Numbers("a number above 0, newtons squared (0 with exponent = 1 alone)", lambda eps: 0 <= eps < np.inf)
    ] = 1e-6
    name: ClassVar[str] = "power"

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.smoothing == 0 and self.exponent != 1:
            raise InputError(
                f"penalty.smoothing = 0: with exponent = {self.exponent} the weight at a force of 0 would be infinite; "
                "give a number above 0 (default 1e-06), or exponent = 1"
            )

    def value(self, size: Floats) -> Floats:
        size = np.asarray(size, dtype=float)
        if self.smoothing == 0:
            return size
        root = np.sqrt(self.smoothing)
        # log(h / s), h^2 = t^2 + s^2; where t outgrows s by more than a square can hold, h^alpha alone still tells sizes apart
        grown = 0.5 * np.log1p(np.square(np.minimum(size, FAR * root) / root))
        # h^alpha - s^alpha as h^alpha (1 - (s/h)^alpha): no cancellation at small forces, no overflow at large ones
        return -(np.hypot(size, root) ** self.exponent) * np.expm1(-self.exponent * grown)

    def slope(self, size: Floats) -> Floats:
        if self.smoothing == 0:
            return np.ones(np.shape(size))
        size = np.asarray(size, dtype=float)
        reach = np.hypot(size, np.sqrt(self.smoothing))
        return self.exponent * (size / reach) * reach ** (self.exponent - 1)

    def curvature(self, size: Floats) -> Floats:
        if self.smoothing == 0:
            return np.zeros(np.shape(size))
        size = np.asarray(size, dtype=float)
        root = np.sqrt(self.smoothing)
        reach = np.hypot(size, root)
        bend = np.square(root / reach) - (1 - self.exponent) * np.square(size / reach)
        return self.exponent * reach ** (self.exponent - 2) * bend

    def weight(self, size: Floats) -> Floats:
        if self.exponent == 1:
            return np.ones(np.shape(size))
        return self.slope(np.maximum(np.asarray(size, dtype=float), self.resolution))

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """The lower of two minima, each by Newton from the side where it cannot pass its root; the smaller t of equals.

        F' = t - size + step phi' is concave up to t2 = sqrt(3) t1, where phi'' is least, and convex from there on. So Newton from
        0 climbs to the one minimum below t2 or past it, and Newton from `size` descends to the one above or past it.
        """
        size, step = (np.array(one) for one in np.broadcast_arrays(np.asarray(size, dtype=float), np.asarray(step, dtype=float)))
        if self.smoothing == 0:
            return np.maximum(size - step, 0.0)
        turn = np.minimum(size, np.sqrt(3) * self.resolution if self.exponent < 1 else np.inf)
        low, no_low = self._root(size, step, np.zeros_like(size), turn)
        high, no_high = self._root(size, step, size, turn)
        better = ~no_low & (self._gain(high, size, step) <= self._gain(low, size, step))
        return np.where(no_high | better, low, high)

    def _root(self, size: Floats, step: Floats, start: Floats, turn: Floats) -> tuple[Floats, Mask]:
        """The minimum between `start` and `turn`, and where there is none: F' keeps its sign up to `turn`."""
        side = np.where(start < turn, -1.0, 1.0)  # the sign of F' at the start, if it is no minimum itself
        t = start
        for _ in range(NEWTON):
            force, stiff = t - size + step * self.slope(t), 1 + step * self.curvature(t)
            ahead = t - force / np.where(stiff > 0, stiff, 1.0)
            ahead = np.where(stiff > 0, np.clip(ahead, np.minimum(t, turn), np.maximum(t, turn)), turn)
            moved = np.where(force * side <= 0, t, ahead)
            settled = np.abs(moved - t) <= ULPS * moved
            t = moved
            if settled.all():
                break
        return t, (t == turn) & ((t - size + step * self.slope(t)) * side > 0)

    def _gain(self, t: Floats, size: Floats, step: Floats) -> Floats:
        """(F(0) - F(t)) / size, which does not overflow."""
        scale = np.maximum(size, np.finfo(float).tiny)
        return t * (1 - 0.5 * (t / scale)) - step * (self.value(t) / scale)

    @property
    def resolution(self) -> float:
        if self.exponent == 1:
            return 0.0
        return float(np.sqrt(self.smoothing / (1 - self.exponent)))
