"""The race of starts: convex steps and rounding from each, until two agree; the judge ranks what they came to."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from relax.convex.backends import BACKENDS, Backend
from relax.design.methods import Method
from relax.design.optimality import EQUILIBRIUM, Certificate, judge
from relax.design.problem import Problem
from relax.design.refit import Shape, refit
from relax.design.rounding import round_supports, seated
from relax.design.search import Search
from relax.design.sequential import SequentialConvex
from relax.design.starts import Start, at_target, choose_starts, heavy_starts, is_planted, tells_sizes
from relax.design.symmetric import symmetric_problem
from relax.design.trace import Journal
from relax.errors import EquilibriumError
from relax.iterate import Algorithm, iterate

STEPS = 60  # convex steps a sequence; those seen to converge took 3 to 25
HEAVY_STEPS = 2  # under the first, heavy weights: enough to know where the few masts stand
CLEARLY = 1e-6  # relative: an unfinished step must be this much lower to be preferred to a finished start
SAME = 1e-8  # relative difference of objectives that are one
ROUNDS = 8  # of convex steps and rounding, while the certificate names candidates that are missing; 1 to 4 were seen to do


@dataclass(frozen=True)
class Outcome:
    """How one start ended, judged when somebody asks; `trouble` says why where the membrane would no longer stand."""

    problem: Problem
    shape: Shape
    unrounded: Shape
    refit: str = "penalised"
    trouble: str = ""

    @cached_property
    def certificate(self) -> Certificate:
        """The judge's word on the shape."""
        return judge(self.problem, self.shape.positions, self.problem.all_forces(self.shape.amplitudes), self.refit)


@dataclass(frozen=True)
class Found:
    """What all starts came to; `factorizations` is what was spent on them."""

    best: Outcome
    factorizations: int
    interrupted: bool


@dataclass(frozen=True)
class Tools:
    """What a run works with: its journal, who solves its convex steps and which method leads it where somebody was named."""

    journal: Journal
    backend: Backend | None = None  # None: what is fastest
    method: Method | None = None  # None: sequential


def best_of(problem: Problem, starts: list[Start] | None, tools: Tools) -> Found:
    """The best that the starts lead to (None: symmetry, or those that the scene asks for), or of what an interrupt left."""
    journal = tools.journal
    outcomes: list[Outcome] = []
    spent, interrupted = 0, False
    try:
        if starts is None:
            outcomes += _by_symmetry(problem, tools)
            settled = bool(outcomes) and outcomes[-1].certificate.converged
            starts = [] if settled else choose_starts(problem, None, journal.skipped)
        if tools.method is not None:
            starts = starts[:1]  # first weights, in which heavy starts differ, mean nothing to other methods
        for begin in starts:
            if _agree(outcomes):
                journal.skipped.append(f"start {begin.name}: two starts ended at the same supports")
                break
            outcomes.append(_run(problem, begin, tools))
            if tools.method is None and begin.name == "pulled" and not outcomes[-1].certificate.converged:
                starts += _others(problem, nothing=outcomes[-1].shape is begin.shape)
        best = outcomes[0] if len(outcomes) == 1 else min(outcomes, key=_rank)
        if last_refit(problem) == "debiased":
            journal.stage = "debiasing"
            shape = refit(problem, best.shape, "debiased", journal)
            spent += shape.factorizations - best.shape.factorizations
            best = replace(best, shape=shape, refit="debiased")
    except KeyboardInterrupt:
        best = _best_so_far(problem, outcomes, journal)
        interrupted = True
    if best.shape.factor is not None and best.shape.factor.proven:
        journal.skipped.append("a trial of the stiffness: every pivot is proven positive")
    spent += sum(each.shape.factorizations for each in outcomes) or best.shape.factorizations
    return Found(best, spent, interrupted)


def _by_symmetry(problem: Problem, tools: Tools) -> list[Outcome]:
    """What the symmetry of a problem leads to, judged as any other outcome; nothing where there is none.

    The search sees one vertex of each orbit first. Then the whole problem is searched from where that ended, since an answer that
    is not symmetric can be better; where few supports hold the target as it is, a look at those supports is enough.
    """
    searches = tools.method is None and isinstance(_method(problem, tools), Search)
    if not searches or problem.scene.settings["solver"]["start"] == "heavy":
        return []
    reduced = symmetric_problem(problem)
    if reduced is None:
        return []
    journal, said = tools.journal, list[str]()
    try:
        start = choose_starts(reduced, None, said)[0]
        if start.weight is not None:
            return []
        journal.lift = reduced.whole
        found, rough = (reduced.whole(shape) for shape in _steps_and_rounding(reduced, start, tools))
    except EquilibriumError:
        return []
    finally:
        journal.lift = None
    parts = f"{reduced.symmetry.order - 1} of {reduced.symmetry.order} parts of the membrane: it has {reduced.symmetry}"
    if is_planted(reduced, start.shape):
        outcome = Outcome(problem, found, rough)
        standing = reduced.one_of_each(np.flatnonzero(problem.standing(found.amplitudes)))
        if outcome.certificate.converged and Search(problem).confirms(found, standing):
            journal.skipped += [*said, parts]
            return [outcome]
    outcome = _run(problem, Start("symmetric", found), tools)
    same = np.array_equal(problem.standing(outcome.shape.amplitudes), problem.standing(found.amplitudes))
    if outcome.certificate.converged:
        what = "found nothing better" if same else "went on from there"
        journal.skipped.append(f"{parts}, and the search of the whole {what}")
    return [outcome]


