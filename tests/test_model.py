"""The small model against E_dist at true equilibrium: what it says to second order must be so."""

from dataclasses import replace

import numpy as np
import pytest
import zoo
from test_refit import problem_of, slope_of, start

from relax.design.model import empty_model
from relax.design.problem import Problem
from relax.design.shape import rest

SCENES = ["hookean", "loads", "force density", "tension-only", "cables", "alpha 0.8"]
STANDING = {6: (0.02, 0.0, 0.25), 12: (0.05, -0.03, 0.3)}
MEMBERS = np.array([6, 12, 3, 18, 11])  # two that stand, three where nothing does


def model_at(problem, shape, *, turned=True):
    """The model of all second-order terms at a shape at rest, without members."""
    factor = problem.factor_at(shape.positions)
    field = problem.dual(shape.positions, factor)
    curvature = problem.metric
    if turned:
        curvature = curvature - problem.membrane.stiffness_turn(shape.positions, field) / 2
    dual = problem.supports.amplitudes(field)
    return empty_model(problem, factor, curvature, shape.amplitudes, problem.distance(shape.positions), dual)


def case(name, **changes):
    problem = problem_of(name, **changes)
    shape = start(problem, STANDING)
    return problem, shape, model_at(problem, shape).enlarged(MEMBERS)


def raw_distance(model, s):
    """E_dist as the model has it before Q is made positive: straight from the module's formula."""
    step = (s - model.origin[model.members]).ravel()
    return model.distance + model.dual[model.members].ravel() @ step + step @ model.quadratic @ step


def at_rest(problem, shape, amplitudes):
    moved = rest(problem, replace(shape, amplitudes=amplitudes))
    assert moved is not None
    return moved


@pytest.mark.parametrize("name", SCENES)
def test_the_distance_has_its_taylor_slopes_at_true_equilibrium(name):
    problem, shape, model = case(name)
    steps = np.array([1e-2, 5e-3, 2.5e-3, 1.25e-3])
    first, second, dual, straight = np.zeros((4, 4))
    for along in np.random.default_rng(0).normal(size=(4, 5, 3)):
        for place, step in enumerate(steps):
            s = shape.amplitudes[MEMBERS] + step * along
            moved = at_rest(problem, shape, model.whole(s))
            true = problem.distance(moved.positions)
            first[place] += abs(true - model.distance - step * np.vdot(model.dual[MEMBERS], along))
            second[place] += abs(true - raw_distance(model, s))
            exact = problem.supports.amplitudes(problem.dual(moved.positions, problem.factor_at(moved.positions)))
            dual[place] += np.linalg.norm(exact - model.dual_at(s))
            straight[place] += np.linalg.norm(exact - model.dual)
    assert slope_of(first, steps) == pytest.approx(2.0, abs=0.15)
    assert slope_of(straight, steps) == pytest.approx(1.0, abs=0.15)
    if name == "force density":  # linear: the model is all there is
        assert second.max() < 1e-12 and dual.max() < 1e-11
        return
    assert slope_of(second, steps) == pytest.approx(3.0, abs=0.15)
    assert slope_of(dual, steps) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("name", SCENES)
def test_without_the_turn_of_the_stiffness_it_is_no_second_order_model(name):
    """The check above can fail: M alone leaves a second-order error on every law but the linear one."""
    problem, shape, _ = case(name)
    model = model_at(problem, shape, turned=False).enlarged(MEMBERS)
    steps = np.array([1e-2, 5e-3, 2.5e-3])
    along = np.random.default_rng(0).normal(size=(5, 3))
    errors = []
    for step in steps:
        s = shape.amplitudes[MEMBERS] + step * along
        errors.append(abs(problem.distance(at_rest(problem, shape, model.whole(s)).positions) - raw_distance(model, s)))
    assert max(errors) < 1e-12 if name == "force density" else slope_of(errors, steps) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("name", SCENES)
