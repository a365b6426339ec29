"""Surrogates against integrals by a sum, and their iterations on random small problems."""

from itertools import pairwise

import naive
import numpy as np
import pytest
from test_penalties import ALL, SMOOTH

from relax.errors import InputError
from relax.sparsity.penalties import MCP, SCAD, Count, GroupLasso, LogSum, Power
from relax.sparsity.supports import sizes
from relax.sparsity.surrogates import REWEIGHTED_L1, REWEIGHTED_L2, Continuation

every = pytest.mark.parametrize("penalty", ALL, ids=str)
smoothings = pytest.mark.parametrize("smoothing", [0.0, 1e-3, 0.7])
both = pytest.mark.parametrize("surrogate", [REWEIGHTED_L1, REWEIGHTED_L2], ids=lambda surrogate: surrogate.name)
SIZES = np.concatenate([[0.0], np.geomspace(1e-6, 1e3, 301)])


def one(number):
    return np.array([float(number)])


@every
@both
@smoothings
def test_it_touches_and_lies_above(penalty, surrogate, smoothing):
    majorised = surrogate.majorised(penalty, SIZES, smoothing)
    assert majorised[0] == 0 and np.all(np.diff(majorised) >= -1e-12 * majorised[-1])
    for at in SIZES[1::20]:
        touching = surrogate.touching(penalty, np.full_like(SIZES, at), SIZES, smoothing)
        assert np.all(touching >= majorised - 1e-12 * (np.abs(touching) + majorised[-1]))
        there = surrogate.touching(penalty, one(at), one(at), smoothing)
        assert there == surrogate.majorised(penalty, one(at), smoothing)


@every
@both
@smoothings
def test_it_is_a_constant_and_its_coefficient_times_a_power(penalty, surrogate, smoothing):
    for at in (1e-3, 0.3, 20.0):
        weight = surrogate.coefficient(penalty, one(at), smoothing)
        for size in (0.0, 0.1, 5.0):
            rise = surrogate.touching(penalty, one(at), one(size), smoothing) - surrogate.majorised(penalty, one(at), smoothing)
            assert rise == pytest.approx(weight * (size**surrogate.degree - at**surrogate.degree), rel=1e-12, abs=1e-15)


@every
@both
@pytest.mark.parametrize("smoothing", [1e-3, 0.7])
def test_the_coefficient_is_the_slope_of_what_it_majorises(penalty, surrogate, smoothing):
    for at in (0.011, 0.3, 2.0):
        power = surrogate.degree

        def majorised(step, at=at, power=power):
            return surrogate.majorised(penalty, one((at**power + step) ** (1 / power)), smoothing)

        rate = surrogate.coefficient(penalty, one(at), smoothing)
        if isinstance(penalty, Count) and surrogate is REWEIGHTED_L1:
            assert rate == 0
            continue
        assert naive.taylor_order(majorised, rate, 0.01 * at**power) > 1.8


@pytest.mark.parametrize("penalty", SMOOTH, ids=str)
def test_what_reweighted_l1_descends_is_the_integral_of_the_weight(penalty):
    t = np.concatenate([[0.0], np.geomspace(1e-9, 10, 200_001)])
    weight = penalty.weight(t)
    psi = np.cumsum(np.diff(t) * (weight[1:] + weight[:-1]) / 2)
    assert np.allclose(REWEIGHTED_L1.majorised(penalty, t[1::500]), psi[::500], rtol=1e-6, atol=1e-12)


@every
def test_least_squares_without_smoothing_majorises_the_penalty_itself(penalty):
    assert np.array_equal(REWEIGHTED_L2.majorised(penalty, SIZES), penalty.value(SIZES))
    stands = SIZES[1:]
    assert np.allclose(REWEIGHTED_L2.coefficient(penalty, stands), penalty.slope(stands) / (2 * stands), rtol=1e-12, atol=1e-250)


def test_coefficients_by_hand():
    # tau^2 / (t^2 + tau^2)^2 = 9 / 25^2, of t^2 / (t^2 + tau^2) = 16 / 25
    assert REWEIGHTED_L2.coefficient(Count(), one(4), 3.0) == pytest.approx(9 / 625)
    assert REWEIGHTED_L2.majorised(Count(), one(4), 3.0) == pytest.approx(16 / 25)
    # 1 / (2 5), of 5 - 3
    assert REWEIGHTED_L2.coefficient(GroupLasso(), one(4), 3.0) == pytest.approx(0.1)
    assert REWEIGHTED_L2.majorised(GroupLasso(), one(4), 3.0) == pytest.approx(2)
    # slope 1 / (1 + 5 / 5) / (2 5)
    assert REWEIGHTED_L2.coefficient(LogSum(5.0), one(4), 3.0) == pytest.approx(0.05)
    assert REWEIGHTED_L1.coefficient(LogSum(7.0), one(4), 3.0) == pytest.approx(0.5)
    # alpha / 2 (t^2 + eps + tau^2)^(alpha/2 - 1)
    assert REWEIGHTED_L2.coefficient(Power(0.5, 2.0), one(3), 1.0) == pytest.approx(0.25 * 12**-0.75)


@pytest.mark.parametrize("penalty", [MCP(0.01), SCAD(0.01)], ids=str)
def test_a_smoothing_of_many_knees_still_tells_small_forces_from_large_ones(penalty):
    small, mean, large = REWEIGHTED_L2.coefficient(penalty, np.array([0.0, 1.0, 50.0]), 1.0)
    assert small > 1.3 * mean > 0 and large == 0
    # its height is that of the penalty, but for what the smoothing itself spans
    assert REWEIGHTED_L2.majorised(penalty, one(50), 1.0) > 0.5 * penalty.value(one(50))


