"""Where supports may act: groups of force components, one group a candidate vertex."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.sparsity.reach import ANYTHING, Reach, sizes

__all__ = ["OrbitSupports", "Supports", "sizes"]


@dataclass(frozen=True)
class Supports:
    """Candidates among the n free vertices; the amplitudes s (m, c) of their forces enter equilibrium as f + g + B s = 0.

    Parameters
    ----------
    vertices : (m,) int
        Indices into the free vertices, ascending.
    weights : (m,)
        Factor of each group's penalty; 0: a support that stands whatever comes.
    free : int
        Number of free vertices n.
    reach : Reach
        What each of them can do; its c axes are the components of an amplitude.
    """

    vertices: Ints
    weights: Floats
    free: int
    reach: Reach = ANYTHING

    def __post_init__(self) -> None:
        lock_arrays(self)

    @property
    def width(self) -> int:
        """Components of a group's amplitudes, c."""
        return len(self.reach.axes)

    @cached_property
    def rows(self) -> Ints:
        """Row of K that each amplitude acts on (m, c)."""
        return 3 * self.vertices[:, None] + np.array(self.reach.axes)

    @cached_property
    def always(self) -> Mask:
        """Groups that stand whatever comes (m,)."""
        return self.weights == 0

    @cached_property
    def none(self) -> Floats:
        """Amplitudes (m, c) of no support at all."""
        return np.zeros((len(self.vertices), self.width))

    def forces(self, amplitudes: Floats) -> Floats:
        """B s as nodal forces (n, 3) newtons."""
        forces = np.zeros((self.free, 3))
        forces[self.vertices[:, None], self.reach.axes] = amplitudes
        return forces

    def amplitudes(self, forces: Floats) -> Floats:
        """The components (m, c) of nodal forces (n, 3) along the axes, at the candidates: B s = p there, if p is along them."""
        return forces[self.vertices[:, None], self.reach.axes]

    def nearest(self, forces: Floats) -> Floats:
        """Amplitudes (m, c) of the forces nearest to nodal ones (n, 3) that the supports can carry."""
        return self.reach.project(self.amplitudes(forces))

    def duals(self, field: Floats) -> Floats:
        """What each group feels of a dual field (n, 3): B^T lam (m, c)."""
        return field[self.vertices[:, None], self.reach.axes]

    def steepness(self, dual: Floats) -> Floats:
        """|P_C(-lam_g)| / c_g (m,): what a unit of force gains at each candidate, over its price; 0 for those without a price."""
        return self.reach.pull(dual) / np.where(self.always, np.inf, self.weights)


@dataclass(frozen=True, kw_only=True)
class OrbitSupports(Supports):
    """Candidates of a symmetric membrane by one vertex of each orbit: B projects on what a support can do there, times its share.

    Parameters
    ----------
    vertices, weights, free, reach
        As in Supports.
    share : (m,)
        What the membrane counts of each vertex: less than 1 on a mirror and on the axis.
    invariant : (m, c, c)
        Projection on the amplitudes that the symmetry allows there.
    """

    share: Floats
    invariant: Floats

    def _allowed(self, vectors: Floats) -> Floats:
        return np.einsum("gij,gj->gi", self.invariant, vectors)

    def forces(self, amplitudes: Floats) -> Floats:
        """B s as nodal forces (n, 3) newtons."""
        return super().forces(self.share[:, None] * self._allowed(amplitudes))

    def amplitudes(self, forces: Floats) -> Floats:
        """The amplitudes (m, c) of symmetric nodal forces (n, 3)."""
        return self._allowed(super().amplitudes(forces)) / self.share[:, None]

    def duals(self, field: Floats) -> Floats:
        """What each group feels of a dual field (n, 3): B^T lam (m, c)."""
        return self.share[:, None] * self._allowed(super().duals(field))
