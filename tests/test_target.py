"""How the distance from the target is measured: blocks by hand and by plain loops, and answers judged with dense matrices."""

import naive_judge
import numpy as np
import pytest
import zoo

from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.errors import InputError
from relax.membrane.mesh import Mesh, mesh_from_faces
from relax.membrane.scene import build_scene
from relax.membrane.symmetry import find_symmetry

CHOICES = [(metric, weighted) for metric in ("pairs", "normal", "height") for weighted in (False, True)]
SLOPE = np.array([0.3, -0.2])


def tilted(x, y):
    return SLOPE[0] * x + SLOPE[1] * y


def naive_normals(mesh, x):
    """Sum of the faces' cross products round each vertex, face by face; a quad by its two triangles."""
    total = np.zeros_like(x)
    for face in mesh.faces.tolist():
        corners = [v for v in face if v >= 0]
        triangles = [corners[:3]] if len(corners) == 3 else [corners[:3], [corners[0], corners[2], corners[3]]]
        vector = sum(np.cross(x[b] - x[a], x[c] - x[a]) / 2 for a, b, c in triangles)
        for vertex in corners:
            total[vertex] += vector
    return total / np.linalg.norm(total, axis=1)[:, None]


def refused(mesh, target, **changes):
    with pytest.raises(InputError) as caught:
        build_scene(zoo.settings(**changes), mesh, target, None)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# blocks


@pytest.mark.parametrize("diagonals", ["alternating", "none", "both"])
def test_the_normal_of_a_plane_is_the_same_everywhere(diagonals):
    scene = zoo.grid_scene(5, tilted, diagonals, target__metric="normal")
    normal = np.array([*-SLOPE, 1]) / np.sqrt(1 + SLOPE @ SLOPE)
    np.testing.assert_allclose(scene.metric, np.tile(np.outer(normal, normal), (25, 1, 1)), atol=1e-15)


@pytest.mark.parametrize("diagonals", ["alternating", "none", None])
def test_normals_are_the_mean_of_the_faces_weighted_by_area(diagonals):
    options = {"target__metric": "normal"}
    scene = zoo.irregular_scene(**options) if diagonals is None else zoo.grid_scene(6, zoo.bumps, diagonals, **options)
    normal = naive_normals(scene.mesh, scene.clean_target)
    np.testing.assert_allclose(scene.metric, normal[:, :, None] * normal[:, None, :], atol=1e-14)


def test_the_side_from_which_faces_are_seen_does_not_matter():
    scene = zoo.irregular_scene(target__metric="normal")
    turned = Mesh(scene.mesh.vertices, scene.mesh.faces[:, [0, 2, 1, 3]], scene.mesh.edges)
    other = build_scene(zoo.settings(target__metric="normal"), turned, scene.clean_target, None)
    np.testing.assert_allclose(other.metric, scene.metric, atol=1e-15)


def test_height_alone():
    scene = zoo.grid_scene(5, zoo.hill, target__metric="height")
    assert np.array_equal(scene.metric, np.tile(np.diag([0.0, 0.0, 1.0]), (25, 1, 1)))


@pytest.mark.parametrize("metric", ["pairs", "normal", "height"])
def test_area_weights_are_plan_areas_in_square_metres(metric):
    mesh, flat = zoo.mixed()
    target = 2 * flat + np.outer(tilted(*2 * flat.T[:2]), [0, 0, 1])  # lengths doubled: four times the area, tilted or not
    changes = {"target__metric": metric, "supports__fixed": [0]}
    plain = build_scene(zoo.settings(**changes), mesh, target, None)
    weighted = build_scene(zoo.settings(target__area_weights=True, **changes), mesh, target, None)
    area = 4 * np.array([1 / 4, 1 / 4 + 1 / 12, 1 / 4 + 1 / 12, 1 / 4, 1 / 12])  # a quarter of the quad, a third of the triangle
    np.testing.assert_allclose(weighted.metric, area[:, None, None] * plain.metric, rtol=1e-14)


def test_the_metric_is_that_of_the_clean_target():
    changes = {"target__metric": "normal", "target__area_weights": True}
    noisy = zoo.irregular_scene(target__noise={"sigma": 0.1, "seed": 1}, **changes)
    assert np.array_equal(noisy.metric, zoo.irregular_scene(**changes).metric)


