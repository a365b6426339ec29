from dataclasses import fields

import numpy as np
import pytest
import zoo

from relax.errors import InputError
from relax.membrane.mesh import edge_areas, mesh_from_faces
from relax.membrane.scene import build_scene


def lengths(mesh, x):
    return np.linalg.norm(x[mesh.edges[:, 1]] - x[mesh.edges[:, 0]], axis=1)


def edge_constants(scene):
    """{(a, b): k}."""
    return dict(zip(map(tuple, scene.mesh.edges.tolist()), scene.spring_constant, strict=True))


def two_squares():
    """Two quads apart from each other."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    return mesh_from_faces(8, np.array([[0, 1, 2, 3], [4, 5, 6, 7]])), np.vstack([square, square + np.array([3.0, 0, 0])])


# rest lengths and spring constants


def test_rest_lengths_are_measured_where_rest_says():
    mesh, x = zoo.irregular()
    flat = x * [1, 1, 0]
    assert np.allclose(zoo.irregular_scene().rest_length, 0.7 * lengths(mesh, flat))
    scene = zoo.irregular_scene(membrane__rest="target", membrane__rest_scale=0.9)
    assert np.allclose(scene.rest_length, 0.9 * lengths(mesh, x))
    assert np.allclose(scene.start, flat)
    rest = x * [2, 1, 0] + [5, 0, 0]
    scene = build_scene(zoo.settings(membrane__rest="flat.obj"), mesh, x, rest)
    assert np.allclose(scene.rest_length, 0.7 * lengths(mesh, rest))
    assert np.allclose(scene.start[~scene.fixed], rest[~scene.fixed])
    assert np.allclose(scene.start[scene.fixed], x[scene.fixed])


def test_cables_and_force_density():
    scene = zoo.irregular_scene(membrane__material="cables", membrane__stiffness=3.0)
    assert np.allclose(scene.spring_constant * scene.rest_length, 3)
    scene = zoo.irregular_scene(membrane__springs="force-density", membrane__stiffness=3.0)
    assert np.array_equal(scene.spring_constant, np.full(len(scene.mesh.edges), 3.0))
    assert scene.membrane.springs.name == "force-density"


@pytest.mark.parametrize("rest", ["plan", "target"])
def test_fabric_takes_area_and_length_from_the_rest_mesh(rest):
    mesh, x = zoo.irregular()
    shape = x if rest == "target" else x * [1, 1, 0]
    scene = zoo.irregular_scene(membrane__rest=rest, membrane__stiffness=5.0, membrane__rest_scale=0.6)
    assert np.allclose(scene.spring_constant, 5 * edge_areas(shape, mesh) / lengths(mesh, shape) ** 2)


@pytest.mark.parametrize("n", [4, 7])
@pytest.mark.parametrize(("diagonals", "side", "diagonal"), [("alternating", 1, 0.5), ("both", 1, 0.25), ("none", 2, None)])
def test_fabric_on_a_regular_grid_is_one_constant_at_any_fineness(n, diagonals, side, diagonal):
    scene = zoo.grid_scene(n, diagonals=diagonals, membrane__stiffness=6.0)
    inside = ~scene.fixed[scene.mesh.edges].all(axis=1)
    length = lengths(scene.mesh, scene.clean_target) * (n - 1)
    assert np.allclose(scene.spring_constant[inside & (length < 1.1)], 6 * side)
    if diagonal is not None:
        assert np.allclose(scene.spring_constant[inside & (length > 1.1)], 6 * diagonal)


def test_the_pyramid_has_spokes_of_one_newton_per_metre():
    for changes in ({}, {"membrane__material": "cables", "membrane__stiffness": 0.75}):
        k = edge_constants(zoo.pyramid(**changes))
        assert np.allclose([k[i, 4] for i in range(4)], 1)


# loads, noise, metric


@pytest.mark.parametrize("diagonals", ["alternating", "both", "none"])
def test_loads_add_up_to_load_times_plan_area(diagonals):
    load = [0.5, 0.0, -2.0]
    scene = zoo.grid_scene(5, zoo.hill, diagonals, membrane__loads=load)
    assert np.allclose(scene.loads.sum(axis=0), load)
    assert np.allclose(zoo.pyramid(membrane__loads=load).loads[4], zoo.PYRAMID_AREA * np.array(load))
    noisy = zoo.grid_scene(5, zoo.hill, diagonals, membrane__loads=load, target__noise={"sigma": 0.1, "seed": 0})
    assert np.array_equal(noisy.loads, scene.loads)


def test_noise_is_the_recipe_of_the_format():
    box = {"box": [[0.2, 0.2], [0.5, 0.7]]}
    clean = zoo.irregular_scene(supports__candidates=box)
    noisy = zoo.irregular_scene(supports__candidates=box, target__noise={"sigma": 0.2, "seed": 7})
    free = np.flatnonzero(~clean.fixed)
    noise = np.random.default_rng(7).normal(0, 0.2, (len(free), 3))
    assert np.array_equal(noisy.target[free], clean.target[free] + noise)
    assert np.array_equal(noisy.target[clean.fixed], clean.target[clean.fixed])
    for field in fields(clean):  # all else is measured before the noise
        if isinstance(getattr(clean, field.name), np.ndarray) and field.name != "target":
            assert np.array_equal(getattr(noisy, field.name), getattr(clean, field.name)), field.name


def test_metric_and_support_weights_are_uniform():
    scene = zoo.irregular_scene()
    assert np.array_equal(scene.metric, np.tile(np.eye(3), (25, 1, 1)))
    assert np.array_equal(scene.support_weight, np.ones(25))


# fixed vertices and candidates


def test_fixed_vertices():
    mesh, _ = zoo.grid(4)
    assert np.flatnonzero(~zoo.grid_scene(4, zoo.hill).fixed).tolist() == [5, 6, 9, 10]
    assert np.flatnonzero(zoo.grid_scene(4, zoo.hill, supports__fixed="corners").fixed).tolist() == [0, 3, 12, 15]
    scene = zoo.grid_scene(4, zoo.hill, supports__fixed=[3, 5, 3])
    assert np.flatnonzero(scene.fixed).tolist() == [3, 5]
    assert np.array_equal(scene.membrane.free, np.setdiff1d(np.arange(mesh.vertices), [3, 5]))


def test_corners_are_those_of_the_target_in_space():
    # the middle of one edge lifted: the outline turns there by 2 atan(0.4 / 0.5) = 77 degrees
    mesh, x = zoo.grid(3)
    x[1, 2] = 0.4
    scene = build_scene(zoo.settings(supports__fixed="corners"), mesh, x, None)
    assert np.flatnonzero(scene.fixed).tolist() == [0, 1, 2, 6, 8]


def test_candidates():
    def candidates(**changes):
        return np.flatnonzero(zoo.grid_scene(4, zoo.hill, **changes).candidates).tolist()

    assert candidates() == [5, 6, 9, 10]
    assert candidates(supports__candidates=[10, 5]) == [5, 10]
    assert candidates(supports__candidates={"box": [[0.3, 0.0], [0.7, 0.5]]}) == [5, 6]
    assert candidates(supports__candidates={"box": [[1 / 3, 1 / 3], [1 / 3, 1 / 3]]}) == [5]  # sides of the box are inside
    assert candidates(supports__never=[5, 0]) == [6, 9, 10]
    assert candidates(supports__candidates=[10, 5], supports__never=[5]) == [10]


# sentences


def flat(n=3):
    return zoo.grid(n)


def refused(mesh, target, rest=None, **changes):
    with pytest.raises(InputError) as caught:
        build_scene(zoo.settings(**changes), mesh, target, rest)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_target_that_is_no_number():
    mesh, x = flat()
    x[4, 1] = np.nan
    assert refused(mesh, x) == "target: vertex 4 is at [0.5, nan, 0.0]: every coordinate must be a finite number"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"supports__fixed": [0, 9]}, "supports.fixed: vertex 9 does not exist; the target has vertices 0 to 8"),
        ({"supports__fixed": [-1]}, "supports.fixed: vertex -1 does not exist; the target has vertices 0 to 8"),
        ({"supports__fixed": list(range(9))}, "supports.fixed: every vertex is fixed, so no membrane is left to shape"),
        (
            {"supports__fixed": "none", "supports__direction": "up"},
            "supports.direction: the part of the membrane",
        ),
        ({"supports__fixed": [], "supports__max_force": 1.0}, "supports.max_force: the part of the membrane that holds vertex 0"),
        ({"supports__fixed": "none", "supports__candidates": [4]}, "has neither a fixed vertex nor two places for a support"),
        ({"supports__fixed": "none", "target__metric": "height"}, "target.metric: the part of the membrane that holds vertex 0"),
        ({"supports__candidates": [9]}, "supports.candidates: vertex 9 does not exist; the target has vertices 0 to 8"),
        ({"supports__candidates": [4, 3]}, "supports.candidates: vertex 3 is fixed, so no support can act there"),
        ({"supports__candidates": []}, "supports.candidates: no vertex is left where a support may stand"),
        (
            {"supports__candidates": {"box": [[2, 2], [3, 3]]}},
            "supports.candidates: no vertex lies in the box; the target reaches",
        ),
        ({"supports__never": [4]}, "supports.candidates: no vertex is left where a support may stand"),
        ({"supports__never": [9]}, "supports.never: vertex 9 does not exist; the target has vertices 0 to 8"),
        ({"membrane__rest_scale": 1.5}, "membrane.rest_scale: every edge is slack in the wanted shape"),
        ({"membrane__rest_scale": 1.0}, "(now 1.0) until the rest lengths are shorter than the target's edges"),
        ({"membrane__rest_scale": 1.5, "membrane__springs": "tension-only"}, "membrane.rest_scale: every edge is slack"),
    ],
)
def test_settings_that_do_not_fit_the_mesh(changes, sentence):
    assert sentence in refused(*flat(), **changes)


def test_a_part_without_a_fixed_vertex_is_named():
    said = refused(*two_squares(), supports__fixed=[0, 1], supports__candidates=[2, 3, 4])
    assert "the part of the membrane that holds vertex 4" in said
    scene = build_scene(zoo.settings(supports__fixed=[0, 1]), *two_squares(), None)
    assert "the part of the membrane that holds vertex 4 has no fixed vertex" in scene.warnings[0]
    assert not build_scene(zoo.settings(supports__fixed="none"), *two_squares(), None).warnings


def test_a_rest_mesh_of_another_size():
    mesh, x = flat()
    assert refused(mesh, x, x[:-1], membrane__rest="flat.obj") == (
        "membrane.rest: flat.obj has 8 vertices, the target 9; a rest mesh needs the same numbering"
    )


def test_edges_without_rest_length():
    mesh, x = flat()
    x[4] = x[0] + [0, 0, 1]  # above a corner: no length in plan
    edge = mesh.edges.tolist().index([0, 4])
    said = refused(mesh, x)
    assert f"membrane.rest: edge {edge} (vertices 0 and 4) has a rest length of zero on the plan of the target" in said
    assert "on the rest mesh" in refused(mesh, x, x * [1, 1, 0], membrane__rest="flat.obj")
    build_scene(zoo.settings(membrane__rest="target"), mesh, x, None)


def test_faces_without_area():
    mesh = mesh_from_faces(4, np.array([[0, 1, 2, -1], [0, 2, 3, -1]]))
    x = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]])  # 0 1 2 in a row
    said = refused(mesh, x, supports__fixed=[0, 2])
    assert 'membrane.material: the faces beside edge 0 (vertices 0 and 1) have no area, so "fabric" gives it no' in said
    build_scene(zoo.settings(membrane__material="cables", supports__fixed=[0, 2]), mesh, x, None)


def test_slack_edges_are_a_warning():
    assert zoo.grid_scene(5, zoo.hill).warnings == ()
    (warning,) = zoo.grid_scene(5, zoo.hill, membrane__rest_scale=1.01).warnings
    scene = zoo.grid_scene(5, zoo.hill, membrane__rest_scale=1.01)
    share = (scene.membrane.tension(scene.target) < 0).mean()
    assert 0 < share < 1
    assert f"membrane.rest_scale: {share:.1%} of the edges are slack" in warning
    assert zoo.grid_scene(5, zoo.hill, membrane__rest_scale=1.01, membrane__springs="force-density").warnings == ()


def test_a_scene_does_not_change_under_a_reader():
    scene = zoo.pyramid()
    assert (scene.title, scene.ground) == ("zoo", 0.0)
    with pytest.raises(ValueError, match="read-only"):
        scene.target[0, 0] = 3


def test_a_scene_far_from_the_origin_is_refused():
    mesh, flat = zoo.grid(5)
    with pytest.raises(InputError, match="too far from the origin"):
        build_scene(zoo.settings(), mesh, flat + np.array([0.0, 4e6, 0.0]), None)


def test_rest_lengths_equal_to_the_target_are_slack_to_the_last_bit():
    mesh, flat = zoo.grid(5)
    hill = flat + np.outer(0.3 * np.sin(np.pi * flat[:, 0]) * np.sin(np.pi * flat[:, 1]), [0, 0, 1])
    with pytest.raises(InputError, match="every edge is slack"):
        build_scene(zoo.settings(membrane__rest="target", membrane__rest_scale=1.0), mesh, hill, None)
