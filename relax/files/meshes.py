"""Meshes from files: OBJ, PLY, OFF and STL by our own readers, the VTK family by meshio; the file's numbering is kept."""

import contextlib
import io
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from relax.arrays import Floats, Ints
from relax.errors import InputError
from relax.files.bytes import read_bytes
from relax.files.ply import read_ply
from relax.files.polygons import Polygons, read_obj, read_off, read_stl
from relax.files.schema import MESH_SUFFIXES

CORNERS = 4  # of a face at most
IGNORED_CELLS = frozenset(["vertex", "line", "empty"])
FACE_CELLS = {"triangle": (0, 1, 2), "quad": (0, 1, 2, 3), "polygon": None, "pixel": (0, 1, 3, 2)}  # corners in turn


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
        **{".vtk": lambda content: _read_vtk(path, content), ".vtu": lambda content: _read_vtk(path, content)},
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


def _read_vtk(path: Path, content: bytes) -> tuple[Floats, Polygons]:
    """Points and polygons of a VTK or VTU file, by meshio."""
    kind = path.suffix[1:].lower()
    cells = _announced_vtk(content) if kind == "vtk" else _announced_vtu(content)
    mesh = _meshio_read(path, kind)
    if sum(len(block.data) for block in mesh.cells) != cells:
        raise InputError(
            f"the file announces {cells} cells, but {sum(len(block.data) for block in mesh.cells)} can be read: it is cut short "
            "or holds triangle strips or other cells that are not read; save it as OBJ"
        )
    polygons: Polygons = []
    for block in mesh.cells:
        if block.type in IGNORED_CELLS:
            continue
        if block.type not in FACE_CELLS:
            raise InputError(
                f"it holds cells of the kind {block.type}: a membrane is made of triangles and quads; save its surface"
            )
        corners = np.asarray(block.data, dtype=np.int64)
        polygons += corners[:, FACE_CELLS[block.type] or slice(None)].tolist()
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    return points, polygons


def _meshio_read(path: Path, kind: str) -> Any:
    """The file as meshio has it: without its prints, its warnings and its exit."""
    import meshio  # a tenth of a second that only the VTK family costs

    silence = io.StringIO()
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # numbers that numpy gives up on in the middle: meshio would go on with those read so far
            warnings.filterwarnings("error", message="string or file could not be read to its end")
            return meshio.read(path, file_format=kind)
    except (SystemExit, Exception):
        # the reasons meshio gives are for programmers, often empty
        raise InputError(f"this is not a {kind.upper()} file that can be read; save it again, or as OBJ") from None


def _announced_vtk(content: bytes) -> int:
    """Number of cells that a legacy VTK file says it has."""
    dataset = re.search(rb"^DATASET\s+(\w+)", content, re.MULTILINE | re.IGNORECASE)
    if dataset is None or dataset[1].upper() != b"UNSTRUCTURED_GRID":
        found = dataset[1].decode() if dataset else "no dataset"
        raise InputError(f"it holds {found}, expected UNSTRUCTURED_GRID: save the surface as OBJ, PLY or VTU")
    types = re.search(rb"^CELL_TYPES\s+(\d+)", content, re.MULTILINE | re.IGNORECASE)
    return int(types[1]) if types else 0


def _announced_vtu(content: bytes) -> int:
    """Number of cells that a VTU file says it has; of several pieces meshio keeps the last one's cells alone."""
    pieces = re.findall(rb"<Piece\b[^>]*>", content)
    if len(pieces) != 1:
        raise InputError(f"it holds {len(pieces)} pieces, expected one: save the surface as one piece, or as OBJ")
    cells = re.search(rb"NumberOfCells\s*=\s*[\"']\s*(\d+)", pieces[0])
    return int(cells[1]) if cells else 0
