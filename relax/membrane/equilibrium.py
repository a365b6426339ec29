"""Form-finding by Newton on the stiffness matrix: where the membrane comes to rest under given forces, or why it does not."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from relax.arrays import Floats
from relax.factor import Factor
from relax.iterate import Stop, iterate
from relax.membrane.chords import AIM, Chords
from relax.membrane.membrane import Membrane
from relax.membrane.rest import FOUND, Balance, Equilibrium

ASTRAY = 10.0  # growth of the residual at which chord steps lead nowhere
ROUND_OFF = 1e-14  # of what the digits of the potential are counted from
FAR = 0.1  # a residual after a Newton step that says that its stiffness is of no use here
ENOUGH = 1e-11  # below this a residual that no longer falls is round-off
LARGEST_LIMIT = 200
NO_LESS = 4 * float(np.finfo(float).eps)  # relative residual of a shape whose positions are right to round-off
LAST = 3  # steps for the last digits: each solve gains several, until round-off is all that is left


@dataclass(frozen=True)
class _State:
    positions: Floats
    unbalanced: Floats  # (n, 3)
    residual: float
    before: float  # the residual one step earlier
    chords: Chords | None  # steps with the factorisation at hand, if one is
    factorizations: int = 0
    origin: "_State | None" = None  # where the chord steps began that led here
    nearest: "_State | None" = None  # the one of them with the smallest residual
    fresh: bool = False  # the last step used the stiffness of its own start
    stuck: bool = False


@dataclass(frozen=True)
class _Newton:
    """Newton on the total potential, energy - applied . x: line search, and K made definite where it is not."""

    balance: Balance
    hopeless: Callable[[Floats], bool] | None = None

    def begin(self, positions: Floats, factor: Factor | None) -> _State:
        unbalanced, residual = self.balance.measure(positions)
        return _State(positions, unbalanced, residual, np.inf, None if factor is None else Chords(factor))

    def step(self, state: _State) -> _State:
        membrane, chords = self.balance.membrane, state.chords
        far = state.fresh and state.residual > FAR
        if chords is not None and not far and chords.pay(state.residual) and chords.factor.positive_definite:
            after, shift = chords.step(state.positions[membrane.free], state.unbalanced, state.residual)
            nearest = min(state, state.nearest or state, key=attrgetter("residual"))
            moved = replace(self._moved(state, shift, 1.0), chords=after, factorizations=state.factorizations)
            moved = replace(moved, origin=state.origin or state, nearest=nearest)
            if moved.residual <= ASTRAY * after.residuals[0] and not self.balance.lost(moved.positions):
                return moved
            state = moved
        begin = self._best_on_the_way(state)
        factor = membrane.factor_at(begin.positions)
        count = state.factorizations + (chords is None or factor is not chords.factor)
        direct = factor
        if not factor.positive_definite:
            direct = membrane.lifted_factor_at(begin.positions)
            count += 1
        found = self._search(begin, direct.solve(begin.unbalanced))
        chords = Chords(factor) if factor.positive_definite else None
        return replace(found, chords=chords, factorizations=count, fresh=True)

    def _best_on_the_way(self, state: _State) -> _State:
        """Where Newton goes on after chord steps: nearest to rest, unless the potential rose there, which Newton would undo."""
        if state.origin is None or state.nearest is None:
            return state
        nearest = min(state, state.nearest, key=attrgetter("residual"))
        noise = ROUND_OFF * self.balance.magnitude(state.origin.positions)
        fell = self.balance.potential(nearest.positions) <= self.balance.potential(state.origin.positions) + noise
        return nearest if fell else state.origin

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
        if state.residual <= AIM:
            return Stop.CONVERGED
        settled = state.fresh and state.residual > 0.5 * state.before
        if state.residual <= ENOUGH and (settled or state.stuck):
            return Stop.CONVERGED
        if self.balance.lost(state.positions):
            return Stop.LOST_SUPPORT
        if self.hopeless is not None and self.hopeless(state.positions):
            return Stop.HOPELESS
        return self.reason(state) if state.stuck else None

    def reason(self, state: _State) -> Stop:
        """Why Newton is lost: a mechanism where every edge is taut, a slack region otherwise."""
        tension = self.balance.membrane.tension(state.positions)
        return Stop.SLACK if (tension <= 0).any() else Stop.MECHANISM

    def record(self, state: _State) -> dict[str, float]:
        return {"residual": state.residual}


def find_equilibrium(
    membrane: Membrane,
    positions: Floats,
    applied: Floats,
    factor: Factor | None = None,
    limit: int = LARGEST_LIMIT,
    hopeless: Callable[[Floats], bool] | None = None,
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
    hopeless : function of positions (V, 3), optional
        Asked at each shape on the way whether to break off there.

    Returns
    -------
    Equilibrium
        Never raises for a membrane that finds no rest: `stop` says why, `found` is False. An iteration is a Newton step
        with its line search, or a chord step.
    """
    newton = _Newton(Balance(membrane, applied, positions), hopeless)
    run = iterate(newton, newton.begin(positions, factor), limit)
    state, stop = run.state, run.stop
    if state.residual <= FOUND:
        stop = Stop.CONVERGED
    elif stop is Stop.LIMIT and state.chords is None:
        stop = newton.reason(state)
    factor = None if state.chords is None else state.chords.factor
    shape = membrane.kept_centroids(state.positions, positions)
    return Equilibrium(shape, state.residual, stop, run.steps, state.factorizations, factor, ("newton",))


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
