"""What each support counts, and supports that always stand: by hand, and the sentences where a scene contradicts itself."""

import numpy as np
import pytest
import zoo

from relax.errors import InputError
from relax.membrane.symmetry import find_symmetry


def scene(**changes):
    return zoo.grid_scene(4, lambda x, y: np.where((x > 0.3) & (x < 0.7) & (y > 0.3) & (y < 0.7), 3 * x, 0.0), **changes)


def refused(**changes):
    with pytest.raises(InputError) as caught:
        scene(**changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_weights_by_height_have_the_mean_one():
    # candidates 5 6 9 10 at 1, 2, 1, 2 metres, ground 1 below 0: 2, 3, 2, 3 over 2.5
    got = scene(supports__weights="height", supports__ground=-1.0)
    np.testing.assert_allclose(got.support_weight[[5, 6, 9, 10]], [0.8, 1.2, 0.8, 1.2], rtol=1e-12)
    np.testing.assert_allclose(got.support_weight[~got.candidates], 0.4, rtol=1e-12)


def test_the_mean_is_that_of_the_candidates_alone():
    got = scene(supports__weights="height", supports__ground=-1.0, supports__candidates=[6, 10])
    np.testing.assert_allclose(got.support_weight[[5, 6, 9, 10]], [2 / 3, 1, 2 / 3, 1], rtol=1e-12)


def test_a_support_near_the_ground_counts_a_hundredth():
    got = scene(supports__weights="height", supports__ground=1.0)  # heights 0, 1, 0, 1
    np.testing.assert_allclose(got.support_weight[[5, 6, 9, 10]], [0.01, 2, 0.01, 2], rtol=1e-9)
    assert (got.support_weight[got.fixed] == 0.01).all()  # below ground


def test_heights_are_those_of_the_clean_target():
    clean = scene(supports__weights="height", supports__ground=-1.0)
    noisy = scene(supports__weights="height", supports__ground=-1.0, target__noise={"sigma": 0.2, "seed": 0})
    assert np.array_equal(clean.support_weight, noisy.support_weight)


def test_heights_that_are_no_weights_are_refused():
    said = refused(supports__weights="height", supports__ground=2.0)
    assert said == (
        'supports.weights = "height": the candidates lie -0.5 m above ground on average, so that heights are no weights: '
        "lower supports.ground (now 2) below the target"
    )


def test_a_support_that_always_stands_is_a_candidate_of_weight_zero():
    got = scene(supports__candidates=[5], supports__always=[10, 6])
    assert np.flatnonzero(got.candidates).tolist() == [5, 6, 10]
    assert got.support_weight[[5, 6, 9, 10]].tolist() == [1, 0, 1, 0]
    assert np.flatnonzero(scene(supports__candidates=[], supports__always=[9]).candidates).tolist() == [9]
    got = scene(supports__weights="height", supports__ground=-1.0, supports__always=[5])
    np.testing.assert_allclose(got.support_weight[[5, 6, 9, 10]], [0, 1.2, 0.8, 1.2], rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"always": [5, 16]}, "supports.always: vertex 16 does not exist; the target has vertices 0 to 15"),
        (
            {"always": [5, 3]},
            "supports.always: vertex 3 is fixed, so no support can act there: take it out of always or of fixed",
        ),
        ({"always": [5], "never": [6, 5]}, "supports.always: vertex 5 is in never too: take it out of always or never"),
    ],
)
def test_contradictions(changes, sentence):
    assert refused(**{f"supports__{key}": value for key, value in changes.items()}) == sentence


def test_symmetry_sees_weights():
    # 9 x 9: vertex 29 is off every mirror
    assert find_symmetry(zoo.grid_scene(9, zoo.hill, supports__weights="height")).order == 8
    assert find_symmetry(zoo.grid_scene(9, zoo.hill, supports__always=[40])).order == 8
    assert find_symmetry(zoo.grid_scene(9, zoo.hill, supports__always=[29])) is None
