"""Every experiment with a small size runs, and its rows are what it promises."""

import csv
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from PIL import Image

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
        ("ingredients", {"ingredient", "instead", "scene", "rise", "supports without", "times", "changed", "asked", "converged"}),
        pytest.param(
            "run_time",
            {"scene", "method", "1e-2 above, s", "1e-6 above, s", "above", "stationarity", "equilibrium", "converged"},
            marks=pytest.mark.skipif(
                not find_spec("benchopt"), reason="benchopt is not installed: pip install -e '.[benchmark]'"
            ),
        ),
        ("forms", {"case", "vertices", "method", "seconds", "iterations", "residual", "found", "apart, m", "ran", "stop"}),
        ("screenshots", {"scene", "vertices", "steps", "MB", "written, s", "opened, s", "complaints"}),
        ("recovery", {"formulation", "scenes and weight", "scenes", "exact", "precision", "recall", "force error", "converged"}),
        ("stability", {"axis", "value", "outcome", "equilibrium", "stationarity", "drift", "as planted", "sentence"}),
        pytest.param(
            "accuracy",
            {"case", "quantity", "reference", "error", "digits", "condition", "lost"},
            marks=pytest.mark.skipif(find_spec("mpmath") is None, reason="the references in 50 digits need mpmath"),
        ),
        ("fuzz", {"format", "files", "read", "refused", "wrong", "slowest, s", "peak, MB"}),
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


def test_the_paper_s_figures_are_drawn_with_their_tables(tmp_path):
    asked = ["--size", "small", "--pictures", tmp_path / "pictures", "--output", tmp_path / "rows.csv"]
    done = subprocess.run([sys.executable, EXPERIMENTS / "figures.py", *asked], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "rows.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert {"figure", "scene", "state", "objective", "rms distance, m", "noise rms, m", "numpy"} <= set(rows[0])
    assert done.stdout.count("\n") == len(rows) + 2 == 10
    drawn = sorted((tmp_path / "pictures").iterdir())
    assert [path.name for path in drawn] == [f"figure-{number}.{kind}" for number in (2, 3, 4) for kind in ("csv", "png")]
    for path in drawn[1::2]:
        with Image.open(path) as image:
            assert image.width == 1050 and image.info["dpi"][0] == pytest.approx(300, abs=0.1)  # a column of 3.5 inches
        assert path.stat().st_size < 200_000
    with drawn[2].open(newline="") as handle:
        before, after, plain = csv.DictReader(handle)
    assert int(before["forces"]) > 100 and int(after["forces"]) == 1
    assert abs(float(before["off"])) > 2 * abs(float(after["off"])) > 0 and abs(float(plain["off"])) < 1e-6
