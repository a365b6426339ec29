"""What the commands share: exit statuses, arguments and options and how a shell completes them, the start of a scene, Ctrl-C."""

import glob
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from relax.errors import InputError

if TYPE_CHECKING:
    from relax.design.solve import Design
    from relax.files.results import Draw
    from relax.membrane.scene import Scene

DONE, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def _folder(_context: click.Context, _option: click.Parameter, text: str | None) -> Path | None:
    """The folder typed after -o; empty text would mean the current one."""
    if text is not None and not text.strip():
        raise InputError("-o: the name of the result folder is empty: give one, or leave -o out")
    return None if text is None else Path(text)


class Named(click.Path):
    """A path that is typed; empty text would mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not str(value).strip():
            word = param.metavar if isinstance(param, click.Argument) else param.opts[0] if param else "a path"
            raise InputError(f"{word}: the name is empty: give one")
        return super().convert(value, param, ctx)


def output_option(default: str) -> Callable[[Any], Any]:
    """Where to write; `default` in words."""
    return click.option("-o", "--output", metavar="DIR", callback=_folder, help=f"Result folder. Default: {default}.")


json_option = click.option("--json", "as_json", is_flag=True, help="Print the content of result.json instead of a summary.")
rows_option = click.option("--json", "as_json", is_flag=True, help="Print a JSON array, one flat object a row, not a table.")
quiet_option = click.option(
    "--quiet", is_flag=True, help="No progress and no summary; warnings and errors stay, and --json still prints."
)


def _scenes(incomplete: str) -> list[str]:
    """Scene files that begin like this, here or a folder further down."""
    return sorted(f for depth in ("*.toml", "*/*.toml") for f in glob.glob(glob.escape(incomplete) + depth))


def _results(incomplete: str) -> list[str]:
    """The same of folders that hold a result."""
    found = [f for depth in ("*", "*/*") for f in glob.glob(glob.escape(incomplete) + depth + "/result.json")]
    return sorted(os.path.dirname(name) for name in found)


def complete_scenes(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Scene files, and folders where there are none."""
    return [CompletionItem(name) for name in _scenes(incomplete)] or [CompletionItem(incomplete, type="dir")]


def complete_results(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Result folders, and other folders where there are none."""
    return [CompletionItem(name) for name in _results(incomplete)] or [CompletionItem(incomplete, type="dir")]


def complete_starts(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The starts that have a name, and result folders."""
    named = [CompletionItem(name) for name in ("auto", "target", "heavy") if name.startswith(incomplete)]
    return named + complete_results(context, parameter, incomplete)


def complete_names(section: str, key: str) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """The names that a key of the scene takes."""

    def complete(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from relax.files.schema import SCHEMA  # loads scipy, which only a shell that asks waits for

        return [CompletionItem(name) for name in SCHEMA[section][key].possible if name.startswith(incomplete)]

    return complete


def complete_keys(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """section.key= of the format, then the names that the key takes, in TOML's quotes."""
    from relax.files.schema import SCHEMA

    keys = {f"{section}.{name}": key.possible for section, names in SCHEMA.items() for name, key in names.items()}
    word, sign, _ = incomplete.partition("=")
    if sign:
        names = keys.get(word, ())
        return [CompletionItem(f'{word}="{name}"') for name in (() if isinstance(names, str) else names)]
    return [
        CompletionItem(f"{name}=", help=words if isinstance(words, str) else " | ".join(words))
        for name, words in keys.items()
        if name.startswith(incomplete)
    ]


scene_argument = click.argument("scene", metavar="SCENE.toml", type=Named(path_type=Path), shell_complete=complete_scenes)
result_argument = click.argument("result", metavar="RESULT_DIR", type=Named(path_type=Path), shell_complete=complete_results)
set_option = click.option(
    "--set",
    "assignments",
    metavar="SECTION.KEY=VALUE",
    multiple=True,
    shell_complete=complete_keys,
    help="Any key of the scene, as a TOML value.",
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


def result_pictures(design: "Design") -> dict[str, "Draw"]:
    """What draws the pictures that go into a result folder, by file name."""
    from relax.plots.page import draw_page
    from relax.plots.picture import draw_picture

    return {"picture.png": lambda path: draw_picture(design, path), "view.html": lambda path: draw_page(design, path)}


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
