from dataclasses import fields
from math import inf

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive_judge import profile

from relax.errors import InputError
from relax.sparsity.parameters import parameters
from relax.sparsity.penalties import (
    MCP,
    PENALTIES,
    SCAD,
    Count,
    GroupLasso,
    LogSum,
    Power,
    group_prox,
    is_convex,
    make_penalty,
    steepest,
)

SMOOTH = [
    GroupLasso(),
    Power(),
    Power(0.1, 1e-4),
    Power(0.9, 1e-2),
    Power(1.0, 1e-6),
    Power(1.0, 0.0),
    Power(0.5, 4.0),
    LogSum(0.3),
    LogSum(1e-3),
    LogSum(1e4),
    MCP(0.7),
    MCP(1e-3),
    SCAD(0.06),
    SCAD(0.3, 2.01),
    SCAD(1e-3, 30.0),
]
ALL = [*SMOOTH, Count()]
smooth = pytest.mark.parametrize("penalty", SMOOTH, ids=str)
every = pytest.mark.parametrize("penalty", ALL, ids=str)
SIZES = np.concatenate([np.geomspace(1e-6, 1e4, 61), [np.sqrt(2e-6)]])
FINE = np.geomspace(1e-9, 1e9, 200_001)
FUNCTIONS = ("value", "slope", "curvature", "weight")


def at(function, size):
    return float(function(np.array([size]))[0])


def settings_of(penalty, weight=1.0):
    return {"name": penalty.name, "weight": weight} | {name: getattr(penalty, name) for name in parameters(type(penalty))}


@every
def test_nothing_costs_nothing_and_more_never_less(penalty):
    assert penalty.value(np.zeros(2)).tolist() == [0, 0]
    assert np.all(np.diff(penalty.value(np.sort(SIZES))) >= 0)
    assert penalty.value(SIZES).min() > 0
    assert penalty.slope(SIZES).min() >= 0


@every
def test_values_and_slopes_are_the_plain_formulas(penalty):
    cost, slope, largest = profile(settings_of(penalty, 2.5))
    for size in SIZES:
        # the plain difference of powers cancels where the force is small
        slight = 1e-15 * getattr(penalty, "smoothing", 0.0) ** (getattr(penalty, "exponent", 1.0) / 2)
        assert 2.5 * at(penalty.value, size) == pytest.approx(cost(size), rel=1e-9, abs=2.5 * slight)
        assert 2.5 * at(penalty.slope, size) == pytest.approx(slope(size), rel=1e-12, abs=1e-15)
    assert 2.5 * steepest(penalty) == pytest.approx(largest, rel=1e-14)


@every
def test_functions_keep_the_shape_and_the_argument(penalty):
    for shape in ((), (3,), (2, 3), (0,)):
        size = np.full(shape, 0.3)
        for name in FUNCTIONS:
            assert np.shape(getattr(penalty, name)(size)) == shape
        assert np.shape(penalty.prox(size, 0.1)) == shape
        assert np.all(size == 0.3)
    steps = [0.1, 1.0, 10.0]
    together = penalty.prox(np.full(3, 0.3), np.array(steps))
    assert together.tolist() == [float(penalty.prox(np.array([0.3]), step)[0]) for step in steps]


@every
def test_single_precision_is_taken_as_double(penalty):
    single = np.array([0.0, 0.3, 2.0], dtype=np.float32)
    for name in FUNCTIONS:
        function = getattr(penalty, name)
        assert function(single).dtype == np.float64
        assert np.array_equal(function(single), function(single.astype(float)))
    assert penalty.prox(single, np.float32(0.1)).dtype == np.float64


@every
def test_no_size_overflows(penalty):
    extreme = np.array([0.0, 1e-300, 1e-150, 1.0, 1e150, 1e300])
    with np.errstate(all="raise", under="ignore"):
        for name in FUNCTIONS:
            found = getattr(penalty, name)(extreme)
            assert np.isfinite(found[1:]).all()
            assert np.isfinite(found[0]) or (name == "weight" and isinstance(penalty, Count))
        for step in (1e-6, 1.0, 1e6):
            nearest = penalty.prox(extreme, step)
            assert np.isfinite(nearest).all()
            assert nearest[0] == 0 and nearest[-1] == pytest.approx(1e300)
    assert np.all(np.diff(penalty.value(extreme)) >= 0) and np.all(np.diff(penalty.weight(extreme[1:])) <= 0)


@smooth
@pytest.mark.parametrize("size", [1.1e-3, 0.02, 0.31, 5.0])
def test_slope_and_curvature_are_derivatives(penalty, size):
    t = np.array([size])
    h = 0.002 * size
    assert naive.taylor_order(lambda u: penalty.value(t + u), penalty.slope(t), h) > 1.9
    assert naive.taylor_order(lambda u: penalty.slope(t + u), penalty.curvature(t), h) > 1.9


