import numpy as np
import pytest

from relax.sparsity.supports import Supports, sizes

SUPPORTS = Supports(np.array([1, 3, 4]), np.array([1.0, 2.0, 0.5]), 6)


BASIS = np.eye(18)[:, [3, 4, 5, 9, 10, 11, 12, 13, 14]]


def test_rows_by_hand():
    assert SUPPORTS.rows.tolist() == [[3, 4, 5], [9, 10, 11], [12, 13, 14]]


def test_forces_are_the_basis_times_amplitudes_and_amplitudes_its_transpose():
    rng = np.random.default_rng(0)
    s, p = rng.normal(size=(3, 3)), rng.normal(size=(6, 3))
    assert np.array_equal(SUPPORTS.forces(s).ravel(), BASIS @ s.ravel())
    assert np.array_equal(SUPPORTS.amplitudes(p).ravel(), BASIS.T @ p.ravel())
    assert np.array_equal(SUPPORTS.amplitudes(SUPPORTS.forces(s)), s)
    assert not SUPPORTS.forces(s)[[0, 2, 5]].any()


def test_sizes():
    assert np.allclose(sizes(np.array([[3.0, 0, 4], [0, 0, 0], [1, -2, 2]])), [5, 0, 3])


def test_supports_do_not_change_under_a_reader():
    with pytest.raises(ValueError, match="read-only"):
        SUPPORTS.weights[0] = 3
