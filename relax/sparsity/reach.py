"""What one support can do: in which directions it acts, how far its force may lean, and how large it may be.

Its amplitudes s are the force's components along `axes`, upward last. They lie in a cone C, all of space where nothing is asked,
cut off at the largest force. Both are convex, so projections say everything that an algorithm needs: a support where none
stands would act along P_C(-lam), and s is stationary for E_dist + R where s = P(s - tau gradient).
"""

from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError

UPWARD = 2  # the axis that gravity has


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

    def cone(self, vectors: Floats) -> Floats:
        """P_C: the nearest amplitudes (m, c) in the cone, of any size."""
        if self.tangent is None:
            return vectors
        up, across = vectors[:, -1], vectors[:, :-1]
        lateral = np.sqrt(np.einsum("ij,ij->i", across, across))
        inside = lateral <= self.tangent * up
        length, unit = self._on_the_side(up, lateral, across)
        nearest = np.column_stack([(self.tangent * length)[:, None] * unit, length])
        return np.where(inside[:, None], vectors, nearest)

    def project(self, vectors: Floats) -> Floats:
        """P: the nearest amplitudes (m, c) newtons that a support can have."""
        return self._capped(self.cone(vectors))

    def slope(self, vectors: Floats) -> Floats:
        """How P turns: its derivative (m, c, c) at `vectors` (m, c), symmetric, eigenvalues between 0 and 1.

        On an edge between two smooth pieces it is that of one of them.
        """
        count, width = vectors.shape
        turn = np.broadcast_to(np.eye(width), (count, width, width)).copy()
        inner = vectors
        if self.tangent is not None:
            inner = self.cone(vectors)
            up, across = vectors[:, -1], vectors[:, :-1]
            lateral = np.sqrt(np.einsum("ij,ij->i", across, across))
            outside = lateral > self.tangent * up
            length, unit = self._on_the_side(up, lateral, across)
            side = np.column_stack([self.tangent * unit, np.ones(count)]) / np.sqrt(1 + self.tangent**2)
            along = side[:, :, None] * side[:, None, :]
            around = np.zeros_like(along)
            around[:, :-1, :-1] = np.eye(width - 1) - unit[:, :, None] * unit[:, None, :]
            around *= (self.tangent * length / np.where(lateral > 0, lateral, 1.0))[:, None, None]
            turn[outside] = np.where((length > 0)[:, None, None], along + around, 0.0)[outside]
        size = np.sqrt(np.einsum("ij,ij->i", inner, inner))
        beyond = size > self.largest
        if beyond.any():
            unit = inner[beyond] / size[beyond, None]
            cap = (self.largest / size[beyond])[:, None, None] * (np.eye(width) - unit[:, :, None] * unit[:, None, :])
            turn[beyond] = cap @ turn[beyond]
        return turn

    def _capped(self, vectors: Floats) -> Floats:
        if not np.isfinite(self.largest):
            return vectors
        size = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
        return vectors * (self.largest / np.maximum(size, self.largest))[:, None]

    def _on_the_side(self, up: Floats, lateral: Floats, across: Floats) -> tuple[Floats, Floats]:
        """Upward component (m,) of the nearest point on the cone's side, 0 at its tip, and the direction across (m, c - 1)."""
        assert self.tangent is not None
        length = np.maximum(self.tangent * lateral + up, 0.0) / (1 + self.tangent**2)
        return length, across / np.where(lateral > 0, lateral, 1.0)[:, None]


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
