"""The front door: from a problem to a design, its supports rounded and its figures judged."""

import copy
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relax.arrays import Floats
from relax.convex.backends import BACKENDS, Backend
from relax.design.ledger import sentences
from relax.design.masts import Mast, standing_masts
from relax.design.optimality import EQUILIBRIUM, OFF_SUPPORT, Certificate, judge
from relax.design.parts import Part, PartJournal, assembled, counted, split
from relax.design.problem import Problem
from relax.design.refit import Shape, refit
from relax.design.rounding import round_supports, seated
from relax.design.search import Search
from relax.design.sequential import SequentialConvex
from relax.design.starts import Start, at_target, choose_starts, heavy_starts, is_planted, resolve_weight, tells_sizes
from relax.design.symmetric import symmetric_problem
from relax.design.trace import Callback, Journal, Trace
from relax.errors import EquilibriumError, InputError
from relax.iterate import Algorithm, Stop, iterate
from relax.membrane.equilibrium import find_equilibrium

STEPS = 60  # convex steps a sequence; those seen to converge took 3 to 25
HEAVY_STEPS = 2  # under the first, heavy weights: enough to know where the few masts stand
CLEARLY = 1e-6  # relative: an unfinished step must be this much lower to be preferred to a finished start
SAME = 1e-8  # relative difference of objectives that are one
ROUNDS = 8  # of convex steps and rounding, while the certificate names candidates that are missing; 1 to 4 were seen to do


@dataclass(frozen=True)
class Design:
    """What a run found: the membrane at rest, the supports that hold it, and what the judge says of it.

    `settings` are the scene's as resolved (`penalty.weight` is the number used); `stop` is a sentence; `iterations` and
    `factorizations` count over all starts, `seconds` is the solve alone; `skipped` says what the scene did not need.
    """

    problem: Problem
    settings: Mapping[str, Any] = field(repr=False)
    positions: Floats
    forces: Floats
    certificate: Certificate
    stop: str
    iterations: int
    factorizations: int
    seconds: float
    skipped: tuple[str, ...]
    interrupted: bool
    trace: Trace = field(repr=False)

    @property
    def supports(self) -> tuple[Mast, ...]:
        """The supports as masts, tie-downs and stays."""
        return standing_masts(self.positions, self.forces, self.problem.scene.ground)

    def __str__(self) -> str:
        said = self.certificate
        masts = "1 support" if said.supports == 1 else f"{said.supports} supports"
        figures = f"rms distance {said.rms_distance:.3g} m, objective {said.objective:.6g}"
        return f"{self.stop} in {self.iterations} steps: {masts}, {figures}"


@dataclass(frozen=True)
class _Outcome:
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
class _Found:
    """What all starts came to; `factorizations` is what was spent on them."""

    best: _Outcome
    factorizations: int
    interrupted: bool


@dataclass(frozen=True)
class _Tools:
    """What a run works with: its journal, and who solves its convex steps where somebody was named (None: what is fastest)."""

    journal: Journal
    backend: Backend | None


def solve(
    problem: Problem,
    start: tuple[Floats, Floats] | None = None,
    backend: Backend | None = None,
    callback: Callback | None = None,
) -> Design:
    """The membrane closest to the wanted shape under few supports, with the scene's own [solver] and [rounding].

    Parameters
    ----------
    problem : Problem
    start : positions and forces (V, 3) of another result, optional
        Needed where the scene's `solver.start` names a result folder.
    backend : function Subproblem, start -> Solution, optional
        Solves each convex step; default: the one that the scene's `solver.backend` names.
    callback : function, optional
        Called once a step with step, objective, stationarity, supports, seconds and a note; its time is not counted.

    Raises
    ------
    EquilibriumError
        No start finds a membrane at rest; the message says why.
    """
    # matrices here are small or sparse: more BLAS threads than one were measured to cost a factor of six
    with threadpool_limits(1, "blas"):
        problem = resolve_weight(problem)
        named = problem.scene.settings["solver"]["backend"]
        journal = Journal(problem, callback)
        if backend is None and named != "cvxpy":
            journal.skipped.append("the import of cvxpy: no convex step is handed to it")
        if backend is None and named != "auto":
            backend = BACKENDS[named]
        return _solve(problem, start, _Tools(journal, backend))


def _solve(problem: Problem, start: tuple[Floats, Floats] | None, tools: _Tools) -> Design:
    journal = tools.journal
    parts = split(problem)
    if parts:
        found = _solve_apart(problem, parts, start, tools)
    else:
        found = _best_of(problem, None if start is None else choose_starts(problem, start, journal.skipped), tools)
    stop = Stop.INTERRUPTED.value if found.interrupted else _why(found.best)
    design = _design(problem, found.best, journal, stop)
    said = sentences(problem, journal, found.factorizations)
    return replace(design, factorizations=found.factorizations, skipped=said)


