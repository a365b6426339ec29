"""A membrane: edges under a spring law between fixed and free vertices; its energy, forces, stiffness and how that turns."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array, diags_array

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.factor import Factor, block_order
from relax.membrane.springs import Springs


@dataclass(frozen=True)
class EdgeState:
    """Lengths, directions and force densities of the edges at one shape."""

    length: Floats  # (E,)
    direction: Floats  # (E, 3), u
    density: Floats  # (E,), q: tension / length
    stiffness: Floats  # (E,), axial


@dataclass(frozen=True)
class Membrane:
    """Edges with their springs; matrices act on the free vertices alone, flattened vertex-major.

    Parameters
    ----------
    edges : (E, 2) int
    rest_length : (E,) metres
    spring_constant : (E,) newtons per metre (force density: q)
    springs : Springs
    fixed : (V,) bool
    """

    edges: Ints
    rest_length: Floats
    spring_constant: Floats
    springs: Springs
    fixed: Mask

    def __post_init__(self) -> None:
        lock_arrays(self)

    @cached_property
    def free(self) -> Ints:
        """Indices of the n free vertices, ascending."""
        return np.flatnonzero(~self.fixed)

    @cached_property
    def _incidence(self) -> csr_array:
        """D (n, E) on the free vertices: +1 where an edge ends, -1 where it starts, so D @ (q v) = -f."""
        count = len(self.edges)
        index = np.full(len(self.fixed), -1)
        index[self.free] = np.arange(len(self.free))
        row = index[self.edges.T.ravel()]
        column = np.tile(np.arange(count), 2)
        sign = np.repeat([-1.0, 1.0], count)
        keep = row >= 0
        return csr_array((sign[keep], (row[keep], column[keep])), shape=(len(self.free), count))

    @cached_property
    def _blocks(self) -> tuple[Ints, Ints, Ints]:
        """Pattern of the (n, n) block matrix, once a mesh: row pointer, columns, and where each block's values come from.

        Entries of the last array below E are edges (off-diagonal), from E on they are vertices (diagonal).
        """
        count, size = len(self.edges), len(self.free)
        index = np.full(len(self.fixed), -1)
        index[self.free] = np.arange(size)
        a, b = index[self.edges.T]
        inside = np.flatnonzero((a >= 0) & (b >= 0))
        row = np.concatenate([a[inside], b[inside], np.arange(size)])
        column = np.concatenate([b[inside], a[inside], np.arange(size)])
        source = np.concatenate([inside, inside, count + np.arange(size)])
        order = np.lexsort((column, row))
        pointer = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=size))])
        return pointer, column[order], source[order]

    @cached_property
    def _elimination_order(self) -> Ints:
        """Of the 3n unknowns, from the graph of the free vertices, once a mesh."""
        pointer, column, _ = self._blocks
        return block_order(csr_array((np.ones(len(column)), column, pointer), shape=(len(self.free),) * 2))

    def factor_at(self, positions: Floats) -> Factor:
        """A factorisation of K at `positions` (V, 3)."""
        return Factor(self.stiffness(positions), self._elimination_order)

    def lifted_factor_at(self, positions: Floats) -> Factor:
        """The same of the taut part of K, lifted off singularity by 1e-4 of the mean spring: definite, so a step is downhill."""
        taut = self.taut_stiffness(positions)
        lift = diags_array(np.full(taut.shape[0], 1e-4 * self.spring_constant.mean()), format="csc")
        return Factor(csc_array(taut + lift), self._elimination_order)

    def edge_vectors(self, positions: Floats) -> Floats:
        """Edge vectors v = x_b - x_a, (E, 3) metres."""
        return positions[self.edges[:, 1]] - positions[self.edges[:, 0]]

    def edge_state(self, positions: Floats) -> EdgeState:
        """Lengths, directions, force densities and axial stiffness at `positions` (V, 3)."""
        vector = self.edge_vectors(positions)
        length = np.sqrt(np.einsum("ij,ij->i", vector, vector))
        tension = self.springs.tension(length, self.rest_length, self.spring_constant)
        stiffness = self.springs.stiffness(length, self.rest_length, self.spring_constant)
        # an edge that shrank to a point pulls nowhere; for a force density the limit of tension / length is e''
        point = length == 0
        safe = np.where(point, 1.0, length)
        return EdgeState(length, vector / safe[:, None], np.where(point, stiffness, tension / safe), stiffness)

    def tension(self, positions: Floats) -> Floats:
        """Tension of each edge (E,) newtons."""
        state = self.edge_state(positions)
        return state.density * state.length

    def energy(self, positions: Floats) -> float:
        """Stored energy, newton metres."""
        length = self.edge_state(positions).length
        return float(self.springs.energy(length, self.rest_length, self.spring_constant).sum())

    def forces(self, positions: Floats) -> Floats:
        """Internal force f on each free vertex (n, 3) newtons: minus the gradient of the energy."""
        state = self.edge_state(positions)
        return -(self._incidence @ ((state.density * state.length)[:, None] * state.direction))

    def stiffness(self, positions: Floats) -> csc_array:
        """K = -df/dx (3n, 3n), symmetric: edge blocks q I + (e'' - q) u u^T (MATHEMATICS.md, "Membrane")."""
        state = self.edge_state(positions)
        outer = state.direction[:, :, None] * state.direction[:, None, :]
        blocks = (state.stiffness - state.density)[:, None, None] * outer
        blocks += state.density[:, None, None] * np.eye(3)
        return self._assemble(blocks)

    def taut_stiffness(self, positions: Floats) -> csc_array:
        """K without the parts that pushing edges make negative: positive semidefinite, for a descent direction."""
        state = self.edge_state(positions)
        pull = np.maximum(state.density, 0.0)
        outer = state.direction[:, :, None] * state.direction[:, None, :]
        return self._assemble((np.maximum(state.stiffness, pull) - pull)[:, None, None] * outer + pull[:, None, None] * np.eye(3))

    def stiffness_turn(self, positions: Floats, along: Floats) -> csc_array:
        """T (3n, 3n): the derivative of K @ along with respect to the positions (MATHEMATICS.md, "Reduced form").

        `along` is (n, 3); fixed vertices do not move. With s = e'' - q, w the edge vector of `along`:
        (s / l) [(u.w)(I - 3 u u^T) + w u^T + u w^T] + e''' (u.w) u u^T.
        """
        state = self.edge_state(positions)
        whole = np.zeros_like(positions)
        whole[self.free] = along
        w = self.edge_vectors(whole)
        u = state.direction
        uw = np.einsum("ij,ij->i", u, w)[:, None, None]
        outer = u[:, :, None] * u[:, None, :]
        mixed = w[:, :, None] * u[:, None, :]
        length = np.where(state.length == 0, 1.0, state.length)
        rate = ((state.stiffness - state.density) / length)[:, None, None]
        slope = self.springs.stiffness_slope(state.length, self.rest_length, self.spring_constant)[:, None, None]
        blocks = rate * (uw * (np.eye(3) - 3 * outer) + mixed + mixed.transpose(0, 2, 1)) + slope * uw * outer
        return self._assemble(blocks)

    def _assemble(self, blocks: Floats) -> csc_array:
        """Sum edge blocks (E, 3, 3) into the free vertices' matrix; the pattern is the mesh's and never changes."""
        pointer, column, source = self._blocks
        diagonal = abs(self._incidence) @ blocks.reshape(-1, 9)
        values = np.concatenate([-blocks.reshape(-1, 9), diagonal])[source].reshape(-1, 3, 3)
        size = 3 * len(self.free)
        rows = bsr_array((values, column, pointer), shape=(size, size)).tocsr()
        # symmetric, so the rows of the compressed form are its columns
        return csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)
