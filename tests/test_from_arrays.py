"""A scene from arrays is the scene that a file with the same arrays gives, in three lines."""

from dataclasses import fields

import numpy as np
import pytest
import zoo
from folders import bump, refused, write_scene

import relax
from relax.files.exports import write_obj


def same(one, other):
    for item in fields(one):
        if isinstance(getattr(one, item.name), np.ndarray):
            np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name), err_msg=item.name)
    np.testing.assert_array_equal(one.mesh.faces, other.mesh.faces)
    np.testing.assert_array_equal(one.mesh.edges, other.mesh.edges)
    mine, theirs = ({key: dict(keys) if key != "title" else keys for key, keys in each.settings.items()} for each in (one, other))
    for each in (mine, theirs):
        each.pop("title")
        each["target"].pop("mesh"), each["target"].pop("heights"), each["membrane"].pop("rest")
    assert mine == theirs


def test_three_lines_with_plain_lists():
    vertices, faces = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 0.75]], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    scene = relax.scene_from_arrays(vertices, faces, {"membrane.rest_scale": 0.75})
    design = relax.solve(relax.Problem(scene, weight=1e-4))
    assert [mast.vertex for mast in design.supports] == [4]
    assert design.supports[0].force[2] == pytest.approx(zoo.PYRAMID_FORCE, rel=1e-2)


def test_a_mesh_is_what_its_file_gives(tmp_path):
    mesh, target = zoo.mixed()
    target[:, 2] = [0, 0.1, 0.2, 0, 0.3]
    flat = target * [1.1, 1.1, 0]
    write_obj(tmp_path / "a.obj", target, mesh.faces)
    write_obj(tmp_path / "b.obj", flat, mesh.faces)
    (tmp_path / "a.toml").write_text(
        '[target]\nmesh = "a.obj"\nnoise = { sigma = 0.1, seed = 3 }\n[membrane]\nrest = "b.obj"\n[supports]\nfixed = [0, 3]\n'
    )
    keys = {"target.noise": {"sigma": 0.1, "seed": 3}, "supports.fixed": [0, 3]}
    same(relax.scene_from_arrays(target, mesh.faces, keys, flat), relax.load_scene(tmp_path / "a.toml"))


def test_a_height_field_is_what_its_file_gives(tmp_path):
    path = write_scene(tmp_path, 'diagonals = "both"\nheight_scale = 2.0\n[supports]\ndirection = "up"\n')
    path.write_text(path.read_text().replace("[0.2, 0.2]", "[0.2, 0.3]"))
    keys = {"target.diagonals": "both", "target.height_scale": 2.0, "supports.direction": "up"}
    same(relax.scene_from_heights(bump(), (0.2, 0.3), keys), relax.load_scene(path))


def test_its_result_is_saved_and_loaded(tmp_path):
    scene = relax.scene_from_heights(bump(), (0.2, 0.2))
    design = relax.solve(relax.Problem(scene, weight=0.02))
    relax.write_result(tmp_path / "r", design)
    again = relax.solve(relax.Problem(relax.load_result(tmp_path / "r").scene))
    np.testing.assert_array_equal(again.positions, design.positions)


SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((SQUARE[0], [[0, 1, 2]]), "vertices: found an array of float64 of the shape (3,), expected numbers of the shape (V, 3)"),
        ((SQUARE, [0, 1, 2]), "faces: found an array of int64 of the shape (3,)"),
        ((SQUARE, [[0.0, 1.0, 2.0]]), "faces: found an array of float64"),
        ((SQUARE, [[0, 1, 7]]), "face 0 names vertex 7"),
        ((SQUARE, [[0, 1, 2, 3]], {"penalty.wieght": 1}), 'penalty.wieght: unknown key; perhaps "weight" is meant'),
        ((SQUARE, [[0, 1, 2, 3]], {"membrane.rest": "a.obj"}), "hand the vertices of the rest mesh over as `rest`"),
        ((SQUARE, [[0, 1, 2, 3]], {}, SQUARE[:3]), "rest: it has 3 vertices, expected 4"),
        ((SQUARE * np.nan, [[0, 1, 2, 3]]), "nan"),
        ((np.zeros((0, 3)), np.zeros((0, 3), dtype=int)), "at least one of them is empty"),
    ],
)
def test_bad_arrays_get_one_sentence(arguments, sentence):
    assert sentence in refused(lambda: relax.scene_from_arrays(*arguments))


def test_bad_heights_get_one_sentence():
    assert "heights: found an array of float64 of the shape (5,)" in refused(
        lambda: relax.scene_from_heights(np.zeros(5), (1, 1))
    )
    assert "target.spacing = [0, 1]" in refused(lambda: relax.scene_from_heights(np.zeros((5, 5)), (0, 1)))
