import naive
import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.convex.restricted import solve_restricted

few = settings(derandomize=True, max_examples=40, deadline=None)
STEPS = zoo.convex_steps()


def problem(seed, fraction, rank=None):
    """A random restricted step (G, b, w); `rank` below 3k leaves G singular."""
    rng = np.random.default_rng(seed)
    groups = 1 + seed % 6
    columns = rng.normal(size=(rank or 3 * groups + 2, 3 * groups))
    linear = columns.T @ rng.normal(size=len(columns))
    weights = rng.uniform(0.5, 2, groups)
    largest = np.linalg.norm(2 * linear.reshape(-1, 3), axis=1) / weights
    return columns.T @ columns, linear, fraction * largest.max() * weights


def parallel(closeness):
    """Three pairs of neighbours whose columns differ by `closeness` only, as those of neighbouring candidates do."""
    rng = np.random.default_rng(1)
    base = rng.normal(size=(30, 9))
    columns = np.hstack([base, base + closeness * rng.normal(size=base.shape)])
    linear = -columns.T @ (base @ rng.normal(size=9) + 0.1 * rng.normal(size=30))
    return columns.T @ columns, linear, np.full(6, 0.1 * np.abs(linear).max())


def close(quadratic, linear, weights, s, tolerance=1e-9):
    """Whether s meets the optimality conditions, and as a check on those, beats the naive answer."""
    naively = naive.group_value(quadratic, linear, weights, naive.group_lasso(quadratic, linear, weights, 3000))
    value = naive.group_value(quadratic, linear, weights, s)
    return naive.violation(quadratic, linear, weights, s) <= tolerance and value <= naively + 1e-10 * abs(naively)


@few
@given(st.integers(0, 10_000), st.sampled_from([0.02, 0.3, 0.9]))
def test_from_nothing(seed, fraction):
    data = problem(seed, fraction)
    assert close(*data, solve_restricted(*data, np.zeros((len(data[2]), 3))))


@few
@given(st.integers(0, 10_000), st.sampled_from([0.02, 0.3, 0.9]), st.sampled_from([1e-6, 1.0, 1e3]))
def test_from_anywhere(seed, fraction, far):
    data = problem(seed, fraction)
    start = far * np.random.default_rng(seed + 1).normal(size=(len(data[2]), 3))
    assert close(*data, solve_restricted(*data, start))


@few
@given(st.integers(0, 10_000))
def test_the_answer_is_the_naive_one(seed):
    data = problem(seed, 0.2)
    s = solve_restricted(*data, np.zeros((len(data[2]), 3)))
    wanted = naive.group_lasso(*data)
    assert np.allclose(s, wanted, atol=1e-6 * max(1e-3, np.abs(wanted).max()))
    assert np.array_equal(s.any(axis=1), wanted.any(axis=1))


@few
@given(st.integers(0, 10_000))
def test_started_at_the_answer_it_stays(seed):
    data = problem(seed, 0.2)
    s = solve_restricted(*data, np.zeros((len(data[2]), 3)))
    assert np.allclose(solve_restricted(*data, s), s, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", [3, 5, 11])
def test_heavy_weights_leave_exact_zeros(seed):
    quadratic, linear, weights = problem(seed, 1.001)
    start = np.ones((len(weights), 3))
    assert not solve_restricted(quadratic, linear, weights, start).any()
    assert not solve_restricted(quadratic, linear, weights, 0 * start).any()


@pytest.mark.parametrize("closeness", [1e-1, 1e-2, 1e-3])
@pytest.mark.parametrize("start", [0.0, 1.0])
def test_neighbours_with_nearly_parallel_columns(closeness, start):
    data = parallel(closeness)
    s = solve_restricted(*data, np.full((6, 3), start))
    assert close(*data, s)
    assert s.any(axis=1).sum() == 3  # one of each pair


@pytest.mark.parametrize("closeness", [1e-4, 1e-6, 1e-8])
def test_columns_so_parallel_that_only_the_value_is_known(closeness):
    data = parallel(closeness)
    alone = (data[0][:9, :9], data[1][:9], data[2][:3])  # one of each pair: at most `closeness` worse
    best = naive.group_value(*alone, naive.group_lasso(*alone))
    s = solve_restricted(*data, np.zeros((6, 3)))
    assert naive.group_value(*data, s) <= best + 1e-7 * abs(best)
    assert naive.violation(*data, s) <= 1e-2


@pytest.mark.parametrize("rank", [2, 4])
def test_a_singular_quadratic(rank):
    data = problem(5, 0.2, rank)
    assert close(*data, solve_restricted(*data, np.zeros((6, 3))), 1e-8)


@pytest.mark.parametrize("name", STEPS)
def test_all_candidates_of_a_small_step(name):
    step = STEPS[name]
    quadratic, linear, _ = naive.reduced(step)
    s = solve_restricted(quadratic, linear, step.weights, np.zeros(step.rows.shape))
    assert naive.violation(quadratic, linear, step.weights, s) <= 1e-8


def test_one_group_by_hand():
    # G = 2 I: the force against b, of size (|2 b| - w) / (2 x 2)
    s = solve_restricted(2 * np.eye(3), np.array([0.0, 3.0, 4.0]), np.array([2.0]), np.zeros((1, 3)))
    assert np.allclose(s, [[0, -0.6 * 2, -0.8 * 2]])


def test_a_wrong_answer_is_seen():
    data = problem(5, 0.2)
    s = solve_restricted(*data, np.zeros((6, 3)))
    assert not close(*data, 1.001 * s)
    dropped = s.copy()
    dropped[np.flatnonzero(s.any(axis=1))[0]] = 0
    assert not close(*data, dropped)
