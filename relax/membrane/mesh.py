"""Meshes as arrays: faces, unique edges, boundary, areas; everything that needs no physics."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.errors import InputError

CORNER_TURN = np.radians(30.0) * (1 + 1e-9)  # a circle drawn with 12 vertices or more has no corners, round-off or not
CANCELLED = 1e-9  # of the area beside a vertex: what is left of normals that cancel is round-off, and points anywhere


@dataclass(frozen=True)
class Mesh:
    """Connectivity of a membrane.

    Parameters
    ----------
    vertices : int
        Number of vertices V.
    faces : (F, 4) int
        Triangles and quads, counter-clockwise seen from above; -1 pads triangles.
    edges : (E, 2) int
        Unique edges a < b in ascending order: the sides of the faces and, where asked for, quad diagonals.
    """

    vertices: int
    faces: Ints
    edges: Ints

    def __post_init__(self) -> None:
        lock_arrays(self)


def mesh_from_faces(vertices: int, faces: Ints, extra_edges: Ints | None = None) -> Mesh:
    """A mesh with the unique sides of its faces as edges, and `extra_edges` (k, 2) beside them.

    Raises
    ------
    InputError
        A face index out of range, a face that names a vertex twice, two faces on the same vertices, or a vertex that no face
        uses.
    """
    faces = np.asarray(faces, dtype=np.int64)
    padding = (faces == -1) & (np.arange(faces.shape[1]) == 3)
    bad = ((faces < 0) & ~padding) | (faces >= vertices)
    if bad.any():
        face, corner = np.argwhere(bad)[0]
        raise InputError(
            f"face {face} names vertex {faces[face, corner]}, but the mesh has vertices 0 to {vertices - 1}: mend the face"
        )
    ordered = np.sort(faces, axis=1)
    twice = np.flatnonzero(((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any(axis=1))
    if twice.size:
        raise InputError(f"face {twice[0]} names a vertex twice ({faces[twice[0]].tolist()}): remove or mend it")
    _refuse_duplicates(ordered)
    sides = _sides(faces)[0]
    if extra_edges is not None:
        sides = np.vstack([sides, np.sort(extra_edges, axis=1)])
    edges = np.unique(sides, axis=0)
    used = np.zeros(vertices, dtype=bool)
    used[edges] = True
    if not used.all():
        raise InputError(f"vertex {np.flatnonzero(~used)[0]} belongs to no face: remove isolated vertices")
    return Mesh(vertices, faces, edges)


def _refuse_duplicates(ordered: Ints) -> None:
    """Refuse two faces on the same vertices; `ordered` (F, 4) holds the corners of each face in ascending order."""
    order = np.lexsort(ordered.T)  # stable: of equal faces the earlier comes first
    again = np.flatnonzero((ordered[order[1:]] == ordered[order[:-1]]).all(axis=1))
    if again.size:
        pair = again[np.argmin(order[again + 1])]
        raise InputError(f"faces {order[pair]} and {order[pair + 1]} have the same vertices: remove one of them")


def _directed_sides(faces: Ints) -> tuple[Ints, Ints]:
    """Sides of all faces as (k, 2), in the direction in which the face runs round, and the face of each (k,)."""
    corners = np.where(faces[:, 3:] < 0, faces[:, [0, 1, 2, 0]], faces)
    starts = np.concatenate([corners[:, i] for i in range(4)])
    ends = np.concatenate([corners[:, (i + 1) % 4] for i in range(4)])
    real = starts != ends
    owner = np.tile(np.arange(len(faces)), 4)
    return np.column_stack([starts, ends])[real], owner[real]


def _sides(faces: Ints) -> tuple[Ints, Ints]:
    """Sides of all faces as (k, 2) with a < b, and the face of each (k,)."""
    sides, owner = _directed_sides(faces)
    return np.sort(sides, axis=1), owner


def against_each_other(mesh: Mesh) -> tuple[int, int] | None:
    """Two faces that run along a side in the same direction, so that their normals are on two sides of the membrane."""
    sides, owner = _directed_sides(mesh.faces)
    key = sides[:, 0] * mesh.vertices + sides[:, 1]
    order = np.argsort(key, kind="stable")
    again = np.flatnonzero(np.diff(key[order]) == 0)
    return (int(owner[order[again[0]]]), int(owner[order[again[0] + 1]])) if again.size else None


def edge_numbers(mesh: Mesh, pairs: Ints) -> Ints:
    """The edge between two vertices (k, 2) in either order, as its place in `mesh.edges` (k,); -1 where there is none."""
    key = mesh.edges[:, 0] * mesh.vertices + mesh.edges[:, 1]
    wanted = pairs.min(axis=1) * mesh.vertices + pairs.max(axis=1)
    found = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
    return np.where(key[found] == wanted, found, -1)


def grid_mesh(rows: int, columns: int, diagonals: str) -> Mesh:
    """The mesh of a height field, vertex = row * columns + column.

    `diagonals`: "alternating" gives triangles whose diagonal joins (r, c) and (r+1, c+1) where r + c is even and the
    other two corners elsewhere; "none" gives quads; "both" gives quads with both diagonals as edges.
    """
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    d, c = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    quads = np.column_stack([a, b, c, d])
    if diagonals == "none":
        return mesh_from_faces(index.size, quads)
    if diagonals == "both":
        return mesh_from_faces(index.size, quads, np.vstack([np.column_stack([a, c]), np.column_stack([b, d])]))
    even = ((a // columns + a % columns) % 2 == 0)[:, None]
    pad = np.full((len(a), 1), -1)
    first = np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(even, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    faces = np.stack([np.hstack([first, pad]), np.hstack([second, pad])], axis=1).reshape(-1, 4)
    return mesh_from_faces(index.size, faces)


def _face_vectors(positions: Floats, faces: Ints) -> Floats:
    """Area times normal of each face (F, 3): half the cross product of a triangle's sides or of a quad's diagonals."""
    triangle = faces[:, 3:] < 0
    last = np.where(triangle[:, 0], faces[:, 0], faces[:, 3])
    one = positions[faces[:, 2]] - positions[faces[:, 0]]
    other = np.where(triangle, positions[faces[:, 1]] - positions[faces[:, 0]], positions[last] - positions[faces[:, 1]])
    return 0.5 * np.cross(one, other)


def face_areas(positions: Floats, faces: Ints) -> Floats:
    """Area of each face (F,)."""
    return np.linalg.norm(_face_vectors(positions, faces), axis=1)


def vertex_areas(positions: Floats, mesh: Mesh) -> Floats:
    """Share of the adjacent faces' area (V,): a third of each triangle, a quarter of each quad, so that they add up."""
    real = mesh.faces >= 0
    share = face_areas(positions, mesh.faces) / real.sum(axis=1)
    return np.asarray(np.bincount(mesh.faces[real], np.repeat(share, real.sum(axis=1)), mesh.vertices), dtype=float)


