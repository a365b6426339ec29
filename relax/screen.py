"""What the command line shows: progress and warnings on stderr, summaries and tables on stdout."""

import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from relax.design.solve import Design
    from relax.files import StoredResult

CONVERGED = "converged"  # what a run says that needs no further word
LATEST = 4  # parts of long work whose pace counts: those of a path become slower, those of a comparison differ
PAUSE = 1.0  # seconds between two lines on a pipe that say no more than how far it is
MINUTES = 100  # seconds from which minutes are named
MOST_ROWS = 24  # of a table on the screen
Column = tuple[str, str, str]  # a field of a row, its heading with the unit, and how a number is written
# the figures that fit in 100 columns; the files have all of them
PATH_COLUMNS: tuple[Column, ...] = (
    ("weight", "weight", ".3g"),
    ("supports", "supports", "d"),
    ("rms_distance", "rms, m", ".4g"),
    ("objective", "objective", ".6g"),
    ("penalty", "penalty", ".4g"),
    ("total_force", "force, N", ".4g"),
    ("seconds", "seconds", ".2f"),
    ("converged", "converged", ""),
    ("chosen", "chosen", ""),
)
COMPARE_COLUMNS: tuple[Column, ...] = (
    ("penalty", "penalty", ""),
    ("method", "method", ""),
    ("backend", "back-end", ""),
    ("objective", "objective", ".6g"),
    ("over_best", "above", ".1e"),
    ("supports", "supports", "d"),
    ("rms_distance", "rms, m", ".4g"),
    ("seconds", "seconds", ".2f"),
)
EXPLAIN_COLUMNS: tuple[Column, ...] = (
    ("vertex", "vertex", "d"),
    ("force", "force, N", ".4g"),
    ("dual", "dual", ".4g"),
    ("price", "price", ".4g"),
    ("loss_distance", "+ distance", "+.4g"),
    ("loss_objective", "+ objective", "+.4g"),
    ("estimate", "estimate", "+.4g"),
    ("share", "share", ".1%"),
)


@contextmanager
def progress(*, quiet: bool) -> Iterator[Callable[[Mapping[str, Any]], None] | None]:
    """A callback that says on stderr how a run goes: one line kept up to date on a terminal, else one line a step."""
    if quiet:
        yield None
        return
    with _line() as show:
        yield lambda record: show(_step(record))


def _step(record: Mapping[str, Any]) -> str:
    residual = "-" if record["stationarity"] is None else f"{record['stationarity']:.1e}"
    return (
        f"step {record['step']}: objective {record['objective']:.6g}, supports {record['supports']}, "
        f"stationarity {residual}, {record['seconds']:.1f} s, {record['note']}"
    )


@contextmanager
def _line() -> Iterator[Callable[[str], None]]:
    """A function that shows a line on stderr, on a terminal always the same one, which is blank in the end."""
    live = sys.stderr.isatty()

    def show(line: str) -> None:
        if live:
            line = f"\r{line[: shutil.get_terminal_size().columns - 1]}\x1b[K"
        click.echo(line, err=True, nl=not live)

    try:
        yield show
    finally:
        if live:
            click.echo("\r\x1b[K", err=True, nl=False)


class Work:
    """Work in parts of a kind: says which of how many is done, and how long the others may take.

    A pipe gets a line a part; a terminal has one line, which also shows the steps of the part at hand.

    Parameters
    ----------
    what : str
        What a part is called.
    total : int
        How many there are; with `bound` "at most", they may be fewer.
    show : function that shows a line, or None to say nothing
    bound : str
    """

    def __init__(self, what: str, total: int, show: Callable[[str], None] | None, bound: str = "") -> None:
        self.what, self.total, self.show, self.bound = what, total, show, bound
        self.timed = True
        self.ends = [time.perf_counter()]
        self.said = self.ends[0]

    @property
    def step(self) -> Callable[[Mapping[str, Any]], None] | None:
        """For the solves inside a part; only a terminal shows their steps, so only there they are made."""
        return self._step if self.show is not None and sys.stderr.isatty() else None

    def _step(self, record: Mapping[str, Any]) -> None:
        assert self.show is not None
        self.show(f"{self._where(len(self.ends))}{self.left()}: {_step(record)}")

    def done(self, words: str, parts: int = 1) -> None:
        """One part more is done, or several; `words` say what came of it, without them a pipe hears of it now and then."""
        now, before = time.perf_counter(), self.ends[-1]
        self.ends += [before + (now - before) * (index + 1) / parts for index in range(parts)]
        if self.show is not None and (words or now - self.said >= PAUSE or sys.stderr.isatty()):
            self.said = now
            self.show(f"{self._where(len(self.ends) - 1)}{self.left()}{': ' if words else ''}{words}")

    def _where(self, number: int) -> str:
        return f"{self.what} {number} of {f'{self.bound} ' if self.bound else ''}{self.total}"

    def left(self) -> str:
        """About how long the parts that are left take, at the pace of the last few; nothing while there is no pace to tell."""
        ends = self.ends[-LATEST - 1 :]
        parts = self.total - len(self.ends) + 1
        if not self.timed or len(ends) < 3 or parts <= 0:
            return ""
        seconds = parts * (ends[-1] - ends[0]) / (len(ends) - 1)
        if seconds < 1:
            return ""
        return f", about {f'{seconds:.0f} s' if seconds < MINUTES else f'{seconds / 60:.0f} min'} left"


