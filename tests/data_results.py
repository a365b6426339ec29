"""The scenes of data/ solved through the command line, each once a session however many tests and workers look at it."""

import fcntl
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relax.cli import run

DATA = Path(__file__).resolve().parent.parent / "data"
SCENES = ("tent", "tent-noisy", "five-masts", "scalloped", "sail", "bumps", "pavilion", "terrain")
SLOW = ("bumps", "pavilion", "terrain")  # some seconds each


@dataclass(frozen=True)
class Solved:
    """A result folder as its files have it; nothing here goes through the package."""

    folder: Path
    status: int
    arrays: dict[str, np.ndarray]
    said: dict[str, Any]

    @property
    def stands(self) -> list[int]:
        return np.flatnonzero(self.arrays["forces"].any(axis=1)).tolist()


def solved(tmp_path_factory, scene: str, *options: str, data: Path = DATA) -> Solved:
    """The result of `relax solve data/SCENE.toml OPTIONS`."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    name = "-".join([scene, *options]).replace("/", "_").replace('"', "")
    folder, status = root / f"{name}-result", root / f"{name}.status"
    with (root / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not status.exists():
            status.write_text(str(run(["solve", str(data / f"{scene}.toml"), "-o", str(folder), "--quiet", *options])))
    with np.load(folder / "result.npz", allow_pickle=False) as archive:
        arrays = dict(archive)
    return Solved(folder, int(status.read_text()), arrays, json.loads((folder / "result.json").read_text()))