def test_enlarged_in_steps_is_enlarged_at_once(name):
    problem, shape, model = case(name)
    stepwise = model_at(problem, shape)
    for entering in (MEMBERS[:1], MEMBERS[1:4], MEMBERS[4:]):
        stepwise = stepwise.enlarged(entering)
    np.testing.assert_array_equal(stepwise.members, model.members)
    np.testing.assert_allclose(stepwise.columns, model.columns, atol=1e-13 * np.abs(model.columns).max())
    np.testing.assert_allclose(stepwise.quadratic, model.quadratic, atol=1e-12 * np.abs(model.quadratic).max())
    dense = np.linalg.inv(problem.membrane.stiffness(shape.positions).toarray())[:, problem.supports.rows[MEMBERS].ravel()]
    np.testing.assert_allclose(model.columns, dense, atol=1e-10 * np.abs(dense).max())
    np.testing.assert_allclose(model.quadratic, dense.T @ model.curvature.toarray() @ dense, atol=1e-12)


@pytest.mark.parametrize("name", SCENES)
def test_at_its_origin_the_model_is_the_problem(name):
    problem, shape, model = case(name)
    origin = shape.amplitudes[MEMBERS]
    assert model.value(origin) == pytest.approx(problem.objective(shape.positions, shape.amplitudes), rel=1e-12)
    np.testing.assert_array_equal(model.dual_at(origin), model.dual)
    np.testing.assert_array_equal(model.whole(origin), shape.amplitudes)


@pytest.mark.parametrize("name", SCENES)
def test_where_the_quadratic_is_positive_the_value_is_that_of_the_formula(name):
    problem, _, model = case(name)
    # the curvature of a quadratic of its own choice: positive, so that nothing is reflected
    positive = replace(model, quadratic=model.quadratic + 10 * np.abs(model.quadratic).max() * np.eye(15))
    for s in np.random.default_rng(1).normal(size=(5, 5, 3)):
        wanted = raw_distance(positive, s) + problem.sparsity(positive.whole(s))
        assert positive.value(s) == pytest.approx(wanted, rel=1e-10)


def test_where_the_model_bends_down_it_is_bent_up_as_much():
    _, _, model = case("hookean")
    vectors = np.linalg.qr(np.random.default_rng(2).normal(size=(15, 15)))[0]
    bends = np.linspace(-1.0, 2.0, 15)
    bent = replace(model, quadratic=(vectors * bends) @ vectors.T)
    np.testing.assert_allclose(bent.small.quadratic, (vectors * np.abs(bends)) @ vectors.T, atol=1e-12)
    # its value and slope at the origin stay
    origin = model.origin[MEMBERS]
    assert bent.value(origin) == pytest.approx(model.value(origin), rel=1e-12)
    gradient = 2 * (bent.small.quadratic @ origin.ravel()).reshape(-1, 3) + 2 * bent.small.linear
    np.testing.assert_allclose(gradient, model.dual[MEMBERS], atol=1e-12)


def test_a_model_without_members_is_the_origin_alone():
    problem = problem_of("hookean")
    shape = start(problem, {})
    model = model_at(problem, shape)
    none = np.zeros((0, 3))
    assert model.value(none) == pytest.approx(problem.distance(shape.positions), rel=1e-14)
    np.testing.assert_array_equal(model.dual_at(none), model.dual)
    assert not model.whole(none).any()


def test_candidates_that_are_some_of_the_vertices_keep_their_places():
    """Members are counted among the candidates, columns among the free vertices."""
    scene = zoo.planted(7, zoo.TWO_MASTS, sigma=0.02, penalty__weight=5e-3, supports__candidates=[16, 24, 26, 33]).scene
    problem = Problem(scene)
    shape = start(problem, {1: (0.0, 0.0, 0.2)})
    model = model_at(problem, shape).enlarged(np.array([3, 1]))
    s = np.array([[0.01, 0.0, 0.02], [0.0, 0.01, 0.21]])
    moved = at_rest(problem, shape, model.whole(s))
    assert np.flatnonzero(problem.all_forces(moved.amplitudes).any(axis=1)).tolist() == [24, 33]
    assert raw_distance(model, s) == pytest.approx(problem.distance(moved.positions), rel=1e-3)
