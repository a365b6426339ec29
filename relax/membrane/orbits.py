"""A symmetric membrane by one vertex of each orbit: energy, forces and stiffness as functions of the representatives alone.

All are divided by the order of the group, so that away from mirrors and axis they are those of the whole membrane. Where a
vertex may not leave its mirror or the axis, the stiffness is projected, and what is projected out is held by springs of its own.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array

from relax.arrays import Floats, Ints
from relax.membrane.membrane import Membrane, symmetric_matrix
from relax.membrane.symmetry import Symmetry


@dataclass(frozen=True, kw_only=True)
class OrbitMembrane(Membrane):
    """One edge of each orbit of edges, between images of representatives; positions are relative to the symmetry's axis.

    Parameters
    ----------
    edges, rest_length, spring_constant, springs, fixed, engine
        As in Membrane; the vertices are representatives, the constants are times the share of the orbit.
    turns : (E, 2, 3, 3)
        Q that takes the representative to where the edge starts, and to where it ends.
    invariant : (V, 3, 3)
        Projection on the displacements that a vertex can have.
    """

    turns: Floats
    invariant: Floats

    @cached_property
    def _turned(self) -> tuple[Ints, Ints]:
        """Edges that start, and that end, at another vertex than a representative."""
        start, end = (~(self.turns == np.eye(3)).all(axis=(2, 3))).T
        return np.flatnonzero(start), np.flatnonzero(end)

    @cached_property
    def _bound(self) -> Ints:
        """Free vertices (of n) that may not move in every direction."""
        return np.flatnonzero((self.invariant[self.free] != np.eye(3)).any(axis=(1, 2)))

    def edge_vectors(self, positions: Floats) -> Floats:
        """Edge vectors (E, 3): Q_b x_b - Q_a x_a."""
        ends = [positions[vertices] for vertices in self.edges.T]
        for end, turned in enumerate(self._turned):
            ends[end][turned] = np.einsum("eij,ej->ei", self.turns[turned, end], ends[end][turned])
        return ends[1] - ends[0]

    @cached_property
    def _gathered(self) -> csr_array:
        """+1 (n, 2E) where an edge starts, -1 where it ends."""
        count = len(self.edges)
        row = np.concatenate(self._index)
        sign = np.repeat([1.0, -1.0], count)
        keep = row >= 0
        return csr_array((sign[keep], (row[keep], np.flatnonzero(keep))), shape=(len(self.free), 2 * count))

    def forces_and_tension(self, positions: Floats) -> tuple[Floats, Floats]:
        """Internal force on each representative (n, 3), times its orbit's share, and the edges' tensions (E,)."""
        state = self.edge_state(positions)
        tension = state.density * state.length
        pull = tension[:, None] * state.direction
        felt = [pull.copy(), pull]
        for end, turned in enumerate(self._turned):
            felt[end][turned] = np.einsum("eji,ej->ei", self.turns[turned, end], felt[end][turned])
        forces: Floats = self._gathered @ np.concatenate(felt)
        bound = self._bound
        forces[bound] = np.einsum("vij,vj->vi", self.invariant[self.free[bound]], forces[bound])
        return forces, tension

    @cached_property
    def _blocks(self) -> tuple[Ints, Ints, Ints]:
        pointer, column, _ = self._sums
        return pointer, column, np.zeros(0, dtype=np.int64)

    @cached_property
    def _sums(self) -> tuple[Ints, Ints, csr_array]:
        """Pattern of the (n, n) block matrix, and the sum (blocks, 4E + n) that makes its entries from the parts."""
        start, end = self._index
        own = np.arange(len(self.free))
        row = np.concatenate([start, end, start, end, own])
        column = np.concatenate([start, end, end, start, own])
        keep = np.flatnonzero((row >= 0) & (column >= 0))
        key, place = np.unique(row[keep] * len(own) + column[keep], return_inverse=True)
        pointer = np.searchsorted(key, np.arange(len(own) + 1) * len(own))
        gather = csr_array((np.ones(len(keep)), (place, keep)), shape=(len(key), len(row)))
        return pointer, key % len(own), gather

    def _assemble(self, blocks: Floats, ground: Floats | float = 0.0) -> csc_array:
        """S^T (sum of edge blocks and `ground`) S / G, S the symmetric displacements: Q_a^T k Q_b at each pair of ends."""
        pointer, column, gather = self._sums
        at_start, at_end, across = blocks.copy(), blocks.copy(), -blocks
        start, end = self._turned
        either = np.union1d(start, end)
        at_start[start] = self._seen(blocks, start, 0, 0)
        at_end[end] = self._seen(blocks, end, 1, 1)
        across[either] = -self._seen(blocks, either, 0, 1)
        count = len(self.free)
        parts = np.concatenate([at_start, at_end, across, across.transpose(0, 2, 1)]).reshape(-1, 9)
        values = (gather @ np.concatenate([parts, np.broadcast_to(ground, (count, 9))])).reshape(-1, 3, 3)
        self._project(values)
        return symmetric_matrix(values, column, pointer)

    def _seen(self, blocks: Floats, edges: Ints, left: int, right: int) -> Floats:
        """Blocks of some edges in the coordinates of the representatives at their ends: Q_left^T k Q_right."""
        seen: Floats = self.turns[edges, left].transpose(0, 2, 1) @ blocks[edges] @ self.turns[edges, right]
        return seen

    @cached_property
    def _projected(self) -> tuple[Ints, Floats, Floats, Ints, Floats]:
        """Blocks beside vertices that are not free in every direction, the projections on both sides; springs on the diagonal."""
        pointer, column, _ = self._sums
        row = np.repeat(np.arange(len(pointer) - 1), np.diff(pointer))
        allowed = self.invariant[self.free]
        bound = np.zeros(len(self.free), dtype=bool)
        bound[self._bound] = True
        beside = np.flatnonzero(bound[row] | bound[column])
        diagonal = np.flatnonzero((row == column) & bound[row])
        springs = float(self.spring_constant.mean()) * (np.eye(3) - allowed[row[diagonal]])
        return beside, allowed[row[beside]], allowed[column[beside]], diagonal, springs

    def _project(self, values: Floats) -> None:
        beside, left, right, diagonal, springs = self._projected
        values[beside] = left @ values[beside] @ right
        values[diagonal] += springs

    def _pivot_bound(self, least: Floats, largest: Floats, lift: float = 0.0) -> float:
        """None is known: the pivots and a trial solve tell."""
        return 0.0


def orbit_membrane(membrane: Membrane, symmetry: Symmetry) -> OrbitMembrane:
    """The membrane by its representatives."""
    count = len(membrane.fixed)
    a, b = symmetry.images[:, membrane.edges.T].transpose(1, 0, 2)
    key = (np.minimum(a, b) * count + np.maximum(a, b)).min(axis=0)
    # the edge of an orbit that lies nearest the representatives: most of its ends are some
    away = np.count_nonzero(symmetry.element[membrane.edges], axis=1)
    order = np.lexsort((away, key))
    first = np.concatenate([[True], np.diff(key[order]) > 0])
    chosen = order[first]
    orbit = np.empty(len(key), dtype=np.int64)
    orbit[order] = np.cumsum(first) - 1
    number = np.bincount(orbit)
    ends = membrane.edges[chosen]
    return OrbitMembrane(
        symmetry.orbit[ends],
        np.bincount(orbit, membrane.rest_length) / number,
        np.bincount(orbit, membrane.spring_constant) / symmetry.order,
        membrane.springs,
        membrane.fixed[symmetry.representatives],
        membrane.engine,
        turns=symmetry.turns[symmetry.element[ends]],
        invariant=symmetry.invariant,
    )
