"""Places: which vertices are held, where supports may stand, and what each counts in the penalty."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from relax.arrays import Floats, Mask
from relax.errors import InputError
from relax.membrane.mesh import Mesh, boundary_vertices, component_labels, corner_vertices

LEAST_WEIGHT = 0.01  # of a support near the ground: a weight of 0 would let it stand whatever it is worth


def fixed_vertices(choice: Any, mesh: Mesh, target: Floats) -> Mask:
    """Vertices that `supports.fixed` holds (V,); raises InputError where a part of the membrane has none, or no free one."""
    if choice == "boundary":
        fixed = boundary_vertices(mesh)
    elif choice == "corners":
        fixed = corner_vertices(target, mesh)
    else:
        fixed = _listed("supports.fixed", [] if choice == "none" else choice, mesh)
    if fixed.all():
        raise InputError("supports.fixed: every vertex is fixed, so no membrane is left to shape: fix fewer, or refine the mesh")
    labels = component_labels(mesh)
    held = np.zeros(labels.max() + 1, dtype=bool)
    held[labels[fixed]] = True
    if not held.all():
        vertex = int(np.argmin(held[labels]))
        raise InputError(
            f"supports.fixed: no vertex is fixed in the part of the membrane that holds vertex {vertex}, so nothing keeps it "
            "in place: fix at least one vertex of each connected part"
        )
    return fixed


def candidate_vertices(supports: Mapping[str, Any], fixed: Mask, mesh: Mesh, target: Floats) -> Mask:
    """Vertices where a support may stand (V,): `candidates` and `always` without `never`, none of them fixed."""
    choice = supports["candidates"]
    if choice == "free":
        mask = ~fixed
    elif isinstance(choice, Mapping):
        low, high = np.asarray(choice["box"], dtype=float)
        mask = ~fixed & (target[:, :2] >= low).all(axis=1) & (target[:, :2] <= high).all(axis=1)
    else:
        mask = _listed("supports.candidates", choice, mesh)
        _refuse_fixed("candidates", mask & fixed)
    never = _listed("supports.never", supports["never"], mesh)
    always = _listed("supports.always", supports["always"], mesh)
    _refuse_fixed("always", always & fixed)
    if (always & never).any():
        raise InputError(f"supports.always: vertex {np.argmax(always & never)} is in never too: take it out of always or never")
    mask = (mask & ~never) | always
    if not mask.any():
        raise InputError("supports.candidates: no vertex is left where a support may stand: widen candidates or shorten never")
    return mask


def support_weights(supports: Mapping[str, Any], candidates: Mask, target: Floats) -> Floats:
    """Factor of each vertex's penalty (V,): 1, or its height above ground over the candidates' mean; 0 where one always stands.

    Raises
    ------
    InputError
        The candidates lie on or below the ground on average, so that no height could be a weight.
    """
    weight = np.ones(len(target))
    if supports["weights"] == "height":
        height = target[:, 2] - supports["ground"]
        mean = float(height[candidates].mean())
        if mean <= 0:
            raise InputError(
                f'supports.weights = "height": the candidates lie {mean:.6g} m above ground on average, so that heights are no '
                f"weights: lower supports.ground (now {supports['ground']:.6g}) below the target"
            )
        weight = np.maximum(height / mean, LEAST_WEIGHT)
    weight[supports["always"]] = 0.0
    return weight


def _listed(key: str, vertices: list[int], mesh: Mesh) -> Mask:
    mask = np.zeros(mesh.vertices, dtype=bool)
    for vertex in vertices:
        if not 0 <= vertex < mesh.vertices:
            raise InputError(f"{key}: vertex {vertex} does not exist; the target has vertices 0 to {mesh.vertices - 1}")
        mask[vertex] = True
    return mask


def _refuse_fixed(key: str, both: Mask) -> None:
    if both.any():
        raise InputError(
            f"supports.{key}: vertex {np.argmax(both)} is fixed, so no support can act there: take it out of {key} or of fixed"
        )
