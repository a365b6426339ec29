"""Form-finding by Newton on the stiffness matrix: where the membrane comes to rest under given forces, or why it does not."""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats
from relax.factor import Factor
from relax.iterate import Stop, iterate
from relax.membrane.membrane import Membrane
from relax.membrane.rest import FOUND, Balance, Equilibrium

RESIDUAL = 1e-13  # aim, relative: what double precision reaches on meshes of 1e5 vertices
ENOUGH = 1e-11  # below this a residual that no longer falls is round-off
CHORDS = 8  # steps with an old factor that are cheaper than a new one
LARGEST_LIMIT = 200
NO_LESS = 4 * float(np.finfo(float).eps)  # relative residual of a shape whose positions are right to round-off
LAST = 3  # steps for the last digits: each solve gains several, until round-off is all that is left


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

    balance: Balance

    def begin(self, positions: Floats, factor: Factor | None) -> _State:
        unbalanced, residual = self.balance.measure(positions)
        return _State(positions, unbalanced, residual, np.inf, factor)

    def step(self, state: _State) -> _State:
        if state.factor is not None and _pays(state.residual, state.before) and state.factor.positive_definite:
            chord = self._moved(state, state.factor.solve(state.unbalanced), 1.0)
            if _pays(chord.residual, state.residual):
                return replace(chord, factor=state.factor, factorizations=state.factorizations)
        factor = self.balance.membrane.factor_at(state.positions)
        count = state.factorizations + (factor is not state.factor)
        direct = factor
        if not factor.positive_definite:
            direct = self.balance.membrane.lifted_factor_at(state.positions)
            count += 1
        found = self._search(state, direct.solve(state.unbalanced))
        return replace(found, factor=factor if factor.positive_definite else None, factorizations=count, fresh=True)

    def _search(self, state: _State, direction: Floats) -> _State:
        """Backtrack until the potential falls enough (Armijo), or the residual does where round-off hides the potential."""
        balance = self.balance
        start, slope = balance.potential(state.positions), -float(np.vdot(state.unbalanced, direction))
        noise = 1e-14 * (abs(start) + float(np.abs(balance.applied).sum()) * np.abs(state.positions - balance.anchor).max())
        length = 1.0
        for _ in range(40):
            trial = self._moved(state, direction, length)
            if balance.potential(trial.positions) <= start + 1e-4 * length * slope:
                return trial
            if -slope < 1e3 * noise and trial.residual < state.residual:
                return trial
            length *= 0.5
        return replace(state, stuck=True)

    def _moved(self, state: _State, direction: Floats, length: float) -> _State:
        positions = self.balance.moved(state.positions, length * direction)
        unbalanced, residual = self.balance.measure(positions)
        return _State(positions, unbalanced, residual, state.residual, None)

    def done(self, state: _State) -> Stop | None:
        if state.residual <= RESIDUAL:
            return Stop.CONVERGED
        settled = state.fresh and state.residual > 0.5 * state.before
        if state.residual <= ENOUGH and (settled or state.stuck):
            return Stop.CONVERGED
        if self.balance.lost(state.positions):
            return Stop.LOST_SUPPORT
        return self.reason(state) if state.stuck else None

    def reason(self, state: _State) -> Stop:
        """Why Newton is lost: a mechanism where every edge is taut, a slack region otherwise."""
        tension = self.balance.membrane.tension(state.positions)
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
        Never raises for a membrane that finds no rest: `stop` says why, `found` is False. An iteration is a Newton step,
        with its line search.
    """
    newton = _Newton(Balance(membrane, applied, positions))
    run = iterate(newton, newton.begin(positions, factor), limit)
    state, stop = run.state, run.stop
    if state.residual <= FOUND:
        stop = Stop.CONVERGED
    elif stop is Stop.LIMIT and state.factor is None:
        stop = newton.reason(state)
    shape = membrane.kept_centroids(state.positions, positions)
    return Equilibrium(shape, state.residual, stop, run.steps, state.factorizations, state.factor, ("newton",))


def with_last_digits(membrane: Membrane, positions: Floats, applied: Floats, factor: Factor) -> Floats:
    """Positions (V, 3) of a membrane at rest, by chord steps until the residual falls no more: a solve each.

    At the residual where form-finding ends, enough for all that decides, up to two digits of the positions are still open.
    """
    balance = Balance(membrane, applied, positions)
    unbalanced, residual = balance.measure(positions)
    for _ in range(LAST):
        if residual <= NO_LESS:
            break
        trial = balance.moved(positions, factor.solve(unbalanced))
        left, smaller = balance.measure(trial)
        if smaller >= 0.5 * residual:
            break
        positions, unbalanced, residual = trial, left, smaller
    return positions
