from dataclasses import replace
from functools import cache

import naive
import numpy as np
import pytest
import zoo
from scipy.sparse import block_diag, csc_array, diags_array

from relax.convex.backends import BACKENDS
from relax.convex.reference import solve_with_cvxpy
from relax.convex.subproblem import Solution, certify
from relax.errors import BackendError
from relax.factor import Factor
from relax.sparsity.reach import ANYTHING, Reach

STEPS = zoo.convex_steps()
every_step = pytest.mark.parametrize("step", STEPS.values(), ids=STEPS)
every_name = pytest.mark.parametrize("name", STEPS)


def amplitudes(step, seed=0):
    """Random amplitudes of a size that moves the membrane as far as it has to go, half of them zero."""
    rng = np.random.default_rng(seed)
    s = rng.normal(size=step.rows.shape) * np.abs(step.unsupported).max() * step.stiffness.diagonal().mean()
    s[1:] *= (rng.random(len(s) - 1) < 0.5)[:, None]
    return np.array([naive.nearest(force, step.reach) for force in s])


@cache
def optimum(name):
    """Amplitudes and value of the optimum, by naive proximal gradient."""
    s = naive.step_optimum(STEPS[name])
    return s, naive.step_value(STEPS[name], s)


@every_step
def test_the_value_is_that_of_the_data(step):
    s = amplitudes(step)
    solution = certify(step, s)
    nodal = step.load.copy()
    for row, amplitude in zip(step.rows.ravel(), s.ravel(), strict=True):
        nodal[row] += amplitude
    assert np.allclose(step.stiffness @ solution.displacement, nodal, rtol=1e-9, atol=1e-9 * np.abs(nodal).max())
    moved = solution.displacement + step.offset
    size = np.linalg.norm(s, axis=1)
    value = moved @ step.metric.toarray() @ moved + sum(step.weights * size) + sum(step.bends * size**2)
    assert solution.value == pytest.approx(value, rel=1e-12)
    pulled = 2 * np.linalg.solve(step.stiffness.toarray(), step.metric @ moved)
    assert np.allclose(solution.dual, pulled[step.rows], rtol=1e-9, atol=1e-12 * np.abs(pulled).max())


@every_name
def test_the_bound_is_below_the_optimum_and_the_value_above(name):
    step, (s, best) = STEPS[name], optimum(name)
    for seed in range(5):
        for trial in (amplitudes(step, seed), s + 0.1 * amplitudes(step, seed), s + 1e-3 * amplitudes(step, seed)):
            solution = certify(step, trial)
            assert solution.bound <= best * (1 + 1e-9)
            assert solution.value >= best * (1 - 1e-9)


@every_name
def test_no_gap_at_the_optimum(name):
    step, (s, best) = STEPS[name], optimum(name)
    solution = certify(step, s)
    assert solution.value == pytest.approx(best, rel=1e-12)
    assert abs(solution.gap) <= 1e-7  # the naive dual is known to about the root of the error of its value
    assert np.array_equal(solution.standing, np.linalg.norm(s, axis=1) > 0)


@every_name
def test_the_gap_shrinks_on_the_way_to_the_optimum(name):
    step, (s, _) = STEPS[name], optimum(name)
    gaps = [certify(step, s + t * amplitudes(step)).gap for t in (1.0, 1e-1, 1e-2, 1e-3)]
    assert gaps[0] > gaps[-1]
    assert gaps[:3] == sorted(gaps[:3], reverse=True)
    assert gaps[-1] > 0  # a wrong answer never gets away without a gap


RNG_REACHES = [
    ANYTHING,
    Reach((2,)),
    Reach((2,), 0.0),
    Reach(tangent=0.3),
    Reach(tangent=3.0),
    Reach(largest=0.05),
    Reach((2,), largest=0.03),
    Reach(tangent=0.5, largest=0.05),
]


def random_step(seed):
    """A step of every kind: reach, metric (full, singular or height alone), kept groups, curvature, at random."""
    rng = np.random.default_rng(seed)
    reach = RNG_REACHES[seed % len(RNG_REACHES)]
    roots = rng.normal(size=(16, 3, 1 + seed % 3))  # blocks of rank 1 to 3
    metric = csc_array(block_diag(list(roots @ roots.transpose(0, 2, 1))))
    if seed % 5 == 0:
        metric = csc_array(diags_array(np.tile([0.0, 0.0, 1.0], 16)))
    chosen = rng.permutation(16)[: 3 + seed % 12]
    step = zoo.convex_step(SCENE, rng.uniform(0.02, 0.5), metric=metric, spread=1.0, reach=reach)
    weights = np.where(rng.random(len(chosen)) < 0.2, 0.0, step.weights[chosen])
    bends = rng.uniform(0, 1, len(chosen)) * (rng.random(len(chosen)) < 0.5) if seed % 4 == 1 else None
    return replace(step, rows=step.rows[chosen], weights=weights, curvature=bends)


SCENE = zoo.planted(6, zoo.PULLED, 0.02).scene


@pytest.mark.parametrize("seed", range(32))
def test_no_bound_passes_the_optimum_of_another_solver(seed):
    step = random_step(seed)
    s = solve_with_cvxpy(step)
    best = certify(step, s)
    optimum = naive.step_value(step, best.amplitudes)
    assert best.gap <= 1e-6
    for factor in (3.0, 0.3, 0.03, 1e-3, 1e-6):
        near = certify(step, s + factor * amplitudes(step, seed))
        assert near.bound <= optimum * (1 + 1e-7)
        assert near.value >= optimum * (1 - 1e-7)
    polished = BACKENDS["clarabel"](step, step.nothing)
    assert polished.gap <= 1e-10
    assert polished.value == pytest.approx(optimum, rel=1e-6)


