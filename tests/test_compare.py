from dataclasses import dataclass

import numpy as np
import pytest
import zoo

import relax
import relax.design.compare as comparison
from relax.design.methods import METHODS
from relax.design.methods.sequential import Sequential
from relax.errors import BackendError, InputError


@pytest.fixture(scope="module")
def noisy():
    return relax.Problem(zoo.planted(9, zoo.TWO_MASTS, 0.005).scene, weight=0.02)


@pytest.fixture(scope="module")
def rows(noisy):
    return relax.ranked(relax.compare(noisy))


def test_a_row_for_each_penalty_method_and_back_end(rows):
    named = [(row.penalty, row.method, row.backend) for row in rows]
    assert named[0] == ("power", "sequential", "auto") and len(set(named)) == len(named)
    assert {row.penalty for row in rows} >= {"power", "group-lasso"}
    assert {row.backend for row in rows} >= {"auto", "working-set", "clarabel", "cvxpy"}
    assert {row.method for row in rows} == {"sequential", *METHODS}


def test_every_answer_is_judged_in_one_objective(noisy, rows):
    done = [row for row in rows if row.objective is not None]
    assert len(done) >= 5
    for row in done:
        # the paper's objective is its two terms, whatever the row was found with
        assert row.objective >= row.distance > 0
        assert row.stationarity < 1e-8
    best = min(row.objective for row in done if row.converged)
    assert all(row.over_best == pytest.approx(row.objective / best - 1, abs=1e-15) for row in done)
    assert min(row.over_best for row in done if row.converged) == 0
    # the same two masts stand in each, so after the refit under the same R they are one answer
    assert all(row.objective == pytest.approx(best, rel=1e-9) for row in done if row.supports == 2)
    assert sum(row.supports == 2 for row in done) >= 5
    design = relax.solve(noisy)
    assert rows[0].objective == pytest.approx(design.certificate.objective)
    assert rows[0].total_force == pytest.approx(np.linalg.norm(design.forces, axis=1).sum())
    assert rows[0].own_objective == pytest.approx(rows[0].objective)


def test_own_objective_is_under_the_own_penalty(noisy, rows):
    row = next(row for row in rows if row.penalty == "group-lasso")
    assert row.own_objective != pytest.approx(row.objective)
    own = relax.solve(noisy.replace(penalty=relax.GroupLasso(), weight=row.weight))
    assert row.own_objective == pytest.approx(own.certificate.objective, rel=1e-6)


def test_a_typical_force_costs_the_same_under_each_penalty(noisy):
    typical = np.array([0.2])
    for name, other in comparison.penalties_for(noisy, 0.2).items():
        assert name == other.penalty.name != "power"
        assert other.weight * other.penalty.value(typical)[0] == pytest.approx(noisy.weight * noisy.penalty.value(typical)[0])


def test_penalties_of_a_registry_take_parameters_of_the_force_s_size(noisy, monkeypatch):
    @dataclass(frozen=True)
    class MCP:
        knee: float
        name: str = "mcp"

        def value(self, size):
            inside = np.minimum(size, self.knee)
            return inside - inside**2 / (2 * self.knee)

    monkeypatch.setattr(comparison, "PENALTIES", {"power": relax.Power, "mcp": MCP})
    (other,) = comparison.penalties_for(noisy, 0.2).values()
    assert other.penalty.knee == 0.2
    assert other.weight * 0.1 == pytest.approx(noisy.weight * noisy.penalty.value(np.array([0.2]))[0])


def test_the_paper_s_penalty_takes_the_place_of_another(noisy):
    lasso = noisy.replace(penalty=relax.GroupLasso())
    first = next(relax.compare(lasso))
    assert first.penalty == "power" and first.weight == noisy.weight
    own = noisy.replace(penalty=relax.Power(0.7, 1e-5))
    assert comparison.paper_problem(own).penalty == own.penalty


def test_it_is_lazy_and_starts_where_it_is_told(noisy, monkeypatch):
    seen = []
    real = comparison.solve

    def solve(problem, start, *rest):
        seen.append(start)
        return real(problem, start, *rest)

    monkeypatch.setattr(comparison, "solve", solve)
    design = relax.solve(noisy)
    begin = design.positions, design.forces
    runs = relax.compare(noisy, begin)
    next(runs)
    assert len(seen) == 1
    next(runs)
    assert len(seen) == 2 and all(start is begin for start in seen)


def test_a_run_that_cannot_be_made_is_a_row_with_the_reason(noisy, monkeypatch):
    def refuses(step, start):
        raise BackendError("this back-end takes no cones")

    def refused(problem, start, journal):
        raise InputError("more than 3 candidates: this method takes no more")

    monkeypatch.setattr(comparison, "BACKENDS", {"none": refuses})
    monkeypatch.setattr(comparison, "METHODS", ("sequential", "exact"))
    monkeypatch.setattr(comparison, "method_by_name", lambda name: Sequential() if name == "sequential" else refused)
    rows = {(row.method, row.backend): row for row in relax.ranked(relax.compare(noisy))}
    exact = rows["exact", "auto"]
    assert exact.stop == "more than 3 candidates: this method takes no more" and exact.objective is None
    none = rows["sequential", "none"]
    assert "this back-end takes no cones" in none.stop and none.objective is None and none.over_best is None
    assert set(none.flat()) == set(exact.flat())


def test_an_interrupted_run_is_the_last(noisy):
    calls = []

    def callback(record):
        calls.append(record)
        if len(calls) == 9:
            raise KeyboardInterrupt

    rows = list(relax.compare(noisy, callback=callback))
    assert rows[-1].interrupted and "interrupted" in rows[-1].stop
    assert not any(row.interrupted for row in rows[:-1])
