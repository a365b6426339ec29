"""What the parts of this benchmark share: solvers that hand in steps, relax's own methods as such, how a point is judged."""

import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from benchopt import BaseSolver

import relax
from relax.convex.backends import BACKENDS
from relax.design.methods import method_by_name
from relax.design.methods.sequential import Sequential
from relax.design.optimality import EQUILIBRIUM
from relax.design.starts import given
from relax.sparsity.supports import sizes

EXPERIMENTS = Path(__file__).resolve().parents[2]
if str(EXPERIMENTS) not in sys.path:
    sys.path.append(str(EXPERIMENTS))  # benchopt loads each file by its path: the scenes and peers of the experiments are there

from peers import MANY, pruned  # noqa: E402 - found by the line above
from price import planted  # noqa: E402 - the same

WARM = 8  # vertices a side of the membrane on which a solver warms up: imports and what is compiled once


@dataclass(frozen=True)
class Step:
    """Where a method is after `seconds`: positions and support forces (V, 3), None where there is no point, and its own word."""

    seconds: float
    positions: np.ndarray | None
    forces: np.ndarray | None
    said: str = ""


class Stepwise(BaseSolver):
    """A method whose run keeps its steps and the clock; nothing is judged before it has ended.

    A subclass gives `steps(problem)`. The steps are then handed to benchopt one by one, with its clock set to theirs, so that one
    run gives the whole curve and no judging is in it.
    """

    sampling_strategy = "callback"

    def steps(self, problem: relax.Problem) -> Iterable[Step]:
        """The steps of one run, from the problem to the answer."""
        raise NotImplementedError

    def set_objective(self, problem):
        self.problem = problem

    def warm_up(self):
        for _ in self.steps(planted(WARM, 1, 0.0)[0]):
            pass

    def get_next(self, stop_val):
        """Every step counts."""
        return stop_val + 1

    def run(self, cb):
        before = 0.0
        for step in list(self.steps(fresh(self.problem))):
            self.step = step
            cb.time_callback = time.perf_counter() - (step.seconds - before)
            before = step.seconds
            if not cb():
                return

    def get_result(self):
        return {"positions": self.step.positions, "forces": self.step.forces, "said": self.step.said}


def fresh(problem: relax.Problem) -> relax.Problem:
    """The problem on a mesh never seen, so that what is done once a mesh is in the time of every run."""
    return problem.replace(scene=replace(problem.scene))


def steps_of(problem: relax.Problem, method: str = "sequential", backend: str | None = None) -> list[Step]:
    """The steps of `relax.solve` by a method or, for the sequential one, by a back-end."""
    chosen = method_by_name(method) if backend is None else Sequential(BACKENDS[backend])
    begin = time.perf_counter()
    try:
        design = relax.solve(problem, method=chosen)
    except relax.RelaxError as error:
        return [Step(time.perf_counter() - begin, None, None, str(error))]
    trace, answer = design.trace, Step(design.seconds, design.positions, design.forces, design.stop)
    return [*map(Step, trace.seconds, trace.positions, trace.forces, trace.notes), answer, *rounded(problem, answer)]


def rounded(problem: relax.Problem, answer: Step) -> list[Step]:
    """The steps of the rounding that every answer gets alike, its time counted; none where the smoothing left no small force."""
    amplitudes = problem.supports.amplitudes(answer.forces[problem.membrane.free])
    small = made_by_smoothing(problem, amplitudes)
    if not amplitudes[small].any() or np.count_nonzero(amplitudes[~small].any(axis=1)) > MANY:
        return []
    found = []
    begin = time.perf_counter()

    def tell(record: Any) -> None:
        found.append((time.perf_counter() - begin, record["shape"]))

    with suppress(relax.EquilibriumError):  # then it ends where the method did
        pruned(problem, answer.positions, np.where(small[:, None], 0.0, amplitudes), tell)
    return [
        Step(answer.seconds + seconds, shape.positions, problem.all_forces(shape.amplitudes), answer.said)
        for seconds, shape in found
    ]


def made_by_smoothing(problem: relax.Problem, amplitudes: np.ndarray) -> np.ndarray:
    """Which groups (m,) carry no more than the penalty can tell from nothing."""
    return (sizes(amplitudes) <= problem.penalty.resolution) & ~problem.supports.always


def as_it_stands(problem: relax.Problem, positions: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions and forces (V, 3) without the forces that the smoothing made, at rest; None where there is no rest."""
    amplitudes = problem.supports.amplitudes(forces[problem.membrane.free])
    small = made_by_smoothing(problem, amplitudes)
    if not amplitudes[small].any() and relax.judge(problem, positions, forces).equilibrium <= EQUILIBRIUM:
        return positions, forces
    kept = problem.all_forces(np.where(small[:, None], 0.0, amplitudes))
    shape = given(problem, positions, kept)
    return None if shape is None else (shape.positions, problem.all_forces(shape.amplitudes))
