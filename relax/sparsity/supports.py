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
        """The part of nodal forces (n, 3) that the candidates can carry (m, 3): B^T p."""
        return forces[self.vertices]


def sizes(amplitudes: Floats) -> Floats:
    """|s_g| of each group, (m,)."""
    return np.sqrt(np.einsum("ij,ij->i", amplitudes, amplitudes))