@smooth
def test_the_slope_at_nothing_is_its_limit(penalty):
    assert np.allclose(penalty.slope(np.zeros(1)), penalty.slope(np.array([1e-12])), atol=1e-5)
    if not isinstance(penalty, Power):
        assert at(penalty.slope, 0.0) == steepest(penalty) == 1


@smooth
def test_the_weight_is_the_largest_slope_from_there_on(penalty):
    slopes = penalty.slope(FINE)
    for t in [0.0, *SIZES]:
        brute = slopes[t <= FINE].max(initial=at(penalty.slope, t))
        assert at(penalty.weight, t) == pytest.approx(brute, rel=1e-6)


@smooth
def test_each_step_majorises_psi_and_psi_is_phi_up_to_a_constant(penalty):
    t = np.concatenate([[0.0], np.geomspace(1e-8, 1e2, 40_001)])
    weight = penalty.weight(t)
    assert np.all(np.diff(weight) <= 1e-14)  # psi is concave
    psi = np.concatenate([[0.0], np.cumsum(np.diff(t) * (weight[1:] + weight[:-1]) / 2)])
    for touching in range(0, len(t), 2000):
        assert np.all(psi[touching] + weight[touching] * (t - t[touching]) >= psi - 1e-7 * psi[-1])
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


@every
def test_in_the_square_of_the_force_every_penalty_is_concave(penalty):
    u = np.concatenate([[0.0], np.geomspace(1e-8, 1e4, 2001)])
    chords = np.diff(penalty.value(np.sqrt(u))) / np.diff(u)
    assert np.all(np.diff(chords) <= 1e-9 * chords[:-1] + 1e-15)


@pytest.mark.parametrize("eps", [1e-8, 1e-2, 4.0])
@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.9])
def test_the_constant_of_off_support_in_the_format(alpha, eps):
    said = alpha * eps ** ((alpha - 1) / 2) * (1 - alpha) ** -0.5 * ((2 - alpha) / (1 - alpha)) ** (alpha / 2 - 1)
    assert steepest(Power(alpha, eps)) == pytest.approx(said)
    assert steepest(Power(1.0, eps)) == steepest(GroupLasso()) == 1


def test_values_by_hand():
    # (9 + 16)^(1/2 / 2) - 16^(1/4) = sqrt(5) - 2; its slope 1/2 3 25^(-3/4)
    assert at(Power(0.5, 16.0).value, 3.0) == pytest.approx(np.sqrt(5) - 2)
    assert at(Power(0.5, 16.0).slope, 3.0) == pytest.approx(1.5 * 25**-0.75)
    assert at(GroupLasso().value, 3.0) == 3
    assert np.allclose(Power(1.0, 0.0).value(SIZES), SIZES)
    # 2 log(1 + 6 / 2) = 4 log 2
    assert at(LogSum(2.0).value, 6.0) == pytest.approx(4 * np.log(2))
    assert at(LogSum(2.0).slope, 2.0) == 0.5
    # 3 - 9 / 8 halfway, 2 beyond the knee
    assert MCP(4.0).value(np.array([3.0, 4.0, 9.0])).tolist() == [1.875, 2, 2]
    # slope 1 to 2, down to 0 at 6: 2 + (1 + 1/2) / 2 * 2 = 3.5 at 4, 4 from 6 on
    assert SCAD(2.0, 3.0).value(np.array([1.0, 2.0, 4.0, 6.0, 7.0])).tolist() == [1, 2, 3.5, 4, 4]
    assert SCAD(2.0, 3.0).slope(np.array([1.0, 2.0, 4.0, 6.0, 7.0])).tolist() == [1, 1, 0.5, 0, 0]
    assert Count().value(np.array([0.0, 1e-300, 2.0])).tolist() == [0, 1, 1]
    assert Count().weight(np.array([0.0, 1e-300, 2.0])).tolist() == [inf, 0, 0]


@pytest.mark.parametrize("penalty", [LogSum(1e9), MCP(1e9), SCAD(1e9), Power(1.0, 0.0), Power(1.0, 1e-24)], ids=str)
def test_the_group_lasso_is_the_limit(penalty):
    size = np.geomspace(1e-3, 1e2, 31)
    lasso = GroupLasso()
    assert np.allclose(penalty.value(size), size, rtol=1e-6)
    assert np.allclose(penalty.slope(size), 1, rtol=1e-6) and np.allclose(penalty.weight(size), 1, rtol=1e-6)
    for step in (1e-2, 1.0, 10.0):
        assert np.allclose(penalty.prox(size, step), lasso.prox(size, step), rtol=1e-6, atol=1e-7)


