from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import zoo

from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.shape import Shape, rest
from relax.errors import EquilibriumError
from relax.membrane.equilibrium import find_equilibrium
from relax.sparsity.supports import sizes

SCENES = {
    "hookean": {},
    "loads": {"membrane__loads": [0.02, 0.0, -0.05]},
    "force density": {"membrane__springs": "force-density"},
    "tension-only": {"membrane__springs": "tension-only"},
    "cables": {"membrane__material": "cables", "membrane__stiffness": 0.3},
    "alpha 0.8": {"penalty__exponent": 0.8, "penalty__smoothing": 1e-4},
    "alpha 1": {"penalty__exponent": 1.0, "penalty__smoothing": 1e-4},
    "group lasso": {"penalty__name": "group-lasso"},
}


def problem_of(name, **changes):
    """Two masts on a target that they cannot reach (noise), so that lam and with it T are not zero."""
    wanted = {"penalty__weight": 5e-3, **SCENES[name], **changes}
    scene = zoo.planted(7, zoo.TWO_MASTS, sigma=0.02, **wanted).scene
    return Problem(replace(scene, support_weight=np.linspace(0.6, 1.4, scene.mesh.vertices)))


def start(problem, forces):
    """A shape at rest under forces {group: force}."""
    amplitudes = np.zeros((len(problem.supports.vertices), 3))
    for group, force in forces.items():
        amplitudes[group] = force
    applied = problem.supports.forces(amplitudes) + problem.loads
    found = find_equilibrium(problem.membrane, problem.scene.start, applied)
    assert found.found
    return Shape(found.positions, amplitudes, None, 0)


TWO = {6: (0.02, 0.0, 0.25), 12: (0.05, -0.03, 0.3)}


def moved(problem, shape, along):
    """The shape at true equilibrium under forces changed by `along` on the groups that stand."""
    amplitudes = shape.amplitudes.copy()
    amplitudes[shape.amplitudes.any(axis=1)] += along
    return rest(problem, replace(shape, amplitudes=amplitudes))


def value(problem, shape, share):
    return problem.distance(shape.positions) + share * problem.sparsity(shape.amplitudes)


def gradient(problem, shape, share):
    """MATH: B^T 2 K^-1 M (x - xhat) + R'(p), on the groups that stand."""
    stands = shape.amplitudes.any(axis=1)
    dual = problem.supports.amplitudes(problem.dual(shape.positions, problem.factor_at(shape.positions)))[stands]
    size = sizes(shape.amplitudes)
    slope = problem.strength * problem.supports.weights * problem.penalty.slope(size)
    return dual + share * (slope / np.maximum(size, 1e-300))[stands, None] * shape.amplitudes[stands]


def hessian(problem, shape, share):
    """MATH: B^T K^-1 (2 M - T) K^-1 B + R''(p), dense, R'' = k c phi'' along the force and k c phi' / t across it."""
    factor = problem.factor_at(shape.positions)
    turn = problem.membrane.stiffness_turn(shape.positions, problem.dual(shape.positions, factor)).toarray()
    stands = np.flatnonzero(shape.amplitudes.any(axis=1))
    inverse = np.linalg.inv(factor.matrix.toarray())[:, problem.supports.rows[stands].ravel()]
    whole = inverse.T @ (2 * problem.metric.toarray() - turn) @ inverse
    for place, group in enumerate(stands):
        p = shape.amplitudes[group]
        strength = share * problem.strength * problem.supports.weights[group]
        if problem.penalty.name == "power":
            a, s = problem.penalty.exponent, p @ p + problem.penalty.smoothing
            block = strength * a * s ** (a / 2 - 1) * (np.eye(3) - (2 - a) * np.outer(p, p) / s)
        else:
            block = strength * (np.eye(3) - np.outer(p, p) / (p @ p)) / np.linalg.norm(p)
        at = slice(3 * place, 3 * place + 3)
        whole[at, at] += block
    return whole


def slope_of(errors, steps):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize("share", [1.0, 0.0])
@pytest.mark.parametrize("name", SCENES)
def test_gradient_and_hessian_have_their_taylor_slope_at_true_equilibrium(name, share):
    problem = problem_of(name)
    shape = start(problem, TWO)
    slope, bend = gradient(problem, shape, share), hessian(problem, shape, share)
    steps = np.array([1e-2, 5e-3, 2.5e-3, 1.25e-3])
    first, second, turned = np.zeros((3, 4))
    # one direction alone can be one along which a term happens to vanish
    for along in np.random.default_rng(0).normal(size=(6, 2, 3)):
        for place, step in enumerate(steps):
            near = moved(problem, shape, step * along)
            change = value(problem, near, share) - value(problem, shape, share)
            linear = step * np.vdot(slope, along)
            quadratic = 0.5 * step**2 * along.ravel() @ bend @ along.ravel()
            first[place] += abs(change - linear)
            second[place] += abs(change - linear - quadratic)
            turned[place] += np.linalg.norm((gradient(problem, near, share) - slope).ravel() - step * bend @ along.ravel())
    # a force density without a penalty is a quadratic: nothing of third order is left but round-off
    if name == "force density" and share == 0:
        assert second.max() < 1e-12 and turned.max() < 1e-12
        return
    assert slope_of(first, steps) == pytest.approx(2.0, abs=0.15)
    assert slope_of(second, steps) == pytest.approx(3.0, abs=0.15)
    assert slope_of(turned, steps) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("mode", ["penalised", "debiased"])
