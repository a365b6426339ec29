"""Scenes from TOML files: settings, overrides, and the shape, heights and rest mesh that the file names."""

import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.bytes import read_bytes
from relax.files.checks import LARGEST, shown
from relax.files.heights import read_heights
from relax.files.meshes import read_mesh
from relax.files.schema import HEIGHT_SUFFIXES, MESH_SUFFIXES, Settings, drop_replaced, resolve
from relax.membrane.mesh import Mesh, grid_mesh, mesh_from_faces
from relax.membrane.scene import Scene, build_scene

Overrides = Mapping[str, Any] | Sequence[str]
LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){50}""")  # tomllib needs memory with the square of its parts
STARTS = ("auto", "target", "heavy")


def load_scene(path: str | os.PathLike[str], overrides: Overrides = ()) -> Scene:
    """The scene that a TOML file describes.

    Parameters
    ----------
    path : path
        Paths inside the file are relative to it.
    overrides : mapping of "section.key" to a value, or strings "section.key=VALUE" with a TOML value
        They replace what the file says, and with it what would contradict them: a weight replaces a weight fraction, another
        penalty the parameters of the one before.

    Raises
    ------
    InputError
        One sentence that starts with `path` and names section, key and, where there is one, file and index.
    """
    changes = _parse_overrides(overrides)
    path = Path(path)
    try:
        return scene_from(_override(_read_toml(path), changes), path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def scene_from(raw: Mapping[str, Any], path: Path) -> Scene:
    """The scene of a file's sections and keys, as TOML gives them, if it lay at `path`; raises InputError without that path."""
    return _build(resolve(raw, path.stem), path.parent)


def override(raw: dict[str, Any], overrides: Overrides) -> dict[str, Any]:
    """A file's sections and keys with `overrides` in place of what they replace, as for `load_scene`."""
    return _override(raw, _parse_overrides(overrides))


def start_folder(path: str | os.PathLike[str], scene: Scene) -> Path | None:
    """The result folder that `solver.start` names in the scene file at `path`; None for the starts that have a name."""
    start = scene.settings["solver"]["start"]
    return None if start in STARTS else Path(path).parent / start


def holds_result(folder: Path) -> bool:
    """Whether a result.json that can be read lies in `folder`."""
    try:
        return isinstance(json.loads(read_bytes(folder / "result.json")), dict)
    except (InputError, ValueError, RecursionError):
        return False


def _read_toml(path: Path) -> dict[str, Any]:
    content = read_bytes(path)
    if path.suffix.lower() in (*MESH_SUFFIXES, *HEIGHT_SUFFIXES):
        raise InputError("this is a shape, and a scene file is expected: relax new writes one for it")
    try:
        text = content.decode("utf-8-sig")
        if LONG_KEY.search(text):
            raise InputError("it holds a key of far more parts than section.key has: mend it")
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise InputError(f"byte {error.start} is no text: a scene file is TOML in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"this is not valid TOML: {str(error)[:1].lower()}{str(error)[1:]}; mend the line") from None
    except (RecursionError, ValueError):
        raise InputError("this is not valid TOML: it holds values nested too deep or numbers too long; mend them") from None


def _parse_overrides(overrides: Overrides) -> dict[tuple[str, ...], Any]:
    """Values by the words of their keys."""
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(overrides, Mapping):
        return {tuple(key.split(".")): value for key, value in overrides.items()}
    changes: dict[tuple[str, ...], Any] = {}
    for text in overrides:
        key, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not key:
            raise InputError(f"--set {text}: expected section.key=VALUE, for example --set penalty.weight=0.02")
        try:
            parsed = tomllib.loads(f"value = {value}")
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            parsed = {}
        if list(parsed) != ["value"]:
            raise InputError(f"--set {text}: {value or 'nothing'} is not a TOML value; text needs quotes: --set '{key}=\"...\"'")
        changes[tuple(key.split("."))] = parsed["value"]
    return changes


def _override(raw: dict[str, Any], changes: Mapping[tuple[str, ...], Any]) -> dict[str, Any]:
    """What the file says with `changes` in place of what they replace."""
    changed: dict[str, set[str]] = {}
    for words, value in changes.items():
        table = raw
        for word in words[:-1]:
            table = table.setdefault(word, {})
            if not isinstance(table, dict):
                raise InputError(f"{'.'.join(words)}: {word} = {shown(table)} is no section, so nothing can be set inside it")
        table[words[-1]] = value
        if len(words) > 1:
            changed.setdefault(words[0], set()).add(words[1])
    for section, names in changed.items():
        drop_replaced(section, raw[section], names)
    return raw


def _build(settings: Settings, folder: Path) -> Scene:
    mesh, target = _read_target(settings["target"], folder)
    _refuse_huge(target, "target")
    rest = None
    choice = settings["membrane"]["rest"]
    if choice not in ("plan", "target"):
        try:
            rest = read_mesh(folder / choice)[0]
        except InputError as error:
            raise InputError(f"membrane.rest = {shown(choice)}: {error}") from None
        _refuse_huge(rest, f"membrane.rest = {shown(choice)}")
    if settings["supports"]["ground"] is None:
        settings["supports"]["ground"] = float(target[:, 2].min())
    _check_start(settings["solver"]["start"], folder)
    return build_scene(settings, mesh, target, rest)


def _read_target(target: Settings, folder: Path) -> tuple[Mesh, Floats]:
    """Mesh and clean positions (V, 3)."""
    key = "mesh" if target["heights"] is None else "heights"
    try:
        if key == "mesh":
            positions, faces = read_mesh(folder / target["mesh"])
            return mesh_from_faces(len(positions), faces), positions
        heights, own_spacing = read_heights(folder / target["heights"])
    except InputError as error:
        raise InputError(f"target.{key} = {shown(target[key])}: {error}") from None
    if target["spacing"] is None and own_spacing is not None:
        target["spacing"] = list(own_spacing)
    rows, columns = heights.shape
    row, column = np.divmod(np.arange(heights.size), columns)
    with np.errstate(over="ignore"):  # _build refuses what overflows
        x, y, z = column * target["spacing"][0], row * target["spacing"][1], heights.ravel() * target["height_scale"]
    return grid_mesh(rows, columns, target["diagonals"]), np.column_stack([x, y, z])


def _refuse_huge(positions: Floats, where: str) -> None:
    """Refuse coordinates whose areas and stiffnesses could overflow."""
    huge = np.argwhere(~(np.abs(positions) <= LARGEST))
    if len(huge):
        vertex = int(huge[0][0])
        raise InputError(
            f"{where}: vertex {vertex} is at {positions[vertex].tolist()}, farther than {LARGEST:g}: mend it, or the units"
        )


def _check_start(start: str, folder: Path) -> None:
    if start in STARTS:
        return
    if not holds_result(folder / start):
        raise InputError(
            f'solver.start = {shown(start)}: this is neither "auto", "target" nor "heavy", and no result folder either; '
            "name one of them, or a folder that relax solve wrote, relative to the scene file"
        )