def test_counting_is_the_limit_of_a_small_knee_under_a_fitting_weight():
    size = np.geomspace(1e-3, 1e2, 31)
    for penalty, top in ((MCP(1e-6), 0.5e-6), (SCAD(1e-6), 2.35e-6)):
        assert np.allclose(penalty.value(size) / top, Count().value(size))
        assert np.allclose(penalty.prox(size, 0.3 / top), Count().prox(size, 0.3))


@every
def test_which_penalties_are_one_convex_step(penalty):
    assert is_convex(penalty) == (isinstance(penalty, GroupLasso) or getattr(penalty, "exponent", 0.5) == 1)
    assert is_convex(penalty) == bool((penalty.curvature(SIZES) >= 0).all() and not isinstance(penalty, Count))
    assert np.isfinite(steepest(penalty)) != isinstance(penalty, Count)


EXPONENT = st.floats(-6, 6)
STRANGE = [
    Power(0.02, 1e-10),
    Power(0.99, 1e-8),
    Power(0.999999, 1e-3),
    Power(1e-3, 1.0),
    LogSum(1e-8),
    SCAD(1e3, 2.0001),
    MCP(1e5),
]


@pytest.mark.parametrize("penalty", [*ALL, *STRANGE], ids=str)
@settings(max_examples=60, deadline=None)
@given(size=EXPONENT, step=EXPONENT, near=st.booleans())
def test_the_prox_is_nowhere_beaten(penalty, size, step, near):
    z = 10.0 ** (size / 2)
    # half of the time steps at which keeping the force and dropping it cost about the same
    step = 10.0 ** (step / 6) * z * z / at(penalty.value, z) if near else 10.0**step
    t = float(penalty.prox(np.array([z]), step)[0])
    least, where = naive.prox(penalty.value, z, step)
    assert 0 <= t <= z
    mine = t * (t / 2 - z) + step * at(penalty.value, t)
    assert mine <= least + 1e-14 * z * z
    if abs(t - where) > 1e-4 * z:  # another minimum, as low
        assert abs(mine - least) <= 1e-12 * z * z


@every
def test_the_prox_is_stationary_to_the_last_digits(penalty):
    size = np.geomspace(1e-4, 1e3, 400)
    for step in np.geomspace(1e-6, 1e6, 49):
        t = penalty.prox(size, step)
        stands = t > 0
        force = t - size + step * penalty.slope(t)
        stiffness = 1 + step * np.abs(penalty.curvature(t)) + step * penalty.slope(t) / np.maximum(t, 1e-300)
        assert np.all(np.abs(force[stands]) <= 1e-14 * (size + stiffness * t)[stands])
        # nothing stands only where the steepest slope, or the jump, holds it down
        assert np.all(size[~stands] <= step * steepest(penalty))


@pytest.mark.parametrize("offset", [-1e-7, -1e-9, 1e-9, 1e-7])
def test_the_prox_is_exact_where_its_two_searches_meet(offset):
    # F is convex, so its one minimum is on one side of t2; the ends of both searches there are equal in value to the last digit
    penalty = Power(0.5, 1e-2)
    t = np.sqrt(3) * penalty.resolution * (1 + offset)
    step = 0.5 / abs(at(penalty.curvature, t))
    size = t + step * at(penalty.slope, t)
    assert at(lambda size: penalty.prox(size, step), size) == pytest.approx(t, rel=1e-14)


TIES = [
    (Count(), np.sqrt(8.0), 4.0),  # 8 / 2 = 4
    (MCP(1.0), 2.0, 4.0),  # 2^2 / 2 = 4 knee / 2
    (MCP(1.0), 1.0, 1.0),  # step = knee: level up to the knee
    (SCAD(1.0, 3.0), 4.0, 4.0),  # 4^2 / 2 = 4 (3 + 1) / 2
    (SCAD(1.0, 3.0), 3.0, 2.0),  # level from 1 to 3, the soft threshold being 1
    (GroupLasso(), 3.0, 3.0),
    (LogSum(2.0), 1.0, 1.0),
]


@pytest.mark.parametrize(("penalty", "size", "step"), TIES)
def test_of_equals_the_smaller_is_taken_and_past_them_the_larger(penalty, size, step):
    smaller = {(SCAD(1.0, 3.0), 3.0): 1.0}.get((penalty, size), 0.0)
    assert at(lambda t: penalty.prox(t, step), size) == smaller
    assert at(lambda t: penalty.prox(t, step), size * (1 + 1e-9)) > smaller
    assert at(lambda t: penalty.prox(t, step), size * (1 - 1e-9)) <= smaller


