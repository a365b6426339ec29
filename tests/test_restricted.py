import naive
import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.convex import restricted
from relax.convex.restricted import solve_restricted
from relax.convex.semismooth import proximal
from relax.iterate import Stop, iterate
from relax.sparsity.reach import Reach

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


@pytest.mark.parametrize("start", [0.0, 0.05])
@pytest.mark.parametrize("name", STEPS)
def test_all_candidates_of_a_small_step(name, start):
    step = STEPS[name]
    quadratic, linear, _ = naive.reduced(step)
    quadratic += np.diag(np.repeat(step.bends, step.rows.shape[1]))
    s = solve_restricted(quadratic, linear, step.weights, np.full(step.rows.shape, start), step.reach)
    assert naive.step_violation(step, s) <= 1e-8
    assert np.allclose(step.reach.project(s), s, rtol=1e-13, atol=1e-16)


REACHES = [Reach((2,)), Reach((2,), 0.0), Reach(tangent=0.5), Reach(largest=0.3), Reach(tangent=2.0, largest=0.2)]


def general(seed, reach, kept, rank=None):
    """A random restricted step under a reach, `kept` of its groups without a weight."""
    rng = np.random.default_rng(seed)
    groups, width = 2 + seed % 7, len(reach.axes)
    columns = rng.normal(size=(rank or width * groups + 2, width * groups))
    linear = -columns.T @ rng.normal(size=len(columns))
    weights = rng.uniform(0.1, 0.5, groups) * 2 * np.abs(linear).max()
    weights[:kept] = 0.0
    return columns.T @ columns, linear, weights


def optimal(quadratic, linear, weights, s, reach, tolerance=1e-9):
    """Whether s can be had, and no proximal gradient step, of a length of its own and by loops, leaves it."""
    gradient = 2 * (quadratic @ s.ravel() + linear).reshape(s.shape)
    pace = 0.3 / np.trace(quadratic)
    for force, lam, w in zip(s, gradient, weights, strict=True):
        if not np.allclose(naive.nearest(force, reach), force, rtol=1e-12):
            return False
        inner = naive.nearest_in_cone(force - pace * lam, reach.tangent)
        size = np.linalg.norm(inner)
        moved = inner * min(max(size - pace * w, 0), reach.largest) / size if size > 0 else inner
        if np.linalg.norm(moved - force) > tolerance * pace * 2 * np.abs(linear).max():
            return False
    return True


@few
@given(st.integers(0, 10_000), st.sampled_from(REACHES), st.integers(0, 2), st.sampled_from([0.0, 1e-3, 1.0, 1e3]))
def test_cones_caps_and_kept_groups_from_anywhere(seed, reach, kept, far):
    data = general(seed, reach, kept)
    start = far * np.random.default_rng(seed + 1).normal(size=(len(data[2]), len(reach.axes)))
    s = solve_restricted(*data, start, reach)
    assert optimal(*data, s, reach)
    again = solve_restricted(*data, s, reach)
    assert np.allclose(again, s, rtol=1e-9, atol=1e-9)
    assert not s.any() or not optimal(*data, 1.001 * s, reach)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("reach", REACHES)
def test_newton_s_end_is_quadratic(reach, seed):
    data = general(seed, reach, 1)
    s = solve_restricted(*data, np.zeros((len(data[2]), len(reach.axes))), reach)
    problem = proximal(*data, reach)
    near = problem.state(reach.project(s * (1 + 1e-3 * np.random.default_rng(seed).normal(size=s.shape))))
    run = iterate(problem, near, 20)
    assert run.stop is Stop.CONVERGED
    assert run.steps <= 4


@few
@given(st.integers(0, 10_000), st.sampled_from(REACHES))
def test_a_singular_quadratic_under_a_reach(seed, reach):
    data = general(seed, reach, 0, rank=3)
    s = solve_restricted(*data, np.zeros((len(data[2]), len(reach.axes))), reach)
    assert optimal(*data, s, reach, 1e-7)


@pytest.mark.parametrize("reach", REACHES)
def test_where_newton_gives_up_the_cone_program_takes_over(reach, monkeypatch):
    data = general(5, reach, 1)
    start = np.ones((len(data[2]), len(reach.axes)))
    wanted = solve_restricted(*data, start, reach)
    monkeypatch.setattr(restricted, "WARM", 0)
    assert np.allclose(solve_restricted(*data, start, reach), wanted, atol=1e-9)
    monkeypatch.setattr(restricted, "LIMIT", 0)  # what Clarabel alone makes of it
    assert np.allclose(solve_restricted(*data, start, reach), wanted, atol=1e-4)


def test_limits_by_hand():
    # G = 2 I: against b, of size (|2 b| - w) / (2 x 2) = 2
    data = (2 * np.eye(3), np.array([0.0, 3.0, -4.0]), np.array([2.0]), np.zeros((1, 3)))
    assert np.allclose(solve_restricted(*data), [[0, -1.2, 1.6]])
    assert np.allclose(solve_restricted(*data, Reach(largest=1.0)), [[0, -0.6, 0.8]])
    # it leans by 37 degrees, less than 45; along the side of a steeper cone the pull is that of P_C(-2 b)
    assert np.allclose(solve_restricted(*data, Reach(tangent=1.0)), [[0, -1.2, 1.6]])
    side = np.array([0, -1, 2]) / np.sqrt(5)
    assert np.allclose(solve_restricted(*data, Reach(tangent=0.5)), [((side @ [0, -6, 8]) - 2) / 4 * side])
    free = (*data[:2], np.zeros(1), data[3])
    assert np.allclose(solve_restricted(*free), [[0, -1.5, 2]])
    assert np.allclose(solve_restricted(np.eye(1), np.array([3.0]), np.ones(1), np.ones((1, 1)), Reach((2,), 0.0)), 0)
    assert np.allclose(solve_restricted(np.eye(1), np.array([3.0]), np.ones(1), np.ones((1, 1)), Reach((2,))), -2.5)


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
