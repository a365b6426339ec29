from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import relax
from relax.errors import InputError


def curve_of(*points, equilibrium=None):
    """Stand-ins for designs with so many supports and such an rms distance, weights falling."""
    return [
        SimpleNamespace(
            problem=SimpleNamespace(strength=1.0 / (1 + index)),
            forces=np.full((count, 3), 1.0),
            certificate=SimpleNamespace(
                supports=count,
                rms_distance=rms,
                objective=1.0,
                distance=0.75,
                penalty=0.25,
                equilibrium=(equilibrium or {}).get(index, 0.0),
                stable=True,
            ),
        )
        for index, (count, rms) in enumerate(points)
    ]


def test_the_arrays_are_the_designs_figures():
    curve = relax.trade_off(curve_of((0, 1.0), (2, 0.1)))
    assert curve.supports.tolist() == [0, 2] and curve.rms_distance.tolist() == [1.0, 0.1]
    assert curve.weight.tolist() == [1.0, 0.5] and curve.force == pytest.approx([0, 2 * np.sqrt(3)])
    assert (curve.objective == curve.distance + curve.penalty).all()


def test_the_knee_by_hand():
    # scaled: (0, 1), (0.1, 0.5), (0.5, 0.25), (1, 0): below the chord by 0.4 and 0.25
    assert relax.trade_off(curve_of((0, 1.0), (1, 0.1), (5, 10**-1.5), (10, 0.01))).knee == 1
    # each support worth as much as the one before, or more: the last
    assert relax.trade_off(curve_of((0, 1.0), (1, 0.1), (2, 0.01))).knee == 2
    assert relax.trade_off(curve_of((0, 1.0), (1, 0.9), (2, 0.01))).knee == 2
    assert relax.trade_off(curve_of((0, 1.0), (1, 0.0))).knee == 1
    assert relax.trade_off(curve_of((3, 1.0))).knee == 0


def test_a_shape_off_equilibrium_is_no_part_of_the_curve():
    designs = curve_of((0, 1.0), (1, 1e-9), (2, 0.1), equilibrium={1: 1e-3})
    assert relax.trade_off(designs).efficient.tolist() == [True, False, True]
    nothing = curve_of((1, 0.5), (0, 1.0), equilibrium={0: 1.0, 1: 1.0})
    assert relax.trade_off(nothing).knee == 1


@given(st.lists(st.tuples(st.integers(0, 4), st.sampled_from([0.1, 0.2, 0.3, 0.4])), min_size=1, max_size=12))
def test_the_efficient_ones_are_those_that_no_other_beats(points):
    curve = relax.trade_off(curve_of(*points))
    for index, (count, rms) in enumerate(points):
        beaten = any(
            (c <= count and r <= rms and (c, r) != (count, rms)) or ((c, r) == (count, rms) and other < index)
            for other, (c, r) in enumerate(points)
        )
        assert curve.efficient[index] == (not beaten)
    assert curve.efficient[curve.knee]


def test_the_one_that_was_asked_for():
    designs = curve_of((0, 1.0), (2, 0.3), (2, 0.2), (5, 0.1), (4, 0.15))
    assert relax.choose(designs, count=2) == (2, True)
    assert relax.choose(designs, count=4) == (4, True)
    assert relax.choose(designs[1:], count=1) == (0, False)
    assert relax.choose(designs, rms=0.2) == (2, True)
    assert relax.choose(designs, rms=0.01) == (3, False)
    assert relax.choose(designs) == (relax.trade_off(designs).knee, True)


def test_nothing_is_no_curve():
    with pytest.raises(InputError, match="no design"):
        relax.trade_off([])


def test_a_membrane_that_does_not_stand_is_no_answer():
    """It is nearest, but no equilibrium; the same rule as for the knee."""
    designs = curve_of((0, 1.0), (1, 0.3), (2, 0.001), equilibrium={2: 1e-3})
    assert relax.choose(designs, count=2) == (1, True)
    assert relax.choose(designs, rms=0.5) == (1, True)
    assert relax.choose(designs, rms=0.01)[1] is False
