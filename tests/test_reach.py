import numpy as np
import pytest
from scipy.optimize import minimize

from relax.errors import InputError
from relax.sparsity.reach import ANYTHING, Reach, reach_of

REACHES = {
    "anything": ANYTHING,
    "vertical": Reach((2,)),
    "up": Reach((2,), 0.0),
    "upright of three": Reach(tangent=0.0),
    "lean 30": Reach(tangent=np.tan(np.pi / 6)),
    "lean 80": Reach(tangent=np.tan(np.radians(80))),
    "lean 90": Reach(tangent=float(np.tan(np.pi / 2))),
    "capped": Reach(largest=1.2),
    "vertical, capped": Reach((2,), largest=0.7),
    "up, capped": Reach((2,), 0.0, 0.7),
    "lean 30, capped": Reach(tangent=np.tan(np.pi / 6), largest=1.2),
    "lean 90, capped": Reach(tangent=float(np.tan(np.pi / 2)), largest=1.2),
}
every_reach = pytest.mark.parametrize("reach", REACHES.values(), ids=REACHES)
RNG = np.random.default_rng(0)


def vectors(reach, count=200, seed=0):
    return 1.5 * np.random.default_rng(seed).normal(size=(count, len(reach.axes)))


def holds(reach, s, slack=1e-12):
    """Whether one amplitude vector is in the cone and below the cap, from their definitions."""
    fits = np.linalg.norm(s) <= reach.largest + slack
    if reach.tangent is not None:
        lean = np.arctan2(np.linalg.norm(s[:-1]), s[-1])
        fits &= np.linalg.norm(s) <= slack or lean <= np.arctan(reach.tangent) + 1e-9
    return bool(fits)


@every_reach
def test_a_projection_is_inside_and_nearer_than_anything_inside(reach):
    v = vectors(reach)
    near = reach.project(v)
    assert all(holds(reach, s) for s in near)
    assert np.allclose(reach.project(near), near, atol=1e-15)
    # the variational inequality, over points inside that no projection made
    others = [s for s in vectors(reach, 2000, 1) if holds(reach, s)][:60]
    assert len(others) > 5 or reach.tangent == 0
    for other in [*others, np.zeros(len(reach.axes))]:
        assert (np.einsum("ij,ij->i", v - near, other - near) <= 1e-12).all()


@every_reach
def test_what_is_inside_stays(reach):
    inside = np.array([s for s in vectors(reach, 2000) if holds(reach, s, 0.0)] or [np.zeros(len(reach.axes))])
    assert np.allclose(reach.project(inside), inside, rtol=1e-14, atol=1e-15)


@every_reach
def test_the_cone_and_its_polar_share_a_vector(reach):
    v = vectors(reach)
    part = reach.cone(v)
    rest = v - part  # Moreau: orthogonal, and the rest makes no acute angle with the cone
    assert np.allclose(np.einsum("ij,ij->i", part, rest), 0, atol=1e-12)
    for other in part:
        assert (rest @ other <= 1e-12 * max(1.0, np.abs(other).max())).all()
    assert np.allclose(reach.pull(-v), np.linalg.norm(part, axis=1))


def test_by_hand():
    v = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -2.0], [0.0, 0.0, 2.0], [3.0, 4.0, -6.0]])
    assert np.allclose(Reach(tangent=1.0).cone(v), [[1.5, 2, 2.5], [0, 0, 0], [0, 0, 2], [0, 0, 0]])
    assert np.allclose(Reach(tangent=0.0).cone(v), [[0, 0, 0], [0, 0, 0], [0, 0, 2], [0, 0, 0]])
    assert np.allclose(Reach((2,), 0.0).cone(v[:, 2:]), [[0], [0], [2], [0]])
    assert np.allclose(Reach(largest=2.5).project(v[:1]), [[1.5, 2, 0]])
    assert np.allclose(Reach((2,), 0.0).pull(np.array([[3.0], [-3.0]])), [0, 3])


@every_reach
@pytest.mark.parametrize("threshold", [0.0, 0.4, 1.5])
def test_the_prox_is_the_minimiser(reach, threshold):
    v = vectors(reach, 12)
    found = reach.prox(v, np.full(12, threshold))
    for one, s in zip(v, found, strict=True):

        def value(s, one=one):
            return 0.5 * np.sum((s - one) ** 2) + threshold * np.linalg.norm(s)

        assert holds(reach, s)
        # any other point inside, reached from here or from a search of its own, is no better
        searched = minimize(lambda s: value(reach.project(s[None])[0]), 0.5 * one, method="Nelder-Mead", tol=1e-9).x
        others = [reach.project(searched[None])[0], *reach.project(s + 0.1 * vectors(reach, 50, 2)), 0 * s]
        assert value(s) <= min(value(other) for other in others) + 1e-12


@every_reach
@pytest.mark.parametrize("threshold", [0.0, 0.4])
def test_the_slope_is_the_derivative(reach, threshold):
    v, along = vectors(reach), vectors(reach, seed=3)
    thresholds = np.full(len(v), threshold)
    turn = reach.slope(v, thresholds)
    assert np.allclose(turn, turn.transpose(0, 2, 1), atol=1e-14)
    values = np.linalg.eigvalsh(turn)
    assert values.min() >= -1e-14 and values.max() <= 1 + 1e-14
    h = 1e-6
    difference = (reach.prox(v + h * along, thresholds) - reach.prox(v - h * along, thresholds)) / (2 * h)
    close = np.linalg.norm(difference - np.einsum("gij,gj->gi", turn, along), axis=1) < 1e-6
    assert close.mean() > 0.97  # a random vector is seldom within h of an edge between two pieces
    if threshold == 0:
        assert np.array_equal(turn, reach.slope(v))
        assert np.allclose(reach.prox(v, thresholds), reach.project(v), atol=1e-15)


@every_reach
def test_constrained_says_whether_there_is_anything_to_violate(reach):
    free = all(holds(reach, s) for s in vectors(reach, 200))
    assert reach.constrained is not free


def test_none_at_all():
    for reach in REACHES.values():
        nothing = np.zeros((0, len(reach.axes)))
        assert reach.project(nothing).shape == reach.prox(nothing, np.zeros(0)).shape == nothing.shape
        assert reach.slope(nothing).shape == (0, len(reach.axes), len(reach.axes))


def test_what_a_scene_says():
    assert reach_of("any", None) == ANYTHING
    assert reach_of("any", 3) == Reach(largest=3.0)
    assert reach_of("vertical", None) == Reach((2,))
    assert reach_of("up", 2.0) == Reach((2,), 0.0, 2.0)
    assert reach_of({"lean": 0}, None) == Reach((2,), 0.0)
    assert reach_of({"lean": 45}, None).tangent == pytest.approx(1)
    # leaning at most 90 degrees is pushing
    assert np.allclose(reach_of({"lean": 90}, None).cone(np.array([[1.0, 2, -3], [1, 2, 3]])), [[1, 2, 0], [1, 2, 3]])


def test_what_no_support_can_be_is_refused():
    with pytest.raises(InputError, match=r"the tangent of a support's largest lean is -1\.0: expected"):
        Reach(tangent=-1.0)
    for largest in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match=r"the largest force of a support is .*: expected a number above 0"):
            Reach(largest=largest)
