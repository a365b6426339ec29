"""Switching ingredients off: what does nothing is noticed, units are units, and what was planted is recovered."""

import numpy as np
import pytest

import relax


@pytest.fixture(scope="module")
def ingredients():
    """The experiment as a module."""
    import ingredients

    return ingredients


def test_a_patch_that_nobody_asks_for_is_noticed(ingredients):
    from unittest.mock import patch

    def idle():
        return patch("relax.design.greedy_never_asked", create=True)

    lost = ingredients.Ingredient("lost", "nothing else", without=idle)
    held = ingredients.Ingredient("second order: R", "touching parabolas", without=ingredients.parabolas)
    rows = [ingredients.row(each, "planted", 10, 1) for each in (lost, held)]
    assert not rows[0]["changed"] and not rows[0]["asked"] and rows[1]["asked"]
    assert ingredients.without_effect(rows) == ["lost: nothing else"]


def test_a_patch_of_a_name_that_is_gone_is_an_error(ingredients):
    for each in ingredients.INGREDIENTS:
        with each.without():  # patches by name: AttributeError where there is none
            pass


def test_millimetres_and_kilonewtons_are_the_same_scene(ingredients):
    problem = ingredients.scene_of("planted", 10)
    design, moved = relax.solve(problem), ingredients.in_millimetres(relax.solve)(problem)
    assert moved.certificate.objective / 1e6 == pytest.approx(design.certificate.objective, rel=1e-9)
    np.testing.assert_allclose(moved.positions / 1e3, design.positions, atol=1e-9)
    np.testing.assert_allclose(moved.forces * 1e3, design.forces, atol=1e-9)
    assert ingredients.recovered(moved, 10) == ingredients.recovered(design, 10)
    assert ingredients.recovered(design, 10).startswith("5 of 5, 0 others")


def test_the_touching_parabolas_bend_as_the_slope_says(ingredients):
    from relax.design import refit

    problem = ingredients.scene_of("planted", 10)
    amplitudes = np.array([[0.3, 0.0, -0.4], [0.0, 2.0, 0.0]])
    members = np.array([3, 7])
    exact = refit.penalty_hessian(problem, members, amplitudes)
    with ingredients.parabolas():
        above = refit.penalty_hessian(problem, members, amplitudes)
    assert np.linalg.eigvalsh(above - exact).min() > -1e-12  # from above, and alike across each force
    np.testing.assert_allclose((above - exact)[:3, :3] @ [0.8, 0.0, 0.6], 0, atol=1e-12)
    assert np.linalg.eigvalsh(exact).min() < 0 < np.linalg.eigvalsh(above).min()


def test_a_path_has_both_halves_beside_it(ingredients):
    rows = ingredients.path_rows("planted", 10, 2)
    assert [row["instead"] for row in rows] == ["afresh alone", "from the design before alone"]
    assert all(row["rise"] >= -1e-9 and row["converged"] for row in rows)
