"""Form-finding by dynamic relaxation with kinetic damping: the membrane swings, and is stopped whenever it is fastest.

Fictitious masses, explicit steps, and all velocities set to zero at each peak of the kinetic energy (Barnes 1988; MATHEMATICS.md,
"Form-finding"). Nothing is factorised and K need not be definite, so slack membranes and bad starts come to rest too.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from relax.arrays import Floats
from relax.iterate import Stop, iterate
from relax.membrane.membrane import Membrane
from relax.membrane.rest import FOUND, Balance, Equilibrium, differences, stiffness_bound

AIM = 1e-11  # relative residual: linear convergence, so a digit beyond what a result needs costs a tenth, the last ones too much
# masses over those at the edge of stability: the fastest swing is then over in one step; with less it may live on, stop the
# whole at each of its own peaks and hold up the slow ones (1.1 took 0.8 times the steps on most scenes, ten times on some)
MARGIN = 2.0
BATCH = 100  # explicit steps between looks at the whole
HEAVIER = 4.0  # masses after a swing that gained energy, and half as much more from swing to swing: a step half as long
HEAVIEST = 1e6  # masses over the first; beyond it no mass helps
VISIBLE = 1e-12  # of the potential's magnitude: a rise that is none of round-off
SETTLED = 20  # batches without a smaller residual, once it is found: round-off
LARGEST_LIMIT = 100_000


@dataclass(frozen=True)
class _State:
    positions: Floats
    unbalanced: Floats  # (n, 3)
    residual: float
    potential: float
    momentum: Floats | None = None  # (n, 3) over the root of the masses; None at rest
    energies: tuple[float, float] = (0.0, 0.0)  # kinetic, two explicit steps ago and one
    steps: int = 0
    heavier: float = 1.0  # what the masses are multiplied by
    best: float = np.inf
    idle: int = 0


@dataclass(frozen=True)
class _DynamicRelaxation:
    """Leap-frog between the peaks of kinetic energy; the unit of time is the step, so masses are in newtons per metre."""

    balance: Balance
    limit: int
    aim: float

    @cached_property
    def _differences(self) -> tuple[csr_array, csr_array, Floats]:
        """C and its transpose on the free vertices, and what the fixed ones add to the edge vectors (E, 3)."""
        free, fixed = differences(self.balance.membrane)
        return free, csr_array(free.T), fixed @ self.balance.start[self.balance.membrane.fixed]

    def _unbalanced(self, place: Floats) -> Floats:
        """The same as `Balance.measure`, in half the time: this is what a run consists of."""
        membrane = self.balance.membrane
        free, back, held = self._differences
        vector = free @ place
        vector += held
        length = np.sqrt(np.einsum("ij,ij->i", vector, vector))
        tension = membrane.springs.tension(length, membrane.rest_length, membrane.spring_constant)
        vector *= (tension / np.where(length > 0, length, 1.0))[:, None]
        return self.balance.applied - back @ vector

    def _masses(self, positions: Floats) -> Floats:
        """MARGIN / 2 times the stiffness of the edges at each vertex (n, 1): no frequency is beyond the reach of the step."""
        mass = MARGIN / 2 * (abs(self._differences[1]) @ stiffness_bound(self.balance.membrane, positions))
        return np.where(mass > 0, mass, 1.0)[:, None]  # a vertex without a stiff edge goes where it is pushed, at any mass

    def begin(self, positions: Floats) -> _State:
        return _State(positions, *self.balance.measure(positions), self.balance.potential(positions))

    def step(self, state: _State) -> _State:
        """A swing; one that gains energy is not stable, for the springs stiffened on the way, and is made again, heavier."""
        with np.errstate(over="ignore", invalid="ignore"):  # where it blows up
            after = self._swing(state)
            rise = after.potential - state.potential - 0.5 * state.energies[1]
        if state.heavier < HEAVIEST and not rise <= VISIBLE * self.balance.magnitude(state.positions):
            still = replace(state, momentum=None, energies=(0.0, 0.0))
            return replace(still, steps=after.steps, heavier=HEAVIER * state.heavier)
        return after

    def _swing(self, state: _State) -> _State:
        """Explicit steps until the kinetic energy has passed a peak, and the stop there; at most BATCH."""
        root = np.sqrt(state.heavier * self._masses(state.positions))
        place = state.positions[self.balance.membrane.free]
        force, momentum, (older, old) = state.unbalanced, state.momentum, state.energies
        count = min(BATCH, self.limit - state.steps)
        for taken in range(count):
            after = force / (2 * root) if momentum is None else momentum + force / root
            energy = float(np.vdot(after, after))
            if energy < old and momentum is not None:
                # back along the last step to where a parabola through the three energies has its top
                back = 0.5 - (older - energy) / (2 * (older - 2 * old + energy))
                return self._stopped(state, place - back * momentum / root, taken + 1)
            place = place + after / root
            momentum, older, old = after, old, energy
            force = self._unbalanced(place)
        return replace(self._stopped(state, place, count), momentum=momentum, energies=(older, old))

    def _stopped(self, state: _State, place: Floats, taken: int) -> _State:
        """At rest at a new place (n, 3)."""
        positions = state.positions.copy()
        positions[self.balance.membrane.free] = place
        unbalanced, residual = self.balance.measure(positions)
        return _State(
            positions,
            unbalanced,
            residual,
            self.balance.potential(positions),
            steps=state.steps + taken,
            heavier=max(1.0, state.heavier / 2),
            best=min(state.best, residual),
            idle=0 if residual < state.best else state.idle + 1,
        )

    def done(self, state: _State) -> Stop | None:
        if state.residual <= self.aim or (state.residual <= FOUND and state.idle >= SETTLED):
            return Stop.CONVERGED
        if self.balance.lost(state.positions):
            return Stop.LOST_SUPPORT
        return Stop.LIMIT if state.steps >= self.limit else None

    def record(self, state: _State) -> dict[str, float]:
        return {"residual": state.residual}


def relax_dynamically(
    membrane: Membrane, positions: Floats, applied: Floats, limit: int | None = None, aim: float = AIM
) -> Equilibrium:
    """Bring the membrane to rest under `applied` forces by dynamic relaxation with kinetic damping.

    Parameters
    ----------
    membrane : Membrane
    positions : (V, 3) metres
        Where to start, at rest; fixed vertices stay there.
    applied : (n, 3) newtons
        Loads and support forces on the free vertices.
    limit : int, optional
        Largest number of explicit steps; default 100,000.
    aim : float
        Relative residual at which to stop.

    Returns
    -------
    Equilibrium
        Never raises for a membrane that finds no rest: `stop` says why, `found` is False. An iteration is one explicit step,
        one evaluation of the forces.

    Notes
    -----
    The number of steps grows with the square root of the condition of K: with the vertices a side, and with the root of
    stiffness over prestress. The shape is a stable one: from an unstable equilibrium, or one of a linear membrane with
    pushing edges, the membrane swings away.

    M. R. Barnes, Form-finding and analysis of prestressed nets and membranes, Computers & Structures 30 (1988) 685-695.
    """
    method = _DynamicRelaxation(Balance(membrane, applied, positions), LARGEST_LIMIT if limit is None else limit, aim)
    run = iterate(method, method.begin(positions), method.limit)
    state = run.state
    stop = Stop.CONVERGED if state.residual <= FOUND else run.stop
    shape = membrane.kept_centroids(state.positions, positions)
    return Equilibrium(shape, state.residual, stop, state.steps, 0, None, ("dynamic-relaxation",))
