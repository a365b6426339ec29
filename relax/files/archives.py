"""The arrays of a result's .npz files, each with the shape and type that relax/FORMATS.md gives it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from relax.errors import InputError
from relax.files.bytes import read_bytes
from relax.files.checks import LARGEST
from relax.files.npy import Header, read_archive

Arrays = dict[str, Any]
Shapes = Mapping[str, tuple[str | int, ...]]

# letters stand for lengths that have to agree
RESULT: Shapes = {
    **{name: ("V", 3) for name in ("positions", "target", "clean_target", "start", "forces", "loads")},
    **{"faces": ("F", 4), "edges": ("E", 2), "rest_length": ("E",), "spring_constant": ("E",)},
    **{"fixed": ("V",), "candidates": ("V",), "metric": ("V", 3, 3), "support_weight": ("V",)},
}
TRACE: Shapes = {
    **{name: ("T", "V", 3) for name in ("positions", "forces")},
    **{name: ("V", 3) for name in ("unrounded_positions", "unrounded_forces")},
    **{name: ("T",) for name in ("objective", "stationarity", "seconds", "notes")},
}
# the others are floats
KINDS = {"faces": np.int64, "edges": np.int64, "fixed": np.bool_, "candidates": np.bool_, "notes": np.str_}
OPEN = ("objective", "stationarity")  # of a step at which the stiffness was singular: not finite


def read_arrays(path: Path, shapes: Shapes, known: Mapping[str, int] | None = None) -> Arrays:
    """The arrays of a file, with the shapes and types that relax/FORMATS.md gives them; `known`: lengths given elsewhere."""
    lengths = dict(known or {})
    found = read_archive(read_bytes(path), shapes, lambda name, header: _check_header(name, header, shapes[name], lengths))
    return {name: _checked(name, array) for name, array in found.items()}


def _check_header(name: str, header: Header, shape: tuple[str | int, ...], lengths: dict[str, int]) -> None:
    """Refuse an array of another shape or type; `lengths` gathers what the letters stand for."""
    kind = KINDS.get(name, np.float64)
    wanted = "(" + ", ".join(str(length) for length in shape) + ("," if len(shape) == 1 else "") + ")"
    same = len(header.shape) == len(shape) and all(
        length == (wish if isinstance(wish, int) else lengths.setdefault(wish, length))
        for length, wish in zip(header.shape, shape, strict=True)
    )
    if not same:
        known = ", ".join(f"{letter} = {length}" for letter, length in lengths.items())
        raise InputError(f"{name} has the shape {header.shape}, expected {wanted} with {known or 'V vertices'}")
    if not np.can_cast(header.kind, kind, "same_kind") or (kind is np.str_ and header.kind.kind != "U"):
        raise InputError(f"{name} holds {header.kind}, expected {np.dtype(kind).name}")


def _checked(name: str, array: Any) -> Any:
    """`array` in its proper type, if its values allow it."""
    if array.dtype.kind == "f" and name not in OPEN and not np.isfinite(array).all():
        raise InputError(f"{name} is not finite at index {np.argwhere(~np.isfinite(array))[0].tolist()}")
    if array.dtype.kind == "f" and name not in OPEN and (np.abs(array) > LARGEST).any():
        index = np.argwhere(np.abs(array) > LARGEST)[0].tolist()
        raise InputError(f"{name} is {array[tuple(index)]} at index {index}, beyond {LARGEST:g}: mend it")
    return array.astype(KINDS.get(name, np.float64))
