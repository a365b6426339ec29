import naive
import numpy as np
import pytest

from relax.sparsity.penalties import GroupLasso, Power, make_penalty

PENALTIES = [
    GroupLasso(),
    Power(),
    Power(0.1, 1e-4),
    Power(0.9, 1e-2),
    Power(1.0, 1e-6),
    Power(1.0, 0.0),
    Power(0.5, 4.0),
]
every = pytest.mark.parametrize("penalty", PENALTIES, ids=str)
SIZES = np.concatenate([np.geomspace(1e-6, 1e4, 61), [np.sqrt(2e-6)]])
FINE = np.geomspace(1e-9, 1e9, 200_001)


@every
def test_nothing_costs_nothing_and_more_never_less(penalty):
    assert penalty.value(np.zeros(2)).tolist() == [0, 0]
    assert np.all(np.diff(penalty.value(np.sort(SIZES))) > 0)
    assert penalty.slope(SIZES).min() >= 0


@every
def test_functions_keep_the_shape_and_the_argument(penalty):
    for shape in ((), (3,), (2, 3)):
        size = np.full(shape, 0.3)
        for function in (penalty.value, penalty.slope, penalty.curvature, penalty.weight):
            assert np.shape(function(size)) == shape
        assert np.all(size == 0.3)


@every
@pytest.mark.parametrize("size", [1e-3, 0.02, 0.3, 5.0])
def test_slope_and_curvature_are_derivatives(penalty, size):
    t = np.array([size])
    h = 0.002 * size
    assert naive.taylor_order(lambda u: penalty.value(t + u), penalty.slope(t), h) > 1.9
    assert naive.taylor_order(lambda u: penalty.slope(t + u), penalty.curvature(t), h) > 1.9


@every
def test_the_slope_at_nothing_is_its_limit(penalty):
    assert np.allclose(penalty.slope(np.zeros(1)), penalty.slope(np.array([1e-12])), atol=1e-5)


@every
def test_the_weight_is_the_largest_slope_from_there_on(penalty):
    slopes = penalty.slope(FINE)
    for t in [0.0, *SIZES]:
        brute = slopes[t <= FINE].max(initial=float(penalty.slope(np.array([t]))[0]))
        assert float(penalty.weight(np.array([t]))[0]) == pytest.approx(brute, rel=1e-6)


@every
def test_each_step_majorises_psi_and_psi_is_phi_up_to_a_constant(penalty):
    t = np.concatenate([[0.0], np.geomspace(1e-8, 1e2, 40_001)])
    weight = penalty.weight(t)
    assert np.all(np.diff(weight) <= 1e-14)  # psi is concave
    psi = np.concatenate([[0.0], np.cumsum(np.diff(t) * (weight[1:] + weight[:-1]) / 2)])
    for at in range(0, len(t), 2000):
        assert np.all(psi[at] + weight[at] * (t - t[at]) >= psi - 1e-7 * psi[-1])
    assert np.all(psi >= penalty.value(t) - 1e-7 * psi[-1])
    if penalty != Power(1.0, 1e-6):  # convex throughout: its weight is the slope at infinity
        beyond = t > penalty.resolution
        offset = (psi - penalty.value(t))[beyond]
        assert np.ptp(offset) <= 1e-6 * psi[-1]


@every
def test_beyond_its_resolution_a_penalty_is_concave(penalty):
    if penalty == Power(1.0, 1e-6):
        assert penalty.resolution == 0
        return
    assert np.all(penalty.curvature(SIZES[SIZES > 1.001 * penalty.resolution]) <= 0)
    below = SIZES[SIZES < 0.999 * penalty.resolution]
    assert np.all(penalty.curvature(below) > 0)
    assert (penalty.resolution > 0) == (isinstance(penalty, Power) and penalty.exponent < 1)


@pytest.mark.parametrize("eps", [1e-8, 1e-2, 4.0])
@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.9])
def test_the_constant_of_off_support_in_the_format(alpha, eps):
    said = alpha * eps ** ((alpha - 1) / 2) * (1 - alpha) ** -0.5 * ((2 - alpha) / (1 - alpha)) ** (alpha / 2 - 1)
    assert float(Power(alpha, eps).weight(np.zeros(1))[0]) == pytest.approx(said)
    assert float(Power(1.0, eps).weight(np.zeros(1))[0]) == float(GroupLasso().weight(np.zeros(1))[0]) == 1


def test_values_by_hand():
    # (9 + 16)^(1/2 / 2) - 16^(1/4) = sqrt(5) - 2; its slope 1/2 3 25^(-3/4)
    assert np.allclose(Power(0.5, 16.0).value(np.array([3.0])), np.sqrt(5) - 2)
    assert np.allclose(Power(0.5, 16.0).slope(np.array([3.0])), 1.5 * 25**-0.75)
    assert np.allclose(GroupLasso().value(np.array([3.0])), 3)
    assert np.allclose(Power(1.0, 0.0).value(SIZES), SIZES)


def test_penalties_by_name():
    assert make_penalty("power", 0.7, 1e-3) == Power(0.7, 1e-3)
    assert make_penalty("power", None, None) == Power(0.5, 1e-6)
    assert make_penalty("power", 1.0, 0.0) == Power(1.0, 0.0)
    assert make_penalty("group-lasso", None, None) == GroupLasso()
    assert {make_penalty(name, None, None).name for name in ("power", "group-lasso")} == {"power", "group-lasso"}
