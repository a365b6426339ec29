"""Cables along edges: what they add by hand and spring by spring, where they do not add up, and the sentences on bad paths."""

from itertools import pairwise

import numpy as np
import pytest
import zoo

from relax.design.form import form
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.errors import InputError
from relax.membrane.mesh import edge_numbers
from relax.membrane.symmetry import find_symmetry

EA, SHARE = 3.0, 0.9  # newtons, and the cable's rest_scale
ROW = [21, 22, 23, 24, 25]  # neighbours in a 7 x 7 grid


def cable(path, stiffness=EA, rest_scale=SHARE):
    return {"path": list(path), "stiffness": stiffness, "rest_scale": rest_scale}


def along(scene, path):
    """Edges of a path, by the names of their ends."""
    names = {tuple(edge): index for index, edge in enumerate(scene.mesh.edges.tolist())}
    return [names[tuple(sorted(pair))] for pair in pairwise(path)]


def measured(scene, shape):
    return np.linalg.norm(shape[scene.mesh.edges[:, 1]] - shape[scene.mesh.edges[:, 0]], axis=1)


def test_edges_are_found_by_their_ends():
    mesh, _ = zoo.irregular()
    pairs = np.vstack([mesh.edges[::3], mesh.edges[1::3, ::-1], [[0, 24], [3, 3]]])
    found = edge_numbers(mesh, pairs)
    assert found[-2:].tolist() == [-1, -1]
    np.testing.assert_array_equal(mesh.edges[found[:-2]], np.sort(pairs[:-2], axis=1))


def test_a_cable_under_the_pyramid():
    # spokes 0 and 2 carry a cable too: rest length 0.9 of 1, k = 3 / 0.9, so at 5/4 it pulls 3 / 0.9 (1.25 - 0.9)
    scene = zoo.pyramid(membrane__cables=[cable([0, 4, 2])])
    pull = EA / SHARE * (1.25 - SHARE)
    tension = scene.membrane.tension(scene.target)
    spokes = dict(zip(map(tuple, scene.mesh.edges.tolist()), tension, strict=True))
    np.testing.assert_allclose([spokes[i, 4] for i in range(4)], zoo.PYRAMID_TENSION + pull * np.array([1, 0, 1, 0]), rtol=1e-14)
    # three fifths of each spoke's tension are vertical
    np.testing.assert_allclose(scene.membrane.forces(scene.target)[0], [0, 0, -zoo.PYRAMID_FORCE - 2 * 0.6 * pull], atol=1e-14)


def test_springs_side_by_side_are_one_spring_at_any_length():
    plain = zoo.grid_scene(7, zoo.hill, supports__fixed="corners")
    cables = [cable(ROW), cable(ROW[2:], 5.0, 1.1), cable([0, 1, 2], 0.1, 0.5)]
    scene = zoo.grid_scene(7, zoo.hill, supports__fixed="corners", membrane__cables=cables)
    on_plan = measured(scene, scene.clean_target * [1, 1, 0])
    rng = np.random.default_rng(0)
    for spread in (0.01, 0.2):  # also where springs push
        x = scene.target + rng.normal(scale=spread, size=scene.target.shape)
        wanted = plain.membrane.tension(x)
        for one in cables:
            edges = along(scene, one["path"])
            length, rest = measured(scene, x)[edges], one["rest_scale"] * on_plan[edges]
            wanted[edges] += one["stiffness"] * (length - rest) / rest
        np.testing.assert_allclose(scene.membrane.tension(x), wanted, rtol=1e-12, atol=1e-12)


def test_edges_without_a_cable_are_what_they_were():
    plain = zoo.irregular_scene()
    edge = plain.mesh.edges[5].tolist()
    scene = zoo.irregular_scene(membrane__cables=[cable(edge)])
    for name in ("rest_length", "spring_constant"):
        assert np.flatnonzero(getattr(scene, name) != getattr(plain, name)).tolist() == [5]


def test_cables_are_measured_on_the_rest_mesh():
    scene = zoo.grid_scene(7, zoo.hill, supports__fixed="corners", membrane__rest="target", membrane__cables=[cable(ROW)])
    plain = zoo.grid_scene(7, zoo.hill, supports__fixed="corners", membrane__rest="target")
    edges = along(scene, ROW)
    rest = SHARE * measured(scene, scene.clean_target)[edges]
    np.testing.assert_allclose((scene.spring_constant - plain.spring_constant)[edges], EA / rest, rtol=1e-9)


def test_with_force_densities_a_cable_adds_its_own():
    scene = zoo.force_density_net(membrane__cables=[cable([7, 8, 9]), cable([8, 9], 1.5)], supports__fixed="corners")
    added = dict(zip(along(scene, [7, 8, 9]), [EA, EA + 1.5], strict=True))
    for edge, constant in enumerate(scene.spring_constant):
        assert constant == 2.0 + added.get(edge, 0.0)


def tension_only(**changes):
    return zoo.grid_scene(7, zoo.hill, supports__fixed="corners", membrane__springs="tension-only", **changes)


