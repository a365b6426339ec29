"""The shape that is wanted: its coordinates, its noise, and how the distance from it is measured."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from relax.arrays import Floats, Ints, Mask
from relax.errors import InputError
from relax.membrane.mesh import Mesh, against_each_other, vertex_normals

NORMAL = 1.538  # median length of a vector of three standard normal numbers
FARTHEST = 1e4  # scene sizes from the origin: beyond, the round-off of a position spoils the balance of forces


def check_coordinates(target: Floats) -> None:
    """Refuse coordinates that are no numbers, or so far from the origin that double precision cannot hold the shape."""
    if not np.isfinite(target).all():
        vertex = int(np.argwhere(~np.isfinite(target))[0][0])
        raise InputError(f"target: vertex {vertex} is at {target[vertex].tolist()}: every coordinate must be a finite number")
    size, farthest = float(np.linalg.norm(np.ptp(target, axis=0))), float(np.abs(target).max())
    if farthest > FARTHEST * size:
        raise InputError(
            f"target: coordinates reach {farthest:.3g} m in a scene of {size:.3g} m, too far from the origin for forces to "
            "balance to the last digits: move the scene to the origin"
        )


def with_noise(target: Floats, noise: Mapping[str, Any] | None, fixed: Mask) -> Floats:
    """The target (V, 3) with normal noise at its free vertices."""
    used = target.copy()
    if noise is not None:
        free = np.flatnonzero(~fixed)
        used[free] += np.random.default_rng(noise["seed"]).normal(0.0, noise["sigma"], (len(free), 3))
    return used


def metric_blocks(wanted: Mapping[str, Any], mesh: Mesh, target: Floats, plan_area: Floats, fixed: Mask) -> Floats:
    """Blocks M_i (V, 3, 3) of E_dist = sum_i (x_i - xhat_i)^T M_i (x_i - xhat_i); see MATHEMATICS.md, "The problem".

    Parameters
    ----------
    wanted : section [target] of the settings
    mesh : Mesh
    target : (V, 3) metres
        Clean target, whose normals are taken.
    plan_area : (V,) square metres
        Share of each vertex; a vertex without any is not asked to be anywhere.
    fixed : (V,) bool
        Vertices that E_dist never sees; their normals may be degenerate.

    Raises
    ------
    InputError
        A free vertex without a normal, faces that turn against each other, or area weights that are all zero.
    """
    directions = {"pairs": np.eye(3), "height": np.diag([0.0, 0.0, 1.0])}
    if wanted["metric"] == "normal":
        normal = _normals(mesh, target, fixed)
        blocks = normal[:, :, None] * normal[:, None, :]
    else:
        blocks = np.tile(directions[wanted["metric"]], (mesh.vertices, 1, 1))
    if not wanted["area_weights"]:
        return blocks
    if not plan_area[~fixed].any():
        raise InputError(
            "target.area_weights: no free vertex has any plan area beside it, so no distance would count: "
            "leave area_weights out, or turn the target so that it spans an area in plan"
        )
    return plan_area[:, None, None] * blocks


def _normals(mesh: Mesh, target: Floats, fixed: Mask) -> Floats:
    """Unit normals of the target (V, 3)."""
    faces = against_each_other(mesh)
    if faces is not None:
        raise InputError(
            f'target.metric = "normal": faces {faces[0]} and {faces[1]} run along their common side in the same direction, so '
            "their normals point to different sides of the membrane: turn one of them round in the mesh file"
        )
    normal = vertex_normals(target, mesh)
    without = ~normal.any(axis=1) & ~fixed
    if without.any():
        raise InputError(
            f'target.metric = "normal": vertex {np.argmax(without)} has no normal, as the faces beside it have no area or their '
            'normals cancel: mend the mesh there, or use metric = "pairs"'
        )
    return normal


def noise_level(target: Floats, edges: Ints, counted: Ints) -> float:
    """Standard deviation of normal noise in a target (V, 3) on a mesh with edges (E, 2), metres, as some of its vertices tell it.

    By the median of how far they lie from the mean of their neighbours: few lie at a mast or a crease.
    """
    ends, others = np.concatenate([edges, edges[:, ::-1]]).T
    degree = np.maximum(np.bincount(ends, minlength=len(target)), 1)
    mean = np.column_stack([np.bincount(ends, each, len(target)) for each in target[others].T]) / degree[:, None]
    away = np.linalg.norm(target - mean, axis=1) / np.sqrt(1 + 1 / degree)
    return float(np.median(away[counted])) / NORMAL
