"""What the edges are made of: rest lengths and spring constants of fabric and nets, and the cables along edges beside them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.errors import InputError
from relax.membrane.mesh import Mesh, edge_areas, edge_numbers

SAME_LENGTH = 1e-12  # relative: two products of the same numbers differ by round-off


@dataclass(frozen=True)
class Material:
    """Rest lengths and spring constants (E,), metres and newtons per metre, and sentences on what will surprise."""

    rest_length: Floats
    spring_constant: Floats
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        lock_arrays(self)


def rest_shape(membrane: Mapping[str, Any], target: Floats, rest: Floats | None) -> Floats:
    """Positions (V, 3) on which rest lengths and areas are measured."""
    choice = membrane["rest"]
    if rest is None:
        return target if choice == "target" else target * [1.0, 1.0, 0.0]
    if rest.shape != target.shape:
        raise InputError(
            f"membrane.rest: {choice} has {len(rest)} vertices, the target {len(target)}; a rest mesh needs the same numbering"
        )
    return rest


def make_material(membrane: Mapping[str, Any], mesh: Mesh, shape: Floats, target: Floats, fixed: Mask) -> Material:
    """The springs of section [membrane] on a rest shape; see MATHEMATICS.md, "Membrane".

    Parameters
    ----------
    membrane : section [membrane] of the settings
    mesh : Mesh
    shape, target : (V, 3) metres
        Rest shape and clean target.
    fixed : (V,) bool

    Raises
    ------
    InputError
        An edge without length or, for fabric, without area; a cable that does not run along edges; every edge slack.
    """
    measured = _measured(membrane, mesh, shape)
    material = Material(membrane["rest_scale"] * measured, _constants(membrane, mesh, shape, measured))
    cables = _cables(membrane, mesh, measured)
    wanted = np.linalg.norm(target[mesh.edges[:, 1]] - target[mesh.edges[:, 0]], axis=1)
    remarks = [
        f"membrane.cables: cable {cable.index} runs between fixed vertices alone, so it holds nothing: free them (supports.fixed)"
        for cable in cables
        if fixed[mesh.edges[cable.edges]].all()
    ]
    if membrane["springs"] == "force-density":
        constant = material.spring_constant.copy()
        for cable in cables:
            constant[cable.edges] += cable.stiffness
        return Material(material.rest_length, constant, tuple(remarks))
    if cables:
        remarks += _remarks(membrane["springs"], material, cables, wanted)
        material = _combined(material, cables)
    if (wanted <= material.rest_length * (1 + SAME_LENGTH)).all():
        raise InputError(
            "membrane.rest_scale: every edge is slack in the wanted shape, so no tension can hold it: lower rest_scale "
            f"(now {membrane['rest_scale']}) until the rest lengths are shorter than the target's edges"
        )
    return Material(material.rest_length, material.spring_constant, tuple(remarks))


def _measured(membrane: Mapping[str, Any], mesh: Mesh, shape: Floats) -> Floats:
    """Length of each edge on the rest shape (E,)."""
    a, b = mesh.edges.T
    measured = np.linalg.norm(shape[b] - shape[a], axis=1)
    if not measured.all():
        edge = int(np.argmin(measured))
        raise InputError(
            f"membrane.rest: edge {edge} (vertices {a[edge]} and {b[edge]}) has a rest length of zero on the "
            f"{'plan of the target' if membrane['rest'] == 'plan' else 'rest mesh'}: part the two vertices, or name a rest mesh"
        )
    return measured


def _constants(membrane: Mapping[str, Any], mesh: Mesh, shape: Floats, measured: Floats) -> Floats:
    """Spring constants of the membrane without its cables (E,)."""
    if membrane["springs"] == "force-density":
        return np.full(len(measured), float(membrane["stiffness"]))
    if membrane["material"] == "cables":
        return membrane["stiffness"] / (membrane["rest_scale"] * measured)
    area = edge_areas(shape, mesh)
    if not area.all():
        edge = int(np.argmin(area))
        a, b = mesh.edges[edge]
        raise InputError(
            f"membrane.material: the faces beside edge {edge} (vertices {a} and {b}) have no area, "
            'so "fabric" gives it no stiffness: mend the mesh or use "cables"'
        )
    return membrane["stiffness"] * area / measured**2


@dataclass(frozen=True)
class _Cable:
    """A cable along edges (k,): its number, EA in newtons, and its rest length on each of them, metres."""

    index: int
    edges: Ints
    stiffness: float
    rest_length: Floats


def _cables(membrane: Mapping[str, Any], mesh: Mesh, measured: Floats) -> list[_Cable]:
    cables = []
    for index, cable in enumerate(membrane["cables"]):
        edges = _edges_along(mesh, index, np.asarray(cable["path"], dtype=np.int64))
        cables.append(_Cable(index, edges, cable["stiffness"], cable["rest_scale"] * measured[edges]))
    return cables


def _edges_along(mesh: Mesh, index: int, path: Ints) -> Ints:
    """The edges of a path of vertices (k,), refused where it leaves them."""
    outside = path[(path < 0) | (path >= mesh.vertices)]
    if outside.size:
        raise InputError(
            f"membrane.cables: cable {index} names vertex {outside[0]}, which does not exist; "
            f"the target has vertices 0 to {mesh.vertices - 1}"
        )
    pairs = np.column_stack([path[:-1], path[1:]])
    edges = edge_numbers(mesh, pairs)
    if (edges < 0).any():
        a, b = pairs[np.argmin(edges)]
        raise InputError(
            f"membrane.cables: cable {index} goes from vertex {a} to vertex {b}, which no edge of the mesh joins: "
            "name every vertex on its way, each a neighbour of the one before"
        )
    values, count = np.unique(edges, return_counts=True)
    if (count > 1).any():
        a, b = mesh.edges[values[np.argmax(count > 1)]]
        raise InputError(
            f"membrane.cables: cable {index} runs twice along the edge of vertices {a} and {b}: take one of the two out, "
            "and raise the stiffness if more is meant"
        )
    return edges


def _combined(fabric: Material, cables: list[_Cable]) -> Material:
    """One spring for all that runs along an edge: k = sum k_i, L = sum k_i L_i / k pulls with sum k_i (l - L_i) at any length.

    Tension-only springs do not add up like this between the shortest and the longest of the L_i, where only some of them pull.
    """
    constant = fabric.spring_constant.copy()
    pull = constant * fabric.rest_length
    for cable in cables:
        constant[cable.edges] += cable.stiffness / cable.rest_length
        pull[cable.edges] += cable.stiffness
    along = np.unique(np.concatenate([cable.edges for cable in cables]))
    length = fabric.rest_length.copy()  # to the last bit where no cable runs
    length[along] = pull[along] / constant[along]
    return Material(length, constant)


def _remarks(springs: str, fabric: Material, cables: list[_Cable], wanted: Floats) -> list[str]:
    """What a cable does in the wanted shape, edges `wanted` (E,) long, that no cable would."""
    shortest, longest = fabric.rest_length.copy(), fabric.rest_length.copy()
    for cable in cables:
        shortest[cable.edges] = np.minimum(shortest[cable.edges], cable.rest_length)
        longest[cable.edges] = np.maximum(longest[cable.edges], cable.rest_length)
    said = []
    for cable in cables:
        length = wanted[cable.edges]
        if springs == "tension-only":
            apart = (length > shortest[cable.edges] * (1 + SAME_LENGTH)) & (length < longest[cable.edges] * (1 - SAME_LENGTH))
            sentence = (
                "lie in the wanted shape between the rest lengths of cable and membrane, where one pulls and the other is slack, "
                "while tension-only springs hold both as one: give the cable the membrane's rest_scale, or prestress both more"
            )
        else:
            apart = length < cable.rest_length * (1 - SAME_LENGTH)
            sentence = "are shorter in the wanted shape than its rest length, and a cable cannot push: lower its rest_scale"
        if apart.any():
            said.append(f"membrane.cables: {apart.mean():.1%} of the edges of cable {cable.index} {sentence}")
    return said
