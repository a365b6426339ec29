"""Folded concave penalties: slope 1 at zero, none on large forces, so that these are found without bias.

Their slope is 0 beyond a few knees, and a smoothing tau larger than that would leave least squares nothing to weight: over
random problems with forces of 20 knees, one in eight ended at the best support instead of three in four. So the knee is
stretched as tau grows, at the same height: phi(r h) - phi(r tau), with h = sqrt(t^2 + tau^2) and r = knee / (knee + 4 tau).
"""

from dataclasses import dataclass
from math import inf
from typing import Annotated, ClassVar

import numpy as np

from relax.arrays import Floats
from relax.sparsity.parameters import Force, Numbers, check_parameters

LEAST = 1e-150  # newtons: no force at all, though its square is still a number
STRETCH = 4.0  # of the smoothing: what it adds to the knee


@dataclass(frozen=True)
class MCP:
    """phi(t) = t - t^2 / (2 knee) up to the knee, knee / 2 from there on (Zhang 2010, "Nearly unbiased variable selection").

    Parameters
    ----------
    knee : float
        Newtons: the slope falls in a straight line from 1 at zero to 0 there. knee -> inf is the group lasso. In Zhang's
        letters lambda = 1 and gamma = knee.

    Raises
    ------
    InputError
        A knee that is not above 0.
    """

    knee: Force
    name: ClassVar[str] = "mcp"
    resolution: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)

    def value(self, size: Floats) -> Floats:
        inside = np.minimum(np.asarray(size, dtype=float), self.knee)
        return inside * (1 - 0.5 * (inside / self.knee))

    def slope(self, size: Floats) -> Floats:
        return 1 - np.minimum(np.asarray(size, dtype=float), self.knee) / self.knee

    def curvature(self, size: Floats) -> Floats:
        return np.where(np.asarray(size, dtype=float) < self.knee, -1 / self.knee, 0.0)

    def weight(self, size: Floats) -> Floats:
        return self.slope(size)

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """Firm threshold where step < knee; else, with no minimum below the knee, hard at sqrt(step knee). 0 of equals."""
        size = np.asarray(size, dtype=float)
        step = np.asarray(step, dtype=float)
        room = np.where(step < self.knee, self.knee - step, inf)
        firm = np.minimum(np.maximum(size - step, 0.0) * (self.knee / room), size)
        hard = np.where(size > np.sqrt(step) * np.sqrt(self.knee), size, 0.0)
        return np.where(step < self.knee, np.where(size < self.knee, firm, size), hard)

    def smoothed(self, size: Floats, width: float) -> Floats:
        """What `parabola` majorises: phi(r h) - phi(r width)."""
        return _stretched(self, size, width)

    def parabola(self, size: Floats, width: float) -> Floats:
        """Its slope in t^2: r phi'(r h) / (2 h)."""
        return _stretched_parabola(self, size, width)


@dataclass(frozen=True)
class SCAD:
    """Slope 1 up to the knee, then falling in a straight line to 0 at shape * knee (Fan and Li 2001, equation 2.6).

    phi(t) = t up to the knee; (2 shape knee t - t^2 - knee^2) / (2 (shape - 1) knee) up to shape * knee; (shape + 1) knee / 2
    from there on.

    Parameters
    ----------
    knee : float
        Newtons. In Fan and Li's letters lambda = knee, and phi is their penalty over lambda, so that the slope at zero is 1.
        knee -> inf is the group lasso.
    shape : float
        Their a, above 2; 3.7 is their choice.

    Raises
    ------
    InputError
        A parameter out of its range.
    """

    knee: Force
    shape: Annotated[float, Numbers("a number above 2", lambda shape: 2 < shape < inf)] = 3.7
    name: ClassVar[str] = "scad"
    resolution: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        check_parameters(self)

    def value(self, size: Floats) -> Floats:
        size = np.asarray(size, dtype=float)
        # straight to the knee, then the area under a slope that falls in a straight line
        beyond = np.clip(size, self.knee, self._flat) - self.knee
        return np.minimum(size, self.knee) + 0.5 * beyond * (1 + self.slope(size))

    def slope(self, size: Floats) -> Floats:
        beyond = np.clip(np.asarray(size, dtype=float), self.knee, self._flat)
        return (self._flat - beyond) / (self._flat - self.knee)

    def curvature(self, size: Floats) -> Floats:
        size = np.asarray(size, dtype=float)
        return np.where((size > self.knee) & (size < self._flat), -1 / (self._flat - self.knee), 0.0)

    def weight(self, size: Floats) -> Floats:
        return self.slope(size)

    def prox(self, size: Floats, step: Floats | float) -> Floats:
        """Fan and Li's three pieces where step < (shape - 1) knee, else soft or the size itself; the smaller t of equals.

        With a larger step the middle piece is concave and holds no minimum. The size itself beats the soft threshold beyond
        (step + (shape + 1) knee) / 2, and beyond sqrt(step (shape + 1) knee) where the soft threshold is 0 there.
        """
        size = np.asarray(size, dtype=float)
        step = np.asarray(step, dtype=float)
        fall, top = self._flat - self.knee, self._flat + self.knee
        soft = np.maximum(size - step, 0.0)
        room = np.where(step < fall, fall - step, inf)
        # minus the way from shape * knee down: the middle piece's minimum, exact at its upper end
        middle = self._flat - (self._flat - np.minimum(size, self._flat)) * (fall / room)
        convex = np.where(size - step <= self.knee, soft, np.where(size < self._flat, middle, size))
        jump = np.where(step < top, 0.5 * (step + top), np.sqrt(step) * np.sqrt(top))
        return np.where(step < fall, convex, np.where(size > jump, size, soft))

    def smoothed(self, size: Floats, width: float) -> Floats:
        """What `parabola` majorises: phi(r h) - phi(r width)."""
        return _stretched(self, size, width)

    def parabola(self, size: Floats, width: float) -> Floats:
        """Its slope in t^2: r phi'(r h) / (2 h)."""
        return _stretched_parabola(self, size, width)

    @property
    def _flat(self) -> float:
        return self.shape * self.knee


def _shrunk(knee: float, width: float) -> float:
    """How much smaller a force counts under smoothing; 2 to 8 in place of STRETCH find the same supports, 1 fewer."""
    return knee / (knee + STRETCH * width)


def _stretched(penalty: "MCP | SCAD", size: Floats, width: float) -> Floats:
    r = _shrunk(penalty.knee, width)
    return penalty.value(r * np.hypot(size, width)) - penalty.value(np.full(1, r * width))


def _stretched_parabola(penalty: "MCP | SCAD", size: Floats, width: float) -> Floats:
    r = _shrunk(penalty.knee, width)
    reach = np.maximum(np.hypot(size, width), LEAST)
    return r * penalty.slope(r * reach) / (2 * reach)
