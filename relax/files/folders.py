"""Folders written whole or not at all: filled under a temporary name beside what is there, then exchanged with it."""

import os
import secrets
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from relax.errors import InputError


def check_folder(folder: str | os.PathLike[str], files: Sequence[str]) -> None:
    """Refuse a path at which no folder with our `files` can be written, before anything is computed; nothing is created.

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
        for name in files:
            if (folder / name).is_dir():
                raise InputError(f"{folder}: {name} is a folder, where a file of the result belongs: move it, or use another -o")


def write_whole(folder: Path, ours: Sequence[str], fill: Callable[[Path], None]) -> None:
    """Let `fill` write into an empty folder and put what it wrote in the place of `ours`; other entries of `folder` stay."""
    stage = _new_stage(folder)
    try:
        fill(stage)
        if folder.is_dir():
            _exchange(stage, folder, ours)
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


def _exchange(stage: Path, folder: Path, ours: Sequence[str]) -> None:
    """Put the entries of `stage` in the place of ours in `folder`; on any trouble put the old ones back."""
    new = sorted(entry.name for entry in stage.iterdir())
    old = stage / "old"
    old.mkdir()
    done: list[str] = []
    try:
        for name in dict.fromkeys([*ours, *new]):
            if os.path.lexists(folder / name):
                os.replace(folder / name, old / name)
        for name in new:
            os.replace(stage / name, folder / name)
            done.append(name)
    except BaseException:
        for name in done:
            os.replace(folder / name, stage / name)
        for entry in old.iterdir():
            os.replace(entry, folder / entry.name)
        raise
