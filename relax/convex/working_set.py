"""The convex step on a working set: only candidates that matter get their columns of K^-1 (MATHEMATICS.md, "One convex step").

Groups that cost nothing are in it from the start, candidates that pull harder than their weight enter, and the duality gap of
the whole step says when to stop.
"""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, Ints
from relax.convex.restricted import solve_restricted
from relax.convex.subproblem import Solution, Subproblem, certify
from relax.iterate import Stop, iterate
from relax.sparsity.supports import sizes

GAP = 1e-10
FIRST = 8  # candidates that enter at least, a round; more enter as the set grows
LIMIT = 60
WARM = 60  # groups of a start that enter at once, those with the largest forces, if they are larger than
NOTHING = 1e-6  # this share of the largest: a planted target carries round-off everywhere


@dataclass(frozen=True)
class _State:
    solution: Solution
    members: Ints
    columns: Floats  # (3n, ck): K^-1 B of the members
    quadratic: Floats
    grown: bool = True


@dataclass(frozen=True)
class _WorkingSet:
    subproblem: Subproblem
    largest: int
    gap: float

    def begin(self, amplitudes: Floats) -> _State:
        step = self.subproblem
        nothing = certify(step, step.nothing)
        empty = _State(nothing, np.zeros(0, dtype=np.int64), np.zeros((len(step.offset), 0)), np.zeros((0, 0)))
        size = sizes(amplitudes)
        # a hint only: what is left out comes back by its dual if it matters
        largest = np.argsort(-size)[:WARM]
        warm = np.union1d(largest[size[largest] > NOTHING * size.max()], step.kept)
        return self._solved(self._enlarged(empty, warm), amplitudes) if warm.size else empty

    def _enlarged(self, state: _State, entering: Ints) -> _State:
        entered = self.subproblem.factor.inverse_columns(self.subproblem.rows[entering].ravel())
        columns = np.hstack([state.columns, entered])
        quadratic = columns.T @ (self.subproblem.metric @ columns)
        return replace(state, members=np.concatenate([state.members, entering]), columns=columns, quadratic=quadratic)

    def _solved(self, state: _State, amplitudes: Floats) -> _State:
        step = self.subproblem
        linear = state.columns.T @ (step.metric @ step.unsupported)
        quadratic = state.quadratic
        if step.curvature is not None:
            quadratic = quadratic + np.diag(np.repeat(step.curvature[state.members], amplitudes.shape[1]))
        weights, start = step.weights[state.members], amplitudes[state.members]
        inner = solve_restricted(quadratic, linear, weights, start, step.reach)
        whole = step.nothing
        whole[state.members] = inner
        return replace(state, solution=certify(step, whole, "working set"))

    def step(self, state: _State) -> _State:
        pull, weights = self.subproblem.reach.pull(state.solution.dual), self.subproblem.weights
        excess = np.divide(pull, weights, out=np.where(pull > 0, np.inf, 0.0), where=weights > 0)
        excess[state.members] = 0.0
        worst = np.argsort(-excess)[: max(FIRST, len(state.members) // 2)]
        entering = worst[excess[worst] > 1.0]
        if not entering.size:
            return replace(state, grown=False)
        return self._solved(self._enlarged(state, entering), state.solution.amplitudes)

    def done(self, state: _State) -> Stop | None:
        if state.solution.gap <= self.gap:
            return Stop.CONVERGED
        if not state.grown:
            return Stop.STALLED
        return Stop.LIMIT if len(state.members) > self.largest else None

    def record(self, state: _State) -> dict[str, float]:
        return {"gap": state.solution.gap, "members": len(state.members)}


def solve_on_working_set(step: Subproblem, start: Floats, largest: int, gap: float = GAP) -> Solution:
    """The best point of the step found with at most some `largest` candidates looked at; its gap says how good it is.

    Parameters
    ----------
    step : Subproblem
    start : (m, c) newtons
        Groups that carry a force here are in the first working set.
    largest : int
        When more candidates than this matter the round ends and the full cone program should take over.
    gap : float
        Relative duality gap that is good enough.
    """
    method = _WorkingSet(step, largest, gap)
    state = iterate(method, method.begin(start), LIMIT).state
    return replace(state.solution, looked=state.members)
