from dataclasses import replace

import numpy as np
import pytest
import zoo

from relax.convex.backends import BACKENDS
from relax.convex.quadratic import solve_least_squares, solve_with_osqp
from relax.convex.subproblem import certify
from relax.errors import BackendError
from relax.sparsity.reach import Reach

STEPS = zoo.convex_steps()
SQUARES = STEPS["least squares"]
AXIAL = [name for name, step in STEPS.items() if step.rows.shape[1] == 1]


@pytest.mark.parametrize("name", AXIAL)
def test_osqp_alone_is_good_to_six_digits(name):
    step = STEPS[name]
    assert -1e-12 <= certify(step, solve_with_osqp(step)).gap <= 1e-6


def test_least_squares_are_the_normal_equations():
    step = SQUARES
    columns = np.linalg.inv(step.stiffness.toarray())[:, step.rows.ravel()]
    metric = step.metric.toarray()
    normal = columns.T @ metric @ columns + np.diag(np.repeat(step.curvature, 3))
    wanted = np.linalg.solve(normal, -columns.T @ metric @ step.unsupported).reshape(-1, 3)
    found = solve_least_squares(step)
    assert np.allclose(found, wanted, rtol=1e-10, atol=1e-12 * np.abs(wanted).max())
    assert np.array_equal(solve_with_osqp(step), found)
    assert certify(step, found).gap == pytest.approx(0, abs=1e-13)
    # by strong convexity the gap bounds the distance to the solution
    for seed in range(4):
        off = found + 0.01 * np.random.default_rng(seed).normal(size=found.shape) * np.abs(found).max()
        solution = certify(step, off)
        miss = step.curvature @ np.sum((off - wanted) ** 2, axis=1)
        assert 0 < miss <= solution.value - solution.bound


def test_iterating_reweighted_least_squares_goes_to_the_group_lasso():
    step = STEPS["heavy"]
    wanted = BACKENDS["working-set"](step, step.nothing)
    s = np.full(step.rows.shape, 0.1)
    for _ in range(300):  # the parabola that touches |s| from above has the curvature w / (2 |s|)
        size = np.sqrt(np.sum(s**2, axis=1) + 1e-14)
        s = solve_least_squares(replace(step, weights=0 * step.weights, curvature=step.weights / (2 * size)))
    assert certify(step, s).value == pytest.approx(wanted.value, rel=1e-5)


@pytest.mark.parametrize("largest", [np.inf, 0.05])
def test_least_squares_that_only_push(largest):
    axial = STEPS["vertical"]
    step = replace(axial, weights=0 * axial.weights, curvature=SQUARES.curvature, reach=Reach((2,), 0.0, largest))
    found = {name: solve(step, step.nothing) for name, solve in BACKENDS.items()}
    for solution in found.values():
        assert solution.gap <= 1e-9
        assert np.allclose(solution.amplitudes, found["clarabel"].amplitudes, atol=1e-7)
    assert (found["osqp"].amplitudes >= 0).all() and not found["osqp"].standing.all()


def test_a_pyramid_inside_the_cone_comes_close_with_its_sides():
    lean = STEPS["lean 30"]
    step = replace(lean, weights=0 * lean.weights, curvature=SQUARES.curvature)
    best = BACKENDS["clarabel"](step, step.nothing)
    values = []
    for sides in (4, 8, 32, 128):
        raw = solve_with_osqp(step, sides)
        standing = raw[np.linalg.norm(raw, axis=1) > 1e-6 * np.abs(raw).max()]
        assert np.allclose(step.reach.project(standing), standing, atol=1e-7 * np.abs(raw).max())
        values.append(certify(step, raw).value)
    assert values == sorted(values, reverse=True)
    assert values[0] > best.value * (1 + 1e-4)
    assert values[-1] == pytest.approx(best.value, rel=1e-3)
    with pytest.raises(BackendError, match="a pyramid of 2 sides holds no space"):
        solve_with_osqp(step, 2)


def test_leaning_at_most_90_degrees_needs_no_pyramid():
    flat = STEPS["lean 90"]
    step = replace(flat, weights=0 * flat.weights, curvature=SQUARES.curvature)
    one, other = (BACKENDS[name](step, step.nothing) for name in ("osqp", "clarabel"))
    assert one.gap <= 1e-9
    assert np.allclose(one.amplitudes, other.amplitudes, atol=1e-7)


def test_what_is_no_linear_system_is_refused():
    for step in (STEPS["medium"], replace(SQUARES, reach=Reach(largest=1.0))):
        with pytest.raises(BackendError, match="is no linear system"):
            solve_least_squares(step)
    unseen = replace(SQUARES, metric=0 * SQUARES.metric, curvature=0 * SQUARES.curvature)
    with pytest.raises(BackendError, match="the solution of a convex step is not unique"):
        solve_least_squares(unseen)
