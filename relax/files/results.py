"""Results as folders, written whole or not at all; `load_result` (stored.py) reads them back."""

import csv
import json
import math
import os
import platform
import secrets
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relax.errors import InputError
from relax.files.exports import write_obj, write_vtu
from relax.files.stored import SCENE_ARRAYS, StoredResult, load_result

if TYPE_CHECKING:
    from relax.design.solve import Design

__all__ = ["OURS", "StoredResult", "check_output", "load_result", "versions", "write_result"]

Draw = Callable[[Path], None]
OURS = ("result.json", "result.npz", "trace.npz", "supports.csv", "membrane.obj", "membrane.vtu", "picture.png", "view.html")
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
    if not os.fspath(folder):
        raise InputError("the name of the result folder is empty: give one")
    folder = Path(folder)
    there = next((place for place in (folder, *folder.absolute().parents) if os.path.lexists(place)), Path("/"))
    if not there.is_dir():
        where = "this" if there == folder else f"{there}"
        raise InputError(f"{folder}: {where} is a file, so no result folder can be written here: give another folder with -o")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: {there} cannot be written to: give another folder with -o, or change its permissions")
    if there == folder:
        for name in OURS:
            if (folder / name).is_dir():
                raise InputError(f"{folder}: {name} is a folder, where a file of the result belongs: move it, or use another -o")


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
    folder = Path(folder)
    stage = _new_stage(folder)
    try:
        _fill(stage, design, read_seconds, pictures or {})
        if folder.is_dir():
            _exchange(stage, folder)
        else:
            stage.rename(folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _new_stage(folder: Path) -> Path:
    """An empty hidden folder on the same disk: inside `folder` where that exists, so that its parent need not be writable."""
    try:
        inside = folder if folder.is_dir() else folder.parent
        inside.mkdir(parents=True, exist_ok=True)
        stage = inside / f".relax-{secrets.token_hex(6)}"
        stage.mkdir()
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}): give another folder with -o") from None
    return stage


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
    text = json.dumps(_plain(_summary(design) | {"seconds": seconds}), indent=2, allow_nan=False)
    (stage / "result.json").write_text(text + "\n", encoding="utf-8")


def _exchange(stage: Path, folder: Path) -> None:
    """Put the files of `stage` in the place of ours in `folder`; on any trouble put the old ones back."""
    new = sorted(entry.name for entry in stage.iterdir())
    old = stage / "old"
    old.mkdir()
    done: list[str] = []
    try:
        for name in dict.fromkeys([*OURS, *new]):
            if os.path.lexists(folder / name):
                os.replace(folder / name, old / name)
        for name in new:
            os.replace(stage / name, folder / name)
            done.append(name)
    except BaseException:
        for name in done:
            (folder / name).unlink(missing_ok=True)
        for entry in old.iterdir():
            os.replace(entry, folder / entry.name)
        raise


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


def _plain(value: Any) -> Any:
    """`value` in JSON's own types; a number that is not finite becomes null, since JSON has no other word for it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(entry) for entry in value]
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
