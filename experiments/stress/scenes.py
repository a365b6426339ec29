"""The scenes that the axes bend: a membrane of a square metre under a hill, or under known forces."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import relax
from relax.files.schema import resolve

Made = tuple[relax.Problem, np.ndarray | None]  # the problem, and the planted forces (V, 3) where there are some
Case = tuple[Any, Callable[[], Made]]  # a value on an axis, and what makes its problem
ONE = ((0.5, 0.5, (0.02, 0.0, 0.3)),)
TWO = ((0.25, 0.25, (0.0, 0.02, 0.25)), (0.75, 0.5, (0.05, 0.0, 0.3)))


def settings(**changes: Any) -> Mapping[str, Any]:
    """All sections and keys of a scene, with `section__key=value` changes, checked as those of a file are."""
    raw: dict[str, dict[str, Any]] = {"target": {"mesh": "none.obj"}, "penalty": {"weight": 0.01}, "supports": {"ground": 0.0}}
    for name, value in changes.items():
        section, key = name.split("__")
        raw.setdefault(section, {})[key] = value
    if "weight_fraction" in raw["penalty"] or raw["penalty"]["weight"] is None:
        raw["penalty"].pop("weight")
    return resolve(raw, "stress")


def grid(rows: int, columns: int) -> tuple[relax.Mesh, np.ndarray]:
    """Mesh and flat positions, `columns` vertices over one metre."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return relax.grid_mesh(rows, columns, "alternating"), np.column_stack([column, row, 0 * row]) / (columns - 1)


def hill(flat: np.ndarray, height: float = 0.3) -> np.ndarray:
    """A smooth hill over the unit square."""
    x, y, _ = flat.T
    return flat + np.column_stack([0 * x, 0 * x, height * (np.sin(np.pi * x) * np.sin(np.pi * y)) ** 2])


def hilly(side: int, height: float = 0.3) -> tuple[relax.Mesh, np.ndarray]:
    """The mesh with the hill."""
    mesh, flat = grid(side, side)
    return mesh, hill(flat, height)


def built(mesh: relax.Mesh, target: np.ndarray, **changes: Any) -> Made:
    """A problem without planted forces."""
    return relax.Problem(relax.build_scene(settings(**changes), mesh, target, None)), None


def planted(side: int, masts: Any = ONE, sigma: float = 0.0, flat: np.ndarray | None = None, **changes: Any) -> Made:
    """A membrane brought to rest under forces at places of the unit square, as the target."""
    mesh, even = grid(side, side)
    shape = even if flat is None else flat
    forces = np.zeros_like(even)
    for x, y, force in masts:
        forces[round(y * (side - 1)) * side + round(x * (side - 1))] = force
    bare = relax.build_scene(settings(**changes), mesh, shape, shape)
    found = relax.form(relax.Problem(bare), forces).positions
    noise = {"target__noise": {"sigma": sigma, "seed": 0}} if sigma else {}
    scene = relax.build_scene(settings(**changes, **noise), mesh, found, shape)
    return relax.Problem(replace(scene, loads=bare.loads)), forces


def decades(first: int, last: int, step: int = 1) -> list[float]:
    """Powers of ten."""
    return [10.0**each for each in range(first, last + 1, step)]