@contextmanager
def work(what: str, total: int, *, quiet: bool, bound: str = "") -> Iterator[Work]:
    """Progress of `total` parts, which `what` names; `bound` "at most" where they may be fewer."""
    if quiet:
        yield Work(what, total, None, bound)
        return
    with _line() as show:
        yield Work(what, total, show, bound)


def warn(sentences: Any) -> None:
    """Each sentence on a line of its own, on stderr."""
    for sentence in sentences:
        click.echo(f"relax: warning: {sentence}", err=True)


def print_design(design: "Design", folder: Path) -> None:
    """A few lines on a design, its supports, and where it was written."""
    said = design.certificate
    count = "1 support" if said.supports == 1 else f"{said.supports} supports"
    click.echo(f"{design.problem.scene.title}: {design.stop} ({design.iterations} steps, {design.seconds:.2f} s)")
    click.echo(f"{count}, rms distance {said.rms_distance:.4g} m, largest tension {said.tension_max:.4g} N")
    click.echo(f"objective {said.objective:.8g} = distance {said.distance:.8g} + penalty {said.penalty:.8g}")
    if design.supports:
        place = f"{'vertex':>8}  {'kind':8}  {'x, m':>9} {'y, m':>9} {'z, m':>9}"
        click.echo(f"{place}  {'force, N':>10}  {'length, m':>9}  {'lean, deg':>9}")
    # far below the size of the scene is round-off, and too wide for its column
    nothing = 1e-9 * float(abs(design.positions).max())
    for mast in design.supports[:MOST_ROWS]:
        x, y, z = (value if abs(value) > nothing else 0.0 for value in mast.head)
        length = "-" if mast.length is None else f"{mast.length:.4g}"
        place = f"{mast.vertex:8}  {mast.kind:8}  {x:9.4g} {y:9.4g} {z:9.4g}"
        click.echo(f"{place}  {mast.magnitude:10.4g}  {length:>9}  {mast.lean:9.1f}")
    if len(design.supports) > MOST_ROWS:
        click.echo(f"     ... and {len(design.supports) - MOST_ROWS} more in {folder / 'supports.csv'}")
    click.echo(f"written to {folder}{os.sep}")


def print_check(stored: "StoredResult", judged: Mapping[str, Any], wrong: Sequence[str]) -> None:
    """Every figure as stored and as recomputed, and the verdict."""
    click.echo(f"{'figure':14}{'result.json':>24}{'recomputed':>24}")
    for name, value in judged.items():
        mark = "  differs" if name in wrong else ""
        click.echo(f"{name:14}{_cell(stored.figures.get(name)):>24}{_cell(value):>24}{mark}")
    verdict = "converged" if judged["converged"] else "not converged"
    click.echo(f"{stored.scene.title}: {'every figure agrees' if not wrong else f'{len(wrong)} differ'}; {verdict}")


def _cell(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


def print_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[Column]) -> None:
    """Rows between bars, as Markdown has them; "-" where there is no figure."""
    cells = [[heading for _, heading, _ in columns]]
    cells += [[_shown(row[name], form) for name, _, form in columns] for row in rows]
    widths = [max(len(line[index]) for line in cells) for index in range(len(columns))]
    text = [not form for _, _, form in columns]
    for number, line in enumerate(cells):
        filled = [cell.ljust(width) if left else cell.rjust(width) for cell, width, left in zip(line, widths, text, strict=True)]
        click.echo(f"| {' | '.join(filled)} |")
        if number == 0:
            dashes = ["-" * width if left else "-" * (width - 1) + ":" for width, left in zip(widths, text, strict=True)]
            click.echo(f"| {' | '.join(dashes)} |")


def print_notes(rows: Sequence[Mapping[str, Any]]) -> None:
    """What the table of a comparison leaves out: why a run gave no answer, or one that the judge does not accept."""
    for row in rows:
        said = [] if row["stop"] == CONVERGED else [row["stop"]]
        said += ["the judge does not accept the refitted answer"] if row["converged"] is False else []
        if said:
            click.echo(f"{row['penalty']}, {row['method']}, {row['backend']}: {'; '.join(said)}")


def _shown(value: Any, form: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else ""
    return format(value, form) if form else str(value)
