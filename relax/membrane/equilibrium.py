"""Form-finding by Newton on the stiffness matrix: where the membrane comes to rest under given forces, or why it does not."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from relax.arrays import Floats
from relax.factor import Factor
from relax.iterate import Stop, iterate
from relax.membrane.membrane import Membrane

RESIDUAL = 1e-13  # aim, relative: what double precision reaches on meshes of 1e5 vertices
ENOUGH = 1e-11  # below this a residual that no longer falls is round-off
FOUND = 1e-10  # what a result needs
CHORDS = 8  # steps with an old factor that are cheaper than a new one
LARGEST_LIMIT = 200
LOST = 1e4  # farther away than this many scene sizes: nothing holds it


@dataclass(frozen=True)
class Equilibrium:
    """Where the membrane came to rest.

    `residual` is the largest unbalanced force at a free vertex over the largest of tensions and applied forces; `found`
    says whether it is at most 1e-10; `factor` is the last factorisation used, of K near the shape found.
    """

    positions: Floats
    residual: float
    stop: Stop
    iterations: int
    factorizations: int
    factor: Factor | None

    @property
    def found(self) -> bool:
        return self.residual <= FOUND


@dataclass(frozen=True)
class _State:
    positions: Floats
    unbalanced: Floats  # (n, 3)
    residual: float
    before: float  # the residual one step earlier
    factor: Factor | None
    factorizations: int = 0
    fresh: bool = False  # the last step used the stiffness of its own start
    stuck: bool = False


@dataclass(frozen=True)
class _Newton:
    """Newton on the total potential, energy - applied . x: line search, and K made definite where it is not."""

    membrane: Membrane
    applied: Floats
    start: Floats

    @cached_property
    def _size(self) -> float:
        return float(np.abs(self.membrane.rest_length).max() * np.sqrt(len(self.membrane.edges)))

    @cached_property
    def anchor(self) -> Floats:
        """A point that does not move (3,)."""
        return self.start[np.argmax(self.membrane.fixed)]

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

    def begin(self, positions: Floats, factor: Factor | None) -> _State:
        unbalanced, residual = self.measure(positions)
        return _State(positions, unbalanced, residual, np.inf, factor)

    def step(self, state: _State) -> _State:
        if state.factor is not None and _pays(state.residual, state.before) and state.factor.positive_definite:
            chord = self._moved(state, state.factor.solve(state.unbalanced), 1.0)
            if _pays(chord.residual, state.residual):
                return replace(chord, factor=state.factor, factorizations=state.factorizations)
        factor = self.membrane.factor_at(state.positions)
        count = state.factorizations + (factor is not state.factor)
        direct = factor
        if not factor.positive_definite:
            direct = self.membrane.lifted_factor_at(state.positions)
            count += 1
        found = self._search(state, direct.solve(state.unbalanced))
        return replace(found, factor=factor if factor.positive_definite else None, factorizations=count, fresh=True)

    def _search(self, state: _State, direction: Floats) -> _State:
        """Backtrack until the potential falls enough (Armijo), or the residual does where round-off hides the potential."""
        start, slope = self.potential(state.positions), -float(np.vdot(state.unbalanced, direction))
        noise = 1e-14 * (abs(start) + float(np.abs(self.applied).sum()) * np.abs(state.positions - self.anchor).max())
        length = 1.0
        for _ in range(40):
            trial = self._moved(state, direction, length)
            if self.potential(trial.positions) <= start + 1e-4 * length * slope:
                return trial
            if -slope < 1e3 * noise and trial.residual < state.residual:
                return trial
            length *= 0.5
        return replace(state, stuck=True)

    def _moved(self, state: _State, direction: Floats, length: float) -> _State:
        positions = state.positions.copy()
        positions[self.membrane.free] += length * direction
        unbalanced, residual = self.measure(positions)
        return _State(positions, unbalanced, residual, state.residual, None)

    def done(self, state: _State) -> Stop | None:
        if state.residual <= RESIDUAL:
            return Stop.CONVERGED
        settled = state.fresh and state.residual > 0.5 * state.before
        if state.residual <= ENOUGH and (settled or state.stuck):
            return Stop.CONVERGED
        if np.abs(state.positions - self.anchor).max() > LOST * max(self._size, np.abs(self.membrane.rest_length).max()):
            return Stop.LOST_SUPPORT
        return self.reason(state) if state.stuck else None

    def reason(self, state: _State) -> Stop:
        """Why Newton is lost: a mechanism where every edge is taut, a slack region otherwise."""
        tension = self.membrane.tension(state.positions)
        return Stop.SLACK if (tension <= 0).any() else Stop.MECHANISM

    def record(self, state: _State) -> dict[str, float]:
        return {"residual": state.residual}


def _pays(residual: float, before: float) -> bool:
    """Whether steps that shrink the residual as much as this one did reach round-off before a new factor would be cheaper."""
    if not np.isfinite(before) or residual <= RESIDUAL:
        return True
    return residual < before and np.log(residual / RESIDUAL) <= CHORDS * np.log(before / residual)


def find_equilibrium(
    membrane: Membrane, positions: Floats, applied: Floats, factor: Factor | None = None, limit: int = LARGEST_LIMIT
) -> Equilibrium:
    """Bring the membrane to rest under `applied` forces.

    Parameters
    ----------
    membrane : Membrane
    positions : (V, 3) metres
        Where to start; fixed vertices stay there.
    applied : (n, 3) newtons
        Loads and support forces on the free vertices.
    factor : Factor, optional
        A factorisation of K near `positions`; chord steps use it while they pay.
    limit : int
        Largest number of steps.

    Returns
    -------
    Equilibrium
        Never raises for a membrane that finds no rest: `stop` says why, `found` is False.
    """
    newton = _Newton(membrane, applied, positions)
    run = iterate(newton, newton.begin(positions, factor), limit)
    state, stop = run.state, run.stop
    if state.residual <= FOUND:
        stop = Stop.CONVERGED
    elif stop is Stop.LIMIT and state.factor is None:
        stop = newton.reason(state)
    return Equilibrium(state.positions, state.residual, stop, run.steps, state.factorizations, state.factor)
