from dataclasses import replace

import naive
import numpy as np
import pytest
import zoo
from scipy.sparse import csc_array

import relax.convex.backends as module
from relax.convex.backends import BACKENDS
from relax.convex.reference import solve_with_cvxpy
from relax.convex.subproblem import certify
from relax.convex.working_set import solve_on_working_set
from relax.errors import BackendError
from relax.factor import Factor
from relax.files.schema import SCHEMA
from relax.sparsity.reach import Reach

STEPS = zoo.convex_steps()
AXIAL = {name for name, step in STEPS.items() if step.rows.shape[1] == 1}
QUADRATIC = AXIAL | {"least squares"}  # what OSQP takes
CASES = [(name, backend) for name in STEPS for backend in BACKENDS if backend != "osqp" or name in QUADRATIC]
every_case = pytest.mark.parametrize(("name", "backend"), CASES)
every_backend = pytest.mark.parametrize("backend", BACKENDS)


@pytest.fixture(scope="module")
def best():
    """Optima of the steps, by naive proximal gradient."""
    return {name: naive.step_optimum(step) for name, step in STEPS.items()}


def nothing(step):
    return step.nothing


def plain(backend):
    """A step that the back-end takes, with several supports."""
    return STEPS["vertical, uneven weights" if backend == "osqp" else "medium"]


@every_case
def test_every_backend_solves_every_step(backend, name, best):
    step = STEPS[name]
    solution = BACKENDS[backend](step, nothing(step))
    assert solution.value == pytest.approx(naive.step_value(step, best[name]), rel=1e-9)
    assert -1e-12 <= solution.gap <= 1e-9
    # optimality and reach from the data, not from the solution's own word
    assert naive.step_violation(step, solution.amplitudes) <= 1e-8
    assert solution.value == pytest.approx(naive.step_value(step, solution.amplitudes), rel=1e-11)
    for force in solution.amplitudes:
        assert np.allclose(naive.nearest(force, step.reach), force, rtol=1e-12, atol=1e-15)
    again = certify(step, solution.amplitudes)
    assert (again.value, again.bound) == (pytest.approx(solution.value, rel=1e-12), pytest.approx(solution.bound, rel=1e-12))
    assert np.array_equal(solution.standing, best[name].any(axis=1))
    if name != "three kept, height alone":  # forces in plan that cost nothing and lift nothing may be anything
        assert np.allclose(solution.amplitudes, best[name], atol=1e-5 * np.abs(best[name]).max())


@pytest.mark.parametrize("name", [name for name, step in STEPS.items() if step.reach.constrained])
def test_each_reach_of_the_zoo_binds(name, best):
    step = STEPS[name]
    free = naive.step_optimum(replace(step, reach=Reach(step.reach.axes)), 2000)
    assert naive.step_value(step, best[name]) > naive.step_value(step, free) * (1 + 1e-4)
    if np.isfinite(step.reach.largest):
        size = np.linalg.norm(best[name], axis=1)
        assert (size > step.reach.largest * (1 - 1e-9)).any()


@pytest.mark.parametrize("name", ["lean 30", "lean 30, capped", "three kept, lean 30"])
def test_some_support_leans_as_far_as_it_may(name, best):
    standing = best[name][best[name].any(axis=1)]
    lean = np.degrees(np.arctan2(np.linalg.norm(standing[:, :2], axis=1), standing[:, 2]))
    assert lean.max() == pytest.approx(30) and lean.max() <= 30 + 1e-9


def test_the_scene_format_takes_every_name():
    assert SCHEMA["solver"]["backend"].possible == ("auto", *BACKENDS)


@pytest.mark.parametrize(("name", "lacks"), [("medium", "norm"), ("capped", "norm"), ("lean 30", "norm")])
def test_osqp_says_what_it_lacks_and_who_can(name, lacks):
    sentence = (
        f"OSQP takes no second-order cones, so not the {lacks} of a force with several components: use working-set, clarabel"
    )
    with pytest.raises(BackendError, match=sentence):
        BACKENDS["osqp"](STEPS[name], nothing(STEPS[name]))
    bent = replace(STEPS[name], weights=np.zeros(16), curvature=STEPS["least squares"].curvature)
    if bent.reach.constrained:
        with pytest.raises(BackendError, match=r"so not the largest (lean|size) of a force"):
            BACKENDS["osqp"](bent, nothing(bent))


def test_the_zoo_has_steps_of_every_size():
    names = ("heavy", "medium", "light", "nothing stands", "millimetres")
    counts = {name: int(BACKENDS["working-set"](STEPS[name], nothing(STEPS[name])).standing.sum()) for name in names}
    assert counts["nothing stands"] == 0
    assert 1 <= counts["heavy"] < counts["medium"] < counts["light"]
    assert counts["millimetres"] == counts["medium"]