def test_tension_only_springs_with_one_rest_scale_add_up_everywhere():
    scene, plain = tension_only(membrane__cables=[cable(ROW, rest_scale=0.7)]), tension_only()
    assert scene.warnings == ()
    edges = along(scene, ROW)
    x = scene.target * [1, 1, 0] + np.random.default_rng(0).normal(scale=0.1, size=scene.target.shape) * [1, 1, 0]
    wanted = plain.membrane.tension(x)
    rest = plain.rest_length[edges]
    wanted[edges] += EA * np.maximum(measured(scene, x)[edges] / rest - 1, 0)
    assert (wanted[edges] == 0).any() and (wanted[edges] > 0).any()
    np.testing.assert_allclose(scene.membrane.tension(x), wanted, rtol=1e-12, atol=1e-12)


def test_tension_only_springs_that_do_not_add_up_are_a_warning():
    assert tension_only(membrane__cables=[cable(ROW)]).warnings == ()  # every edge is longer than both rest lengths
    scene = tension_only(membrane__cables=[cable([0, 1, 2]), cable(ROW, rest_scale=1.2)])
    length = measured(scene, scene.target)[along(scene, ROW)] * 6  # of plan lengths 1
    share = np.mean((length > 0.7) & (length < 1.2))
    assert 0 < share < 1
    warning, *_ = scene.warnings  # the last one is on slack edges
    assert warning.startswith(f"membrane.cables: {share:.1%} of the edges of cable 1 lie in the wanted shape between the rest")


def test_a_cable_that_would_push_is_a_warning():
    scene = zoo.grid_scene(7, zoo.hill, supports__fixed="corners", membrane__cables=[cable(ROW, rest_scale=1.2), cable([0, 1])])
    length = measured(scene, scene.target)[along(scene, ROW)] * 6
    warning, *_ = scene.warnings  # the last one is on slack edges
    assert warning == (
        f"membrane.cables: {np.mean(length < 1.2):.1%} of the edges of cable 0 are shorter in the wanted shape than its rest "
        "length, and a cable cannot push: lower its rest_scale"
    )


def test_a_cable_between_fixed_vertices_is_a_warning():
    (warning,) = zoo.grid_scene(7, zoo.hill, membrane__cables=[cable(ROW), cable(range(7))]).warnings
    assert warning.startswith("membrane.cables: cable 1 runs between fixed vertices alone, so it holds nothing")
    assert len(zoo.force_density_net(membrane__cables=[cable(range(6))]).warnings) == 1


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ([0, 49], "cable 1 names vertex 49, which does not exist; the target has vertices 0 to 48"),
        ([0, 1, 3], "cable 1 goes from vertex 1 to vertex 3, which no edge of the mesh joins: name every vertex on its way"),
        ([0, 1, 1], "cable 1 goes from vertex 1 to vertex 1, which no edge"),
        ([1, 7], "cable 1 goes from vertex 1 to vertex 7, which no edge"),  # the diagonal that is not there
        ([0, 1, 2, 1], "cable 1 runs twice along the edge of vertices 1 and 2: take one of the two out"),
        ([0, 1, 8, 7, 0, 1], "cable 1 runs twice along the edge of vertices 0 and 1"),
    ],
)
def test_paths_that_leave_the_edges(path, sentence):
    with pytest.raises(InputError) as caught:
        zoo.grid_scene(7, zoo.hill, membrane__cables=[cable([0, 1, 8, 7, 0]), cable(path)])
    assert str(caught.value).startswith(f"membrane.cables: {sentence}") and "\n" not in str(caught.value)


SIDES = [list(range(7)), list(range(6, 49, 7)), list(range(42, 49)), list(range(0, 49, 7))]


def free_edge(count, **changes):
    cables = [cable(side, 2.0, 0.8) for side in SIDES[:count]]
    return zoo.grid_scene(7, zoo.hill, supports__fixed="corners", membrane__cables=cables, **changes)


@pytest.mark.parametrize(("count", "order"), [(0, 8), (1, 2), (2, 2), (4, 8)])
def test_symmetry_sees_cables(count, order):
    assert find_symmetry(free_edge(count)).order == order


def test_a_free_edge_is_scalloped_and_a_stiffer_cable_holds_it_further_out():
    def sag(stiffness):
        cables = [cable(side, stiffness, 0.95) for side in SIDES]
        scene = zoo.grid_scene(7, None, supports__fixed="corners", membrane__cables=cables if stiffness else [])
        return form(Problem(scene), np.zeros_like(scene.target)).positions[3, 1]

    sags = [sag(stiffness) for stiffness in (0.0, 1.0, 10.0, 100.0)]
    assert all(one > other > 0 for one, other in pairwise(sags))
    assert sags[0] > 2 * sags[-1]


def test_a_free_edge_with_cables_is_solved():
    design = solve(Problem(free_edge(4, penalty__weight=1e-3)))
    assert design.certificate.converged and design.certificate.supports > 0
