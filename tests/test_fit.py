import numpy as np
import pytest
from test_faces import every_reach, minimiser, quadratic

from relax.convex.fit import fit_within, solve_definite
from relax.sparsity.reach import Reach


@every_reach
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("started", [False, True])
def test_the_fit_is_the_minimum_that_projected_gradients_find(reach, seed, started):
    matrix, linear = quadratic(len(reach.axes), seed)
    start = np.random.default_rng(seed).normal(size=linear.shape) if started else None
    found = fit_within(reach, matrix / 2, linear / 2, start)
    best = minimiser(reach, matrix, linear)
    assert np.allclose(found, best, atol=1e-7), np.abs(found - best).max()
    assert np.allclose(reach.project(found), found, atol=1e-14)


def test_neighbours_nearly_parallel_do_not_stall_it():
    """What columns of K^-1 of neighbouring vertices look like: a condition number of 1e8."""
    rng = np.random.default_rng(5)
    base = rng.normal(size=(40, 1))
    columns = np.hstack([base + 1e-4 * rng.normal(size=(40, 1)) for _ in range(8)])
    matrix, linear = columns.T @ columns, -(columns.T @ (3 * base)).reshape(8, 1)
    found = fit_within(Reach((2,), 0.0, 0.6), matrix, linear, None)
    gradient = 2 * ((matrix @ found.ravel()).reshape(found.shape) + linear)
    at_cap, at_zero = found[:, 0] >= 0.6 - 1e-12, found[:, 0] <= 0
    assert (gradient[~at_cap & ~at_zero] < 1e-5).all() and (gradient[at_cap] <= 1e-5).all() and (gradient[at_zero] >= -1e-5).all()
    assert found.sum() == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_a_badly_conditioned_fit_is_a_fixed_point_of_the_projected_gradient(seed):
    """Up to a condition number of 1e8; no step along the gradient, projected, goes anywhere."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 16))
    turn = np.linalg.qr(rng.normal(size=(3 * count, 3 * count)))[0]
    matrix = turn * np.geomspace(1, 1e-8, 3 * count) @ turn.T
    matrix, linear = (matrix + matrix.T) / 2, 0.3 * rng.normal(size=(count, 3))
    reach = Reach((0, 1, 2), 0.5, 1.0)
    found = fit_within(reach, matrix, linear, None)
    gradient = 2 * ((matrix @ found.ravel()).reshape(found.shape) + linear)
    assert np.abs(found - reach.project(found - 0.5 * gradient)).max() < 1e-11


def test_solve_definite_takes_nothing_and_what_is_singular():
    assert solve_definite(np.zeros((0, 0)), np.zeros(0)).size == 0
    assert np.allclose(solve_definite(np.ones((2, 2)), np.array([2.0, 2.0])), [1.0, 1.0])