def vertex_normals(positions: Floats, mesh: Mesh) -> Floats:
    """Unit normals (V, 3), the mean of the adjacent faces' weighted by area; 0 where they cancel or no face has an area."""
    vectors = _face_vectors(positions, mesh.faces)
    corner = mesh.faces >= 0
    at, of = mesh.faces[corner], np.repeat(np.arange(len(mesh.faces)), corner.sum(axis=1))
    total = np.column_stack([np.bincount(at, vectors[of, axis], minlength=mesh.vertices) for axis in range(3)])
    beside = np.bincount(at, np.linalg.norm(vectors, axis=1)[of], minlength=mesh.vertices)
    length = np.linalg.norm(total, axis=1)
    there = length > CANCELLED * beside
    return np.where(there[:, None], total / np.where(there, length, 1.0)[:, None], 0.0)


def edge_areas(positions: Floats, mesh: Mesh) -> Floats:
    """Area of the faces beside each edge (E,), for van Gelder's spring constants.

    A quad whose diagonals are edges gives half its area to its sides and diagonals, the mean of its two triangulations.
    """
    sides, owner = _sides(mesh.faces)
    areas = face_areas(positions, mesh.faces)
    quads = np.flatnonzero(mesh.faces[:, 3] >= 0)
    crossed = np.zeros(len(mesh.faces), dtype=bool)
    total = np.zeros(len(mesh.edges))
    diagonals = [edge_numbers(mesh, mesh.faces[quads][:, pair]) for pair in ([0, 2], [1, 3])]
    crossed[quads] = (diagonals[0] >= 0) & (diagonals[1] >= 0)
    for edge in diagonals:
        there = edge >= 0
        total += np.bincount(edge[there], 0.5 * areas[quads][there], minlength=len(total))
    share = np.where(crossed, 0.5, 1.0) * areas
    return total + np.bincount(edge_numbers(mesh, sides), share[owner], minlength=len(total))


def boundary_vertices(mesh: Mesh) -> Mask:
    """Vertices on a side that belongs to a single face (V,)."""
    mask = np.zeros(mesh.vertices, dtype=bool)
    mask[_outline(mesh)] = True
    return mask


def _outline(mesh: Mesh) -> Ints:
    sides, counts = np.unique(_sides(mesh.faces)[0], axis=0, return_counts=True)
    return sides[counts == 1]


def corner_vertices(positions: Floats, mesh: Mesh) -> Mask:
    """Boundary vertices at which the outline turns by more than 30 degrees (V,)."""
    outline = _outline(mesh)
    ends = np.concatenate([outline[:, 0], outline[:, 1]])
    away = positions[np.concatenate([outline[:, 1], outline[:, 0]])] - positions[ends]
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    total = np.zeros((mesh.vertices, 3))
    np.add.at(total, ends, away)
    # two unit vectors leave a vertex; where the outline runs straight on they cancel, |sum| = 2 sin(turn / 2)
    return np.linalg.norm(total, axis=1) > 2 * np.sin(CORNER_TURN / 2)


def component_labels(mesh: Mesh) -> Ints:
    """Connected component of each vertex (V,)."""
    a, b = mesh.edges.T
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(mesh.vertices, mesh.vertices))
    return connected_components(graph, directed=False)[1].astype(np.int64)
