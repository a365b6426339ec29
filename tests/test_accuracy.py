"""Answers known by hand, to the last digits of double precision; experiments/accuracy.py has those that take 50 digits."""

from fractions import Fraction

import numpy as np
import pytest
import zoo

from relax.design.form import form
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.membrane.formers import form_find
from relax.membrane.membrane import Membrane
from relax.membrane.springs import Hookean

EPS = np.finfo(float).eps


def top(force):
    nodal = np.zeros((5, 3))
    nodal[4, 2] = force
    return nodal


def test_one_spring_hangs_where_its_law_says():
    membrane = Membrane(np.array([[0, 1]]), np.array([0.5]), np.array([3.0]), Hookean(), np.array([True, False]))
    found = form_find(membrane, np.array([[0.0, 0, 0], [0, 0, -0.9]]), np.array([[0.0, 0.0, -1.0]]))
    assert found.positions[1, 2] == pytest.approx(-float(Fraction(1, 2) + Fraction(1, 3)), rel=2 * EPS)


def test_the_pyramid_rises_to_three_quarters():
    assert form(Problem(zoo.pyramid()), top(1.2)).positions[4, 2] == pytest.approx(0.75, rel=4 * EPS)


def test_the_pyramid_needs_six_fifths_of_a_newton():
    """K dz = dp with K near 2: the force is as exact as the height, in newtons."""
    design = solve(Problem(zoo.pyramid(rounding__refit="debiased", penalty__weight=1e-3)))
    np.testing.assert_allclose(design.forces[4], [0, 0, 1.2], rtol=0, atol=16 * EPS)


def test_a_hanging_chain_balances_joint_by_joint_to_the_last_digits():
    """Ten equal springs, a weight at each joint: one horizontal pull, and a vertical one that falls by a weight a joint."""
    count = 11
    fixed = np.isin(np.arange(count), [0, 10])
    edges = np.column_stack([np.arange(10), np.arange(1, count)])
    membrane = Membrane(edges, np.full(10, 0.125), np.full(10, 3.0), Hookean(), fixed)
    start = np.zeros((count, 3))
    start[:, 0], start[1:-1, 2] = np.linspace(0, 1, count), -0.25
    x = form_find(membrane, start, np.tile([0.0, 0.0, -0.0625], (9, 1))).positions
    v = np.diff(x, axis=0)
    length = np.linalg.norm(v, axis=1)
    pull = (3.0 * (length - 0.125) / length)[:, None] * v
    round_off = 8 * EPS * 3.0 * (length.max() + 0.125)
    np.testing.assert_allclose(pull[:, 0], pull[0, 0], rtol=0, atol=round_off)
    np.testing.assert_allclose(np.diff(pull[:, 2]), 0.0625, rtol=0, atol=round_off)
    assert not x[:, 1].any()


def test_a_linear_net_is_the_solution_of_its_rational_system():
    """One unknown, its neighbours at thirds and sevenths: x = sum q x_i / sum q, in fractions."""
    scene = zoo.force_density_net(3, membrane__loads=[0.0, 0.0, -1.0])
    found = form(Problem(scene), np.zeros_like(scene.target)).positions
    (middle,) = scene.membrane.free
    beside = [int(a + b - middle) for a, b in scene.mesh.edges if middle in (a, b)]
    pull = 2 * len(beside)
    for axis in range(3):
        total = sum(2 * Fraction(scene.start[i, axis]) for i in beside) + Fraction(scene.loads[middle, axis])
        assert found[middle, axis] == pytest.approx(float(total / pull), rel=2 * EPS, abs=EPS)


@pytest.mark.parametrize("masts", [zoo.ONE_MAST, zoo.TWO_MASTS], ids=["one", "two"])
def test_planted_forces_are_found_again_to_the_last_digits(masts):
    """The target is rounded to 1e-16 m, and springs of 1 N/m turn that into as many newtons, a few at each mast."""
    case = zoo.planted(9, masts, penalty__weight=1e-3, rounding__refit="debiased")
    design = solve(Problem(case.scene))
    assert design.certificate.equilibrium < 1e-14
    np.testing.assert_allclose(design.forces, case.forces, rtol=0, atol=1e-14)


def test_what_is_unbalanced_does_not_hide_in_the_gradient():
    """The gradient of a planted optimum rests on an x - xhat of 1e-7 m: at rest to round-off it stays nothing."""
    case = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-5)
    design = solve(Problem(case.scene))
    again = form(Problem(case.scene), design.forces)
    assert np.abs(again.positions - design.positions).max() < 4 * EPS
    assert again.certificate.stationarity < 1e-10