@every_backend
def test_a_planted_fault_shows_in_the_gap(backend):
    step = plain(backend)
    solution = BACKENDS[backend](step, nothing(step))
    faults = [1.01 * solution.amplitudes, solution.amplitudes + 1e-3, np.roll(solution.amplitudes, 1, axis=0)]
    weakest = np.argmin(np.where(solution.standing, np.linalg.norm(solution.amplitudes, axis=1), np.inf))
    dropped = solution.amplitudes.copy()
    dropped[weakest] = 0
    for fault in (*faults, dropped):
        assert certify(step, fault).gap > 1e-6 > 1e3 * solution.gap


@pytest.mark.parametrize(
    ("backend", "where"),
    [("clarabel", "cone.solve_with_clarabel"), ("cvxpy", "reference.solve_with_cvxpy"), ("osqp", "quadratic.solve_with_osqp")],
)
def test_a_solver_that_is_wrong_is_refused(backend, where, monkeypatch):
    step = plain(backend)
    right = BACKENDS[backend](step, nothing(step)).amplitudes
    monkeypatch.setattr(f"relax.convex.{where}", lambda step: 2 * right)
    with pytest.raises(BackendError, match=rf"{backend} left a duality gap of .* which is no solution"):
        BACKENDS[backend](step, nothing(step))
    monkeypatch.setattr(f"relax.convex.{where}", lambda step: np.nan * right)
    with pytest.raises(BackendError, match="which is no solution"):
        BACKENDS[backend](step, nothing(step))


@every_backend
def test_a_singular_stiffness_is_a_sentence(backend):
    step = plain(backend)
    singular = replace(step, factor=Factor(csc_array(np.diag([*np.ones(47), 0.0]))))
    with pytest.raises(BackendError, match="the stiffness is singular at this shape"):
        BACKENDS[backend](singular, nothing(step))


@every_backend
def test_the_start_does_not_change_the_answer(backend):
    step = plain(backend)
    cold = BACKENDS[backend](step, nothing(step))
    random = np.random.default_rng(0).normal(size=step.rows.shape)
    for start in (cold.amplitudes, random, 1e3 * random):
        warm = BACKENDS[backend](step, start)
        assert warm.gap <= 1e-8
        assert np.allclose(warm.amplitudes, cold.amplitudes, atol=1e-5 * np.abs(cold.amplitudes).max())


@every_backend
def test_units_do_not_change_the_answer(backend):
    step = plain(backend)
    metres, millimetres = (BACKENDS[backend](each, nothing(step)) for each in (step, zoo.in_millimetres(step)))
    assert np.allclose(1e3 * millimetres.amplitudes, metres.amplitudes, atol=1e-5 * np.abs(metres.amplitudes).max())
    assert millimetres.value == pytest.approx(1e6 * metres.value)


@pytest.mark.parametrize("many", [1, 2, 5])
def test_where_too_many_matter_the_cone_program_takes_over(many, monkeypatch):
    step = STEPS["light"]
    wanted = BACKENDS["working-set"](step, nothing(step))
    assert wanted.standing.sum() > many and wanted.ran == "working set"
    monkeypatch.setattr(module, "MANY", 3 * many)
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


def test_component_by_component_is_the_l1_norm():
    step = STEPS["medium"]
    apart = step.components()
    wanted = naive.step_optimum(apart)
    for name, solve in BACKENDS.items():
        solution = solve(apart, nothing(apart))
        assert solution.gap <= 1e-9, name
        assert np.allclose(solution.amplitudes, wanted, atol=1e-6 * np.abs(wanted).max())
    forces = wanted.reshape(-1, 3)
    quadratic, linear, constant = naive.reduced(step)
    flat = forces.ravel()
    l1 = constant + flat @ quadratic @ flat + 2 * linear @ flat + step.weights @ np.abs(forces).sum(axis=1)
    assert solution.value == pytest.approx(l1, rel=1e-12)
    assert 0 < np.count_nonzero(forces) < 3 * forces.any(axis=1).sum()  # it leaves out components, which the group norm does not
    assert STEPS["vertical"].components() is STEPS["vertical"]
    for name in ("capped", "lean 30"):
        with pytest.raises(BackendError, match="ties the components of a support to each other"):
            STEPS[name].components()


def test_an_unknown_solver_is_a_sentence():
    with pytest.raises(BackendError, match="cvxpy's solver NOSUCH failed on a convex step"):
        solve_with_cvxpy(STEPS["heavy"], "NOSUCH")
