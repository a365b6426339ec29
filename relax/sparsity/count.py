"""Counting supports, whatever they carry."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relax.arrays import Floats

LEAST = 1e-150  # newtons: a smoothing that is none, though its square is still a number


@dataclass(frozen=True)
class Count:
    """phi(t) = 1 for t > 0: the number of supports, what every other penalty stands for.

    Notes
    -----
    The slope is 0 wherever a force stands, and phi jumps at zero: the largest slope from t on, taken as a limit, is infinite at
    0 and 0 beyond. So the duals say nothing of a candidate without a support, every fit on a support is stationary, and
    reweighted l1 keeps what it starts with. Reweighted least squares works on the smoothed t^2 / (t^2 + width^2) (Geman and
    McClure 1985), which lies below phi and reaches it as the width goes to 0.
    """

    name: ClassVar[str] = "count"
    resolution: ClassVar[float] = 0.0

    def value(self, size: Floats) -> Floats:
        return np.where(np.asarray(size) > 0, 1.0, 0.0)

    def slope(self, size: Floats) -> Floats:
        return np.zeros(np.shape(size))

    def curvature(self, size: Floats) -> Floats:
        return np.zeros(np.shape(size))

    def weight(self, size: Floats) -> Floats:
        return np.where(np.asarray(size) > 0, 0.0, np.inf)

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """Hard threshold: `size` where size^2 > 2 step; 0 of equals."""
        size = np.asarray(size, dtype=float)
        return np.where(size > np.sqrt(2 * np.asarray(step, dtype=float)), size, 0.0)

    def smoothed(self, size: Floats, width: float) -> Floats:
        """t^2 / (t^2 + width^2): what `parabola` majorises."""
        if width == 0:
            return self.value(size)
        size = np.asarray(size, dtype=float)
        return np.square(size / np.hypot(size, width))

    def parabola(self, size: Floats, width: float) -> Floats:
        """Its slope in t^2: width^2 / (t^2 + width^2)^2."""
        width = max(width, LEAST)
        reach = np.hypot(np.asarray(size, dtype=float), width)
        return np.square(width / reach / reach)
