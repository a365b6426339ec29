"""The front door: from a problem to a design, its supports rounded and its figures judged."""

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relax.arrays import Floats
from relax.convex.backends import BACKENDS
from relax.design.masts import Mast, standing_masts
from relax.design.optimality import Certificate, judge
from relax.design.problem import Problem
from relax.design.refit import Shape, refit
from relax.design.rounding import round_supports
from relax.design.sequential import SequentialConvex, State, Weights
from relax.design.starts import Start, at_target, given, heavy_starts, is_planted, resolve_weight
from relax.errors import EquilibriumError, InputError
from relax.iterate import Record, Stop, iterate
from relax.membrane.equilibrium import find_equilibrium

STEPS = 60  # convex steps a sequence; those seen to converge took 3 to 25
HEAVY_STEPS = 2  # under the first, heavy weights: enough to know where the few masts stand
ROUNDS = 20  # of convex steps and rounding, while the certificate names candidates that are missing

Callback = Callable[[Record], None]


@dataclass(frozen=True)
class Trace:
    """The steps of a run, and the state before rounding.

    Parameters
    ----------
    positions, forces : (T, V, 3)
    objective, seconds : (T,)
    notes : T sentences
    unrounded_positions, unrounded_forces : (V, 3)
    """

    problem: Problem = field(repr=False)
    positions: Floats
    forces: Floats
    objective: Floats
    seconds: Floats
    notes: tuple[str, ...]
    unrounded_positions: Floats
    unrounded_forces: Floats

    @cached_property
    def stationarity(self) -> Floats:
        """Of each step (T,), by the judge; nan where the stiffness was singular. Not part of the run's time."""
        judged = [judge(self.problem, x, p).stationarity for x, p in zip(self.positions, self.forces, strict=True)]
        return np.array([np.nan if value is None else value for value in judged])


@dataclass(frozen=True)
class Design:
    """What a run found: the membrane at rest, the supports that hold it, and what the judge says of it."""

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
        return f"{self.stop} in {self.iterations} steps: {masts}, rms distance {said.rms_distance:.3g} m, objective {said.objective:.6g}"


class _Journal:
    """Collects the steps of a run, and the best rounded shape so far."""

    def __init__(self, problem: Problem, callback: Callback | None) -> None:
        self.problem, self.callback = problem, callback
        self.begin = time.perf_counter()
        self.paused = 0.0
        self.shapes: list[Shape] = []
        self.objective: list[float] = []
        self.seconds: list[float] = []
        self.notes: list[str] = []
        self.stage = ""

    def __call__(self, record: Record) -> None:
        """Keep a record; one that shows the same shape as the last is not a step."""
        shape: Shape = record["shape"]
        if self.shapes and shape.positions is self.shapes[-1].positions and shape.amplitudes is self.shapes[-1].amplitudes:
            return
        now = time.perf_counter()
        self.shapes.append(replace(shape, factor=None))
        self.objective.append(record["objective"])
        self.seconds.append(now - self.begin - self.paused)
        self.notes.append(f"{self.stage}: {record['note']}" if record["note"] else self.stage)
        if self.callback is not None:
            stationarity = judge(self.problem, shape.positions, full_forces(self.problem, shape)).stationarity
            kept = {"objective": record["objective"], "supports": record["supports"], "stationarity": stationarity}
            self.callback({"step": len(self.shapes) - 1, "seconds": self.seconds[-1], "note": self.notes[-1], **kept})
            self.paused += time.perf_counter() - now


def full_forces(problem: Problem, shape: Shape) -> Floats:
    """Support forces of all vertices (V, 3)."""
    forces = np.zeros_like(problem.scene.target)
    forces[problem.membrane.free] = problem.supports.forces(shape.amplitudes)
    return forces


@dataclass(frozen=True)
class _Outcome:
    start: str
    shape: Shape
    unrounded: Shape
    certificate: Certificate


def solve(problem: Problem, start: tuple[Floats, Floats] | None = None, callback: Callback | None = None) -> Design:
    """The membrane closest to the wanted shape under few supports, with the scene's own [solver] and [rounding].

    Parameters
    ----------
    problem : Problem
    start : positions and forces (V, 3) of another result, optional
        Needed where the scene's `solver.start` names a result folder.
    callback : function, optional
        Called once a step with step, objective, stationarity, supports, seconds and a note; its time is not counted.

    Raises
    ------
    EquilibriumError
        No start finds a membrane at rest; the message says why.
    """
    # matrices here are small or sparse: more BLAS threads than one were measured to cost a factor of six
    with threadpool_limits(1, "blas"):
        return _solve(resolve_weight(problem), start, callback)


def _solve(problem: Problem, start: tuple[Floats, Floats] | None, callback: Callback | None) -> Design:
    journal = _Journal(problem, callback)
    outcomes: list[_Outcome] = []
    skipped: list[str] = []
    interrupted = False
    try:
        for begin in _starts(problem, start, skipped):
            outcomes.append(_run(problem, begin, journal))
        best = min(outcomes, key=lambda outcome: (not outcome.certificate.converged, outcome.certificate.objective))
        best = _debiased(problem, best, journal)
    except KeyboardInterrupt:
        interrupted = True
        best = _best_so_far(problem, outcomes, journal)
    return _design(problem, best, journal, tuple(skipped), interrupted=interrupted)


