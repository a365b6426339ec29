"""The front door: from a problem to a design, its supports rounded and its figures judged."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relax.arrays import Floats
from relax.convex.backends import BACKENDS, Backend
from relax.design.masts import Mast, standing_masts
from relax.design.optimality import EQUILIBRIUM, OFF_SUPPORT, Certificate, judge
from relax.design.problem import Problem
from relax.design.refit import Shape, refit
from relax.design.rounding import round_supports, seated
from relax.design.search import Search
from relax.design.sequential import SequentialConvex
from relax.design.starts import Start, at_target, choose_starts, heavy_starts, resolve_weight, tells_sizes
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
    """How one start ended; `trouble` says why where the membrane would no longer stand."""

    shape: Shape
    unrounded: Shape
    certificate: Certificate
    trouble: str = ""


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
        if backend is None and named != "auto":
            backend = BACKENDS[named]
        return _solve(problem, start, _Tools(Journal(problem, callback), backend))


def _solve(problem: Problem, start: tuple[Floats, Floats] | None, tools: _Tools) -> Design:
    journal = tools.journal
    outcomes: list[_Outcome] = []
    skipped: list[str] = []
    spent = 0
    try:
        starts = choose_starts(problem, start, skipped)
        for begin in starts:
            if _agree(outcomes):
                skipped.append(f"start {begin.name}: two starts ended at the same supports")
                break
            outcomes.append(_run(problem, begin, tools))
            if begin.name == "pulled" and not outcomes[-1].certificate.converged:
                starts += _others(problem, nothing=outcomes[-1].shape is begin.shape)
        best = min(outcomes, key=_rank)
        if problem.scene.settings["rounding"]["refit"] == "debiased":
            journal.stage = "debiasing"
            shape = refit(problem, best.shape, "debiased", journal)
            spent += shape.factorizations - best.shape.factorizations
            best = replace(best, shape=shape, certificate=_judged(problem, shape))
        stop = _why(best)
    except KeyboardInterrupt:
        best = _best_so_far(problem, outcomes, journal)
        stop = Stop.INTERRUPTED.value
    spent += sum(each.shape.factorizations for each in outcomes) or best.shape.factorizations
    return replace(_design(problem, best, journal, stop), skipped=tuple(skipped), factorizations=spent)


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
    first = len(journal.shapes)
    try:
        shape, unrounded = _steps_and_rounding(problem, start, tools)
    except EquilibriumError as error:
        trouble = str(error)
        shape = unrounded = journal.shapes[-1] if len(journal.shapes) > first else start.shape
    certificate = judge(problem, shape.positions, problem.all_forces(shape.amplitudes))
    return _Outcome(shape, unrounded, certificate, trouble or journal.failure)


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
        journal.notes[-1] += f"; then {state.failure}"
    journal.failure = state.failure
    return state.shape


def _agree(outcomes: list[_Outcome]) -> bool:
    """Whether two starts both converged, to the same supports and the same objective."""
    if len(outcomes) < 2 or not all(outcome.certificate.converged for outcome in outcomes):
        return False
    one, other = (outcome.certificate.objective for outcome in outcomes[-2:])
    stands, also = (outcome.shape.amplitudes != 0 for outcome in outcomes[-2:])
    return bool(abs(one - other) <= SAME * abs(one) and np.array_equal(stands, also))


def _judged(problem: Problem, shape: Shape) -> Certificate:
    """The judge's word on a shape as the scene's last solve leaves it."""
    refitted = problem.scene.settings["rounding"]["refit"]
    return judge(problem, shape.positions, problem.all_forces(shape.amplitudes), refitted)


def _best_so_far(problem: Problem, outcomes: list[_Outcome], journal: Journal) -> _Outcome:
    """What an interrupted run can show: the best finished start, or a step of another that is clearly lower (all are at rest)."""
    if not journal.shapes:
        raise KeyboardInterrupt
    shape = journal.shapes[int(np.argmin(journal.objective))]
    if outcomes:
        done = min(outcomes, key=_rank)
        if _objective(problem, shape) >= (1 - CLEARLY) * done.certificate.objective:
            shape = done.shape
    return _Outcome(shape, shape, _judged(problem, shape))


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
        certificate = _judged(problem, shape)
        journal.stage = "form-finding"
        note = "Newton on the stiffness matrix"
        journal({"shape": shape, "objective": certificate.objective, "supports": certificate.supports, "note": note})
        stop = Stop.UNSTABLE if found.found and not certificate.stable else found.stop
        return replace(_design(problem, _Outcome(shape, shape, certificate), journal, stop.value), iterations=found.iterations)
