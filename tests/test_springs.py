from itertools import pairwise

import naive
import numpy as np
import pytest

from relax.membrane.springs import SPRINGS

REST, CONSTANT = np.array([1.0, 0.5, 2.0]), np.array([1.0, 4.0, 0.3])
TAUT, SHORT = np.array([1.3, 0.9, 3.0]), np.array([0.7, 0.2, 1.5])


@pytest.mark.parametrize("length", [TAUT, SHORT], ids=["taut", "short"])
@pytest.mark.parametrize("law", SPRINGS.values(), ids=SPRINGS)
def test_each_function_is_the_derivative_of_the_one_before(law, length):
    chain = (law.energy, law.tension, law.stiffness, law.stiffness_slope)
    way = np.array([1.0, -0.5, 0.7])
    for function, derivative in pairwise(chain):
        slope = derivative(length, REST, CONSTANT) * way
        assert naive.taylor_order(lambda t, f=function: f(length + t * way, REST, CONSTANT), slope) > 1.9


@pytest.mark.parametrize("law", SPRINGS.values(), ids=SPRINGS)
def test_laws_are_of_the_length_alone_and_of_each_edge_alone(law):
    for function in (law.energy, law.tension, law.stiffness, law.stiffness_slope):
        whole = function(TAUT, REST, CONSTANT)
        assert whole.shape == (3,)
        assert np.array_equal(whole[1:], function(TAUT[1:], REST[1:], CONSTANT[1:]))


@pytest.mark.parametrize("law", SPRINGS.values(), ids=SPRINGS)
def test_taut_edges_pull_and_resist(law):
    assert law.tension(TAUT, REST, CONSTANT).min() > 0
    assert law.stiffness(TAUT, REST, CONSTANT).min() > 0
    assert law.energy(TAUT, REST, CONSTANT).min() > 0


def test_the_table_is_by_name():
    assert list(SPRINGS) == ["hookean", "tension-only", "force-density"]
    assert all(law.name == name for name, law in SPRINGS.items())


def test_hookean_by_hand():
    law = SPRINGS["hookean"]
    assert np.allclose(law.energy(TAUT, REST, CONSTANT), [0.045, 0.32, 0.15])
    assert np.allclose(law.tension(TAUT, REST, CONSTANT), [0.3, 1.6, 0.3])
    assert np.allclose(law.tension(SHORT, REST, CONSTANT), [-0.3, -1.2, -0.15])
    assert np.array_equal(law.stiffness(SHORT, REST, CONSTANT), CONSTANT)


def test_tension_only_is_hookean_or_nothing():
    law, hookean = SPRINGS["tension-only"], SPRINGS["hookean"]
    for name in ("energy", "tension", "stiffness", "stiffness_slope"):
        assert np.array_equal(getattr(law, name)(TAUT, REST, CONSTANT), getattr(hookean, name)(TAUT, REST, CONSTANT))
        assert not getattr(law, name)(SHORT, REST, CONSTANT).any()


def test_force_density_by_hand():
    law = SPRINGS["force-density"]
    assert np.allclose(law.tension(SHORT, REST, CONSTANT) / SHORT, CONSTANT)
    assert np.allclose(law.energy(SHORT, 7 * REST, CONSTANT), CONSTANT * SHORT**2 / 2)
