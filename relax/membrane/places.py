"""Places: which vertices are held, where supports may stand, and what each counts in the penalty."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from relax.arrays import Floats, Mask
from relax.errors import InputError
from relax.membrane.mesh import Mesh, boundary_vertices, component_labels, corner_vertices

LEAST_WEIGHT = 0.01  # of a support near the ground: a weight of 0 would let it stand whatever it is worth


def fixed_vertices(choice: Any, mesh: Mesh, target: Floats) -> Mask:
    """Vertices that `supports.fixed` holds (V,).

    "none", or a list, may leave a connected part to its supports alone.

    Raises
    ------
    InputError
        No free vertex is left, or a part has no edge or corner to be fixed at.
    """
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
    if not held.all() and choice in ("boundary", "corners"):
        vertex = int(np.argmin(held[labels]))
        raise InputError(
            f"supports.fixed: the part of the membrane that holds vertex {vertex} has no {choice}, so nothing keeps it in place: "
            'list the fixed vertices, or give "none" to hold the membrane by supports alone'
        )
    return fixed


def check_floating(settings: Mapping[str, Any], fixed: Mask, candidates: Mask, mesh: Mesh) -> tuple[str, ...]:
    """A remark on a part that a list of fixed vertices leaves to its supports alone; what cannot hold such a part is refused.

    Raises
    ------
    InputError
        Supports that do not point anywhere, or fewer than two candidates there; a metric in which vertices may slide.
    """
    supports = settings["supports"]
    labels = component_labels(mesh)
    floating = np.setdiff1d(labels, labels[fixed])
    if not floating.size:
        return ()
    where = f"the part of the membrane that holds vertex {int(np.argmax(labels == floating[0]))} has no fixed vertex"
    key = "direction" if supports["direction"] != "any" else "max_force"
    if supports["direction"] != "any" or supports["max_force"] is not None:
        raise InputError(
            f"supports.{key}: {where}, so supports alone hold it, whose forces must add up to nothing but its loads: let them "
            'point anywhere (direction = "any", no max_force), or fix a vertex'
        )
    if settings["target"]["metric"] != "pairs":
        raise InputError(
            f"target.metric: {where}, and a metric in which vertices may slide lets it shrink along the target until it needs no "
            'supports: use "pairs", or fix a vertex'
        )
    for part in floating:
        if np.count_nonzero(candidates[labels == part]) < 2:
            vertex = int(np.argmax(labels == part))
            raise InputError(
                f"supports.candidates: the part of the membrane that holds vertex {vertex} has neither a fixed vertex nor two "
                "places for a support, so nothing can hold it: widen candidates, or fix a vertex"
            )
    if supports["fixed"] == "none":
        return ()
    return (f"supports.fixed: {where}: supports alone hold it",)


def candidate_vertices(supports: Mapping[str, Any], fixed: Mask, mesh: Mesh, target: Floats) -> Mask:
    """Vertices where a support may stand (V,): `candidates` and `always` without `never`, none of them fixed."""
    choice = supports["candidates"]
    if choice == "free":
        mask = ~fixed
    elif isinstance(choice, Mapping):
        low, high = np.asarray(choice["box"], dtype=float)
        inside = (target[:, :2] >= low).all(axis=1) & (target[:, :2] <= high).all(axis=1)
        if not inside.any():
            (x0, y0), (x1, y1) = target[:, :2].min(axis=0), target[:, :2].max(axis=0)
            raise InputError(
                f"supports.candidates: no vertex lies in the box; the target reaches from x = {x0:.4g} to {x1:.4g} and from "
                f"y = {y0:.4g} to {y1:.4g}: move the box"
            )
        mask = ~fixed & inside
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
