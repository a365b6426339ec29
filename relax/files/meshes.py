"""Meshes from files: OBJ, PLY, OFF and STL by our own readers, the VTK family by meshio; the file's numbering is kept."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from relax.arrays import Floats, Ints
from relax.errors import InputError
from relax.files.bytes import read_bytes
from relax.files.ply import read_ply
from relax.files.polygons import Polygons, read_obj, read_off, read_stl
from relax.files.schema import MESH_SUFFIXES
from relax.files.vtk import read_vtk

CORNERS = 4  # of a face at most


def read_mesh(path: Path) -> tuple[Floats, Ints]:
    """Vertices and faces of a mesh file.

    Parameters
    ----------
    path : Path
        .obj .ply .off .stl .vtk .vtu; points in two dimensions get z = 0.

    Returns
    -------
    positions : (V, 3) metres
    faces : (F, 4) int
        Numbered as in the file, -1 pads triangles; STL corners are merged in order of first appearance.

    Raises
    ------
    InputError
        A file that is missing, broken, cut short where that shows, without faces, with faces of more than four corners or
        with coordinates that are not finite. The message does not name the file.
    """
    readers: dict[str, Callable[[bytes], tuple[Floats, Polygons]]] = {
        **{".obj": read_obj, ".off": read_off, ".stl": read_stl, ".ply": read_ply},
        **{suffix: lambda content: read_vtk(path, content) for suffix in (".vtk", ".vtu")},
    }
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise InputError(f'"{suffix}" is no mesh format that is read here; possible: {" ".join(MESH_SUFFIXES)}')
    points, polygons = readers[suffix](read_bytes(path))
    return points, _pack(points, polygons)


def _pack(points: Floats, polygons: Polygons) -> Ints:
    """Faces padded to four corners, and checked against the points."""
    bad = np.argwhere(~np.isfinite(points))
    if len(bad):
        vertex = int(bad[0][0])
        raise InputError(f"vertex {vertex} is at {points[vertex].tolist()}: every coordinate must be a finite number")
    if not polygons:
        raise InputError("no faces: a membrane needs triangles or quads")
    for index, corners in enumerate(polygons):
        if not 3 <= len(corners) <= CORNERS:
            raise InputError(f"face {index} has {len(corners)} corners: only triangles and quads are read; triangulate the mesh")
        if min(corners) < 0 or max(corners) >= len(points):
            worst = min(corners) if min(corners) < 0 else max(corners)
            raise InputError(
                f"face {index} names vertex {worst}, but the mesh has vertices 0 to {len(points) - 1}: mend the face"
            )
    return np.array([[*corners, -1][:CORNERS] for corners in polygons], dtype=np.int64)
