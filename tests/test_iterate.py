from dataclasses import dataclass

import numpy as np
import pytest

from relax.iterate import Stop, iterate


@dataclass(frozen=True)
class Count:
    """Counts down; may fail or record something odd on the way."""

    goal: int = 0
    odd: object = 0.0
    fails_at: int = -1

    def step(self, state):
        if state == self.fails_at:
            raise KeyboardInterrupt
        return state - 1

    def done(self, state):
        return Stop.CONVERGED if state <= self.goal else None

    def record(self, state):
        return {"left": state, "figure": self.odd if state == 2 else 0.5}


def test_it_steps_until_done():
    run = iterate(Count(), 3, 10)
    assert (run.state, run.stop, run.steps) == (0, Stop.CONVERGED, 3)
    assert [record["left"] for record in run.trace] == [3, 2, 1, 0]
    assert [record["step"] for record in run.trace] == [0, 1, 2, 3]
    seconds = [record["seconds"] for record in run.trace] + [run.seconds]
    assert seconds == sorted(seconds) and seconds[0] >= 0


@pytest.mark.parametrize(("limit", "stop"), [(0, Stop.LIMIT), (2, Stop.LIMIT), (3, Stop.CONVERGED), (4, Stop.CONVERGED)])
def test_limit_is_the_number_of_steps(limit, stop):
    run = iterate(Count(), 3, limit)
    assert (run.steps, run.stop) == (min(limit, 3), stop)
    assert run.state == 3 - run.steps
    assert len(run.trace) == run.steps + 1


def test_done_at_once_takes_no_step():
    run = iterate(Count(goal=5), 5, 0)
    assert (run.steps, run.stop, run.state) == (0, Stop.CONVERGED, 5)


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, np.float64(np.nan)])
def test_a_figure_that_is_not_finite_ends_it(odd):
    run = iterate(Count(odd=odd), 4, 10)
    assert (run.state, run.stop, run.steps) == (2, Stop.NON_FINITE, 2)


def test_words_and_arrays_may_be_recorded():
    assert iterate(Count(odd="auto"), 3, 10).stop is Stop.CONVERGED
    assert iterate(Count(odd=np.array([1.0, np.inf])), 3, 10).stop is Stop.CONVERGED


def test_the_callback_sees_each_record_as_it_is_made():
    seen = []
    run = iterate(Count(), 3, 10, callback=seen.append)
    assert seen == list(run.trace)


def test_an_interrupt_is_the_callers():
    with pytest.raises(KeyboardInterrupt):
        iterate(Count(fails_at=1), 3, 10)


def test_every_stop_is_a_sentence_of_its_own():
    sentences = [stop.value for stop in Stop]
    assert len(set(sentences)) == len(sentences) == len(Stop.__members__)
    assert all(sentence[0].islower() and not sentence.endswith(".") for sentence in sentences)
