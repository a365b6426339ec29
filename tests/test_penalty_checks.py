"""The checks of a user's penalty: right ones pass, each planted fault is caught by the check that is meant for it."""

import numpy as np
import pytest
from test_penalties import ALL
from test_reweighted import Capped
from test_reweighted import LogSum as Plain

from relax.errors import InputError
from relax.sparsity.checks import Check, check_penalty
from relax.sparsity.penalties import MCP, LogSum, Power

NO_PROX = "it has none: methods that need one will say so"
NAMES = ["arrays", "zero", "rising", "slope", "curvature", "weight", "resolution", "parabola", "tangent", "prox"]


def failed(checks):
    return {check.name: check for check in checks if not check.ok}


@pytest.mark.parametrize("penalty", [*ALL, Plain(0.3)], ids=repr)
@pytest.mark.parametrize("largest", [1.0, 3e4])
def test_right_penalties_pass(penalty, largest):
    checks = check_penalty(penalty, largest)
    assert [check.name for check in checks] == NAMES
    assert not failed(checks)
    assert all(isinstance(check, Check) and check.worst < 1e-3 and check.sentence for check in checks)


class Root:
    """phi = sqrt t without smoothing, its slope infinite at 0."""

    name, resolution = "root", 0.0

    def value(self, size):
        return np.sqrt(size)

    def slope(self, size):
        with np.errstate(divide="ignore"):
            return 0.5 / np.sqrt(size)

    def curvature(self, size):
        return -0.25 * size**-1.5

    weight = slope


def test_a_slope_that_is_infinite_at_nothing_is_right():
    assert not failed(check_penalty(Root()))
    assert check_penalty(Root())[-1] == Check("prox", ok=True, worst=0.0, sentence=NO_PROX)


class Faulty(LogSum):
    """A right log-sum with one function replaced."""

    def __init__(self, **wrong):
        super().__init__(0.2)
        self.__dict__.update(wrong)


RIGHT = LogSum(0.2)


def rising_weight(size):
    return np.where(size < 0.05, 0.5, RIGHT.slope(size))


