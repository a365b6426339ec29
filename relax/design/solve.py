"""The front door: from a problem to a design, its supports rounded and its figures judged."""

import copy
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from threadpoolctl import threadpool_limits

from relax.arrays import Floats
from relax.convex.backends import BACKENDS, Backend
from relax.design.ledger import sentences
from relax.design.masts import Mast, standing_masts
from relax.design.methods import Method, method_by_name
from relax.design.methods.sequential import Sequential
from relax.design.optimality import EQUILIBRIUM, OFF_SUPPORT, Certificate
from relax.design.parts import Part, PartJournal, assembled, counted, split
from relax.design.problem import Problem
from relax.design.race import Found, Outcome, best_of, last_refit
from relax.design.starts import Start, choose_starts, resolve_weight
from relax.design.trace import Callback, Journal, Trace
from relax.errors import EquilibriumError, InputError
from relax.iterate import Stop


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


def solve(
    problem: Problem,
    start: tuple[Floats, Floats] | None = None,
    backend: Backend | None = None,
    method: Method | None = None,
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
    method : function Problem, Start, Journal -> shapes after and before rounding, optional
        Leads from a start to supports; default: the one that the scene's `solver.method` names.
    callback : function, optional
        Called once a step with step, objective, stationarity, supports, seconds and a note; its time is not counted. Where it
        raises `StopRun`, the run ends as after Ctrl-C: the best so far is returned, `interrupted`, and `stop` says who ended it.

    Raises
    ------
    EquilibriumError
        No start finds a membrane at rest; the message says why.
    """
    # matrices here are small or sparse: more BLAS threads than one were measured to cost a factor of six
    with threadpool_limits(1, "blas"):
        problem = resolve_weight(problem)
        said = problem.scene.settings["solver"]
        named = said["backend"]
        journal = Journal(problem, callback)
        if backend is None and named != "cvxpy":
            journal.skipped.append("the import of cvxpy: no convex step is handed to it")
        if backend is None and named != "auto":
            backend = BACKENDS[named]
        method = method or method_by_name(said["method"])
        if backend is not None:
            method = _with_backend(method, backend, said["method"])
        return _solve(problem, start, method, journal)


def _with_backend(method: Method, backend: Backend, name: str) -> Method:
    if isinstance(method, Sequential):
        return replace(method, backend=backend)
    raise InputError(f"solver.backend: the method {name} solves no convex steps by themselves: leave the back-end out")


def _solve(problem: Problem, start: tuple[Floats, Floats] | None, method: Method, journal: Journal) -> Design:
    parts = split(problem)
    if parts:
        found = _solve_apart(problem, parts, start, method, journal)
    else:
        found = best_of(problem, None if start is None else choose_starts(problem, start, journal.skipped), method, journal)
    stop = journal.broken_off.value if found.interrupted else _why(found.best)
    design = as_design(problem, found.best, journal, stop)
    said = sentences(problem, journal, found.factorizations)
    return replace(design, factorizations=found.factorizations, skipped=said)


def _solve_apart(
    problem: Problem, parts: Sequence[Part], start: tuple[Floats, Floats] | None, method: Method, journal: Journal
) -> Found:
    """Each part by itself, the others at rest where they start or ended; after an interrupt the rest stay at their start."""
    said: list[list[str]] = [[] for _ in parts]
    starts = [_starts_of(part, start, words) for part, words in zip(parts, said, strict=True)]
    shapes = [first.shape for first, *_ in starts]
    unrounded, journals, troubles = list(shapes), [], []
    spent, interrupted = 0, False
    for index, part in enumerate(parts):
        journals.append(PartJournal(journal, parts, shapes, index))
        try:
            found = best_of(part.problem, starts[index], method, journals[-1])
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
    return Found(Outcome(problem, shape, rough, last_refit(problem), "; ".join(troubles)), spent, interrupted)


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


def _why(outcome: Outcome) -> str:
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


def as_design(problem: Problem, best: Outcome, journal: Journal, stop: str) -> Design:
    """The outcome of a run with the journal that it kept."""
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
        interrupted=stop in (Stop.INTERRUPTED.value, Stop.STOPPED.value),
        trace=journal.trace(best.unrounded),
    )
