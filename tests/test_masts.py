import numpy as np
import pytest

from relax.design.masts import standing_masts

HEAD = np.array([1.0, 2.0, 3.0])


def one(force, head=HEAD, ground=0.0):
    """The record of a single support at vertex 1 of 3."""
    positions, forces = np.zeros((3, 3)), np.zeros((3, 3))
    positions[1], forces[1] = head, force
    (mast,) = standing_masts(positions, forces, ground)
    assert mast.vertex == 1
    return mast


@pytest.mark.parametrize(
    ("force", "ground", "kind", "foot", "length", "lean"),
    [
        ((0, 0, 2), 0.0, "mast", (1, 2, 0), 3.0, 0.0),
        ((2, 0, 2), 0.0, "mast", (-2, 2, 0), 3 * np.sqrt(2), 45.0),
        ((0, 0, 2), 1.0, "mast", (1, 2, 1), 2.0, 0.0),
        ((0, 0, 2), -1.0, "mast", (1, 2, -1), 4.0, 0.0),
        ((0, 0, -5), 0.0, "tie-down", (1, 2, 0), 3.0, 0.0),
        # pulls along (3, 0, -4): three up is 3/4 of a length of 5 along the line
        ((3, 0, -4), 0.0, "tie-down", (1 + 9 / 4, 2, 0), 15 / 4, np.degrees(np.arccos(0.8))),
        ((0, 7, 0), 0.0, "stay", None, None, 90.0),
        ((0, 0, 2), 3.5, "stay", None, None, 0.0),
        ((0, 0, -2), 3.5, "stay", None, None, 0.0),
        ((0, 0, 2), 3.0, "mast", (1, 2, 3), 0.0, 0.0),
    ],
)
def test_kind_foot_length_and_lean_by_hand(force, ground, kind, foot, length, lean):
    mast = one(force, ground=ground)
    assert mast.kind == kind
    assert mast.head == (1.0, 2.0, 3.0)
    assert mast.force == tuple(force)
    assert mast.magnitude == pytest.approx(np.linalg.norm(force))
    assert mast.lean == pytest.approx(lean, abs=1e-12)
    assert mast.length == (None if length is None else pytest.approx(length))
    assert mast.foot == (None if foot is None else pytest.approx(foot))


@pytest.mark.parametrize("seed", range(8))
def test_the_foot_lies_on_the_line_of_the_force_and_on_the_ground(seed):
    rng = np.random.default_rng(seed)
    head = rng.uniform(-5, 5, 3)
    force = rng.uniform(-5, 5, 3) * 10.0 ** rng.integers(-3, 9)
    ground = head[2] - rng.uniform(0, 4)
    mast = one(force, head, ground)
    axis = np.subtract(mast.foot, head)
    assert mast.foot[2] == pytest.approx(ground)
    np.testing.assert_allclose(np.cross(axis, force) / np.linalg.norm(force), 0, atol=1e-12 * (1 + mast.length))
    assert mast.length == pytest.approx(np.linalg.norm(axis))
    # a mast pushes away from its foot, a tie-down pulls towards it
    assert mast.kind == ("mast" if np.dot(axis, force) < 0 else "tie-down")
    assert mast.lean == pytest.approx(np.degrees(np.arctan2(np.hypot(*force[:2]), abs(force[2]))), abs=1e-6)


def test_supports_come_in_the_order_of_their_vertices_and_zeros_are_none():
    forces = np.zeros((6, 3))
    forces[4] = 1e-100, 0, 0
    forces[2, 2] = -1
    assert [(mast.vertex, mast.kind) for mast in standing_masts(np.ones((6, 3)), forces, 0.0)] == [(2, "tie-down"), (4, "stay")]
    assert standing_masts(np.ones((6, 3)), 0 * forces, 0.0) == ()
