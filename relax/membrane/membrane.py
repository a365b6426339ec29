"""A membrane: edges under a spring law between fixed and free vertices; its energy, forces, stiffness and how that turns."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.factor import Engine, Factor, ScalarFactor, Symbolic
from relax.membrane.springs import ForceDensity, Springs

LIFT = 1e-4  # of the mean spring: what makes a semidefinite stiffness definite
HELD_BY_A_SPRING = 1.0  # of the mean spring: what holds a vertex of a floating part; no balanced force stretches it


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
    engine : str or Engine
        Who factorises: one of `relax.factor.available_engines()`, "auto" for the first of them, or one of your own.
    """

    edges: Ints
    rest_length: Floats
    spring_constant: Floats
    springs: Springs
    fixed: Mask
    engine: str | Engine = "auto"

    def __post_init__(self) -> None:
        lock_arrays(self)

    @cached_property
    def free(self) -> Ints:
        """Indices of the n free vertices, ascending."""
        return np.flatnonzero(~self.fixed)

    @cached_property
    def _index(self) -> tuple[Ints, Ints]:
        """Start and end of each edge among the free vertices, -1 where fixed."""
        index = np.full(len(self.fixed), -1)
        index[self.free] = np.arange(len(self.free))
        start, end = index[self.edges.T]
        return start, end

    @cached_property
    def _incidence(self) -> csr_array:
        """D (n, E) on the free vertices: +1 where an edge ends, -1 where it starts, so D @ (q v) = -f."""
        count = len(self.edges)
        row = np.concatenate(self._index)
        column = np.tile(np.arange(count), 2)
        sign = np.repeat([-1.0, 1.0], count)
        keep = row >= 0
        return csr_array((sign[keep], (row[keep], column[keep])), shape=(len(self.free), count))

    @cached_property
    def _ends(self) -> csr_array:
        """1 (n, E) where an edge starts or ends: sums over the edges at a vertex."""
        return abs(self._incidence)

    @cached_property
    def _blocks(self) -> tuple[Ints, Ints, Ints]:
        """Pattern of the (n, n) block matrix, once a mesh: row pointer, columns, and where each block's values come from.

        Entries of the last array below E are edges (off-diagonal), from E on they are vertices (diagonal).
        """
        count, size = len(self.edges), len(self.free)
        a, b = self._index
        inside = np.flatnonzero((a >= 0) & (b >= 0))
        row = np.concatenate([a[inside], b[inside], np.arange(size)])
        column = np.concatenate([b[inside], a[inside], np.arange(size)])
        source = np.concatenate([inside, inside, count + np.arange(size)])
        order = np.lexsort((column, row))
        pointer = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=size))])
        return pointer, column[order], source[order]

    @property
    def neighbours(self) -> tuple[Ints, Ints]:
        """Graph of the free vertices, each its own neighbour: row pointer (n + 1,) and columns."""
        pointer, column, _ = self._blocks
        return pointer, column

    @cached_property
    def parts(self) -> Ints:
        """The part of each free vertex (n,), from 0 on: a path of free vertices joins those of one part; fixed ones do not."""
        pointer, column = self.neighbours
        size = len(self.free)
        graph = csr_array((np.ones(len(column), dtype=np.int8), column, pointer), shape=(size, size))
        return connected_components(graph, directed=False)[1].astype(np.int64)

    @cached_property
    def _symbolic(self) -> Symbolic:
        """What the factorisations of K share, once a mesh."""
        return Symbolic(3, self.engine)

    @cached_property
    def _scalar_symbolic(self) -> Symbolic:
        """The same of one coordinate of a linear membrane."""
        return Symbolic(1, self.engine)

    @cached_property
    def linear(self) -> bool:
        """Whether K is the same at every shape, and the same in x, y and z."""
        return isinstance(self.springs, ForceDensity)

    @cached_property
    def _linear_factor(self) -> Factor:
        """Of the constant K = S (x) I_3 of force densities, by one scalar factorisation, once a membrane."""
        stiffness = csc_array(self._linear_stiffness + self.grounding) if self.floating else self._linear_stiffness
        bound = self._pivot_bound(self.spring_constant, self.spring_constant)
        scalar = Factor(csc_array(stiffness[::3, ::3]), self._scalar_symbolic, bound)
        return ScalarFactor(stiffness, scalar)

    @cached_property
    def _linear_stiffness(self) -> csc_array:
        return self._assemble(self.spring_constant[:, None, None] * np.eye(3))

    @cached_property
    def floating(self) -> tuple[Ints, ...]:
        """The free vertices of each connected part without a fixed one, as indices into the free ones."""
        fixed = self.fixed[self.edges]
        beside = self.edges[~fixed & fixed[:, ::-1]]  # free vertices, each on an edge to a fixed one
        held = self.parts[np.searchsorted(self.free, beside)]
        return tuple(np.flatnonzero(self.parts == part) for part in np.setdiff1d(self.parts, held))

    @cached_property
    def _grounding(self) -> float:
        """Stiffness of the spring that holds one vertex of each floating part while K is factorised (see `factor_at`)."""
        return HELD_BY_A_SPRING * float(np.abs(self.spring_constant).mean())

    @cached_property
    def _ground(self) -> Floats | float:
        """Blocks (n, 9) of those springs."""
        if not self.floating:
            return 0.0
        blocks = np.zeros((len(self.free), 9))
        for part in self.floating:
            blocks[part[0]] = self._grounding * np.eye(3).ravel()
        return blocks

    @cached_property
    def grounding(self) -> csc_array:
        """Those springs as a matrix (3n, 3n): what a factorisation's matrix has besides K."""
        diagonal = np.zeros((len(self.free), 3))
        for part in self.floating:
            diagonal[part[0]] = self._grounding
        return csc_array(diags_array(diagonal.ravel()))

    def kept_centroids(self, positions: Floats, start: Floats) -> Floats:
        """Positions (V, 3) with each floating part moved to where its mean was at the start, for its forces leave that open."""
        if not self.floating:
            return positions
        moved = positions.copy()
        for part in self.floating:
            vertices = self.free[part]
            moved[vertices] += start[vertices].mean(axis=0) - positions[vertices].mean(axis=0)
        return moved

    def _pivot_bound(self, least: Floats, largest: Floats, lift: float = 0.0) -> float:
        """A lower bound of every pivot of K as a part of its diagonal entry; 0 where this proves none.

        `least` and `largest` (E,) are the smallest and the largest eigenvalue of each edge's block. Where no edge pushes, K is
        at least the Laplacian with conductances `least` in each direction, so a pivot, the energy that is left when one
        unknown moves by one and those eliminated before it follow, is at least the conductance of a path from its vertex to
        a fixed one, or to the one that a spring holds: the smallest of its edges over their number. `lift` is what stands on
        the diagonal besides.
        """
        if not len(self.free) or not len(least) or least.min() < 0:
            return 0.0
        entry = float((self._ends @ largest).max()) + lift
        path = float(least.min()) / len(self.free)
        if self.floating:  # what is lifted has no such spring
            path, entry = 0.0 if lift else min(path, self._grounding / len(self.free)), entry + self._grounding
        return max(path, lift) / entry if entry > 0 else 0.0

    def factor_at(self, positions: Floats) -> Factor:
        """A factorisation of K at `positions` (V, 3); of a linear membrane always the same one.

        Of a part without a fixed vertex one vertex is held by a spring. Under forces that add up to nothing that spring does not
        stretch, so solves are right, with that vertex at rest; and the matrix is positive definite exactly where K is, off the
        translations of such parts: from a bending of K a translation that takes the held vertex back can be taken away.
        """
        if self.linear:
            return self._linear_factor
        state = self.edge_state(positions)
        bound = self._pivot_bound(np.minimum(state.density, state.stiffness), np.maximum(state.density, state.stiffness))
        return Factor(self._assemble(_edge_stiffness(state), self._ground), self._symbolic, bound)

    def lifted_factor_at(self, positions: Floats) -> Factor:
        """The same of the taut part of K, lifted off singularity: definite, so a step is downhill."""
        lift = LIFT * float(self.spring_constant.mean())
        state = self.edge_state(positions)
        pull = np.maximum(state.density, 0.0)
        bound = self._pivot_bound(pull, np.maximum(pull, state.stiffness), lift)
        return Factor(self.taut_stiffness(positions, lift), self._symbolic, bound)

    def tied_factor_at(self, positions: Floats, ties: Floats) -> Factor:
        """The same of K with a spring of stiffness `ties` (n, 3, 3) from each free vertex to the ground."""
        whole = self._assemble(_edge_stiffness(self.edge_state(positions)), ties.reshape(-1, 9))
        if self.linear and np.array_equal(ties, ties[:, :1, :1] * np.eye(3)):
            return ScalarFactor(whole, Factor(csc_array(whole[::3, ::3]), self._scalar_symbolic))
        return Factor(whole, self._symbolic)

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
        return self.forces_and_tension(positions)[0]

    def forces_and_tension(self, positions: Floats) -> tuple[Floats, Floats]:
        """Both in one pass over the edges: (n, 3) and (E,) newtons."""
        state = self.edge_state(positions)
        tension = state.density * state.length
        return -(self._incidence @ (tension[:, None] * state.direction)), tension

    def stiffness(self, positions: Floats) -> csc_array:
        """K = -df/dx (3n, 3n), symmetric: edge blocks q I + (e'' - q) u u^T (MATHEMATICS.md, "Membrane")."""
        if self.linear:
            return self._linear_stiffness
        return self._assemble(_edge_stiffness(self.edge_state(positions)))

    def taut_stiffness(self, positions: Floats, lift: float = 0.0) -> csc_array:
        """K without the parts that pushing edges make negative, positive semidefinite, and with `lift` added to its diagonal."""
        state = self.edge_state(positions)
        pull = np.maximum(state.density, 0.0)
        outer = state.direction[:, :, None] * state.direction[:, None, :]
        blocks = (np.maximum(state.stiffness, pull) - pull)[:, None, None] * outer
        blocks += pull[:, None, None] * np.eye(3)
        return self._assemble(blocks, lift * np.eye(3).ravel())

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

    def _assemble(self, blocks: Floats, ground: Floats | float = 0.0) -> csc_array:
        """Sum edge blocks (E, 3, 3) and `ground` (n, 9) into the free vertices' matrix; the pattern is the mesh's, always."""
        pointer, column, source = self._blocks
        diagonal = self._ends @ blocks.reshape(-1, 9) + ground
        values = np.concatenate([-blocks.reshape(-1, 9), diagonal])[source].reshape(-1, 3, 3)
        return symmetric_matrix(values, column, pointer)


def _edge_stiffness(state: EdgeState) -> Floats:
    """Blocks of the stiffness (E, 3, 3)."""
    outer = state.direction[:, :, None] * state.direction[:, None, :]
    blocks: Floats = (state.stiffness - state.density)[:, None, None] * outer
    blocks += state.density[:, None, None] * np.eye(3)
    return blocks


def symmetric_matrix(blocks: Floats, column: Ints, pointer: Ints) -> csc_array:
    """The symmetric (3n, 3n) matrix of blocks (b, 3, 3) by rows, explicit zeros kept."""
    size = 3 * (len(pointer) - 1)
    rows = bsr_array((blocks, column, pointer), shape=(size, size)).tocsr()
    # symmetric, so the rows of the compressed form are its columns
    return csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)
