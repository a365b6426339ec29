"""Accelerated chord steps: the affine combination by its definition, a change of low rank seen through, and when they pay."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from relax.factor import Factor
from relax.membrane.chords import AIM, DEPTH, FACTORISATION, ROUGH, Chords


def stiff(size, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size))
    return root @ root.T + size * np.eye(size)


def test_a_step_is_that_of_the_best_affine_combination():
    """By its definition, with a multiplier for the sum of the shares; only the last points are remembered."""
    rng = np.random.default_rng(0)
    matrix = stiff(9, 1)
    chords, points, steps = Chords(Factor(csc_array(matrix))), [], []
    for _ in range(DEPTH + 4):
        point, unbalanced = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
        chords, step = chords.step(point, unbalanced, 1.0)
        points.append(point.ravel())
        steps.append(np.linalg.solve(matrix, unbalanced.ravel()))
        x, d = (np.array(each[-DEPTH - 1 :]) for each in (points, steps))
        count = len(x)
        bordered = np.block([[d @ d.T, np.ones((count, 1))], [np.ones((1, count)), np.zeros((1, 1))]])
        share = np.linalg.solve(bordered, np.append(np.zeros(count), 1.0))[:count]
        np.testing.assert_allclose((point + step).ravel(), share @ (x + d), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("rank", [1, 2, 4])
def test_a_change_of_low_rank_is_seen_through_where_plain_steps_leave_for_good(rank):
    rng = np.random.default_rng(rank)
    old, change = stiff(30, 2), rng.normal(size=(30, rank))
    new, forces = old + 40 * change @ change.T, rng.normal(size=30)
    chords = Chords(Factor(csc_array(old)))
    x = plain = np.zeros((10, 3))
    first = np.linalg.norm(forces)
    for _ in range(rank + 2):
        chords, step = chords.step(x, (forces - new @ x.ravel()).reshape(-1, 3), 1.0)
        x = x + step
        plain = plain + np.linalg.solve(old, forces - new @ plain.ravel()).reshape(-1, 3)
    assert np.linalg.norm(forces - new @ x.ravel()) < 1e-6 * first
    assert np.linalg.norm(forces - new @ plain.ravel()) > first


def test_points_that_repeat_do_no_harm():
    chords = Chords(Factor(csc_array(np.eye(3))))
    for _ in range(4):
        chords, step = chords.step(np.ones((1, 3)), np.full((1, 3), 0.5), 1.0)
        assert np.allclose(step, 0.5)


@pytest.mark.parametrize("start", [3e-1, 1e-2, 1e-5])
@pytest.mark.parametrize("fall", [0.9, 0.5, 0.3, 0.1, 1e-2, 1e-4])
def test_they_end_where_a_factorisation_is_cheaper(start, fall):
    """Of one pace: about as cheap, by the model, as to factorise at once or never; where hardly anything is gained they end."""

    def after(residual):  # Newton leaves the square, and chord steps after it keep its pace
        return FACTORISATION + np.log(AIM) / np.log(residual) if residual > AIM else 0.0

    residuals, chords = [start], Chords(Factor(csc_array(np.eye(3))))
    while residuals[-1] > AIM and chords.pay(residuals[-1]):
        chords = Chords(chords.factor, residuals=tuple(residuals))
        residuals.append(residuals[-1] * fall)
    steps = len(residuals) - 1
    assert steps >= 1
    if fall > 0.75:
        assert steps <= 3
    else:
        never = np.ceil(np.log(AIM / start) / np.log(fall))
        assert steps + after(residuals[-1]) <= min(after(start) + 6, never + 3)


def test_one_that_does_not_fall_at_first_is_given_a_second_step_and_no_more():
    factor = Factor(csc_array(np.eye(3)))
    assert Chords(factor).pay(0.2)
    assert Chords(factor, residuals=(0.2,)).pay(0.4)
    assert not Chords(factor, residuals=(0.2, 0.4)).pay(0.3)
    assert Chords(factor, residuals=(0.2, 0.4)).pay(0.04)
    assert not Chords(factor, residuals=(0.2, 0.4)).pay(float("nan"))


def test_far_from_rest_they_go_on_at_any_pace_that_is_no_creep():
    """By cost alone a factorisation would be due, at a fall of a half from 0.04 on; it is to be near enough to serve the dual."""
    factor = Factor(csc_array(np.eye(3)))
    way = [0.2 * 0.5**step for step in range(20)]
    last = next(step for step in range(2, 20) if not Chords(factor, tuple(way[:step])).pay(way[step]))
    assert way[last] <= ROUGH < way[last - 1]
