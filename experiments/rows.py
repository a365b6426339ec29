"""What the experiments share: flat rows to a CSV file with versions and machine, and a table on the screen."""

import csv
import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

Row = Mapping[str, Any]
PACKAGES = ("relax-tensile", "numpy", "scipy", "clarabel", "cvxpy")


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
