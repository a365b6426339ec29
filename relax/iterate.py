"""The one loop of this package: clock, trace, callback, non-finite check and stop reason for every iterative method."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

Record = Mapping[str, Any]
State = TypeVar("State")


class Stop(Enum):
    """Why a loop ended; the value is the sentence that a person reads."""

    CONVERGED = "converged"
    STALLED = "no step lowers the objective any more, though the tolerance is not reached"
    LIMIT = "the largest number of steps was taken before the tolerance was reached"
    NON_FINITE = "a figure is no longer finite: the scene is too badly scaled or holds a singular part"
    INTERRUPTED = "interrupted: this is the best result so far"
    STOPPED = "stopped by the callback: this is the best result so far"
    SLACK = (
        "no equilibrium was found: a region of the membrane is slack, nothing holds it; raise the prestress (lower rest_scale)"
    )
    MECHANISM = "no equilibrium was found: a part can move without stretching (a mechanism); add prestress or fix vertices"
    COLLAPSED = "no equilibrium was found: edges shrink to a point under the prescribed tensions, no net carries them all"
    LOST_SUPPORT = "no equilibrium was found: the membrane moves away without bound; a part of it lost its support"
    HOPELESS = "broken off: where this leads is not wanted"
    UNSTABLE = "equilibrium was found, but it does not stand: the membrane would leave it at the slightest push"


class Algorithm(Protocol[State]):
    """Pure functions of a frozen state."""

    def step(self, state: State) -> State:
        """The next state."""
        ...

    def done(self, state: State) -> Stop | None:
        """Why to stop here, or None."""
        ...

    def record(self, state: State) -> Record:
        """What the trace keeps of a state."""
        ...


@dataclass(frozen=True)
class Run(Generic[State]):
    """How a loop ended: its last state, why, after how many steps and seconds, and a record of each state."""

    state: State
    stop: Stop
    steps: int
    seconds: float
    trace: tuple[Record, ...]


def iterate(
    algorithm: Algorithm[State], state: State, limit: int, callback: Callable[[Record], None] | None = None
) -> Run[State]:
    """Step until `algorithm.done` gives a reason, `limit` steps were taken or a recorded figure is not finite.

    `callback` receives each record with `step` and `seconds`; an exception in it, or Ctrl-C, is the caller's to catch.
    """
    begin = time.perf_counter()
    trace: list[Record] = []
    stop: Stop | None = None
    steps = 0
    while stop is None:
        record = {"step": steps, "seconds": time.perf_counter() - begin, **algorithm.record(state)}
        trace.append(record)
        if callback is not None:
            callback(record)
        if any(isinstance(value, float) and not np.isfinite(value) for value in record.values()):
            stop = Stop.NON_FINITE
            continue
        stop = algorithm.done(state) or (Stop.LIMIT if steps >= limit else None)
        if stop is None:
            state = algorithm.step(state)
            steps += 1
    return Run(state, stop, steps, time.perf_counter() - begin, tuple(trace))
