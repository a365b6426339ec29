"""The sequential method: convex steps and rounding in turns, until the dual certificate names no candidate that is missing.

The steps are a search of small models (search.py) where the penalty tells sizes, which is the default; with a back-end they are
cone programs with reweighted norms (sequential.py), and the search has the last word: what it joins, moves or drops must lower
the objective. So are the first ones where a part of the membrane has no fixed vertex.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from relax.arrays import Floats, Mask
from relax.convex.backends import Backend, quick, working_set
from relax.convex.reweighted import GRADUAL
from relax.design.problem import Problem
from relax.design.rounding import Rounded, gently_seated, round_supports, seated
from relax.design.search import Search
from relax.design.sequential import SequentialConvex
from relax.design.shape import Shape
from relax.design.starts import Start
from relax.design.trace import Journal
from relax.errors import EquilibriumError, InputError
from relax.iterate import Algorithm, iterate
from relax.sparsity.penalties import is_convex, steepest
from relax.sparsity.supports import sizes
from relax.sparsity.surrogates import Continuation

STEPS = 60  # convex steps a sequence; those seen to converge took 3 to 25
HEAVY_STEPS = 2  # under the first, heavy weights: enough to know where the few masts stand
LEAST = 0.03  # of the largest first force: a smaller one counts as this in secant weights, else it could not come back
ROUNDS = 8  # of convex steps and rounding, while the certificate names candidates that are missing; 1 to 4 were seen to do


@dataclass(frozen=True)
class Sequential:
    """Steps from a start to rounded supports.

    Parameters
    ----------
    backend : Backend or None
        Who solves convex steps with reweighted norms; None: a search of models, and the working set where the penalty's weights
        never change or a part has no fixed vertex.
    continuation : Continuation
        How smoothing shrinks in the search.
    moves : "search" or "none"
        What follows cone steps: the search's moves of supports, or nothing.

    Raises
    ------
    InputError
        A back-end that is to take steps under a penalty that jumps at zero: its weights are infinite there.
    """

    backend: Backend | None = None
    continuation: Continuation = GRADUAL
    moves: str = "search"

    def searches(self, problem: Problem) -> bool:
        """Whether its steps are a search of models.

        Where a part has no fixed vertex, forces almost everywhere hold it at first, and a model that lets go of most of them at
        once is far from the truth: damped cone steps go first there, if the penalty has weights for them.
        """
        if self.backend is not None or is_convex(problem.penalty):
            return False
        return not problem.membrane.floating or not np.isfinite(steepest(problem.penalty))

    def __call__(self, problem: Problem, start: Start, journal: Journal) -> tuple[Shape, Shape]:
        """The rounded shape, and the one before the first rounding."""
        shape = start.shape
        if start.weight is not None:
            constant = start.weight * problem.supports.weights
            journal.stage = f"start {start.name}, first weights"
            rough = self.backend or quick
            shape = _sequence(SequentialConvex(problem, lambda _: constant, rough), shape, HEAVY_STEPS, journal)
        if _levels_off(problem, shape) and self.backend is None:
            journal.stage = f"start {start.name}, secant weights"
            shape = _sequence(SequentialConvex(problem, _Secants(problem, shape), working_set), shape, STEPS, journal)
            return _rounds(Search(problem, self.continuation), shape, start, journal)
        if self.searches(problem):
            return _rounds(Search(problem, self.continuation), shape, start, journal)
        if not np.isfinite(steepest(problem.penalty)):
            raise InputError(
                f'solver: the penalty "{problem.penalty.name}" jumps at zero, so convex steps with reweighted norms '
                'cannot tell where a support is worth its price: use the method "sequential" and the back-end "auto"'
            )
        steps = SequentialConvex(problem, problem.group_weights, self.backend or working_set)
        found, unrounded = _rounds(steps, shape, start, journal)
        if journal.failure or is_convex(problem.penalty) or self.moves == "none":
            return found, unrounded  # what a back-end left open stays open, and is said
        return _moved(Search(problem, self.continuation), found, start, journal), unrounded


SEQUENTIAL = Sequential()
REWEIGHTED_L1 = Sequential(working_set, moves="none")  # cone steps and rounding alone, as published


def _levels_off(problem: Problem, shape: Shape) -> bool:
    """Whether a part has no fixed vertex and R no slope at the forces that hold it, so that reweighted norms would let all be."""
    largest = sizes(shape.amplitudes).max(initial=0.0, keepdims=True)
    return bool(problem.membrane.floating) and problem.penalty.slope(largest)[0] == 0


@dataclass(frozen=True)
class _Secants:
    """Weights R(t) / t at each force t, at least a share of the largest of a first shape: never none, though R levels off."""

    problem: Problem
    first: Shape

    def __call__(self, amplitudes: Floats) -> Floats:
        size = np.maximum(sizes(amplitudes), LEAST * sizes(self.first.amplitudes).max())
        return self.problem.strength * self.problem.supports.weights * self.problem.penalty.value(size) / size


def _moved(search: Search, shape: Shape, start: Start, journal: Journal) -> Shape:
    """A rounded shape after what the search still joins, moves, adds or drops; the same where that lowers nothing."""
    try:
        better, _ = _rounds(search, shape, replace(start, name=f"{start.name}, moves"), journal)
    except EquilibriumError:
        return shape
    return better if _objective(search.problem, better) < _objective(search.problem, shape) else shape


def _rounds(method: SequentialConvex | Search, shape: Shape, start: Start, journal: Journal) -> tuple[Shape, Shape]:
    """Steps and rounding in turns: the rounded shape, and the one before the first rounding."""
    problem, first = method.problem, shape
    unrounded = best = None
    keep = np.zeros(len(shape.amplitudes), dtype=bool)
    tried: set[bytes] = set()
    for _ in range(ROUNDS):
        journal.stage = f"start {start.name}"
        if len(keep):  # without candidates there is nothing to choose
            shape = _sequence(method, shape, STEPS, journal)
        if journal.failure and shape is first and first is start.shape:
            return shape, shape  # forces almost everywhere, perhaps: there is nothing to round
        unrounded = unrounded or shape
        journal.stage = f"start {start.name}, rounding"
        result = round_supports(problem, shape, keep, journal)
        if result.missing.any() and problem.standing(result.shape.amplitudes).tobytes() in tried:
            # the convex steps leave them out each time, since a reweighted norm is not R: let Newton on R try them
            keep = keep | result.missing
            result = _seated(problem, result, keep, journal)
        shape = result.shape
        if not result.missing.any():
            if not tried and len(keep):
                pruned = "" if result.dropped.any() else "nothing was pruned, "
                journal.skipped.append(f"a second round of steps: {pruned}no candidate is missing")
            return shape, unrounded
        if best is not None and _objective(problem, shape) >= _objective(problem, best):
            break
        best = shape
        tried.add(problem.standing(shape.amplitudes).tobytes())
        # what was dropped for its size and is missed at once stays: else the two would take turns for ever
        keep = keep | (result.dropped & result.missing)
    return best or shape, unrounded or shape


def _seated(problem: Problem, result: Rounded, keep: Mask, journal: Journal) -> Rounded:
    """What Newton on R makes of first forces where supports are missing; of small ones, of one, where many came to nothing."""
    standing = problem.standing(result.shape.amplitudes)
    for seat in (seated, gently_seated, partial(seated, seats=1)):
        # what stood by its size may shrink beside a newcomer: dropped now, it would only be missed
        found = round_supports(problem, seat(problem, result), keep | standing, journal)
        if _objective(problem, found.shape) < _objective(problem, result.shape):
            break
    return found


def _sequence(method: SequentialConvex | Search, shape: Shape, limit: int, journal: Journal) -> Shape:
    algorithm: Algorithm[Any] = method
    state = iterate(algorithm, method.begin(shape), limit, journal).state
    if state.failure:
        journal.remark(f"; then {state.failure}")
    journal.failure = state.failure
    return state.shape


def _objective(problem: Problem, shape: Shape) -> float:
    return problem.objective(shape.positions, shape.amplitudes)
