"""Where supports may act: groups of force components, one group a candidate vertex."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Ints, lock_arrays


@dataclass(frozen=True)
class Supports:
    """Candidates among the n free vertices; the amplitudes s (m, 3) of their forces enter equilibrium as f + g + B s = 0.

    Parameters
    ----------
    vertices : (m,) int
        Indices into the free vertices, ascending.
    weights : (m,)
        Factor of each group's penalty.
    free : int
        Number of free vertices n.
    """

    vertices: Ints
    weights: Floats
    free: int

    def __post_init__(self) -> None:
        lock_arrays(self)

    @cached_property
    def rows(self) -> Ints:
        """Row of K that each amplitude acts on (m, 3)."""
        return 3 * self.vertices[:, None] + np.arange(3)

    def forces(self, amplitudes: Floats) -> Floats:
        """B s as nodal forces (n, 3) newtons."""
        forces = np.zeros((self.free, 3))
        forces[self.vertices] = amplitudes
        return forces

    def amplitudes(self, forces: Floats) -> Floats:
        """The amplitudes (m, 3) of nodal forces (n, 3), as far as the candidates can carry them: B s = p there."""
        return forces[self.vertices]

    def duals(self, field: Floats) -> Floats:
        """What each group feels of a dual field (n, 3): B^T lam (m, 3)."""
        return field[self.vertices]


@dataclass(frozen=True)
class OrbitSupports(Supports):
    """Candidates of a symmetric membrane by one vertex of each orbit: B projects on what a support can do there, times its share.

    Parameters
    ----------
    vertices, weights, free
        As in Supports.
    share : (m,)
        What the membrane counts of each vertex: less than 1 on a mirror and on the axis.
    invariant : (m, 3, 3)
        Projection on the forces that the symmetry allows there.
    """

    share: Floats
    invariant: Floats

    def _allowed(self, vectors: Floats) -> Floats:
        return np.einsum("gij,gj->gi", self.invariant, vectors)

    def forces(self, amplitudes: Floats) -> Floats:
        """B s as nodal forces (n, 3) newtons."""
        return super().forces(self.share[:, None] * self._allowed(amplitudes))

    def amplitudes(self, forces: Floats) -> Floats:
        """The amplitudes (m, 3) of symmetric nodal forces (n, 3)."""
        return self._allowed(super().amplitudes(forces)) / self.share[:, None]

    def duals(self, field: Floats) -> Floats:
        """What each group feels of a dual field (n, 3): B^T lam (m, 3)."""
        return self.share[:, None] * self._allowed(super().duals(field))


def sizes(amplitudes: Floats) -> Floats:
    """|s_g| of each group, (m,)."""
    return np.sqrt(np.einsum("ij,ij->i", amplitudes, amplitudes))
