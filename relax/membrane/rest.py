"""A membrane at rest: the record that every form-finding method returns, and the residual by which each is measured."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from relax.arrays import Floats
from relax.factor import Factor
from relax.iterate import Stop
from relax.membrane.membrane import Membrane

FOUND = 1e-10  # what a result needs
LOST = 1e4  # farther away than this many scene sizes: nothing holds it
TAUT = 1e-3  # strain at which a spring that goes slack pulls again


@dataclass(frozen=True)
class Equilibrium:
    """Where the membrane came to rest.

    `residual` is the largest unbalanced force at a free vertex over the largest of tensions and applied forces; `found`
    says whether it is at most 1e-10; `factor` is the last factorisation used, of K near the shape found; `ran` names the
    methods in their order. What one iteration is, each method says.
    """

    positions: Floats
    residual: float
    stop: Stop
    iterations: int
    factorizations: int
    factor: Factor | None
    ran: tuple[str, ...]

    @property
    def found(self) -> bool:
        return self.residual <= FOUND


@dataclass(frozen=True)
class Balance:
    """Applied forces against the membrane's own: what form-finding brings to zero.

    Parameters
    ----------
    membrane : Membrane
    applied : (n, 3) newtons
        On the free vertices.
    start : (V, 3) metres
    """

    membrane: Membrane
    applied: Floats
    start: Floats

    @cached_property
    def anchor(self) -> Floats:
        """A point that does not move (3,)."""
        return self.start[np.argmax(self.membrane.fixed)]

    @cached_property
    def _reach(self) -> float:
        """Farther than this from the anchor the membrane is lost, metres."""
        return LOST * float(np.abs(self.membrane.rest_length).max() * np.sqrt(len(self.membrane.edges)))

    def measure(self, positions: Floats) -> tuple[Floats, float]:
        """Unbalanced force (n, 3) and its largest norm, relative."""
        forces, tension = self.membrane.forces_and_tension(positions)
        unbalanced = forces + self.applied
        scale = max(np.abs(tension).max(), np.linalg.norm(self.applied, axis=1).max())
        largest = np.linalg.norm(unbalanced, axis=1).max()
        return unbalanced, float(largest / scale) if scale > 0 else 0.0

    def potential(self, positions: Floats) -> float:
        """Energy minus the work of the applied forces, measured from a fixed vertex: far from the origin digits are dear."""
        return self.membrane.energy(positions) - float(np.vdot(self.applied, positions[self.membrane.free] - self.anchor))

    def magnitude(self, positions: Floats) -> float:
        """What the digits of the potential are counted from: its size and that of the applied forces' work."""
        work = float(np.abs(self.applied).sum()) * float(np.abs(positions - self.anchor).max())
        return abs(self.potential(positions)) + work

    def moved(self, positions: Floats, displacement: Floats) -> Floats:
        """Positions (V, 3) after the free vertices moved by `displacement` (n, 3)."""
        after = positions.copy()
        after[self.membrane.free] += displacement
        return after

    @cached_property
    def adrift(self) -> int | None:
        """A vertex of a part without a fixed vertex whose applied forces add up to something, so that it rests nowhere."""
        if not self.membrane.floating:
            return None
        tension = np.abs(self.membrane.tension(self.start)).max()
        scale = max(tension, np.linalg.norm(self.applied, axis=1).max())
        for part in self.membrane.floating:
            # each vertex of a shape that counts as found may leave its share
            if np.linalg.norm(self.applied[part].sum(axis=0)) > FOUND * len(part) * scale:
                return int(self.membrane.free[part[0]])
        return None

    def lost(self, positions: Floats) -> bool:
        """Whether the membrane has moved away without bound, or would."""
        return self.adrift is not None or float(np.abs(positions - self.anchor).max()) > self._reach


def differences(membrane: Membrane) -> tuple[csr_array, csr_array]:
    """Schek's branch-node matrices C (E, n) of the free and (E, V - n) of the fixed vertices: edge vectors are their sum."""
    count = len(membrane.edges)
    sign = np.repeat([-1.0, 1.0], count)
    row = np.tile(np.arange(count), 2)
    whole = csr_array((sign, (row, membrane.edges.T.ravel())), shape=(count, len(membrane.fixed)))
    return csr_array(whole[:, membrane.free]), csr_array(whole[:, np.flatnonzero(membrane.fixed)])


def stiffness_bound(membrane: Membrane, positions: Floats) -> Floats:
    """The largest eigenvalue in size of each edge's stiffness block (E,), newtons per metre; a slack one counts as just taut."""
    state = membrane.edge_state(positions)
    taut = np.maximum(state.length, (1 + TAUT) * membrane.rest_length)
    axial = membrane.springs.stiffness(taut, membrane.rest_length, membrane.spring_constant)
    return np.maximum(np.maximum(state.density, 0.0), np.abs(axial))
