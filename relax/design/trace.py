"""The trace of a run: every step's shape with its figures, kept while the run goes on and judged when somebody asks."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Mask
from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.shape import Shape, figures
from relax.errors import StopRun
from relax.iterate import Record, Stop

Callback = Callable[[Record], None]


@dataclass(frozen=True)
class Trace:
    """The steps of a run, and the state before rounding.

    Parameters
    ----------
    problem : Problem
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


@dataclass
class Tally:
    """Counts of what a run did not need, for its ledger.

    Parameters
    ----------
    looked : (m,) bool
        Candidates whose columns of K^-1 were made.
    reused, compared : int
        Steps that took no new factorisation, and all that had one from before.
    kept : int
        Newton steps that went by columns and curvature of an earlier shape.
    broken : int
        Trials that were broken off.
    patterns : int
        Sparsity patterns that were factorised.
    """

    looked: Mask
    reused: int = 0
    compared: int = 0
    kept: int = 0
    broken: int = 0
    patterns: int = 1


class Journal:
    """Collects the steps of one run while it goes on; what the callback costs is taken off the clock."""

    def __init__(self, problem: Problem, callback: Callback | None) -> None:
        self.problem, self.callback = problem, callback
        self.begin = time.perf_counter()
        self.paused = 0.0
        self.shapes: list[Shape] = []
        self.objective: list[float] = []
        self.seconds: list[float] = []
        self.notes: list[str] = []
        self.stage = ""
        self.failure = ""
        self.skipped: list[str] = []
        self.tally = Tally(np.zeros(len(problem.supports.vertices), dtype=bool))
        self.first = 0  # the step at which the present start began
        self.lift: Callable[[Shape], Shape] | None = None  # the whole membrane of a run's shapes, while it sees less
        self.broken_off = Stop.INTERRUPTED  # why, where the run is broken off
        self._last: Shape | None = None

    def elapsed(self) -> float:
        """Seconds of the run so far."""
        return time.perf_counter() - self.begin - self.paused

    def _count(self, record: Record) -> None:
        """Into the tally; what a lifted run looks at is all of each orbit."""
        shape: Shape = record["shape"]
        looked = np.zeros_like(shape.amplitudes)
        looked[list(record.get("looked", ()))] = 1.0
        if self.lift is not None:
            looked = self.lift(replace(shape, amplitudes=looked)).amplitudes
        self.tally.looked |= looked.any(axis=1)
        self.tally.kept += record.get("kept", False)
        self.tally.broken += record.get("broken", 0)

    def __call__(self, record: Record) -> None:
        """Keep a record; one that shows the same shape as the last is not a step."""
        shape: Shape = record["shape"]
        last, self._last = self._last, replace(shape, factor=None, dual=None)
        self._count(record)
        if last is not None and shape.positions is last.positions and shape.amplitudes is last.amplitudes:
            return
        if len(self.shapes) > self.first:
            self.tally.compared += 1
            self.tally.reused += shape.factorizations == self.shapes[-1].factorizations
        if self.lift is not None:
            shape = self.lift(shape)
            record = figures(self.problem, shape, record["note"], ())
        self.shapes.append(replace(shape, factor=None, dual=None))
        self.objective.append(record["objective"])
        self.seconds.append(self.elapsed())
        self.notes.append(f"{self.stage}: {record['note']}" if record["note"] else self.stage)
        if self.callback is not None:
            before = time.perf_counter()
            stationarity = judge(self.problem, shape.positions, self.problem.all_forces(shape.amplitudes)).stationarity
            kept = {"objective": record["objective"], "supports": record["supports"], "stationarity": stationarity}
            try:
                self.callback({"step": len(self.shapes) - 1, "seconds": self.seconds[-1], "note": self.notes[-1], **kept})
            except StopRun:
                self.broken_off = Stop.STOPPED
                raise
            finally:
                self.paused += time.perf_counter() - before

    def remark(self, words: str) -> None:
        """Add words to the last note."""
        self.notes[-1] += words

    def trace(self, unrounded: Shape) -> Trace:
        """What was collected, and the shape before rounding."""
        shape = (-1, *unrounded.positions.shape)
        return Trace(
            self.problem,
            np.array([step.positions for step in self.shapes]).reshape(shape),
            np.array([self.problem.all_forces(step.amplitudes) for step in self.shapes]).reshape(shape),
            np.array(self.objective),
            np.array(self.seconds),
            tuple(self.notes),
            unrounded.positions,
            self.problem.all_forces(unrounded.amplitudes),
        )
