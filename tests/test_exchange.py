"""Results for other programs, and completion by the shell."""

import json
import subprocess
import sys

import numpy as np
import pytest
import zoo
from click.shell_completion import BashComplete, ShellComplete
from folders import refused, write_scene

import relax
from relax import exchange
from relax.cli import app, run
from relax.convex.backends import BACKENDS
from relax.design.methods import METHODS
from relax.files import load_result
from relax.files.network import KINDS, export, network
from relax.sparsity.penalties import PENALTIES


def leaning():
    """A loaded net held by a mast, a tie-down and a stay, by hand: at rest only up to what the stays hold."""
    scene = zoo.grid_scene(7, zoo.hill, membrane__loads=[0.0, 0.0, -0.3], supports__ground=-0.2)
    forces = np.zeros((49, 3))
    forces[[16, 24, 32]] = [[0.1, 0.0, 0.3], [0.0, 0.05, -0.2], [0.2, 0.0, 0.0]]
    return relax.form(relax.Problem(scene, weight=1.0), forces)


def balance(node, edge):
    """Load and pull of the edges on each node, from the network's own numbers."""
    at = {key: np.array([values[name] for name in "xyz"]) for key, values in node.items()}
    found = {key: np.array([values[name] for name in ("px", "py", "pz")]) for key, values in node.items()}
    for a, others in edge.items():
        for b, values in others.items():
            pull = values["q"] * (at[b] - at[a])
            found[a], found[b] = found[a] + pull, found[b] - pull
            assert values["force"] == pytest.approx(values["q"] * values["length"], abs=1e-15)
            assert values["length"] == pytest.approx(np.linalg.norm(at[b] - at[a]))
    return found


def test_a_network_is_in_balance_and_its_struts_carry_the_supports():
    design = leaning()
    said = network(design.problem.scene, design.positions, design.forces)
    node, edge = said["node"], said["edge"]
    assert len(node) == 49 + 2 and said["max_node"] == 50 and set(edge) == set(node)  # a stay has no foot
    free = design.problem.scene.membrane.free
    for key, pull in balance(node, edge).items():
        np.testing.assert_allclose([node[key][name] for name in ("rx", "ry", "rz")], pull, atol=1e-14)
        if int(key) in free and key != "32":
            assert not node[key]["is_support"] and np.abs(pull).max() < 1e-9
        else:
            assert node[key]["is_support"]
    np.testing.assert_allclose([node["32"][name] for name in ("rx", "ry", "rz")], [-0.2, 0, 0], atol=1e-9)
    mast, tie = edge["16"]["49"], edge["24"]["50"]
    assert (mast["kind"], tie["kind"]) == ("mast", "tie-down") and mast["force"] < 0 < tie["force"]
    assert node["49"]["z"] == pytest.approx(-0.2) and len([1 for others in edge.values() for _ in others]) == 2 + len(
        design.problem.scene.mesh.edges
    )
    for a, b in design.problem.scene.mesh.edges.tolist():
        assert edge[str(a)][str(b)]["rest_length"] > 0


def test_the_json_is_what_compas_writes(tmp_path):
    design = leaning()
    export(design, tmp_path / "net.json", "compas")
    said = json.loads((tmp_path / "net.json").read_text())
    assert said["dtype"] == "compas.datastructures/Graph" and said["name"] == "zoo"
    wanted = {"attributes", "default_node_attributes", "default_edge_attributes", "node", "edge", "max_node"}
    assert set(said["data"]) == wanted
    assert all(set(values) == set(said["data"]["default_node_attributes"]) for values in said["data"]["node"].values())


def test_compas_itself_reads_it(tmp_path):
    compas = pytest.importorskip(
        "compas", reason="COMPAS is not installed: its JSON is checked by test_the_json_is_what_compas_writes"
    )
    design = leaning()
    export(design, tmp_path / "net.json", "compas")
    graph = compas.json_load(tmp_path / "net.json")
    assert graph.number_of_nodes() == 51
    np.testing.assert_array_equal([graph.node_coordinates(node) for node in range(49)], design.positions)
    assert graph.edge_attribute((16, 49), "kind") == "mast" and graph.edge_attribute((0, 1), "kind") == "membrane"


