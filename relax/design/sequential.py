"""Sequential convex steps: linearise the spring forces, solve the cone program, restore equilibrium, accept if it pays.

Reweighting and linearisation share each step. A step counts only if the objective falls at TRUE equilibrium under the same
weights; else the next one is damped. The loop ends when the same supports stand twice: what is left is Newton's (refit).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats
from relax.convex.backends import Backend
from relax.convex.subproblem import Subproblem
from relax.design.problem import Problem
from relax.design.shape import Shape, displaced, figures
from relax.errors import BackendError, UnheldError, UnsupportedError
from relax.iterate import Stop
from relax.sparsity.supports import sizes

Weights = Callable[[Floats], Floats]  # amplitudes (m, 3) -> weights (m,)
FIRST_DAMPING = 0.3  # of the metric: one refused step is halved or so
LARGEST_DAMPING = 1e9
SETTLED = 1e-3  # relative decrease of a full step below which Newton on the support is the better next step
ENOUGH = 1e-10  # relative decrease below which the linearised model has no more to give


@dataclass(frozen=True)
class State:
    """A shape on the way, with what the last step did."""

    shape: Shape
    damping: float = 0.0
    settled: bool = False  # the same supports stood after the last step as before it, or it gained next to nothing
    note: str = ""
    exhausted: bool = False
    failure: str = ""  # why the back-end gave no step
    looked: frozenset[int] = frozenset()  # candidates whose columns of K^-1 were made, so far


@dataclass(frozen=True)
class SequentialConvex:
    """One sequence of convex steps under one rule for the weights.

    Parameters
    ----------
    problem : Problem
    weights : function
        Weights (m,) at amplitudes (m, 3): the penalty's reweighting, or constants.
    backend : Backend
        Solves each step.
    """

    problem: Problem
    weights: Weights
    backend: Backend

    def begin(self, shape: Shape) -> State:
        """The first state."""
        return State(shape)

    def step(self, state: State) -> State:
        """One convex step from `state`, kept or refused."""
        shape, problem = state.shape, self.problem
        factor = problem.factor_at(shape.positions)
        shape = shape.with_factor(factor)
        weights = self.weights(shape.amplitudes)
        before = problem.distance(shape.positions) + float(weights @ sizes(shape.amplitudes))
        subproblem = problem.linearised(shape.positions, factor, weights)
        for damping in _dampings(state.damping):
            try:
                solution = self.backend(subproblem.damped(damping), shape.amplitudes)
            except UnsupportedError:
                raise  # no step of this problem will do
            except UnheldError as error:  # a shorter step may let go of less
                state = replace(state, failure=str(error))
                continue
            except BackendError as error:
                return replace(state, shape=shape, exhausted=True, failure=str(error))
            looked = range(len(weights)) if solution.looked is None else solution.looked
            state = replace(state, looked=state.looked.union(looked))
            promised = before - self._model(subproblem, solution.displacement, solution.amplitudes)
            if promised <= ENOUGH * before:
                return replace(state, shape=shape, exhausted=True, note=f"{solution.ran}, nothing more to gain")
            moved = displaced(problem, shape, solution.displacement, solution.amplitudes)
            if moved is None:
                continue
            shape = replace(shape, factorizations=moved.factorizations)
            after = problem.distance(moved.positions) + float(weights @ sizes(moved.amplitudes))
            if after < before:
                same = np.array_equal(problem.standing(moved.amplitudes), problem.standing(shape.amplitudes))
                small = damping == 0 and before - after < SETTLED * before
                good = before - after > 0.5 * promised
                return State(
                    moved,
                    damping=_eased(damping) if good else damping,
                    settled=same or small,
                    note=solution.ran + (f", damping {damping:.2g}" if damping else ""),
                    looked=state.looked,
                )
        return replace(state, shape=shape, exhausted=True, note="every step was refused")

    def _model(self, subproblem: Subproblem, displacement: Floats, amplitudes: Floats) -> float:
        """The convex model's value, without damping."""
        moved = subproblem.offset + displacement
        return float(moved @ (subproblem.metric @ moved)) + float(subproblem.weights @ sizes(amplitudes))

    def done(self, state: State) -> Stop | None:
        """Settled, or out of steps that pay."""
        return Stop.CONVERGED if state.settled or state.exhausted else None

    def record(self, state: State) -> dict[str, object]:
        """Figures of the state for the trace."""
        return figures(self.problem, state.shape, state.note, state.looked)


def _dampings(first: float) -> list[float]:
    """The damping to try first, then ever more until a step is too short to matter."""
    series = [first]
    while series[-1] < LARGEST_DAMPING:
        series.append(max(FIRST_DAMPING, 4 * series[-1]))
    return series


def _eased(damping: float) -> float:
    """Less damping after a step that kept its promise."""
    return damping / 8 if damping > FIRST_DAMPING else 0.0
