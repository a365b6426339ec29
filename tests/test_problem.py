from dataclasses import replace

import numpy as np
import pytest
import zoo

from relax.design.problem import Problem
from relax.errors import InputError
from relax.membrane.equilibrium import find_equilibrium
from relax.sparsity.penalties import GroupLasso, Power

LOADED = {"membrane__loads": [0.01, 0.0, -0.02]}


@pytest.fixture(scope="module")
def scene():
    """Every candidate at half the vertices, uneven weights and an uneven, full metric."""
    rng = np.random.default_rng(3)
    plain = zoo.irregular_scene(5, supports__never=[6, 8], **LOADED)
    root = rng.normal(size=(25, 3, 3))
    return replace(plain, metric=root @ root.transpose(0, 2, 1), support_weight=rng.uniform(0.5, 2, 25))


def shifted(scene, seed=0):
    rng = np.random.default_rng(seed)
    positions = scene.target.copy()
    positions[~scene.fixed] += rng.normal(0, 0.02, (int((~scene.fixed).sum()), 3))
    return positions


def test_the_pyramid_by_hand():
    problem = Problem(zoo.pyramid(penalty__weight=2.0, penalty__exponent=1.0, penalty__smoothing=0.25))
    positions = problem.scene.target.copy()
    assert problem.distance(positions) == 0
    positions[4] += [0.3, 0.0, -0.4]
    assert problem.distance(positions) == pytest.approx(0.25)
    # sqrt(1.2^2 + 0.25) = 1.3, less the 0.5 of nothing
    force = np.array([[0, 0, zoo.PYRAMID_FORCE]])
    assert problem.sparsity(force) == pytest.approx(2.0 * (1.3 - 0.5))
    assert problem.sparsity(0 * force) == 0
    assert problem.objective(positions, force) == pytest.approx(0.25 + 1.6)
    assert problem.size == pytest.approx(np.sqrt(4 + 4 + 0.75**2))
    # the force that holds the pyramid balances its springs
    np.testing.assert_allclose(problem.membrane.forces(problem.scene.target) + force, 0, atol=1e-15)


def test_distance_and_sparsity_are_the_sums_of_the_formulas(scene):
    problem = Problem(scene, Power(0.6, 1e-3), 0.3)
    positions, forces = shifted(scene), np.random.default_rng(1).normal(size=(25, 3))
    free, candidates = np.flatnonzero(~scene.fixed), np.flatnonzero(scene.candidates)
    assert set(candidates) == set(free) - {6, 8}
    offset = positions - scene.target
    assert problem.distance(positions) == pytest.approx(sum(offset[i] @ scene.metric[i] @ offset[i] for i in free))
    amplitudes = problem.supports.amplitudes(forces[free])
    np.testing.assert_array_equal(amplitudes, forces[candidates])
    cost = [0.3 * scene.support_weight[i] * ((forces[i] @ forces[i] + 1e-3) ** 0.3 - 1e-3**0.3) for i in candidates]
    np.testing.assert_allclose(problem.group_costs(np.linalg.norm(amplitudes, axis=1)), cost)
    assert problem.sparsity(amplitudes) == pytest.approx(sum(cost))
    assert problem.objective(positions, amplitudes) == pytest.approx(problem.distance(positions) + sum(cost))


def test_group_weights_are_the_slope_of_the_cost(scene):
    problem = Problem(scene, Power(0.6, 1e-6), 0.3)
    amplitudes = np.random.default_rng(1).normal(size=(len(problem.supports.vertices), 3))
    size, step = np.linalg.norm(amplitudes, axis=1), 1e-6
    slope = (problem.group_costs(size + step) - problem.group_costs(size - step)) / (2 * step)
    np.testing.assert_allclose(problem.group_weights(amplitudes), slope, rtol=1e-7)


def test_the_dual_is_minus_the_gradient_that_a_force_feels(scene):
    """Central differences of E_dist at true equilibrium: d E / d p = lam."""
    problem = Problem(scene, GroupLasso(), 0.3)
    membrane = problem.membrane
    rest = find_equilibrium(membrane, scene.target, problem.loads).positions
    dual = problem.dual(rest, problem.factor_at(rest))
    step = 1e-5
    for vertex, axis in ((0, 0), (3, 1), (4, 2), (8, 2)):
        value = []
        for sign in (1, -1):
            forces = problem.loads.copy()
            forces[vertex, axis] += sign * step
            value.append(problem.distance(find_equilibrium(membrane, rest, forces).positions))
        assert dual[vertex, axis] == pytest.approx((value[0] - value[1]) / (2 * step), rel=1e-6)


def test_the_convex_step_is_the_problem_to_first_order(scene):
    """The displacement that the step predicts for small forces is right to second order (its slope is that of Taylor)."""
    problem = Problem(scene, GroupLasso(), 0.3)
    rest = find_equilibrium(problem.membrane, scene.target, problem.loads).positions
    step = problem.linearised(rest, problem.factor_at(rest), np.full(len(problem.supports.vertices), 0.1))
    np.testing.assert_allclose(step.load, 0, atol=1e-12)
    free = problem.membrane.free
    np.testing.assert_array_equal(step.offset.reshape(-1, 3), rest[free] - scene.target[free])
    amplitudes = np.random.default_rng(2).normal(size=(len(step.weights), 3))
    errors = []
    for size in (1e-3, 1e-4):
        predicted = step.factor.solve(step.load + step.spread(size * amplitudes)).reshape(-1, 3)
        applied = problem.supports.forces(size * amplitudes) + problem.loads
        exact = find_equilibrium(problem.membrane, rest, applied).positions[free] - rest[free]
        errors.append(np.abs(predicted - exact).max())
    assert np.log10(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_forces_of_the_candidates_are_spread_to_their_vertices(scene):
    problem = Problem(scene, weight=1.0)
    amplitudes = np.arange(3.0 * len(problem.supports.vertices)).reshape(-1, 3) + 1
    nodal = problem.supports.forces(amplitudes)
    np.testing.assert_array_equal(problem.supports.amplitudes(nodal), amplitudes)
    np.testing.assert_array_equal(nodal.ravel()[problem.supports.rows.ravel()], amplitudes.ravel())
    assert not nodal[~scene.candidates[problem.membrane.free]].any()
    amplitudes[2:] = 0
    np.testing.assert_array_equal(np.flatnonzero(problem.standing(amplitudes)), [0, 1])


def test_defaults_come_from_the_scene():
    power = Problem(zoo.pyramid(penalty__weight=0.25, penalty__exponent=0.7, penalty__smoothing=1e-4))
    assert power.penalty == Power(0.7, 1e-4) and power.weight == power.strength == 0.25
    assert Problem(zoo.pyramid(penalty__name="group-lasso")).penalty == GroupLasso()
    other = power.replace(weight=3.0, penalty=GroupLasso())
    assert (other.weight, other.penalty, other.scene) == (3.0, GroupLasso(), power.scene)
    assert power.weight == 0.25


@pytest.mark.parametrize("weight", [0.0, -1.0, np.nan, np.inf])
def test_a_weight_that_is_no_positive_number_is_refused(weight):
    with pytest.raises(InputError, match=r"penalty\.weight is"):
        Problem(zoo.pyramid(), weight=weight)


def test_a_weight_given_as_a_fraction_is_not_a_number_yet():
    problem = Problem(zoo.pyramid(penalty__weight=None, penalty__weight_fraction=0.5))
    assert problem.weight is None
    with pytest.raises(InputError, match=r"penalty\.weight_fraction"):
        problem.sparsity(np.ones((1, 3)))
