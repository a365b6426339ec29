"""The project's own rules as tests: lint, format, types, import floors, top level, and that README and CI say the same."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOP = {"pyproject.toml", "README.md", "relax", "tests", "experiments", "data"}


def run(*command):
    return subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("command", [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",)], ids=" ".join)
def test_lint_format_and_types(command):
    done = run(*command)
    assert done.returncode == 0, done.stdout + done.stderr


def test_imports_go_down_only():
    command = str(Path(sys.executable).parent / "lint-imports")
    done = subprocess.run([command, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_top_level_is_the_cards():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    top = {line.split("/")[0] for line in listed.splitlines()}
    assert {name for name in top if not name.startswith(".")} == TOP


def test_ci_runs_the_readme_s_test_command():
    command = (ROOT / ".ci" / "run").read_text().splitlines()[-1]
    assert f"\n{command}\n" in (ROOT / "README.md").read_text()


def test_core_dependencies_are_the_ones_that_are_imported():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {line.split(">")[0] for line in project["dependencies"]}
    source = "\n".join(path.read_text() for path in (ROOT / "relax").rglob("*.py"))
    assert not {name for name in named if f"import {name}" not in source and f"from {name}" not in source}
