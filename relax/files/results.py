"""Results as folders, written whole or not at all; `load_result` (stored.py) reads them back."""

import csv
import json
import math
import os
import platform
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relax.files.exports import write_obj, write_vtu
from relax.files.folders import check_folder, write_whole
from relax.files.stored import SCENE_ARRAYS, StoredResult, load_result

if TYPE_CHECKING:
    from relax.design.solve import Design

__all__ = ["OURS", "StoredResult", "check_output", "load_result", "versions", "write_result"]

Draw = Callable[[Path], None]
PICTURES, FORMATS = ("picture", "tensions", "trace", "rounding", "values"), ("png", "pdf", "svg")
OURS = (
    *("result.json", "result.npz", "trace.npz", "supports.csv", "membrane.obj", "membrane.vtu", "view.html"),
    # of a result that is replaced no picture may stay, whoever drew it
    *(f"{name}.{kind}" for name in PICTURES for kind in FORMATS),
)
TRACE_ARRAYS = ("positions", "forces", "objective", "stationarity", "seconds", "unrounded_positions", "unrounded_forces")
PACKAGES = {"relax": "relax-tensile", "numpy": "numpy", "scipy": "scipy", "cvxpy": "cvxpy", "clarabel": "clarabel"}
COLUMNS = (
    *("vertex", "head_x", "head_y", "head_z", "force_x", "force_y", "force_z", "magnitude", "kind"),
    *("foot_x", "foot_y", "foot_z", "length", "lean"),
)


def check_output(folder: str | os.PathLike[str]) -> None:
    """Refuse a path at which no result folder can be written, before anything is computed; nothing is created.

    Raises
    ------
    InputError
        `folder` is empty, is a file or lies inside one, cannot be written to, or holds a folder under the name of one of our
        files.
    """
    check_folder(folder, OURS)


def write_result(
    folder: str | os.PathLike[str], design: "Design", read_seconds: float = 0.0, pictures: Mapping[str, Draw] | None = None
) -> None:
    """Write a result folder whole, or leave what is there as it was.

    Parameters
    ----------
    folder : path
        Files of ours in it are replaced, all of them; files that are not ours are kept.
    design : Design
    read_seconds : float
        How long the scene took to read, for result.json.
    pictures : mapping of a file's name to a function that draws it at the path it is given
    """
    check_output(folder)
    write_whole(Path(folder), OURS, lambda stage: _fill(stage, design, read_seconds, pictures or {}))


def _fill(stage: Path, design: "Design", read_seconds: float, pictures: Mapping[str, Draw]) -> None:
    """All files of a result; result.json last, since it says how long the writing took."""
    began = time.perf_counter()
    scene = design.problem.scene
    arrays: dict[str, Any] = {name: getattr(scene, name) for name in SCENE_ARRAYS}
    arrays |= {"faces": scene.mesh.faces, "edges": scene.mesh.edges, "positions": design.positions, "forces": design.forces}
    np.savez(stage / "result.npz", **arrays)
    trace: dict[str, Any] = {name: np.asarray(getattr(design.trace, name)) for name in TRACE_ARRAYS}
    trace["notes"] = np.array(design.trace.notes, dtype=np.str_)
    np.savez(stage / "trace.npz", **trace)
    _write_supports(stage / "supports.csv", design)
    write_obj(stage / "membrane.obj", design.positions, scene.mesh.faces)
    write_vtu(stage / "membrane.vtu", scene, design.positions, design.forces)
    for name, draw in pictures.items():
        draw(stage / name)
    seconds = {"read": read_seconds, "solve": design.seconds, "write": time.perf_counter() - began}
    text = json.dumps(plain(_summary(design) | {"seconds": seconds}), indent=2, allow_nan=False)
    (stage / "result.json").write_text(text + "\n", encoding="utf-8")


def _summary(design: "Design") -> dict[str, Any]:
    """Content of result.json but for the seconds."""
    noise = design.settings["target"]["noise"]
    return {
        **design.certificate.figures(),
        "stop": design.stop,
        "iterations": design.iterations,
        "factorizations": design.factorizations,
        "skipped": list(design.skipped),
        "interrupted": design.interrupted,
        "warnings": list(dict.fromkeys([*design.problem.scene.warnings, *design.certificate.warnings])),
        "seed": noise["seed"] if noise else None,
        "versions": versions(),
        "settings": design.settings,
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that a result depends on; those that are not installed are left out."""
    found = {"python": platform.python_version()}
    for name, package in PACKAGES.items():
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(package)
    return found


def plain(value: Any) -> Any:
    """`value` in JSON's own types; a number that is not finite becomes null, since JSON has no other word for it."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write_supports(path: Path, design: "Design") -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for mast in design.supports:
            foot = mast.foot or ("", "", "")
            length = "" if mast.length is None else mast.length
            table.writerow([mast.vertex, *mast.head, *mast.force, mast.magnitude, mast.kind, *foot, length, mast.lean])
