"""The shape found, for other programs: OBJ and VTU."""

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from relax.arrays import Floats, Ints
from relax.membrane.scene import Scene


def write_obj(path: Path, positions: Floats, faces: Ints) -> None:
    """Write vertices with 17 digits, from which the same numbers are read back, and faces counted from 1."""
    path.write_text("\n".join(obj_lines("membrane in equilibrium, written by relax", positions, faces)) + "\n", encoding="ascii")


def obj_lines(remark: str, positions: Floats, faces: Ints, group: str = "") -> list[str]:
    """The lines of `write_obj`, the faces in a group where one is named."""
    lines = [f"# {remark}"]
    lines += ["v " + " ".join(f"{value:.17g}" for value in point) for point in positions.tolist()]
    lines += [f"g {group}"] if group else []
    lines += ["f " + " ".join(str(corner + 1) for corner in face if corner >= 0) for face in faces.tolist()]
    return lines


def write_vtu(path: Path, scene: Scene, positions: Floats, forces: Floats) -> None:
    """Write faces and edges; tension is nan on faces, displacement counts from the target, forces are in newtons."""
    fields = {"displacement": positions - scene.target, "support_force": forces.copy(), "load": scene.loads.copy()}
    _write_vtu(path, scene, positions, fields, {"tension": scene.membrane.tension(positions)})


def write_field(path: Path, scene: Scene, positions: Floats, fields: Mapping[str, Floats]) -> None:
    """Write faces and edges with values of the vertices, (V,) or (V, 3), by name."""
    _write_vtu(path, scene, positions, fields, {})


def _write_vtu(path: Path, scene: Scene, positions: Floats, fields: Mapping[str, Floats], of_edges: Mapping[str, Floats]) -> None:
    import meshio  # reading and solving need it not

    faces = scene.mesh.faces
    triangle = faces[:, 3] < 0
    blocks = {"triangle": faces[triangle, :3], "quad": faces[~triangle], "line": scene.mesh.edges}
    blocks = {name: cells for name, cells in blocks.items() if len(cells)}
    mesh = meshio.Mesh(
        positions.copy(),
        list(blocks.items()),
        point_data=dict(fields),
        cell_data={
            key: [values if name == "line" else np.full(len(cells), np.nan) for name, cells in blocks.items()]
            for key, values in of_edges.items()
        },
    )
    silence = io.StringIO()
    with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        meshio.write(path, mesh, file_format="vtu")