@every
def test_a_step_of_nothing_moves_nothing(penalty):
    assert np.allclose(penalty.prox(SIZES, 0.0), SIZES, rtol=1e-14)


@every
def test_the_prox_of_groups_keeps_directions(penalty):
    rng = np.random.default_rng(4)
    vectors = rng.normal(size=(40, 3)) * np.geomspace(1e-3, 10, 40)[:, None]
    vectors[7] = 0.0
    step = np.geomspace(1e-3, 1.0, 40)
    found = group_prox(penalty, vectors, step)
    assert not found[7].any()
    size, kept = np.linalg.norm(vectors, axis=1), np.linalg.norm(found, axis=1)
    assert np.allclose(kept, penalty.prox(size, step), rtol=1e-12, atol=1e-15)
    assert np.allclose(np.sum(found * vectors, axis=1), size * kept, rtol=1e-12)

    def total(v):
        return 0.5 * np.sum((v - vectors) ** 2, axis=1) + step * penalty.value(np.linalg.norm(v, axis=1))

    for scale in (1e-3, 1e-1, 1.0):
        other = found + scale * size[:, None] * rng.normal(size=(40, 3))
        assert np.all(total(found) <= total(other) + 1e-15)
    assert np.isfinite(group_prox(penalty, np.full((2, 3), 1e300), 1.0)).all()


def test_a_penalty_without_a_prox_is_told_so():
    class Bare:
        name = "bare"

    with pytest.raises(InputError, match="penalty 'bare' has no prox: define prox"):
        group_prox(Bare(), np.ones((2, 3)), 1.0)


def test_penalties_by_name():
    assert make_penalty({"name": "power", "exponent": 0.7, "smoothing": 1e-3}) == Power(0.7, 1e-3)
    assert make_penalty({"name": "power", "exponent": None, "weight": 3.0, "knee": 2.0}) == Power(0.5, 1e-6)
    assert make_penalty({"name": "power", "exponent": 1.0, "smoothing": 0.0}) == Power(1.0, 0.0)
    assert make_penalty({"name": "group-lasso", "exponent": 0.5}) == GroupLasso()
    assert make_penalty({"name": "log-sum", "scale": 2.0}) == LogSum(2.0)
    assert make_penalty({"name": "mcp", "knee": 2.0, "shape": 5.0}) == MCP(2.0)
    assert make_penalty({"name": "scad", "knee": 2.0}) == SCAD(2.0, 3.7)
    assert make_penalty({"name": "scad", "knee": 2.0, "shape": 5.0}) == SCAD(2.0, 5.0)
    assert make_penalty({"name": "count"}) == Count()


@every
def test_a_penalty_comes_back_from_its_settings(penalty):
    assert make_penalty(settings_of(penalty)) == penalty
    assert PENALTIES[penalty.name] is type(penalty)
    assert set(parameters(type(penalty))) == {field.name for field in fields(penalty)}


BAD = [
    (lambda: make_penalty({"name": "l1"}), 'penalty.name is \'l1\': expected one of "group-lasso", "power"'),
    (lambda: make_penalty({}), "penalty.name is None"),
    (
        lambda: make_penalty({"name": "mcp"}),
        'penalty.knee is missing: penalty.name = "mcp" needs it; give a number above 0',
    ),
    (lambda: make_penalty({"name": "log-sum", "knee": 1.0}), 'penalty.scale is missing: penalty.name = "log-sum" needs it'),
    (lambda: LogSum(0.0), "penalty.scale is 0.0: expected a number above 0, newtons"),
    (lambda: LogSum(inf), "penalty.scale is inf"),
    (lambda: MCP(-1.0), "penalty.knee is -1.0: expected a number above 0, newtons"),
    (lambda: SCAD(0.0), "penalty.knee is 0.0"),
    (lambda: SCAD(1.0, 2.0), "penalty.shape is 2.0: expected a number above 2"),
    (lambda: Power(0.0), "penalty.exponent is 0.0: expected a number above 0 and at most 1"),
    (lambda: Power(1.1), "penalty.exponent is 1.1"),
    (lambda: Power(np.nan), "penalty.exponent is nan"),
    (lambda: Power(0.5, -1.0), "penalty.smoothing is -1.0: expected a number above 0, newtons squared"),
    (lambda: Power(0.5, 0.0), "penalty.smoothing = 0: with exponent = 0.5"),
]


@pytest.mark.parametrize(("make", "sentence"), BAD)
def test_parameters_out_of_range_are_refused_in_a_sentence(make, sentence):
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value).startswith(sentence) and "\n" not in str(caught.value)
