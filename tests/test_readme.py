"""The README's Python and its commands run as they stand, one after the other."""

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

import relax.cli

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_python_blocks_run(tmp_path, monkeypatch):
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 6
    names = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert names["mast"].vertex == names["other"].supports[0].vertex == 181
    assert (tmp_path / "tent-result" / "result.json").exists()


@pytest.mark.slow
def test_commands_run(tmp_path, monkeypatch):
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^relax .*$", README, re.MULTILINE)
    assert {line.split()[1] for line in commands} == set(relax.cli.app.commands) - {"completion"}
    for line in commands:
        assert relax.cli.run(shlex.split(line, comments=True)[1:]) == 0, line
    assert "_RELAX_COMPLETE" in CliRunner().invoke(relax.cli.app, ["completion", "bash"]).output


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(([^)]+)\)", README))))
def test_links_lead_somewhere(link):
    assert (ROOT / link).exists()
