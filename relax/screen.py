"""What the command line shows: progress and warnings on stderr, summaries and tables on stdout."""

import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from relax.design.solve import Design
    from relax.files import StoredResult

CONVERGED = "converged"  # what a run says that needs no further word
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
    live = sys.stderr.isatty()

    def say(record: Mapping[str, Any]) -> None:
        residual = "-" if record["stationarity"] is None else f"{record['stationarity']:.1e}"
        line = (
            f"step {record['step']}: objective {record['objective']:.6g}, supports {record['supports']}, "
            f"stationarity {residual}, {record['seconds']:.1f} s, {record['note']}"
        )
        if live:
            line = f"\r{line[: shutil.get_terminal_size().columns - 1]}\x1b[K"
        click.echo(line, err=True, nl=not live)

    try:
        yield say
    finally:
        if live:
            click.echo("\r\x1b[K", err=True, nl=False)


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
    for mast in design.supports[:MOST_ROWS]:
        x, y, z = mast.head
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
