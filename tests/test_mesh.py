import naive
import numpy as np
import pytest
import zoo

from relax.errors import InputError
from relax.membrane.mesh import (
    boundary_vertices,
    component_labels,
    corner_vertices,
    edge_areas,
    face_areas,
    grid_mesh,
    mesh_from_faces,
    vertex_areas,
)

DIAGONALS = ("alternating", "both", "none")


def triangle(*rows):
    return np.array([[*row, -1] for row in rows])


def polygon(count):
    """A fan around vertex 0 with a regular outline of `count` vertices."""
    angle = 2 * np.pi * np.arange(count) / count
    positions = np.vstack([np.zeros(3), np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])])
    ring = 1 + np.arange(count)
    return mesh_from_faces(count + 1, triangle(*zip(0 * ring, ring, np.roll(ring, -1), strict=True))), positions


def signed_areas(positions, faces):
    """Plan area of each face, positive where it runs counter-clockwise seen from above."""
    areas = []
    for face in faces:
        x, y = positions[face[face >= 0], :2].T
        areas.append(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return np.array(areas)


def test_edges_are_the_unique_sides_in_order():
    assert zoo.mixed()[0].edges.tolist() == [[0, 1], [0, 3], [1, 2], [1, 4], [2, 3], [2, 4]]


def test_extra_edges_join_the_sides_once():
    mesh = mesh_from_faces(4, np.array([[0, 1, 2, 3]]), np.array([[2, 0], [1, 0]]))
    assert mesh.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]


@pytest.mark.parametrize(
    ("vertices", "faces", "sentence"),
    [
        (3, triangle((0, 1, 2), (0, 1, 3)), "face 1 names vertex 3, but the mesh has vertices 0 to 2: mend the face"),
        (3, triangle((0, 1, 2), (0, -1, 2)), "face 1 names vertex -1"),
        (4, np.array([[0, 1, 2, -2]]), "face 0 names vertex -2"),
        (3, triangle((0, 1, 2), (2, 1, 2)), "face 1 names a vertex twice ([2, 1, 2, -1]): remove or mend it"),
        (4, np.array([[0, 1, 2, 0], [0, 1, 2, 3]]), "face 0 names a vertex twice"),
        (4, triangle((1, 2, 3), (0, 1, 2), (1, 2, 0), (3, 1, 2)), "faces 1 and 2 have the same vertices: remove one of them"),
        (4, np.array([[0, 1, 2, -1], [0, 1, 2, 3], [3, 2, 1, 0]]), "faces 1 and 2 have the same vertices"),
        (5, triangle((0, 1, 2), (1, 2, 4)), "vertex 3 belongs to no face: remove isolated vertices"),
    ],
)
def test_bad_faces_are_refused_in_a_sentence(vertices, faces, sentence):
    with pytest.raises(InputError) as caught:
        mesh_from_faces(vertices, faces)
    assert sentence in str(caught.value)


def test_grid_diagonals_by_hand():
    sides = {(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)}
    # two cells: row + column even joins (0,0)-(1,1); odd joins the other two corners, (0,2)-(1,1)
    diagonals = {"alternating": {(0, 4), (2, 4)}, "both": {(0, 4), (1, 3), (1, 5), (2, 4)}, "none": set()}
    for name, wanted in diagonals.items():
        mesh = grid_mesh(2, 3, name)
        assert set(map(tuple, mesh.edges.tolist())) == sides | wanted, name
        assert len(mesh.edges) == len(sides | wanted), name


@pytest.mark.parametrize("diagonals", DIAGONALS)
def test_grid_faces_run_counter_clockwise_and_fill_the_square(diagonals):
    mesh, flat = zoo.grid(5, diagonals)
    areas = signed_areas(flat, mesh.faces)
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(1)
    assert np.allclose(face_areas(flat, mesh.faces), areas)


def test_areas_by_hand():
    mesh, flat = zoo.mixed()
    assert np.allclose(face_areas(flat, mesh.faces), [1, 0.25])
    quarter, third = 1 / 4, 0.25 / 3
    assert np.allclose(vertex_areas(flat, mesh), [quarter, quarter + third, quarter + third, quarter, third])
    # sides of the quad, 1-2 shared with the triangle
    assert np.allclose(edge_areas(flat, mesh), [1, 1, 1.25, 0.25, 1, 0.25])


def test_areas_of_lifted_triangles_match_the_loop():
    mesh, x = zoo.irregular()
    triangles = mesh.faces[:, :3]
    by_loop = [naive.triangle_area(*x[face]) for face in triangles]
    assert np.allclose(face_areas(x, mesh.faces), by_loop)
    assert vertex_areas(x, mesh).sum() == pytest.approx(sum(by_loop))
    wanted = naive.triangle_edge_areas(x, triangles)
    assert np.allclose(edge_areas(x, mesh), [wanted[tuple(edge)] for edge in mesh.edges.tolist()])


def test_crossed_quads_share_as_the_mean_of_their_two_triangulations():
    mesh, x = zoo.grid(4, "both")
    x = x @ np.array([[1.0, 0, 0.2], [0.3, 1, 0], [0, 0, 1]])  # parallelograms, tilted
    a, b, c, d = mesh.faces.T
    one = naive.triangle_edge_areas(x, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))
    other = naive.triangle_edge_areas(x, np.vstack([np.column_stack([a, b, d]), np.column_stack([b, c, d])]))
    wanted = [(one.get(edge, 0) + other.get(edge, 0)) / 2 for edge in map(tuple, mesh.edges.tolist())]
    assert np.allclose(edge_areas(x, mesh), wanted)


@pytest.mark.parametrize("diagonals", DIAGONALS)
def test_the_boundary_of_a_grid_is_its_ring(diagonals):
    ring = np.zeros((4, 4), dtype=bool)
    ring[[0, -1]] = ring[:, [0, -1]] = True
    mesh, flat = zoo.grid(4, diagonals)
    assert np.array_equal(boundary_vertices(mesh), ring.ravel())
    assert np.flatnonzero(corner_vertices(flat, mesh)).tolist() == [0, 3, 12, 15]


def test_a_mesh_without_outline_has_no_boundary():
    tetrahedron = mesh_from_faces(4, triangle((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)))
    assert not boundary_vertices(tetrahedron).any()
    assert not corner_vertices(np.eye(4)[:, :3], tetrahedron).any()


@pytest.mark.parametrize(("count", "corners"), [(11, 11), (12, 0), (13, 0), (40, 0)])
def test_corners_turn_by_more_than_thirty_degrees(count, corners):
    mesh, x = polygon(count)
    assert corner_vertices(x, mesh).sum() == corners
    assert not corner_vertices(x, mesh)[0]


def test_components():
    mesh = mesh_from_faces(7, triangle((0, 2, 4), (4, 2, 6), (1, 3, 5)))
    labels = component_labels(mesh)
    assert len(set(labels[[0, 2, 4, 6]])) == len(set(labels[[1, 3, 5]])) == 1
    assert labels[0] != labels[1]


def test_a_mesh_does_not_change_under_a_reader():
    with pytest.raises(ValueError, match="read-only"):
        zoo.mixed()[0].edges[0, 0] = 3
