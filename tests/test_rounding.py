from dataclasses import replace

import numpy as np
import pytest
import zoo
from test_refit import start

from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.rounding import round_supports
from relax.design.solve import solve
from relax.sparsity.supports import sizes


@pytest.fixture(scope="module")
def planted():
    return zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-3)


@pytest.fixture(scope="module")
def problem(planted):
    return Problem(planted.scene)


@pytest.fixture(scope="module")
def true(problem, planted):
    """The planted forces by group: {group: force}."""
    amplitudes = problem.supports.amplitudes(planted.forces[problem.membrane.free])
    return {int(group): amplitudes[group] for group in np.flatnonzero(amplitudes.any(axis=1))}


def silent(_):
    pass


def none_kept(shape):
    return np.zeros(len(shape.amplitudes), dtype=bool)


def groups(mask):
    return np.flatnonzero(mask).tolist()


def test_forces_that_the_smoothing_made_are_dropped(problem, true):
    """Tiny forces beside the two masts: as small as the resolution, or a hundred times smaller."""
    resolution = problem.penalty.resolution
    assert resolution == pytest.approx(np.sqrt(2e-6))
    shape = start(problem, true | {0: (0.0, 0.0, 0.01 * resolution), 20: (-0.5 * resolution, 0.0, 0.0)})
    result = round_supports(problem, shape, none_kept(shape), silent)
    assert groups(problem.standing(result.shape.amplitudes)) == sorted(true)
    assert groups(result.dropped) == [0, 20]
    assert not result.missing.any()
    # what is left is the refit of the two masts alone
    alone = refit(problem, start(problem, true))
    np.testing.assert_allclose(result.shape.amplitudes, alone.amplitudes, atol=1e-10)
    np.testing.assert_allclose(result.shape.positions, alone.positions, atol=1e-10)


def test_a_second_rounding_changes_nothing(problem, true):
    shape = start(problem, true | {0: (0.0, 0.0, 1e-4)})
    once = round_supports(problem, shape, none_kept(shape), silent)
    twice = round_supports(problem, once.shape, none_kept(shape), silent)
    assert not twice.dropped.any()
    np.testing.assert_allclose(twice.shape.amplitudes, once.shape.amplitudes, rtol=0, atol=1e-12)


def test_what_is_kept_is_not_dropped_for_its_size(problem, true):
    shape = start(problem, true | {0: (0.0, 0.0, 1e-5), 20: (1e-5, 0.0, 0.0)})
    keep = none_kept(shape)
    keep[20] = True
    result = round_supports(problem, shape, keep, silent)
    assert groups(problem.standing(result.shape.amplitudes)) == sorted([20, *true])
    assert groups(result.dropped) == [0]


def test_no_penalty_with_a_corner_at_zero_drops_for_size(planted, true):
    """Group lasso: a force of any size that the optimality conditions ask for is a support."""
    scene = zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__name="group-lasso", penalty__weight=5e-3).scene
    problem = Problem(scene)
    assert problem.penalty.resolution == 0
    shape = start(problem, true)
    result = round_supports(problem, shape, none_kept(shape), silent)
    assert not result.dropped.any() and groups(problem.standing(result.shape.amplitudes)) == sorted(true)


def test_a_support_that_is_missing_is_named_by_its_dual(problem, true):
    first, second = true
    shape = start(problem, {first: true[first]})
    result = round_supports(problem, shape, none_kept(shape), silent)
    assert second in groups(result.missing)
    assert groups(problem.standing(result.shape.amplitudes)) == [first]
    dual = problem.supports.amplitudes(problem.dual(result.shape.positions, problem.factor_at(result.shape.positions)))
    steepest = problem.strength * float(problem.penalty.weight(np.zeros(1))[0])
    assert groups(result.missing) == groups((sizes(dual) > steepest) & ~problem.standing(result.shape.amplitudes))


def test_a_missing_support_is_one_steeper_than_the_penalty_allows(problem):
    """Of the bare membrane: at a weight a little above the largest useful one nobody is missing, below it the first."""
    bare = start(problem, {})
    dual = sizes(problem.supports.amplitudes(problem.dual(bare.positions, problem.factor_at(bare.positions))))
    useful = dual.max() / float(problem.penalty.weight(np.zeros(1))[0])
    for factor, missing in ((1 + 1e-6, []), (1 - 1e-6, [int(np.argmax(dual))])):
        result = round_supports(problem.replace(weight=factor * useful), bare, none_kept(bare), silent)
        assert groups(result.missing) == missing


def test_every_refit_reports_its_steps(problem, true):
    seen = []
    shape = start(problem, true | {0: (0.0, 0.0, 1e-5)})
    round_supports(problem, shape, none_kept(shape), seen.append)
    assert next(record["supports"] for record in seen) == 3
    assert [record["supports"] for record in seen][-1] == 2
    assert all(np.isfinite(record["objective"]) for record in seen)


@pytest.mark.parametrize("ratio", [1e-2, 1e-4])
def test_first_forces_on_a_soft_half_are_as_small_as_it_needs(ratio):
    """A seat that is a share of the largest force turns a soft region over: Newton takes it away, and the dual goes on to ask."""
    scene = zoo.grid_scene(7, zoo.hill, penalty__weight=0.01)
    soft = scene.target[scene.mesh.edges].mean(axis=1)[:, 0] > 0.5
    scene = replace(scene, spring_constant=scene.spring_constant * np.where(soft, ratio, 1.0))
    said = solve(Problem(scene)).certificate
    assert said.converged and said.off_support < 1