def folded():
    """Two quads in a row and a wall of one more hanging from their right side: vertices 6 and 7 have no plan area."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0], [2, 0, -1], [2, 1, -1]])
    return mesh_from_faces(8, np.array([[0, 1, 4, 3], [1, 2, 5, 4], [2, 6, 7, 5]])), x


def test_a_vertex_without_plan_area_is_not_asked_to_be_anywhere():
    mesh, x = folded()
    changes = {"membrane__rest": "target", "supports__fixed": [0, 3, 6], "target__area_weights": True}
    scene = build_scene(zoo.settings(**changes), mesh, x, None)
    assert not scene.metric[[6, 7]].any()
    moved = x.copy()
    moved[7] += [1.0, 2.0, 3.0]
    problem = Problem(scene)
    assert problem.distance(moved) == 0.0
    moved[4] += [0.0, 0.0, 2.0]
    assert problem.distance(moved) == pytest.approx(4 * 2 / 4)  # a quarter of two unit quads


def test_area_weights_that_are_all_zero_are_refused():
    mesh, x = folded()
    said = refused(mesh, x, membrane__rest="target", supports__fixed=[0, 1, 2, 3, 4, 5], target__area_weights=True)
    assert said.startswith("target.area_weights: no free vertex has any plan area beside it, so no distance would count:")


def test_degenerate_normals_are_refused_where_they_would_count():
    # vertex 4 lies between two faces of which one is the other seen from below: their normals cancel
    mesh = mesh_from_faces(5, np.array([[0, 1, 4, -1], [2, 3, 4, -1]]))
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0.001], [-1, 0, 0], [0, 1, 0]])
    x[2:4] = [[1.0, 0, 0], [0, 0, 0]]  # 0 1 4 and 1 0 4 in the same place
    changes = {"target__metric": "normal", "membrane__material": "cables"}
    said = refused(mesh, x, supports__fixed=[0, 1, 2, 3], **changes)
    assert said == (
        'target.metric = "normal": vertex 4 has no normal, as the faces beside it have no area or their normals cancel: '
        'mend the mesh there, or use metric = "pairs"'
    )
    scene = build_scene(zoo.settings(supports__fixed=[4], **changes), mesh, x, None)
    assert not scene.metric[4].any() and scene.metric[0].any()


def test_faces_that_turn_against_each_other_are_refused():
    mesh, x = zoo.grid(3)
    faces = mesh.faces.copy()
    faces[2] = faces[2][[0, 2, 1, 3]]
    said = refused(mesh_from_faces(9, faces), x, target__metric="normal")
    assert "faces " in said and " and 2 run along" in said.replace("faces 2 and", "faces x and 2 run along")
    assert "turn one of them round in the mesh file" in said
    build_scene(zoo.settings(), mesh_from_faces(9, faces), x, None)


# what it does to a problem


def test_sliding_in_the_surface_costs_nothing_and_leaving_it_all():
    problem = Problem(zoo.grid_scene(6, tilted, target__metric="normal"))
    rng = np.random.default_rng(0)
    normal = np.array([*-SLOPE, 1]) / np.sqrt(1 + SLOPE @ SLOPE)
    away = rng.normal(size=(36, 3))
    away[problem.scene.fixed] = 0
    along = away - np.outer(away @ normal, normal)
    assert problem.distance(problem.scene.target + along) < 1e-28
    assert problem.distance(problem.scene.target + away) == pytest.approx(np.sum((away @ normal) ** 2))


@pytest.mark.parametrize(("metric", "weighted"), CHOICES)
def test_symmetry_is_seen_through_every_metric(metric, weighted):
    scene = zoo.grid_scene(9, zoo.hill, target__metric=metric, target__area_weights=weighted)
    assert find_symmetry(scene).order == 8


def test_area_weights_can_break_a_symmetry():
    # a net that is the same from all sides; one of its quads is two triangles, which no spring knows of
    mesh, x = zoo.grid(3, "both")
    faces = np.vstack([mesh.faces[1:], [[0, 1, 4, -1], [0, 4, 3, -1]]])
    changes = {"membrane__material": "cables"}
    for weighted, order in ((False, 8), (True, 2)):
        scene = build_scene(zoo.settings(target__area_weights=weighted, **changes), Mesh(9, faces, mesh.edges), x, None)
        assert find_symmetry(scene).order == order


def two_tents(**changes):
    """Two irregular membranes side by side."""
    mesh, x = zoo.irregular(6)
    faces = np.vstack([mesh.faces, np.where(mesh.faces < 0, -1, mesh.faces + len(x))])
    return build_scene(
        zoo.settings(**changes), mesh_from_faces(2 * len(x), faces), np.vstack([x, x + np.array([2.0, 0, 0.1])]), None
    )


def test_parts_have_their_share_of_metric_and_weights():
    scene = two_tents(
        target__metric="normal",
        target__area_weights=True,
        supports__weights="height",
        supports__ground=-1.0,
        supports__always=[14],
    )
    assert len(scene.parts) == 2
    for part in scene.parts:
        np.testing.assert_array_equal(part.scene.metric, scene.metric[part.vertices])
        np.testing.assert_array_equal(part.scene.support_weight, scene.support_weight[part.vertices])
    assert sum(int((part.scene.support_weight == 0).sum()) for part in scene.parts) == 1


@pytest.mark.parametrize(("metric", "weighted"), CHOICES)
def test_answers_under_every_metric_are_what_dense_matrices_say(metric, weighted):
    weight = 0.05 * (1 / 64 if weighted else 1)
    scene = zoo.grid_scene(9, zoo.bumps, target__metric=metric, target__area_weights=weighted, penalty__weight=weight)
    design = solve(Problem(scene))
    mine = naive_judge.naive_figures(naive_judge.result_arrays(scene, design.positions, design.forces), scene.settings)
    assert naive_judge.differences(design.certificate.figures(), mine) == []
    assert mine["converged"] and 0 < mine["supports"] < 20


def test_rms_distance_stays_euclidean_and_unweighted():
    scene = zoo.grid_scene(6, zoo.hill, target__metric="height", target__area_weights=True)
    moved = scene.target + np.where(scene.fixed[:, None], 0, [0.3, 0.0, 0.4])
    said = judge(Problem(scene, weight=1.0), moved, np.zeros_like(moved))
    assert said.rms_distance == pytest.approx(0.5)
    area = scene.metric[~scene.fixed, 2, 2].sum()
    assert said.distance == pytest.approx(0.16 * area)