@pytest.mark.parametrize("name", SCENES)
def test_newton_ends_quadratically_at_the_judges_stationarity(name, mode):
    problem = problem_of(name)
    seen = []
    shape = refit(problem, start(problem, TWO), mode, seen.append)
    forces = np.zeros_like(problem.scene.target)
    forces[problem.membrane.free] = problem.supports.forces(shape.amplitudes)
    said = judge(problem, shape.positions, forces, mode)
    assert said.stationarity <= 1e-11 and said.equilibrium <= 1e-11 and said.stable and said.supports == 2
    residual = [record["residual"] for record in seen]
    assert residual[-1] == pytest.approx(said.stationarity, abs=1e-11)
    # from where Newton is at home each step squares what is left; a factorisation from nearby may leave a hundredth of it
    home = next(step for step, left in enumerate(residual) if left < 1e-2)
    assert len(residual) - home <= 6
    for before, after in pairwise(residual[home:]):
        assert after <= max(30 * before**2, 0.01 * before, 1e-11)


@pytest.mark.parametrize("name", SCENES)
def test_the_penalised_value_falls_at_every_step(name):
    problem = problem_of(name)
    seen = []
    refit(problem, start(problem, TWO), "penalised", seen.append)
    objective = [record["objective"] for record in seen]
    assert len(objective) > 2
    assert all(after <= before + 1e-13 * before for before, after in pairwise(objective))


def test_debiased_recovers_the_planted_forces():
    planted = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-2)
    problem = Problem(planted.scene)
    amplitudes = problem.supports.amplitudes(planted.forces[problem.membrane.free])
    stands = np.flatnonzero(amplitudes.any(axis=1))
    shape = start(problem, {group: 0.8 * amplitudes[group] + [0.01, 0, 0] for group in stands})
    fine = refit(problem, shape, "debiased")
    np.testing.assert_allclose(fine.amplitudes, amplitudes, rtol=0, atol=1e-9 * np.abs(amplitudes).max())
    np.testing.assert_allclose(fine.positions, planted.positions, rtol=0, atol=1e-10)
    # the penalty would have kept them too small
    kept = refit(problem, shape, "penalised").amplitudes
    assert (sizes(kept)[stands] < 0.999 * sizes(amplitudes)[stands]).all()


def test_a_support_that_should_vanish_leaves():
    """One planted mast and a weak second support that pushes the wrong way: the way down brings it to zero, exactly."""
    planted = zoo.planted(9, penalty__weight=1e-2, penalty__name="group-lasso")
    problem = Problem(planted.scene)
    amplitudes = problem.supports.amplitudes(planted.forces[problem.membrane.free])
    (true,) = np.flatnonzero(amplitudes.any(axis=1))
    shape = start(problem, {true: amplitudes[true], 3: (0.0, 0.0, -0.02)})
    fine = refit(problem, shape, "penalised")
    assert np.flatnonzero(fine.amplitudes.any(axis=1)).tolist() == [true]
    assert value(problem, fine, 1) < value(problem, shape, 1)
    # without the penalty nothing leaves: the second support is only brought to what it is worth
    kept = refit(problem, shape, "debiased").amplitudes
    assert sizes(kept)[3] < 1e-9 and kept[3].any()


def test_what_cannot_rest_is_refused_with_the_reason(monkeypatch):
    problem = problem_of("hookean")
    shape = start(problem, TWO)
    lost = replace(shape, amplitudes=shape.amplitudes * 1e6)
    monkeypatch.setattr("relax.design.refit.rest", lambda *_: None)
    with pytest.raises(EquilibriumError, match="finds no rest under the supports"):
        refit(problem, lost)


def test_nothing_stands_nothing_to_do():
    problem = problem_of("hookean")
    bare = start(problem, {})
    fine = refit(problem, bare)
    assert not fine.amplitudes.any()
    np.testing.assert_allclose(fine.positions, bare.positions, atol=1e-12)


BOUND = {
    "up and capped": (6, 7.75e-5, {"supports__direction": "up", "supports__max_force": 0.227, "supports__always": [26, 22]}),
    "capped": (7, 2.7e-4, {"supports__max_force": 0.022}),
    "lean 30": (7, 7.6e-5, {"supports__direction": {"lean": 30.0}, "membrane__rest_scale": 0.9}),
}


@pytest.mark.parametrize("name", BOUND)
@pytest.mark.parametrize("mode", ["penalised", "debiased"])
def test_forces_held_back_from_many_sides_still_become_stationary(name, mode):
    """All candidates at once, each pushing a little: most end at nothing, at the cone or at the cap."""
    count, weight, changes = BOUND[name]
    scene = zoo.planted(count, zoo.TWO_MASTS, 0.01, 119, penalty__name="group-lasso", penalty__weight=weight, **changes).scene
    problem = Problem(scene)
    few = problem.supports.none.copy()
    few[:, -1] = 0.01
    begin = rest(problem, Shape(scene.start, few, None, 0))
    found = refit(problem, begin, mode)
    said = judge(problem, found.positions, problem.all_forces(found.amplitudes), mode)
    assert said.stationarity <= 1e-8 and said.equilibrium <= 1e-10
    assert value(problem, found, mode == "penalised") < value(problem, begin, mode == "penalised")


def test_a_first_force_beyond_the_largest_is_cut_back():
    problem = Problem(zoo.planted(7, supports__max_force=0.1).scene)
    found = refit(problem, start(problem, {12: (0.0, 0.0, 0.3)}))
    said = judge(problem, found.positions, problem.all_forces(found.amplitudes))
    assert np.linalg.norm(found.amplitudes[12]) == pytest.approx(0.1) and said.stationarity <= 1e-8 and said.warnings == ()
