"""Scenes from arrays that a program holds, with the keys of a scene file for everything else."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.scenes import override
from relax.files.schema import Settings, resolve
from relax.membrane.mesh import Mesh, grid_mesh, mesh_from_faces
from relax.membrane.scene import Scene, build_scene

Keys = Mapping[str, Any]
MESH, HEIGHTS, REST = "arrays.obj", "arrays.npy", "arrays-rest.obj"  # what the settings name in place of files


def scene_from_arrays(vertices: ArrayLike, faces: ArrayLike, keys: Keys | None = None, rest: ArrayLike | None = None) -> Scene:
    """The scene that asks for a mesh.

    Parameters
    ----------
    vertices : (V, 3) or (V, 2) metres
        The wanted positions.
    faces : (F, 3) or (F, 4) int
        Triangles or quads, from 0; -1 at the end of a row of four pads a triangle.
    keys : mapping of "section.key" to a value, optional
        Keys of a scene file (relax/FORMATS.md), for example `{"membrane.rest_scale": 0.8, "supports.direction": "up"}`.
    rest : (V, 3) metres, optional
        Vertices of the mesh on which rest lengths are measured; default: what `membrane.rest` says, the plan.

    Returns
    -------
    Scene
        Its settings name the files `arrays.obj` and `arrays-rest.obj`, which there are not: a result of it holds the arrays.

    Raises
    ------
    InputError
        Names the argument, or section and key, and what was expected.
    """
    target = _points("vertices", vertices)
    corners = np.asarray(faces)
    if not len(target) or not corners.size:
        raise InputError("vertices and faces: at least one of them is empty: a membrane needs triangles or quads")
    if corners.ndim != 2 or corners.shape[1] not in (3, 4) or not np.issubdtype(corners.dtype, np.integer):
        raise InputError(f"faces: found {_described(corners)}, expected whole numbers of the shape (F, 3) or (F, 4)")
    if corners.shape[1] == 3:
        corners = np.column_stack([corners, np.full(len(corners), -1)])
    given = {"target.mesh": MESH, **(keys or {})}
    flat = None
    if rest is not None:
        given["membrane.rest"] = REST
        flat = _points("rest", rest)
    return _built(resolve(override({}, given)), mesh_from_faces(len(target), corners), target, flat)


def scene_from_heights(heights: ArrayLike, spacing: tuple[float, float], keys: Keys | None = None) -> Scene:
    """The scene that asks for a height field.

    Parameters
    ----------
    heights : (rows, columns) metres
        z; x grows with the column, y with the row.
    spacing : (dx, dy) metres
    keys : as for `scene_from_arrays`

    Returns
    -------
    Scene
        Its settings name the file `arrays.npy`, which there is not: a result of it holds the arrays.

    Raises
    ------
    InputError
        Names the argument, or section and key, and what was expected.
    """
    z = np.asarray(heights)
    if z.ndim != 2 or min(z.shape) < 2 or z.dtype.kind not in "fiu":
        raise InputError(f"heights: found {_described(z)}, expected numbers of the shape (rows, columns), at least 2 of each")
    settings = resolve(override({}, {"target.heights": HEIGHTS, "target.spacing": list(spacing), **(keys or {})}))
    said = settings["target"]
    row, column = np.divmod(np.arange(z.size), z.shape[1])
    target = np.column_stack([column * said["spacing"][0], row * said["spacing"][1], z.ravel() * said["height_scale"]])
    return _built(settings, grid_mesh(z.shape[0], z.shape[1], said["diagonals"]), target, None)


def _points(name: str, values: ArrayLike) -> Floats:
    points = np.asarray(values)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or points.dtype.kind not in "fiu":
        raise InputError(f"{name}: found {_described(points)}, expected numbers of the shape (V, 3)")
    plain = np.zeros((len(points), 3))
    plain[:, : points.shape[1]] = points
    return plain


def _described(array: Any) -> str:
    return f"an array of {array.dtype} of the shape {array.shape}"


def _built(settings: Settings, mesh: Mesh, target: Floats, rest: Floats | None) -> Scene:
    wanted = settings["membrane"]["rest"]
    if rest is None and wanted not in ("plan", "target"):
        raise InputError(f'membrane.rest = "{wanted}": of arrays, hand the vertices of the rest mesh over as `rest`')
    if rest is not None and len(rest) != len(target):
        raise InputError(f"rest: it has {len(rest)} vertices, expected {len(target)}, numbered as the target's")
    if settings["supports"]["ground"] is None:
        settings["supports"]["ground"] = float(target[:, 2].min())
    return build_scene(settings, mesh, target, rest)