def _best_of(problem: Problem, starts: list[Start] | None, tools: _Tools) -> _Found:
    """The best that the starts lead to (None: symmetry, or those that the scene asks for), or of what an interrupt left."""
    journal = tools.journal
    outcomes: list[_Outcome] = []
    spent, interrupted = 0, False
    try:
        if starts is None:
            outcomes += _by_symmetry(problem, tools)
            settled = bool(outcomes) and outcomes[-1].certificate.converged
            starts = [] if settled else choose_starts(problem, None, journal.skipped)
        for begin in starts:
            if _agree(outcomes):
                journal.skipped.append(f"start {begin.name}: two starts ended at the same supports")
                break
            outcomes.append(_run(problem, begin, tools))
            if begin.name == "pulled" and not outcomes[-1].certificate.converged:
                starts += _others(problem, nothing=outcomes[-1].shape is begin.shape)
        best = outcomes[0] if len(outcomes) == 1 else min(outcomes, key=_rank)
        if _last_refit(problem) == "debiased":
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
    return _Found(best, spent, interrupted)


def _by_symmetry(problem: Problem, tools: _Tools) -> list[_Outcome]:
    """What the symmetry of a problem leads to, judged as any other outcome; nothing where there is none.

    The search sees one vertex of each orbit first. Then the whole problem is searched from where that ended, since an answer that
    is not symmetric can be better; where few supports hold the target as it is, a look at those supports is enough.
    """
    if not isinstance(_method(problem, tools), Search) or problem.scene.settings["solver"]["start"] == "heavy":
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
        outcome = _Outcome(problem, found, rough)
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


def _solve_apart(problem: Problem, parts: Sequence[Part], start: tuple[Floats, Floats] | None, tools: _Tools) -> _Found:
    """Each part by itself, the others at rest where they start or ended; after an interrupt the rest stay at their start."""
    journal = tools.journal
    said: list[list[str]] = [[] for _ in parts]
    starts = [_starts_of(part, start, words) for part, words in zip(parts, said, strict=True)]
    shapes = [first.shape for first, *_ in starts]
    unrounded, journals, troubles = list(shapes), [], []
    spent, interrupted = 0, False
    for index, part in enumerate(parts):
        journals.append(PartJournal(journal, parts, shapes, index))
        try:
            found = _best_of(part.problem, starts[index], replace(tools, journal=journals[-1]))
        except KeyboardInterrupt:  # before the first step of this part
            if not journal.shapes:
                raise
            interrupted = True
            break
        shapes[index], unrounded[index] = found.best.shape, found.best.unrounded
        said[index] += journals[-1].skipped
        troubles += [f"part {index + 1}: {found.best.trouble}"] if found.best.trouble else []
        spent += found.factorizations
        interrupted = found.interrupted
        if interrupted:
            break
    journal.tally = counted(problem, parts, [own.tally for own in journals])
    journal.skipped += [_fallen_apart(problem, parts), *_shared(said)]
    shape, rough = (assembled(problem, parts, each) for each in (shapes, unrounded))
    return _Found(_Outcome(problem, shape, rough, _last_refit(problem), "; ".join(troubles)), spent, interrupted)


def _fallen_apart(problem: Problem, parts: Sequence[Part]) -> str:
    count = int(problem.membrane.parts.max()) + 1
    shared = f", as {len(parts)} problems" if len(parts) < count else ""
    return f"one problem of {len(problem.membrane.free)} free vertices: {count} parts solved apart{shared}"


def _starts_of(part: Part, start: tuple[Floats, Floats] | None, skipped: list[str]) -> list[Start]:
    """The starts of one part; what is wrong with it names the part."""
    try:
        return choose_starts(part.problem, part.start(start), skipped)
    except EquilibriumError as error:
        vertex = part.vertices[part.problem.membrane.free[0]]
        raise EquilibriumError(f"the part of the membrane that holds vertex {vertex}: {error}") from error


def _shared(said: list[list[str]]) -> list[str]:
    """Sentences of several parts, each once, with the number of parts that it holds for."""
    counted = Counter(sentence for words in said for sentence in words)
    return [line if count == len(said) else f"in {count} of {len(said)} parts, {line}" for line, count in counted.items()]


def _last_refit(problem: Problem) -> str:
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


def _run(problem: Problem, start: Start, tools: _Tools) -> _Outcome:
    """Convex steps and rounding from one start; a membrane that no longer stands ends them with what was reached."""
    trouble = ""
    journal = tools.journal
    journal.first = len(journal.shapes)
    try:
        shape, unrounded = _steps_and_rounding(problem, start, tools)
    except EquilibriumError as error:
        trouble = str(error)
        shape = unrounded = journal.shapes[-1] if len(journal.shapes) > journal.first else start.shape
    return _Outcome(problem, shape, unrounded, trouble=trouble or journal.failure)


