"""What the commands share: exit statuses, options, the start that a scene names, and Ctrl-C."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from relax.errors import InputError

if TYPE_CHECKING:
    from relax.membrane.scene import Scene

DONE, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def _folder(_context: click.Context, _option: click.Parameter, text: str | None) -> Path | None:
    """The folder typed after -o; empty text would mean the current one."""
    if text is not None and not text.strip():
        raise InputError("-o: the name of the result folder is empty: give one, or leave -o out")
    return None if text is None else Path(text)


def output_option(default: str) -> Callable[[Any], Any]:
    """Where to write; `default` in words."""
    return click.option("-o", "--output", metavar="DIR", callback=_folder, help=f"Result folder. Default: {default}.")


json_option = click.option("--json", "as_json", is_flag=True, help="Print the content of result.json instead of a summary.")
rows_option = click.option("--json", "as_json", is_flag=True, help="Print a JSON array, one flat object a row, not a table.")
quiet_option = click.option(
    "--quiet", is_flag=True, help="No progress and no summary; warnings and errors stay, and --json still prints."
)
set_option = click.option(
    "--set", "assignments", metavar="SECTION.KEY=VALUE", multiple=True, help="Any key of the scene, as a TOML value."
)


def start_of(path: Path, scene: "Scene", typed: str | None = None) -> Any:
    """Positions and forces of the result that the scene starts from, if it names one."""
    from relax.files import load_result
    from relax.files.scenes import STARTS, start_folder

    folder = start_folder(path, scene)
    if folder is None:
        return None
    if typed is not None and typed not in STARTS and os.path.samefile(typed, folder):
        folder = Path(typed)
    stored = load_result(folder)
    if stored.scene.mesh.vertices != scene.mesh.vertices:
        raise InputError(
            f"{path}: solver.start: {folder} has {stored.scene.mesh.vertices} vertices, this scene {scene.mesh.vertices}; "
            "start from a result on the same mesh"
        )
    return stored.positions, stored.forces


@contextmanager
def hold_interrupts() -> Iterator[list[int]]:
    """Keep Ctrl-C from breaking off what is inside; the list holds those that came."""
    came: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    # Python lets the main thread alone change this; a run in the background may ignore Ctrl-C as it is
    if before in (None, signal.SIG_IGN) or threading.current_thread() is not threading.main_thread():
        yield came
        return
    signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)
