"""Every experiment with a small size runs, and its rows are what it promises."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).parent.parent / "experiments"


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("scenes", {"scene", "converged", "stationarity", "inverse / forward"}),
        ("steps", {"back-end", "gap", "apart"}),
        ("price", {"case", "vertices", "engine", "inverse / forward", "at most", "exact", "stationarity", "converged"}),
        ("scale", {"vertices", "engine", "inverse, s", "overall", "peak, GB", "converged"}),
        ("peers", {"case", "method", "times relax", "before rounding", "objective", "same supports", "converged"}),
        ("paper_method", {"scene", "eps", "state", "at the mast", "magnitude", "stationarity", "converged"}),
        ("formulations", {"scene", "penalty", "method", "back-end", "objective", "above", "stationarity", "converged"}),
        ("ablation", {"skip", "scene", "there", "with, s", "without, s", "saved", "apart", "same supports", "as said"}),
        ("refinement", {"case", "vertices", "supports", "objective", "tip, m", "beside, m", "off", "converged"}),
        ("forms", {"case", "vertices", "method", "seconds", "iterations", "residual", "found", "apart, m", "ran", "stop"}),
        ("factors", {"engine", "first, s", "again, s", "memory, MB", "60 columns, s"}),
    ],
)
def test_small_size_runs_and_writes_flat_rows(name, columns, tmp_path):
    output = tmp_path / "rows.csv"
    command = [sys.executable, EXPERIMENTS / f"{name}.py", "--size", "small", "--output", output]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with output.open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert rows and columns | {"python", "numpy", "relax-tensile"} <= set(rows[0])
    assert done.stdout.count("\n") == len(rows) + 2


def test_the_index_names_every_experiment():
    index = (EXPERIMENTS / "README.md").read_text()
    missing = [path.name for path in EXPERIMENTS.glob("*.py") if path.name != "rows.py" and path.name not in index]
    assert not missing