def _rank(outcome: _Outcome) -> tuple[bool, bool, float]:
    """What makes an outcome the better one: converged, at rest, then the objective (which means nothing off equilibrium)."""
    said = outcome.certificate
    return not said.converged, said.equilibrium > EQUILIBRIUM, said.objective


def _why(outcome: _Outcome) -> str:
    """The stop sentence: what the judge did not accept, and why where that is known."""
    said = outcome.certificate
    if said.converged:
        return Stop.CONVERGED.value
    if said.equilibrium > EQUILIBRIUM:
        reason = "the membrane is not at rest"
    elif not said.stable:
        reason = Stop.UNSTABLE.value
    elif said.off_support is not None and said.off_support > OFF_SUPPORT:
        reason = "a candidate without a support would still lower the objective (off_support is above 1)"
    else:
        reason = Stop.STALLED.value
    return f"{reason}; {outcome.trouble}" if outcome.trouble else reason


def _steps_and_rounding(problem: Problem, start: Start, tools: _Tools) -> tuple[Shape, Shape]:
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


def _method(problem: Problem, tools: _Tools) -> SequentialConvex | Search:
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


def _agree(outcomes: list[_Outcome]) -> bool:
    """Whether two starts both converged, to the same supports and the same objective."""
    if len(outcomes) < 2 or not all(outcome.certificate.converged for outcome in outcomes):
        return False
    one, other = (outcome.certificate.objective for outcome in outcomes[-2:])
    stands, also = (outcome.shape.amplitudes != 0 for outcome in outcomes[-2:])
    return bool(abs(one - other) <= SAME * abs(one) and np.array_equal(stands, also))


def _best_so_far(problem: Problem, outcomes: list[_Outcome], journal: Journal) -> _Outcome:
    """What an interrupted run can show: the best finished start, or a step of another that is clearly lower (all are at rest)."""
    if not journal.shapes:
        raise KeyboardInterrupt
    shape = journal.shapes[int(np.argmin(journal.objective))]
    if outcomes:
        done = min(outcomes, key=_rank)
        if _objective(problem, shape) >= (1 - CLEARLY) * done.certificate.objective:
            shape = done.shape
    return _Outcome(problem, shape, shape, _last_refit(problem))


def _objective(problem: Problem, shape: Shape) -> float:
    return problem.objective(shape.positions, shape.amplitudes)


def _design(problem: Problem, best: _Outcome, journal: Journal, stop: str) -> Design:
    settings: dict[str, Any] = copy.deepcopy(dict(problem.scene.settings))
    used = {key: getattr(problem.penalty, key, None) for key in settings["penalty"] if key != "weight_fraction"}
    settings["penalty"] |= used | {"weight": problem.weight}
    return Design(
        problem=problem,
        settings=settings,
        positions=best.shape.positions,
        forces=problem.all_forces(best.shape.amplitudes),
        certificate=best.certificate,
        stop=stop,
        iterations=max(0, len(journal.shapes) - 1),
        factorizations=best.shape.factorizations,
        seconds=journal.elapsed(),
        skipped=(),
        interrupted=stop == Stop.INTERRUPTED.value,
        trace=journal.trace(best.unrounded),
    )


def form(problem: Problem, forces: Floats, callback: Callback | None = None) -> Design:
    """Forward form-finding by Newton from the scene's flat start under given support forces (V, 3) newtons.

    The design's certificate says whether the shape found is in equilibrium and stands; `stop` says why where it is not.

    Raises
    ------
    InputError
        A force at a vertex that is no candidate.
    """
    stray = np.flatnonzero(forces.any(axis=1) & ~problem.scene.candidates)
    if stray.size:
        raise InputError(
            f"forces: a support force acts at vertex {stray[0]}, where the scene allows none: take it out, or make the vertex a "
            "candidate (supports.candidates, supports.never)"
        )
    with threadpool_limits(1, "blas"):
        problem = resolve_weight(problem)
        journal = Journal(problem, callback)
        nodal = forces[problem.membrane.free]
        found = find_equilibrium(problem.membrane, problem.scene.start, nodal + problem.loads)
        shape = Shape(found.positions, problem.supports.amplitudes(nodal), None, found.factorizations)
        outcome = _Outcome(problem, shape, shape, _last_refit(problem))
        certificate = outcome.certificate
        journal.stage = "form-finding"
        note = "Newton on the stiffness matrix"
        journal({"shape": shape, "objective": certificate.objective, "supports": certificate.supports, "note": note})
        stop = Stop.UNSTABLE if found.found and not certificate.stable else found.stop
        return replace(_design(problem, outcome, journal, stop.value), iterations=found.iterations)
