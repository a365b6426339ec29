"""A result for other programs on request: a COMPAS network (JSON), and an OBJ in which the supports are lines."""

import json
import os
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relax.arrays import Floats
from relax.design.masts import Mast, standing_masts
from relax.errors import InputError
from relax.files.exports import obj_lines
from relax.files.stored import StoredResult
from relax.membrane.scene import Scene

if TYPE_CHECKING:
    from relax.design.solve import Design

NODE = {name: 0.0 for name in ("x", "y", "z", "px", "py", "pz", "rx", "ry", "rz")} | {"is_support": False}
EDGE = {"q": 0.0, "force": 0.0, "length": 0.0, "rest_length": None, "kind": "membrane"}


def export(found: "Design | StoredResult", path: str | os.PathLike[str], to: str) -> None:
    """Write a result as a file of another kind; what is there is replaced, whole or not at all.

    Parameters
    ----------
    found : Design or StoredResult
    path : path
    to : str
        "compas": a COMPAS network as `compas.json_load` reads it (`Graph` in COMPAS 2), the supports among its edges. "obj": the
        membrane's faces, and a line from head to foot for each support that has one.

    Raises
    ------
    InputError
        A kind that there is not, or a place where no file can be.

    Notes
    -----
    Nodes are the vertices, then the feet; x, y, z in metres, the load px, py, pz and the residual rx, ry, rz in newtons. The
    residual is what edges and load pull on a node together, p_i + sum_j q_ij (x_j - x_i): zero where the node is free, what
    fixed vertices, feet and the heads of stays must hold where `is_support`. Edges carry the force density q (N/m), force (N,
    tension positive), length and rest_length (m), and kind: "membrane", "mast" or "tie-down".
    """
    if to not in KINDS:
        raise InputError(f'to = "{to}": expected {" or ".join(KINDS)}')
    path = Path(path)
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError(f"{path}: {'this is a folder' if path.is_dir() else 'its folder does not exist'}: name a file elsewhere")
    scene = found.scene if isinstance(found, StoredResult) else found.problem.scene
    text = KINDS[to](scene, found.positions, found.forces)
    stage = path.absolute().with_name(f".relax-{secrets.token_hex(6)}")
    try:
        stage.write_text(text, encoding="utf-8")
        os.replace(stage, path)
    finally:
        stage.unlink(missing_ok=True)


def network(scene: Scene, positions: Floats, forces: Floats) -> dict[str, Any]:
    """The content of a COMPAS network: attributes of each node and each edge (see `export`)."""
    masts = [mast for mast in standing_masts(positions, forces, scene.ground) if mast.foot is not None]
    tension = scene.membrane.tension(positions)
    length = np.linalg.norm(positions[scene.mesh.edges[:, 1]] - positions[scene.mesh.edges[:, 0]], axis=1)
    density = np.divide(tension, length, out=np.zeros_like(tension), where=length > 0)
    table = zip(density.tolist(), tension.tolist(), length.tolist(), scene.rest_length.tolist(), strict=True)
    edges: dict[str, dict[str, dict[str, Any]]] = {str(node): {} for node in range(len(positions) + len(masts))}
    for (a, b), (q, force, long, rest) in zip(scene.mesh.edges.tolist(), table, strict=True):
        edges[str(a)][str(b)] = {"q": q, "force": force, "length": long, "rest_length": rest}
    for foot, mast in enumerate(masts, start=len(positions)):
        edges[str(mast.vertex)][str(foot)] = _strut(mast)
    points = np.vstack([positions, *(np.array([mast.foot]) for mast in masts)])
    loads = np.vstack([scene.loads, np.zeros((len(masts), 3))])
    residual = _residual(points, loads, edges)
    held = np.concatenate([scene.fixed, np.ones(len(masts), dtype=bool)])
    heads = {mast.vertex for mast in masts}
    held[[vertex for vertex in np.flatnonzero(forces.any(axis=1)) if vertex not in heads]] = True
    columns = np.hstack([points, loads, residual]).tolist()
    nodes = {str(node): dict(zip(NODE, [*row, bool(held[node])], strict=True)) for node, row in enumerate(columns)}
    return {
        "attributes": {"units": "m, N"},
        "default_node_attributes": NODE,
        "default_edge_attributes": EDGE,
        "node": nodes,
        "edge": edges,
        "max_node": len(nodes) - 1,
    }


def _strut(mast: Mast) -> dict[str, Any]:
    """A mast is pressed, so its force is negative; a tie-down pulls as the membrane's edges do."""
    length = mast.length or 0.0
    force = -mast.magnitude if mast.kind == "mast" else mast.magnitude
    return {"q": force / length if length else 0.0, "force": force, "length": length, "kind": mast.kind}


def _residual(points: Floats, loads: Floats, edges: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Floats:
    pairs = [(int(a), int(b), edge["q"]) for a, others in edges.items() for b, edge in others.items()]
    start, end, density = (np.array(column) for column in zip(*pairs, strict=True))
    pull = density[:, None] * (points[end] - points[start])
    found = loads.copy()
    np.add.at(found, start, pull)
    np.add.at(found, end, -pull)
    return found


def _as_compas(scene: Scene, positions: Floats, forces: Floats) -> str:
    said = {"dtype": "compas.datastructures/Graph", "data": network(scene, positions, forces), "name": scene.title}
    return json.dumps(said, allow_nan=False) + "\n"


def _as_obj(scene: Scene, positions: Floats, forces: Floats) -> str:
    """Feet behind the membrane's vertices, the supports as lines in groups by their kind."""
    masts = [mast for mast in standing_masts(positions, forces, scene.ground) if mast.foot is not None]
    points = np.vstack([positions, *(np.array([mast.foot]) for mast in masts)])
    lines = obj_lines("membrane in equilibrium and its supports, written by relax", points, scene.mesh.faces, "membrane")
    for kind in dict.fromkeys(mast.kind for mast in masts):
        lines.append(f"g {kind}s")
        lines += [f"l {mast.vertex + 1} {len(positions) + foot}" for foot, mast in enumerate(masts, start=1) if mast.kind == kind]
    return "\n".join(lines) + "\n"


KINDS: dict[str, Callable[[Scene, Floats, Floats], str]] = {"compas": _as_compas, "obj": _as_obj}
SUFFIX = {"compas": ".json", "obj": ".obj"}
