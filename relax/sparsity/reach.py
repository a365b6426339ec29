"""What one support can do: in which directions it acts, how far its force may lean, and how large it may be.

Its amplitudes s are the force's components along `axes`, upward last. They lie in a cone C, all of space where nothing is asked,
cut off at the largest force. Both are convex, so projections say everything that an algorithm needs: a support where none
stands would act along P_C(-lam), and s is stationary for E_dist + R where s = P(s - tau gradient), P the projection on both.
"""

from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats, Mask
from relax.errors import InputError

UPWARD = 2  # the axis that gravity has
FLAT = 1e9  # tangent of a lean that 90 degrees cannot be told from


@dataclass(frozen=True)
class Reach:
    """The forces that a support can carry.

    Parameters
    ----------
    axes : tuple of int
        Components of the force that are free, ascending, upward among them: (0, 1, 2), or (2,) for vertical supports.
    tangent : float or None
        The cone |s_xy| <= tangent * s_z about the upward axis (0: vertical and pushing only); None: no cone.
    largest : float
        Largest force, newtons.

    Raises
    ------
    InputError
        A tangent below 0, or a largest force that is not above 0.
    """

    axes: tuple[int, ...] = (0, 1, 2)
    tangent: float | None = None
    largest: float = np.inf

    def __post_init__(self) -> None:
        if self.tangent is not None and not self.tangent >= 0:
            raise InputError(f"the tangent of a support's largest lean is {self.tangent}: expected a number of 0 or above")
        if not self.largest > 0:
            raise InputError(f"the largest force of a support is {self.largest}: expected a number above 0")

    @property
    def constrained(self) -> bool:
        """Whether there is anything that a force along the axes could violate."""
        return self.tangent is not None or bool(np.isfinite(self.largest))

    @property
    def flat(self) -> bool:
        """Whether the cone is the half-space that pushes, which a solver had better be told."""
        return self.tangent is not None and self.tangent > FLAT

    def cone(self, vectors: Floats) -> Floats:
        """P_C: the nearest amplitudes (m, c) in the cone, of any size."""
        if self.tangent is None:
            return vectors
        up, lateral, unit = _polar(vectors)
        length = self._length(up, lateral)
        nearest = np.column_stack([(self.tangent * length)[:, None] * unit, length])
        return np.where(self._inside(up, lateral)[:, None], vectors, nearest)

    def project(self, vectors: Floats) -> Floats:
        """P: the nearest amplitudes (m, c) newtons that a support can have."""
        return self._capped(self.cone(vectors))

    def pull(self, dual: Floats) -> Floats:
        """|P_C(-lam)| (m,): the slope at which a first force would lower E_dist, for duals (m, c)."""
        return sizes(self.cone(-dual))

    def prox(self, vectors: Floats, threshold: Floats) -> Floats:
        """The minimiser (m, c) of |s - v|^2 / 2 + threshold |s| over what a support can have, for thresholds (m,).

        Cone, shrinkage and cap follow each other, since a cone holds every multiple of its vectors and a ball every part.
        """
        inner = self.cone(vectors)
        size = sizes(inner)
        left = np.minimum(np.maximum(size - threshold, 0.0), self.largest)
        return inner * (left / np.where(size > 0, size, 1.0))[:, None]

    def slope(self, vectors: Floats, threshold: Floats | float = 0.0) -> Floats:
        """How P, or `prox` with a threshold, turns: its derivative (m, c, c) at `vectors` (m, c), symmetric, in [0, I].

        On an edge between two smooth pieces it is that of one of them.
        """
        count, width = vectors.shape
        turn = np.broadcast_to(np.eye(width), (count, width, width)).copy()
        inner = vectors
        if self.tangent is not None:
            inner = self.cone(vectors)
            up, lateral, unit = _polar(vectors)
            outside = ~self._inside(up, lateral)
            length = self._length(up, lateral)
            side = np.column_stack([self.tangent * unit, np.ones(count)]) / np.sqrt(1 + self.tangent**2)
            along = side[:, :, None] * side[:, None, :]
            around = np.zeros_like(along)
            around[:, :-1, :-1] = np.eye(width - 1) - unit[:, :, None] * unit[:, None, :]
            around *= (self.tangent * length / np.where(lateral > 0, lateral, 1.0))[:, None, None]
            turn[outside] = np.where((length > 0)[:, None, None], along + around, 0.0)[outside]
        size = sizes(inner)
        left = np.maximum(size - threshold, 0.0)
        bent = (left < size) | (left > self.largest)
        if bent.any():
            size, left = size[bent], left[bent]
            unit = inner[bent] / np.where(size > 0, size, 1.0)[:, None]
            radial = unit[:, :, None] * unit[:, None, :]
            share = (np.minimum(left, self.largest) / np.where(size > 0, size, 1.0))[:, None, None]
            grows = ((left > 0) & (left <= self.largest))[:, None, None]
            turn[bent] = (share * (np.eye(width) - radial) + grows * radial) @ turn[bent]
        return turn

    def _capped(self, vectors: Floats) -> Floats:
        if not np.isfinite(self.largest):
            return vectors
        return vectors * (self.largest / np.maximum(sizes(vectors), self.largest))[:, None]

    def _inside(self, up: Floats, lateral: Floats) -> Mask:
        assert self.tangent is not None
        inside: Mask = (lateral <= self.tangent * up) & (up >= 0)  # 0 * up is 0 below the tip as well
        return inside

    def _length(self, up: Floats, lateral: Floats) -> Floats:
        """Upward component (m,) of the nearest point on the cone's side, 0 at its tip."""
        assert self.tangent is not None
        return np.maximum(self.tangent * lateral + up, 0.0) / (1 + self.tangent**2)


def sizes(amplitudes: Floats) -> Floats:
    """|s_g| of each group, (m,)."""
    return np.sqrt(np.einsum("ij,ij->i", amplitudes, amplitudes))


def _polar(vectors: Floats) -> tuple[Floats, Floats, Floats]:
    """Upward component (m,), size across (m,) and direction across (m, c - 1)."""
    up, across = vectors[:, -1], vectors[:, :-1]
    lateral = sizes(across)
    return up, lateral, across / np.where(lateral > 0, lateral, 1.0)[:, None]


ANYTHING = Reach()


def reach_of(direction: str | dict[str, float], largest: float | None) -> Reach:
    """The reach that a scene's supports.direction and supports.max_force ask for."""
    cap = np.inf if largest is None else float(largest)
    if isinstance(direction, dict):
        degrees = float(direction["lean"])
        return Reach((UPWARD,), 0.0, cap) if degrees == 0 else Reach((0, 1, 2), float(np.tan(np.radians(degrees))), cap)
    if direction == "any":
        return Reach(largest=cap)
    return Reach((UPWARD,), 0.0 if direction == "up" else None, cap)
