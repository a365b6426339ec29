"""What the experiments share: their two options, flat rows to a CSV file with versions and machine, a table on the screen."""

import argparse
import csv
import os
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from typing import Any

Row = Mapping[str, Any]
PACKAGES = ("relax-tensile", "numpy", "scipy", "clarabel", "cvxpy")


def measured(
    description: str,
    sizes: Iterable[str],
    rows_of: Callable[[str], Sequence[Row]],
    draw: Callable[[Path, Sequence[Row]], None] | None = None,
) -> Sequence[Row]:
    """Rows of the size that the command line asks for, printed, and written where `--output` says.

    `draw` makes pictures of them in the folder of `--pictures`.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=list(sizes), default="full")
    parser.add_argument("--output", type=Path, help="a CSV file for the rows")
    if draw is not None:
        parser.add_argument("--pictures", type=Path, help="a folder for the pictures")
    chosen = parser.parse_args()
    rows = rows_of(chosen.size)
    print_table(rows)
    if chosen.output:
        write_rows(chosen.output, rows)
    if draw is not None and chosen.pictures:
        chosen.pictures.mkdir(parents=True, exist_ok=True)
        draw(chosen.pictures, rows)
    return rows


def in_own_processes(measure: Callable[..., Row], cases: Iterable[Sequence[Any]]) -> list[Row]:
    """A row for each case, one after the other, each in a fresh process, so that its peak memory is its own."""
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        return list(processes.map(measure, *zip(*cases, strict=True)))


def peak_gigabytes() -> float:
    """Largest memory of this process so far."""
    return getrusage(RUSAGE_SELF).ru_maxrss / 2**20


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write one line a run, each with versions, Python, cores and seed of everything random (0: only the scenes' own)."""
    machine = {"python": platform.python_version(), "cores": os.cpu_count(), **{name: version(name) for name in PACKAGES}}
    with path.open("w", newline="") as handle:
        writer = csv.DictWriter(handle, [*rows[0], *machine])
        writer.writeheader()
        writer.writerows({**row, **machine} for row in rows)


def print_table(rows: Sequence[Row]) -> None:
    """Print rows under their keys, as a Markdown table that can be pasted into a page."""
    cells = [[shown(value) for value in row.values()] for row in rows]
    print("| " + " | ".join(rows[0]) + " |")
    print("|" + "---|" * len(rows[0]))
    for line in cells:
        print("| " + " | ".join(line) + " |")


def shown(value: Any) -> str:
    """A figure as people read it."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
