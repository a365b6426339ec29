"""The race of starts: a method's steps from each, until two agree; the judge ranks what they came to."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from relax.design.methods import Method
from relax.design.methods.sequential import Sequential
from relax.design.optimality import EQUILIBRIUM, Certificate, judge
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.search import Search
from relax.design.shape import Shape, to_the_last_digits
from relax.design.starts import Start, at_target, choose_starts, heavy_starts, is_planted
from relax.design.symmetric import SymmetricProblem, symmetric_problem
from relax.design.trace import Journal
from relax.errors import EquilibriumError

CLEARLY = 1e-6  # relative: an unfinished step must be this much lower to be preferred to a finished start
SAME = 1e-8  # relative difference of objectives that are one


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


def best_of(problem: Problem, starts: list[Start] | None, method: Method, journal: Journal) -> Found:
    """The best that the starts lead to (None: symmetry, or those that the scene asks for), or of what an interrupt left."""
    outcomes: list[Outcome] = []
    spent, interrupted = 0, False
    try:
        if starts is None:
            outcomes += _by_symmetry(problem, method, journal)
            settled = bool(outcomes) and outcomes[-1].certificate.converged
            starts = [] if settled else choose_starts(problem, None, journal.skipped)
        if not isinstance(method, Sequential):
            starts = starts[:1]  # first weights, in which heavy starts differ, mean nothing to other methods
        for begin in starts:
            if _agree(outcomes):
                journal.skipped.append(f"start {begin.name}: two starts ended at the same supports")
                break
            outcomes.append(_run(problem, begin, method, journal))
            if isinstance(method, Sequential) and begin.name == "pulled" and not outcomes[-1].certificate.converged:
                starts += _others(problem, nothing=outcomes[-1].shape.amplitudes is begin.shape.amplitudes)
        best = outcomes[0] if len(outcomes) == 1 else min(outcomes, key=_rank)
        if last_refit(problem) == "debiased":
            journal.stage = "debiasing"
            shape = to_the_last_digits(problem, refit(problem, best.shape, "debiased", journal))
            spent += shape.factorizations - best.shape.factorizations
            best = replace(best, shape=shape, refit="debiased")
    except KeyboardInterrupt:
        best = _best_so_far(problem, outcomes, journal)
        interrupted = True
    if best.shape.factor is not None and best.shape.factor.proven:
        journal.skipped.append("a trial of the stiffness: every pivot is proven positive")
    spent += sum(each.shape.factorizations for each in outcomes) or best.shape.factorizations
    return Found(best, spent, interrupted)


def _by_symmetry(problem: Problem, method: Method, journal: Journal) -> list[Outcome]:
    """What the symmetry of a problem leads to, judged as any other outcome; nothing where there is none.

    The search sees one vertex of each orbit first. Then the whole problem is searched from where that ended, since an answer that
    is not symmetric can be better; where few supports hold the target as it is, a look at those supports is enough. Where the
    first step of the whole search undercuts the symmetric answer, that search is followed to its end too.
    """
    searches = isinstance(method, Sequential) and method.searches(problem)
    reduced = symmetric_problem(problem) if searches and problem.scene.settings["solver"]["start"] != "heavy" else None
    if reduced is None:
        return []
    said = list[str]()
    found, planted = _symmetric_answer(reduced, method, journal, said)
    if found is None or not problem.standing(found.shape.amplitudes).any():
        return []  # an orbit of supports may not pay where one of them does
    parts = f"{reduced.symmetry.order - 1} of {reduced.symmetry.order} parts of the membrane: it has {reduced.symmetry}"
    if planted:
        standing = reduced.one_of_each(np.flatnonzero(problem.standing(found.shape.amplitudes)))
        if found.certificate.converged and Search(problem).confirms(found.shape, standing):
            journal.skipped += [*said, parts]
            return [found]
    better = _undercutting(problem, found.shape)
    outcome = _run(problem, Start("symmetric", found.shape), method, journal)
    same = np.array_equal(problem.standing(outcome.shape.amplitudes), problem.standing(found.shape.amplitudes))
    if outcome.certificate.converged:
        what = "found nothing better" if same else "went on from there"
        journal.skipped.append(f"{parts}, and the search of the whole {what}")
    return [outcome] if better is None else [outcome, _run(problem, better, method, journal)]


def _symmetric_answer(
    reduced: SymmetricProblem, method: Method, journal: Journal, said: list[str]
) -> tuple[Outcome | None, bool]:
    """What one vertex of each orbit leads to, as an outcome of the whole, and whether few supports hold the target as it is."""
    try:
        start = choose_starts(reduced, None, said)[0]
        if start.weight is not None:
            return None, False
        journal.lift = reduced.whole
        shape, rough = (reduced.whole(shape) for shape in method(reduced, start, journal))
    except EquilibriumError:
        return None, False
    finally:
        journal.lift = None
    return Outcome(reduced.original, shape, rough), is_planted(reduced, start.shape)


def _undercutting(problem: Problem, shape: Shape) -> Start | None:
    """The whole search's own start, where its first step already ends below a shape."""
    search = Search(problem)
    try:
        start = choose_starts(problem, None, [])[0]
        objective = search.step(search.begin(start.shape)).objective
    except EquilibriumError:
        return None
    return start if objective < _objective(problem, shape) else None


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


def _run(problem: Problem, start: Start, method: Method, journal: Journal) -> Outcome:
    """A method's steps and rounding from one start; a membrane that no longer stands ends them with what was reached."""
    trouble = ""
    journal.stage = f"start {start.name}"
    journal.first = len(journal.shapes)
    try:
        shape, unrounded = method(problem, start, journal)
        shape = to_the_last_digits(problem, shape)
    except EquilibriumError as error:
        trouble = str(error)
        lowest = min(range(journal.first, len(journal.shapes)), key=journal.objective.__getitem__, default=None)
        shape = unrounded = start.shape if lowest is None else journal.shapes[lowest]
    return Outcome(problem, shape, unrounded, trouble=trouble or journal.failure)


def _rank(outcome: Outcome) -> tuple[bool, bool, float]:
    """What makes an outcome the better one: converged, at rest, then the objective (which means nothing off equilibrium)."""
    said = outcome.certificate
    return not said.converged, said.equilibrium > EQUILIBRIUM, said.objective


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
