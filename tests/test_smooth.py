import numpy as np
import pytest
import zoo
from naive import taylor_order

from relax.design.methods.smooth import Smoothed, refuse_constraints, steepest_slope
from relax.design.problem import Problem
from relax.errors import InputError
from relax.sparsity.penalties import GroupLasso, Power

SMOOTHED = [
    Smoothed(Power(0.5, 1e-4), 0.0),
    Smoothed(Power(0.5, 1e-4), 0.1),
    Smoothed(Power(1.0, 0.0), 0.2),
    Smoothed(GroupLasso(), 0.05),
]
SIZES = np.array([0.0, 1e-3, 0.02, 0.3, 2.0])


@pytest.mark.parametrize("smooth", SMOOTHED, ids=str)
def test_slope_and_curvature_are_the_derivatives_of_the_value(smooth):
    for size in SIZES:
        t = np.array([size])
        slope = (smooth.across(t) * t)[0]
        step = 0.2 * max(size, 0.01)
        assert taylor_order(lambda h, t=t: smooth.value(t + h)[0], slope, step * 0.1) > 1.8
        assert taylor_order(lambda h, t=t: (smooth.across(t + h) * (t + h))[0], smooth.along(t)[0], step * 0.1) > 1.8


@pytest.mark.parametrize("smooth", SMOOTHED, ids=str)
def test_the_parabola_touches_from_above(smooth):
    for touch in SIZES[1:]:
        at = np.array([touch])
        raised = smooth.value(at) + smooth.across(at) / 2 * (SIZES**2 - touch**2) - smooth.value(SIZES)
        assert (raised >= -1e-15).all() and raised[SIZES == touch] == pytest.approx(0, abs=1e-16)
    assert smooth.value(np.zeros(1)) == 0


def test_without_width_the_penalty_is_left_as_it_is():
    penalty = Power(0.5, 1e-4)
    smooth = Smoothed(penalty, 0.0)
    np.testing.assert_allclose(smooth.value(SIZES), penalty.value(SIZES), rtol=1e-15)
    np.testing.assert_allclose(smooth.along(SIZES), penalty.curvature(SIZES), rtol=1e-13)
    np.testing.assert_allclose(smooth.across(SIZES) * SIZES, penalty.slope(SIZES), rtol=1e-15)


def test_the_paper_s_penalty_is_the_smoothed_power():
    """Section 3.1: (t^2 + eps)^(alpha/2) is t^alpha over h = sqrt(t^2 + eps)."""
    np.testing.assert_allclose(Smoothed(Power(1.0, 0.0), 0.1).value(SIZES), Power(1.0, 0.01).value(SIZES), rtol=1e-12, atol=1e-17)


class Count:
    """phi jumps at zero."""

    name, resolution = "count", 0.0

    def value(self, size):
        return (size > 0).astype(float)

    def slope(self, size):
        return np.zeros_like(size)

    curvature = weight = slope


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"supports__direction": "up"}, "supports.direction"),
        ({"supports__direction": {"lean": 20.0}}, "supports.direction"),
        ({"supports__max_force": 1.0}, "supports.max_force"),
    ],
)
def test_bounded_supports_are_refused(changes, words):
    problem = Problem(zoo.pyramid(**changes), weight=0.01)
    with pytest.raises(InputError, match=f'"irls" cannot treat .*{words}.*: use the method "sequential"'):
        refuse_constraints(problem, "irls")


def test_what_always_stands_and_what_has_no_slope_is_refused():
    scene = zoo.pyramid(penalty__weight=0.01)
    free = Problem(scene)
    refuse_constraints(free, "irls")
    assert steepest_slope(free) == pytest.approx(0.01 * free.penalty.slope(np.array([free.penalty.resolution]))[0])
    with pytest.raises(InputError, match="'count', which has no finite slope"):
        refuse_constraints(free.replace(penalty=Count()), "lagrangian")
    weights = np.ones(scene.mesh.vertices)
    weights[4] = 0.0
    with pytest.raises(InputError, match="always stand"):
        refuse_constraints(Problem(zoo.replace(scene, support_weight=weights)), "lagrangian")
