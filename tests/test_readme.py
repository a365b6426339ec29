"""The README's Python runs as it stands, from the project's folder, its blocks one after the other."""

import re
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
    assert len(blocks) == 5
    names = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert names["mast"].vertex == names["other"].supports[0].vertex == 181
    assert (tmp_path / "tent-result" / "result.json").exists()


@pytest.mark.parametrize("command", re.findall(r"^relax .*?(?=\s+#|$)", README, re.MULTILINE))
def test_commands_are_understood(command):
    words = command.split()
    assert CliRunner().invoke(relax.cli.app, [words[1], "--help"]).exit_code == 0


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(([^)]+)\)", README))))
def test_links_lead_somewhere(link):
    assert (ROOT / link).exists()