def _starts(problem: Problem, start: tuple[Floats, Floats] | None, skipped: list[str]) -> list[Start]:
    """The starts that the scene asks for; what a run need not look at goes to `skipped`."""
    choice = problem.scene.settings["solver"]["start"]
    if start is not None:
        shape = given(problem, *start)
        if shape is None:
            raise EquilibriumError("solver.start: under the forces of that result this membrane finds no rest; start elsewhere")
        return [Start("given", shape)]
    if choice not in ("auto", "target", "heavy"):
        raise InputError(f"solver.start is {choice!r}: hand the positions and forces of that result to solve(start=...)")
    heavy: list[Start] = []
    if choice in ("auto", "target"):
        shape = at_target(problem)
        if choice == "target":
            if shape is None:
                raise EquilibriumError('solver.start = "target": the membrane finds no rest near the target; use "heavy" or "auto"')
            return [Start("target", shape)]
        if shape is not None and is_planted(problem, shape):
            skipped.append("heavy starts: few supports hold the target as it is")
            return [Start("target", shape)]
    try:
        heavy = heavy_starts(problem)
    except EquilibriumError:
        if choice == "heavy" or shape is None:
            raise
        skipped.append("heavy starts: the membrane without supports finds no rest")
        return [Start("target", shape)]
    skipped.append("start at the target: its own springs ask for a support almost everywhere")
    return heavy


def _run(problem: Problem, start: Start, journal: _Journal) -> _Outcome:
    """Convex steps and rounding from one start, until the certificate names no missing candidate."""
    shape = start.shape
    if start.weight is not None:
        constant = start.weight * problem.supports.weights
        shape = _sequence(problem, shape, lambda _: constant, HEAVY_STEPS, journal, f"start {start.name}, first weights")
    unrounded = None
    keep = np.zeros(len(shape.amplitudes), dtype=bool)
    for _ in range(ROUNDS):
        shape = _sequence(problem, shape, problem.group_weights, STEPS, journal, f"start {start.name}")
        unrounded = unrounded or shape
        journal.stage = f"start {start.name}, rounding"
        result = round_supports(problem, shape, keep, journal)
        shape = result.shape
        if not result.missing.any():
            break
        # what was dropped for its size and is missed at once stays: else the two would take turns for ever
        keep = keep | (result.dropped & result.missing)
    certificate = judge(problem, shape.positions, full_forces(problem, shape))
    return _Outcome(start.name, shape, unrounded or shape, certificate)


def _sequence(problem: Problem, shape: Shape, weights: Weights, limit: int, journal: _Journal, stage: str) -> Shape:
    journal.stage = stage
    backend = BACKENDS[problem.scene.settings["solver"]["backend"]]
    return iterate(SequentialConvex(problem, weights, backend), State(shape), limit, journal).state.shape


def _debiased(problem: Problem, best: _Outcome, journal: _Journal) -> _Outcome:
    """The last solve with R dropped on the support, where the scene asks for it."""
    if problem.scene.settings["rounding"]["refit"] != "debiased":
        return best
    journal.stage = "debiasing"
    shape = refit(problem, best.shape, "debiased", journal)
    return replace(best, shape=shape, certificate=judge(problem, shape.positions, full_forces(problem, shape), "debiased"))


def _best_so_far(problem: Problem, outcomes: list[_Outcome], journal: _Journal) -> _Outcome:
    """What an interrupted run can show: the best finished start, else the last step."""
    if outcomes:
        return min(outcomes, key=lambda outcome: outcome.certificate.objective)
    if not journal.shapes:
        raise KeyboardInterrupt
    shape = journal.shapes[int(np.argmin(journal.objective))]
    certificate = judge(problem, shape.positions, full_forces(problem, shape))
    return _Outcome("interrupted", shape, shape, certificate)


def _design(problem: Problem, best: _Outcome, journal: _Journal, skipped: tuple[str, ...], *, interrupted: bool) -> Design:
    seconds = time.perf_counter() - journal.begin - journal.paused
    settings = copy.deepcopy({key: value for key, value in problem.scene.settings.items()})
    settings["penalty"]["weight"] = problem.weight
    stop = Stop.INTERRUPTED if interrupted else Stop.CONVERGED if best.certificate.converged else Stop.STALLED
    trace = Trace(
        problem,
        np.array([shape.positions for shape in journal.shapes]).reshape(-1, *best.shape.positions.shape),
        np.array([full_forces(problem, shape) for shape in journal.shapes]).reshape(-1, *best.shape.positions.shape),
        np.array(journal.objective),
        np.array(journal.seconds),
        tuple(journal.notes),
        best.unrounded.positions,
        full_forces(problem, best.unrounded),
    )
    return Design(
        problem=problem,
        settings=settings,
        positions=best.shape.positions,
        forces=full_forces(problem, best.shape),
        certificate=best.certificate,
        stop=stop.value,
        iterations=max(0, len(journal.shapes) - 1),
        factorizations=best.shape.factorizations,
        seconds=seconds,
        skipped=skipped,
        interrupted=interrupted,
        trace=trace,
    )


def form(problem: Problem, forces: Floats, callback: Callback | None = None) -> Design:
    """Forward form-finding by Newton from the scene's flat start under given support forces (V, 3) newtons.

    The design's certificate says whether the shape found is in equilibrium and stands; `stop` says why where it is not.
    """
    problem = resolve_weight(problem)
    journal = _Journal(problem, callback)
    nodal = forces[problem.membrane.free]
    found = find_equilibrium(problem.membrane, problem.scene.start, nodal + problem.loads)
    shape = Shape(found.positions, problem.supports.amplitudes(nodal), None, found.factorizations)
    certificate = judge(problem, shape.positions, full_forces(problem, shape))
    objective = certificate.objective
    journal({"shape": shape, "objective": objective, "supports": certificate.supports, "note": "Newton on the stiffness matrix"})
    design = _design(problem, _Outcome("flat", shape, shape, certificate), journal, (), interrupted=False)
    return replace(design, stop=found.stop.value, iterations=found.iterations)
