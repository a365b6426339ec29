"""The log-sum penalty, what reweighting by 1 / (t + scale) descends."""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

import numpy as np

from relax.arrays import Floats
from relax.sparsity.parameters import Force, check_parameters


@dataclass(frozen=True)
class LogSum:
    """phi(t) = s log(1 + t / s): concave, slope 1 at zero (Candes, Wakin, Boyd 2008, section 2.3).

    Parameters
    ----------
    scale : float
        s in newtons: the force at which the slope has fallen to 1/2. s -> inf is the group lasso; with s -> 0 it
        counts, in the sense that phi(t) / phi(1 N) -> 1 for each t > 0, though slowly.

    Raises
    ------
    InputError
        A scale that is not above 0.
    """

    scale: Force
    name: ClassVar[str] = "log-sum"
    resolution: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)

    def value(self, size: Floats) -> Floats:
        size = np.asarray(size, dtype=float)
        small = np.log1p(np.minimum(size, self.scale) / self.scale)
        # t / s of the plain formula may overflow where t is large
        return self.scale * np.where(size < self.scale, small, np.log(size + self.scale) - np.log(self.scale))

    def slope(self, size: Floats) -> Floats:
        return self.scale / (self.scale + np.asarray(size, dtype=float))

    def curvature(self, size: Floats) -> Floats:
        return -self.slope(size) / (self.scale + np.asarray(size, dtype=float))

    def weight(self, size: Floats) -> Floats:
        return self.slope(size)

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """The larger root of t^2 + (s - size) t + s (step - size) = 0, or 0 where that is no higher; the smaller t of equals."""
        size = np.asarray(size, dtype=float)
        step, s = np.asarray(step, dtype=float), self.scale
        excess = np.maximum(size - step, 0.0)
        both, mean = size + s, 2 * np.sqrt(s) * np.sqrt(step)
        # the discriminant's root in the form that does not cancel: of (size - s)^2 + 4 s excess, or of (size + s)^2 - 4 s step
        root = np.where(
            excess > 0,
            np.hypot(size - s, 2 * np.sqrt(s) * np.sqrt(excess)),
            np.sqrt(np.maximum(both - mean, 0.0)) * np.sqrt(both + mean),
        )
        sum_of_roots = size - s
        # below s the two terms cancel where the excess is small: the product of the roots over the other root instead
        cancels = (excess > 0) & (sum_of_roots < 0)
        over_other = 2 * excess * (s / np.where(cancels, root - sum_of_roots, inf))
        t = np.clip(np.where(cancels, over_other, 0.5 * (sum_of_roots + root)), 0.0, size)
        scale = np.maximum(size, np.finfo(float).tiny)
        gain = t * (1 - 0.5 * (t / scale)) - step * (self.value(t) / scale)
        # with size > step F falls from 0 on; else the root is a minimum only where it is real, and must beat 0
        lower = (excess > 0) | ((both >= mean) & (gain > 0))
        return np.where(lower, t, 0.0)