def test_amplitudes_that_no_support_can_have_are_moved():
    step = STEPS["lean 30, capped"]
    wild = 10 * np.random.default_rng(0).normal(size=step.rows.shape)
    solution = certify(step, wild)
    assert np.allclose(solution.amplitudes, [naive.nearest(force, step.reach) for force in wild])
    assert solution.value == pytest.approx(naive.step_value(step, solution.amplitudes))


def test_a_group_that_costs_nothing_does_not_void_the_bound():
    step = STEPS["one kept"]
    s, best = optimum("one kept")
    off = s * 1.05  # the kept group feels a pull here, and every dual with a pull on it bounds nothing
    solution = certify(step, off)
    assert step.reach.pull(solution.dual)[step.kept] > 1e-3 * np.abs(solution.dual).max()
    assert 0.5 * best < solution.bound < best


def test_a_largest_force_that_nothing_reaches_changes_no_bound():
    step = STEPS["three kept, capped"]
    s = naive.step_optimum(replace(step, reach=ANYTHING))
    free = certify(replace(step, reach=ANYTHING), s)
    for largest in (10.0, 1e6, 1e12):
        assert certify(replace(step, reach=Reach(largest=largest)), s).bound == pytest.approx(free.bound, rel=1e-8)


@every_step
def test_scaled_is_the_same_step(step):
    inner, unit = step.scaled()
    s = amplitudes(step)
    one, other = certify(step, s), certify(inner, s / unit)
    length = one.displacement @ one.displacement / (one.displacement @ other.displacement)
    assert np.allclose(other.displacement * length, one.displacement, rtol=1e-9, atol=1e-9 * length)
    assert other.value * length**2 == pytest.approx(one.value, rel=1e-10)
    assert other.bound * length**2 == pytest.approx(one.bound, rel=1e-9)


@every_step
def test_scaled_is_of_order_one_in_any_units(step):
    inner, _ = step.scaled()
    assert inner.stiffness.diagonal().mean() == pytest.approx(1)
    assert 0.1 <= np.abs(inner.unsupported).max() <= 10
    other, _ = zoo.in_millimetres(step).scaled()
    assert np.allclose(inner.offset, other.offset, atol=1e-12)
    assert np.allclose(inner.load, other.load, atol=1e-12)
    assert np.allclose(inner.weights, other.weights)


@every_step
def test_damping_is_the_explicit_term_up_to_a_constant(step):
    delta = 0.7
    metric = step.metric.toarray()
    differences = []
    for seed in range(4):
        s = amplitudes(step, seed)
        plain, damped = certify(step, s), certify(step.damped(delta), s)
        d = plain.displacement
        assert np.allclose(damped.displacement, d, rtol=1e-9, atol=1e-12)
        differences.append(plain.value + delta * (d @ metric @ d) - damped.value)
    scale = plain.value
    assert np.ptp(differences) <= 1e-10 * scale
    # the constant, by hand: r M r (1 - 1 / (1 + delta))
    assert differences[0] == pytest.approx((step.offset @ metric @ step.offset) * delta / (1 + delta), abs=1e-10 * scale)
    assert step.damped(0.0) is step


def test_where_nothing_need_stand_the_certificate_is_exact():
    solution = certify(STEPS["nothing stands"], np.zeros((16, 3)))
    assert solution.gap == pytest.approx(0, abs=1e-14)
    assert np.linalg.norm(solution.dual, axis=1).max() == pytest.approx(STEPS["nothing stands"].weights[0] / 1.01)
    assert not solution.standing.any()
    assert certify(STEPS["heavy"], np.zeros((16, 3))).gap > 1e-3


def test_spread_puts_amplitudes_on_their_rows():
    step = STEPS["few candidates"]
    s = np.arange(15.0).reshape(5, 3)
    nodal = step.spread(s)
    assert np.array_equal(nodal[step.rows], s)
    assert np.count_nonzero(nodal) == 14


def test_a_target_that_is_met_leaves_no_gap():
    step = replace(STEPS["medium"], offset=np.zeros(48), load=np.zeros(48))
    solution = certify(step, np.zeros((16, 3)))
    assert (solution.value, solution.bound, solution.gap) == (0, 0, 0)
    assert np.isfinite(step.scaled()[0].weights).all()


def test_the_gap_is_relative():
    none = np.zeros((0, 3))
    assert Solution(none, np.zeros(0), none, 4.0, 3.0).gap == 0.25


def test_a_singular_stiffness_is_a_sentence():
    step = replace(STEPS["medium"], factor=Factor(csc_array((48, 48))))
    with pytest.raises(BackendError, match="the stiffness is singular at this shape"):
        certify(step, np.zeros((16, 3)))


def test_a_step_does_not_change_under_a_reader():
    with pytest.raises(ValueError, match="read-only"):
        STEPS["medium"].weights[0] = 3


def test_a_displacement_that_the_metric_does_not_see_pulls_nothing():
    """A distance below 0 by round-off, as a metric that sees one direction leaves it."""
    assert not STEPS["three kept, height alone"].kept_columns.largest_pull(-1e-30).any()