@every
@smoothings
def test_coefficients_stay_finite(penalty, smoothing):
    extreme = np.array([0.0, 1e-300, 1e-100, 1.0, 1e150, 1e300])
    with np.errstate(all="raise", under="ignore"):
        square = REWEIGHTED_L2.coefficient(penalty, extreme, smoothing)
    assert np.isfinite(square).all() and np.all(np.diff(square) <= 0)


def small_problem(seed, groups=6):
    """Min s^T G s + 2 b^T s + cost sum phi(|s_g|) with a planted answer of two groups."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(3 * groups + 4, 3 * groups))
    truth = np.zeros((groups, 3))
    truth[:2] = rng.normal(size=(2, 3))
    wanted = columns @ truth.ravel() + 0.1 * rng.normal(size=len(columns))
    quadratic, linear = columns.T @ columns, -(columns.T @ wanted)
    return quadratic, linear, 0.05 * np.abs(linear).max()


def total(problem, s, group_values):
    quadratic, linear, cost = problem
    flat = s.ravel()
    return float(flat @ quadratic @ flat + 2 * linear @ flat + cost * group_values.sum())


@every
@smoothings
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_reweighted_least_squares_descends_the_penalty_itself(penalty, smoothing, seed):
    problem = quadratic, linear, cost = small_problem(seed)
    s = np.linalg.solve(quadratic, -linear).reshape(-1, 3)
    values = []
    for _ in range(60):
        values.append(total(problem, s, REWEIGHTED_L2.majorised(penalty, sizes(s), smoothing)))
        weight = cost * REWEIGHTED_L2.coefficient(penalty, sizes(s), smoothing)
        s = np.linalg.solve(quadratic + np.diag(np.repeat(weight, 3)), -linear).reshape(-1, 3)
    noise = 1e-12 * abs(values[0])
    assert all(after <= before + noise for before, after in pairwise(values))
    flat = getattr(penalty, "knee", 1.0) < 0.1 or isinstance(penalty, Count)
    assert values[-1] < values[0] - noise or (flat and smoothing < 0.1)


@pytest.mark.parametrize("penalty", [Power(), Power(0.9, 1e-2), LogSum(0.3), MCP(7.0)], ids=str)
@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_reweighted_l1_descends_psi_and_ends_where_phi_is_stationary(penalty, smoothing):
    problem = quadratic, linear, cost = small_problem(3)
    s = np.linalg.solve(quadratic, -linear).reshape(-1, 3)
    values = []
    for _ in range(12):
        values.append(total(problem, s, REWEIGHTED_L1.majorised(penalty, sizes(s), smoothing)))
        s = naive.group_lasso(quadratic, linear, cost * REWEIGHTED_L1.coefficient(penalty, sizes(s), smoothing))
    noise = 1e-10 * abs(values[0])
    assert all(after <= before + noise for before, after in pairwise(values)) and values[-1] < values[0] - 1e3 * noise
    size = sizes(s)
    assert 0 < np.count_nonzero(size) < len(size)
    if smoothing:
        return
    gradient = 2 * (quadratic @ s.ravel() + linear).reshape(-1, 3)
    stands = size > 0
    bent = cost * (penalty.slope(size[stands]) / size[stands])[:, None] * s[stands]
    assert sizes(gradient[stands] + bent).max() <= 1e-5 * cost  # what twelve reweightings leave
    assert np.all(sizes(gradient[~stands]) <= cost * penalty.weight(np.zeros(1)))


def test_the_usual_weight_ends_where_the_penalty_is_not_stationary():
    penalty = Power(0.5, 1e-2)
    quadratic, linear, cost = small_problem(3)

    def off(weight):
        s = np.linalg.solve(quadratic, -linear).reshape(-1, 3)
        for _ in range(12):
            s = naive.group_lasso(quadratic, linear, cost * weight(sizes(s)))
        stands = sizes(s) > 0
        gradient = 2 * (quadratic @ s.ravel() + linear).reshape(-1, 3)[stands]
        bent = penalty.slope(sizes(s[stands])) / sizes(s[stands])
        return sizes(gradient + cost * bent[:, None] * s[stands]).max() / cost

    assert off(lambda t: REWEIGHTED_L1.coefficient(penalty, t)) < 1e-5
    assert off(lambda t: 0.5 * (t**2 + 1e-2) ** -0.25) > 1e-4


def test_smoothings_fall_from_the_largest_force_to_the_least_share():
    assert list(Continuation(1.0, 0.5, 0.2).smoothings(8.0)) == [8, 4, 2]
    default = list(Continuation().smoothings(3.0))
    assert default[0] == 3 and default[-1] > 6e-4 >= 0.6 * default[-1]


@pytest.mark.parametrize(
    ("numbers", "sentence"),
    [
        ((1.0, 1.0, 1e-3), "continuation.shrink is 1.0: expected a number between 0 and 1"),
        ((1.0, 0.0, 1e-3), "continuation.shrink is 0.0"),
        ((1.0, 0.5, 0.0), "continuation from 1.0 to 0.0: expected"),
        ((1e-4, 0.5, 1e-3), "continuation from 0.0001 to 0.001"),
        ((np.inf, 0.5, 1e-3), "continuation from inf"),
    ],
)
def test_no_continuation_runs_for_ever(numbers, sentence):
    with pytest.raises(InputError) as caught:
        Continuation(*numbers)
    assert str(caught.value).startswith(sentence)
