import naive
import numpy as np
import pytest
import zoo

import relax.convex.backends as module
from relax.convex.backends import BACKENDS
from relax.convex.reference import solve_with_cvxpy
from relax.convex.subproblem import certify
from relax.convex.working_set import solve_on_working_set
from relax.errors import BackendError

STEPS = zoo.convex_steps()
every_backend = pytest.mark.parametrize("backend", BACKENDS)
every_step = pytest.mark.parametrize("name", STEPS)


@pytest.fixture(scope="module")
def best():
    """Optimal values of the steps, by naive proximal gradient."""
    values = {}
    for name, step in STEPS.items():
        quadratic, linear, constant = naive.reduced(step)
        s = naive.group_lasso(quadratic, linear, step.weights)
        values[name] = constant + naive.group_value(quadratic, linear, step.weights, s)
    return values


def nothing(step):
    return np.zeros(step.rows.shape)


@every_backend
@every_step
def test_every_backend_solves_every_step(backend, name, best):
    step = STEPS[name]
    solution = BACKENDS[backend](step, nothing(step))
    assert solution.value == pytest.approx(best[name], rel=1e-8)
    assert -1e-12 <= solution.gap <= 1e-8
    # optimality from the data, not from the solution's own word
    quadratic, linear, _ = naive.reduced(step)
    assert naive.violation(quadratic, linear, step.weights, solution.amplitudes) <= 1e-6
    again = certify(step, solution.amplitudes)
    assert (again.value, again.bound) == (pytest.approx(solution.value, rel=1e-12), pytest.approx(solution.bound, rel=1e-12))


@every_step
def test_backends_agree_on_who_stands(name):
    step = STEPS[name]
    standing = [solve(step, nothing(step)).standing for solve in BACKENDS.values()]
    assert all(np.array_equal(standing[0], other) for other in standing)


def test_the_zoo_has_steps_of_every_size():
    counts = {name: int(BACKENDS["working-set"](step, nothing(step)).standing.sum()) for name, step in STEPS.items()}
    assert counts["nothing stands"] == 0
    assert 1 <= counts["heavy"] < counts["medium"] < counts["light"]
    assert counts["millimetres"] == counts["medium"]


@every_backend
def test_a_planted_fault_shows_in_the_gap(backend):
    step = STEPS["medium"]
    solution = BACKENDS[backend](step, nothing(step))
    faults = [1.01 * solution.amplitudes, solution.amplitudes + 1e-3, np.roll(solution.amplitudes, 1, axis=0)]
    weakest = np.argmin(np.where(solution.standing, np.linalg.norm(solution.amplitudes, axis=1), np.inf))
    dropped = solution.amplitudes.copy()
    dropped[weakest] = 0
    for fault in (*faults, dropped):
        assert certify(step, fault).gap > 1e-6 > 1e3 * solution.gap


@pytest.mark.parametrize(("backend", "solver"), [("clarabel", "solve_with_clarabel"), ("cvxpy", "solve_with_cvxpy")])
def test_a_solver_that_is_wrong_is_refused(backend, solver, monkeypatch):
    step = STEPS["medium"]
    right = getattr(module, solver)(step)
    monkeypatch.setattr(module, solver, lambda step: 2 * right)
    with pytest.raises(BackendError, match=rf"{backend} left a duality gap of .* which is no solution"):
        BACKENDS[backend](step, nothing(step))
    monkeypatch.setattr(module, solver, lambda step: np.nan * right)
    with pytest.raises(BackendError, match="which is no solution"):
        BACKENDS[backend](step, nothing(step))


@every_backend
def test_the_start_does_not_change_the_answer(backend):
    step = STEPS["medium"]
    cold = BACKENDS[backend](step, nothing(step))
    for start in (cold.amplitudes, np.random.default_rng(0).normal(size=(16, 3)), 1e3 * STEPS["medium"].load.reshape(-1, 3)):
        warm = BACKENDS[backend](step, start)
        assert warm.gap <= 1e-8
        assert np.allclose(warm.amplitudes, cold.amplitudes, atol=1e-5 * np.abs(cold.amplitudes).max())


@every_backend
def test_units_do_not_change_the_answer(backend):
    metres, millimetres = (BACKENDS[backend](STEPS[name], np.zeros((16, 3))) for name in ("medium", "millimetres"))
    assert np.allclose(1e3 * millimetres.amplitudes, metres.amplitudes, atol=1e-5 * np.abs(metres.amplitudes).max())
    assert millimetres.value == pytest.approx(1e6 * metres.value)


@pytest.mark.parametrize("many", [1, 2, 5])
def test_where_too_many_matter_the_cone_program_takes_over(many, monkeypatch):
    step = STEPS["light"]
    wanted = BACKENDS["working-set"](step, nothing(step))
    assert wanted.standing.sum() > many and wanted.ran == "working set"
    monkeypatch.setattr(module, "MANY", many)
    solution = BACKENDS["working-set"](step, nothing(step))
    assert solution.ran == "clarabel"
    assert solution.value == pytest.approx(wanted.value, rel=1e-7)


def test_the_working_set_says_when_it_gave_up():
    step = STEPS["light"]
    stopped = solve_on_working_set(step, nothing(step), 1)
    assert stopped.gap > 1e-10
    assert solve_on_working_set(step, nothing(step), 16).gap <= 1e-10


def test_the_working_set_need_not_look_at_every_candidate(monkeypatch):
    scene = zoo.planted(15).scene
    step = zoo.convex_step(scene, 0.5)
    asked = []
    factor = type(step.factor).solve
    monkeypatch.setattr(type(step.factor), "solve", lambda self, right: asked.append(right.shape) or factor(self, right))
    solution = solve_on_working_set(step, nothing(step), 120)
    assert solution.gap <= 1e-10
    columns = sum(shape[1] for shape in asked if len(shape) == 2 and shape[0] == len(step.offset))
    assert 0 < columns < step.rows.size / 2


def test_an_unknown_solver_is_a_sentence():
    with pytest.raises(BackendError, match="cvxpy's solver NOSUCH failed on a convex step"):
        solve_with_cvxpy(STEPS["heavy"], "NOSUCH")