def test_an_obj_has_its_supports_as_lines(tmp_path):
    design = leaning()
    export(design, tmp_path / "a.obj", "obj")
    lines = (tmp_path / "a.obj").read_text().splitlines()
    points = np.array([line.split()[1:] for line in lines if line.startswith("v ")], dtype=float)
    np.testing.assert_array_equal(points[:49], design.positions)
    assert sum(line.startswith("f ") for line in lines) == len(design.problem.scene.mesh.faces)
    assert lines[-4:] == ["g masts", "l 17 50", "g tie-downs", "l 25 51"]
    np.testing.assert_allclose(points[49:], [mast.foot for mast in design.supports[:2]])


@pytest.fixture
def solved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, "[penalty]\nweight = 0.02\n")
    assert run(["solve", "hill.toml", "--quiet"]) == 0
    return tmp_path


def test_the_command_writes_what_the_function_does(solved, capfd):
    assert run(["export", "hill-result", "--to", "compas"]) == 0
    assert capfd.readouterr().out == "written to hill-export.json\n"
    relax.export(load_result("hill-result").design(), "again.json", "compas")
    assert (solved / "again.json").read_bytes() == (solved / "hill-export.json").read_bytes()
    assert run(["export", "hill-result", "--to", "obj", "-o", "x.obj", "--quiet"]) == 0 and (solved / "x.obj").exists()
    before = sorted(solved.iterdir())
    for arguments in (
        ["nowhere", "--to", "obj"],
        ["hill-result", "--to", "dwg"],
        ["hill-result"],
        ["hill-result", "--to", "obj", "-o", "no/x.obj"],
    ):
        assert run(["export", *arguments]) == 2
    assert sorted(solved.iterdir()) == before
    assert "expected compas or obj" in refused(lambda: relax.export(load_result("hill-result"), "x", "dwg"))


def test_the_command_offers_the_kinds_that_there_are():
    assert tuple(KINDS) == exchange.KINDS


# --- completion ---


def completed(*words):
    """What a shell would offer for the last word."""
    *before, last = words
    return [item.value for item in ShellComplete(app, {}, "relax", "_RELAX_COMPLETE").get_completions(list(before), last)]


def test_completion_offers_commands_files_folders_and_names(solved):
    (solved / "deep").mkdir()
    write_scene(solved / "deep", name="other.toml")
    assert {"solve", "path", "new", "export", "completion"} <= set(completed(""))
    assert completed("solve", "") == ["deep/other.toml", "hill.toml"] and completed("path", "hi") == ["hill.toml"]
    assert completed("check", "") == ["hill-result"] == completed("export", "h") == completed("explain", "hill")
    assert completed("plot", "") == ["hill-result"]
    assert completed("solve", "x.toml", "--start", "") == ["auto", "target", "heavy", "hill-result"]
    assert completed("solve", "x.toml", "--method", "") == list(METHODS)
    assert completed("solve", "x.toml", "--backend", "") == ["auto", *BACKENDS]
    assert completed("solve", "x.toml", "--penalty", "") == list(PENALTIES)
    assert completed("solve", "x.toml", "--penalty", "l") == ["log-sum"]
    assert completed("export", "hill-result", "--to", "") == list(KINDS)
    assert "--weight" in completed("solve", "--w")


def test_completion_offers_the_keys_of_the_format_and_their_names():
    assert completed("compare", "x.toml", "--set", "penalty.we") == ["penalty.weight=", "penalty.weight_fraction="]
    assert 'membrane.springs="tension-only"' in completed("solve", "x.toml", "--set", "membrane.springs=")
    assert completed("solve", "x.toml", "--set", "penalty.weight=") == []


def test_where_nothing_matches_the_shell_looks_for_folders(solved):
    [item] = ShellComplete(app, {}, "relax", "_RELAX_COMPLETE").get_completions(["solve"], "nothing")
    assert item.type == "dir"


@pytest.mark.parametrize("shell", exchange.SHELLS)
def test_the_script_names_the_shell_and_the_program(shell, capfd):
    assert run(["completion", shell]) == 0
    out = capfd.readouterr().out
    assert "_RELAX_COMPLETE" in out and f"{shell}_complete" in out


def test_a_shell_asks_the_program(solved, monkeypatch):
    """The whole way, as bash goes it."""
    assert BashComplete.name == "bash"
    environment = {"_RELAX_COMPLETE": "bash_complete", "COMP_WORDS": "relax check hi", "COMP_CWORD": "2"}
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    command = [sys.executable, "-c", "from relax.cli import main; main()"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "plain,hill-result\n" and done.returncode == 0