FAULTS = {
    "value is not 0 at 0": ({"value": lambda t: RIGHT.value(t) + 1e-3}, "zero", {"zero", "weight"}),
    "value falls": (
        {"value": lambda t: t - t**2, "slope": lambda t: 1 - 2 * t, "curvature": lambda t: np.full_like(t, -2.0)},
        "rising",
        None,
    ),
    "slope is twice too large": ({"slope": lambda t: 2 * RIGHT.slope(t)}, "slope", None),
    "slope is 1 % too small": ({"slope": lambda t: 0.99 * RIGHT.slope(t)}, "slope", None),
    "curvature has the wrong sign": ({"curvature": lambda t: -RIGHT.curvature(t)}, "curvature", {"curvature"}),
    "curvature is 1 % too large": ({"curvature": lambda t: 1.01 * RIGHT.curvature(t)}, "curvature", {"curvature"}),
    "weight is value": ({"weight": RIGHT.value}, "weight", None),
    "weight is constant": ({"weight": np.ones_like}, "weight", {"weight"}),
    "weight rises": ({"weight": rising_weight}, "tangent", None),
    "weight is too small": ({"weight": lambda t: 0.9 * RIGHT.slope(t)}, "weight", None),
    "resolution is too large": ({"resolution": 0.1}, "resolution", None),
    "resolution is below 0": ({"resolution": -1.0}, "arrays", None),
    "prox is soft": ({"prox": lambda size, step: np.maximum(size - step, 0)}, "prox", {"prox"}),
    "prox is a local minimum": (
        {"prox": lambda size, step: np.where(RIGHT.prox(size, step) == size * 0, 0, RIGHT.prox(size, step) * (1 + 1e-5))},
        "prox",
        {"prox"},
    ),
    "prox is below 0": ({"prox": lambda size, step: size - step}, "prox", {"prox"}),
    "prox takes one step alone": ({"prox": lambda size, step: RIGHT.prox(size, float(step))}, "prox", {"prox"}),
    "value raises": ({"value": lambda t: 1 / 0}, "arrays", None),
    "slope is a number": ({"slope": lambda t: 1.0}, "arrays", None),
    "curvature drops an axis": ({"curvature": lambda t: RIGHT.curvature(np.ravel(t))}, "arrays", {"arrays"}),
    "value is whole numbers": ({"value": lambda t: np.ones(np.shape(t), dtype=int)}, "arrays", None),
    "slope is nan at 0": ({"slope": lambda t: RIGHT.value(t) / t}, "arrays", None),
    "name is none": ({"name": None}, "arrays", {"arrays"}),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_caught_by_its_own_check(fault):
    wrong, name, alone = FAULTS[fault]
    found = failed(check_penalty(Faulty(**wrong)))
    assert name in found
    if alone is not None:
        assert set(found) <= alone
    for check in found.values():
        assert check.worst > 0 and "\n" not in check.sentence


def test_a_fault_is_told_with_its_place_and_numbers():
    found = failed(check_penalty(Faulty(curvature=lambda t: -RIGHT.curvature(t)), 2.0))
    assert found["curvature"].worst > 0.1
    assert found["curvature"].sentence.startswith("curvature(") and "but slope rises by -" in found["curvature"].sentence
    found = failed(check_penalty(Faulty(value=lambda t: 1 / 0)))
    assert found["arrays"].sentence == "it raised ZeroDivisionError: division by zero"
    assert found["arrays"].worst == np.inf
    assert len(found) >= 8  # all that need the value


def test_a_class_with_nothing_in_it_fails_without_an_exception():
    found = check_penalty(object())
    assert [check.name for check in found] == NAMES
    assert not any(check.ok for check in found[:-1])


def test_an_inherited_function_that_no_longer_fits_is_found():
    assert set(failed(check_penalty(Capped(knee=0.5)))) == {"curvature"}


def test_a_convex_profile_above_the_parabola_is_found():
    class Cubic:
        """phi = t^3: rises faster than any parabola, so that least squares would not descend."""

        name, resolution = "cubic", 0.0

        def value(self, size):
            return size**3

        def slope(self, size):
            return 3 * size**2

        def curvature(self, size):
            return 6 * size

        def weight(self, size):
            return np.full(np.shape(size), 3e18)

    assert "parabola" in failed(check_penalty(Cubic()))


def test_a_resolution_that_is_off_is_found_on_both_sides():
    class Shifted(Power):
        @property
        def resolution(self):
            return self.factor * super().resolution

        def weight(self, size):
            return Power(self.exponent, self.smoothing).weight(size)

    for factor, names in ((1.0, set()), (0.9, {"resolution"}), (1.1, {"resolution"})):
        penalty = Shifted(0.5, 1e-4)
        object.__setattr__(penalty, "factor", factor)
        assert set(failed(check_penalty(penalty))) - {"tangent"} == names


def test_the_usual_weight_of_the_literature_is_not_the_largest_slope():
    class Usual(Power):
        def weight(self, size):
            return self.exponent * (size**2 + self.smoothing) ** ((self.exponent - 1) / 2)

    assert "weight" in failed(check_penalty(Usual(0.5, 1e-4)))


def test_arrays_are_not_written_to():
    def value(size):
        size *= 2
        return MCP(1.0).value(size)

    assert "changes the array" in failed(check_penalty(Faulty(value=value)))["arrays"].sentence


@pytest.mark.parametrize("largest", [0.0, -1.0, np.inf, np.nan])
def test_the_largest_force_is_a_number_above_nothing(largest):
    with pytest.raises(InputError, match=r"largest is .*: expected a force above 0, newtons"):
        check_penalty(RIGHT, largest)