def last_refit(problem: Problem) -> str:
    """How the scene's last solve treats the penalty."""
    return str(problem.scene.settings["rounding"]["refit"])


def _others(problem: Problem, *, nothing: bool) -> list[Start]:
    """What else to start from: the target, which a light weight does not leave far; the heavy ones where nothing came so far."""
    shape = at_target(problem)
    starts = [] if shape is None else [Start("target", shape)]
    try:
        return [*starts, *heavy_starts(problem)] if nothing else starts
    except EquilibriumError:
        return starts


def _run(problem: Problem, start: Start, tools: Tools) -> Outcome:
    """A method's steps and rounding from one start; a membrane that no longer stands ends them with what was reached."""
    trouble = ""
    journal = tools.journal
    journal.first = len(journal.shapes)
    try:
        if tools.method is None:
            shape, unrounded = _steps_and_rounding(problem, start, tools)
        else:
            journal.stage = f"start {start.name}"
            shape, unrounded = tools.method(problem, start, journal)
    except EquilibriumError as error:
        trouble = str(error)
        shape = unrounded = journal.shapes[-1] if len(journal.shapes) > journal.first else start.shape
    return Outcome(problem, shape, unrounded, trouble=trouble or journal.failure)


def _rank(outcome: Outcome) -> tuple[bool, bool, float]:
    """What makes an outcome the better one: converged, at rest, then the objective (which means nothing off equilibrium)."""
    said = outcome.certificate
    return not said.converged, said.equilibrium > EQUILIBRIUM, said.objective


def _steps_and_rounding(problem: Problem, start: Start, tools: Tools) -> tuple[Shape, Shape]:
    """The rounded shape, and the one before the first rounding: until the certificate names no missing candidate."""
    shape, journal = start.shape, tools.journal
    if start.weight is not None:
        constant = start.weight * problem.supports.weights
        journal.stage = f"start {start.name}, first weights"
        rough = tools.backend or BACKENDS["quick"]
        shape = _sequence(SequentialConvex(problem, lambda _: constant, rough), shape, HEAVY_STEPS, journal)
    unrounded = best = None
    keep = np.zeros(len(shape.amplitudes), dtype=bool)
    method = _method(problem, tools)
    tried: set[bytes] = set()
    for _ in range(ROUNDS):
        journal.stage = f"start {start.name}"
        if len(keep):  # without candidates there is nothing to choose
            shape = _sequence(method, shape, STEPS, journal)
        if journal.failure and shape is start.shape:
            return shape, shape  # forces almost everywhere, perhaps: there is nothing to round
        unrounded = unrounded or shape
        journal.stage = f"start {start.name}, rounding"
        result = round_supports(problem, shape, keep, journal)
        if result.missing.any() and problem.standing(result.shape.amplitudes).tobytes() in tried:
            # the convex steps leave them out each time, since a reweighted norm is not R: let Newton on R try them
            keep = keep | result.missing
            result = round_supports(problem, seated(problem, result), keep, journal)
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


def _method(problem: Problem, tools: Tools) -> SequentialConvex | Search:
    """The search, where the penalty tells sizes and no back-end of convex steps was asked for."""
    if tools.backend is None and tells_sizes(problem):
        return Search(problem)
    return SequentialConvex(problem, problem.group_weights, tools.backend or BACKENDS["working-set"])


def _sequence(method: SequentialConvex | Search, shape: Shape, limit: int, journal: Journal) -> Shape:
    algorithm: Algorithm[Any] = method
    state = iterate(algorithm, method.begin(shape), limit, journal).state
    if state.failure:
        journal.remark(f"; then {state.failure}")
    journal.failure = state.failure
    return state.shape


def _agree(outcomes: list[Outcome]) -> bool:
    """Whether two starts both converged, to the same supports and the same objective."""
    if len(outcomes) < 2 or not all(outcome.certificate.converged for outcome in outcomes):
        return False
    one, other = (outcome.certificate.objective for outcome in outcomes[-2:])
    stands, also = (outcome.shape.amplitudes != 0 for outcome in outcomes[-2:])
    return bool(abs(one - other) <= SAME * abs(one) and np.array_equal(stands, also))


def _best_so_far(problem: Problem, outcomes: list[Outcome], journal: Journal) -> Outcome:
    """What an interrupted run can show: the best finished start, or a step of another that is clearly lower (all are at rest)."""
    if not journal.shapes:
        raise KeyboardInterrupt
    shape = journal.shapes[int(np.argmin(journal.objective))]
    if outcomes:
        done = min(outcomes, key=_rank)
        if _objective(problem, shape) >= (1 - CLEARLY) * done.certificate.objective:
            shape = done.shape
    return Outcome(problem, shape, shape, last_refit(problem))


def _objective(problem: Problem, shape: Shape) -> float:
    return problem.objective(shape.positions, shape.amplitudes)
