"""The lessons run from top to bottom with all that they assert, their exercises have solutions, and a fault in them is seen."""

import re
import runpy
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest

pytest.importorskip("marimo", reason="the lessons are marimo notebooks: pip install -e '.[lessons]'")

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "experiments" / "lessons"
LESSONS = sorted(FOLDER.glob("[0-9]_*.py"))
NOTEBOOKS = [*LESSONS, *sorted((FOLDER / "solutions").glob("*.py"))]


@pytest.fixture(autouse=True)
def as_a_script(monkeypatch):
    """What lies beside a notebook can be imported, as when Python runs it; what the solutions add to the path is forgotten."""
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])


def named(path):
    return f"{path.parent.name}/{path.stem}"


def texts(path):
    """The Markdown of a notebook, cell by cell."""
    return re.findall(r'mo\.md\(r"""\n(.*?)"""', path.read_text(), re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_runs_with_all_that_it_asserts(path):
    outputs, _ = runpy.run_path(str(path))["app"].run()
    pictures = sum(type(output).__name__ == "Figure" for output in outputs)
    assert path not in LESSONS or 2 <= pictures <= 4


FAULTS = [
    ("1_tent", "(constant - density)[:, None, None]", "(constant + density)[:, None, None]"),
    ("2_inverse", "(1 / kappa / (1 / kappa**2 + damping))", "(1 / kappa / (1 / kappa + damping))"),
    (
        "3_convex",
        "np.clip(np.sum(offset * moved) / np.sum(moved**2), -largest, largest)",
        "np.sum(offset * moved) / np.sum(moved**2)",
    ),
    ("4_concave", "slope(np.maximum(size, np.sqrt(eps / (1 - alpha))), alpha, eps)", "slope(size, alpha, eps)"),
    ("5_rounding", "np.linalg.solve(gram + np.diag(", "np.linalg.solve(gram + 0.5 * np.diag("),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "right", "wrong"), FAULTS, ids=[fault[0] for fault in FAULTS])
def test_a_planted_fault_is_seen(name, right, wrong, tmp_path):
    source = (FOLDER / f"{name}.py").read_text()
    assert source.count(right) == 1
    faulty = tmp_path / "experiments" / "lessons" / f"{name}.py"
    faulty.parent.mkdir(parents=True)
    faulty.write_text(source.replace(right, wrong))
    (tmp_path / "data").symlink_to(ROOT / "data")
    with pytest.raises(AssertionError):
        runpy.run_path(str(faulty))["app"].run()


def test_there_are_five_and_the_page_names_them():
    assert [path.stem[0] for path in LESSONS] == list("12345")
    page = (FOLDER / "README.md").read_text()
    assert all(f"({path.name})" in page for path in LESSONS)


@pytest.mark.parametrize("path", LESSONS, ids=named)
def test_every_lesson_has_goals_and_a_solution_of_each_exercise(path):
    cells = texts(path)
    assert "**Goals.**" in cells[0] and cells[0].count("\n    - ") >= 3
    assert "## Exercises" in cells[-1] and f"`solutions/{path.name}`" in cells[-1]
    exercises = re.findall(r"^    (\d)\. \*\*(.+?)\.\*\*", cells[-1], re.MULTILINE)
    assert 3 <= len(exercises) <= 4
    solved = (FOLDER / "solutions" / path.name).read_text()
    assert re.findall(r"^    ## (\d)\. (.+)$", solved, re.MULTILINE) == exercises
    # each answers with something that can fail
    assert all("assert " in part for part in re.split(r"^    ## \d\. ", solved, flags=re.MULTILINE)[1:])


def test_the_sliders_are_answered(monkeypatch):
    lesson = runpy.run_path(str(FOLDER / "4_concave.py"))
    net = lesson["three_masts"](0.0)
    few = lesson["answer"](net, 0.5, 0.03)
    assert np.array_equal(few.forces.any(axis=1), net.planted.any(axis=1))
    noisy = lesson["three_masts"](0.02)
    assert lesson["answer"](noisy, 1.0, 0.01).certificate.supports > 30
    dear = lesson["answer"](noisy, 0.5, 0.5)
    assert 1 <= dear.certificate.supports <= 2
    drawn = lesson["quick_picture"](noisy.mesh, dear.positions, noisy.wanted, dear.forces, noisy.planted)
    assert drawn.count("<circle") == 2 * dear.certificate.supports and drawn.count("<rect") == 3 and "nan" not in drawn


def test_marimo_finds_no_fault():
    command = [sys.executable, "-m", "marimo", "check", "--strict", *map(str, NOTEBOOKS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def commands():
    """The commands of the page's shell block, without their comments."""
    block = re.search(r"```sh\n(.*?)```", (FOLDER / "README.md").read_text(), re.DOTALL)
    return [line.split("#")[0].split() for line in block[1].splitlines()]


def test_the_page_s_script_command_runs():
    command = next(words for words in commands() if words[0] == "python")
    done = subprocess.run([sys.executable, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow
def test_the_page_s_browser_commands_are_served_without_the_net(tmp_path):
    opened = [words for words in commands() if words[0] == "marimo"]
    assert {words[1] for words in opened} == {"edit", "run"} and all((ROOT / words[2]).exists() for words in opened)
    command = next(words for words in opened if words[1] == "run")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    server = [sys.executable, "-m", *command, "--headless", "--host", "127.0.0.1", "--port", address.split(":")[1]]
    with (tmp_path / "log").open("w") as log, subprocess.Popen(server, cwd=ROOT, stdout=log, stderr=log) as process:
        try:
            page = fetched(f"http://{address}", time.monotonic() + 60)
        finally:
            process.terminate()
    assert "4. From l1 to l2^alpha" in page
    assert not re.findall(r'(?:src|href)="(?:https?:)?//[^"]*"', page)


def fetched(address, until):
    """The page at an address, as soon as somebody answers there."""
    while True:
        try:
            with urlopen(address, timeout=10) as answer:
                return answer.read().decode()
        except URLError:
            assert time.monotonic() < until
            time.sleep(0.1)
