"""The commands on more than one answer: exit statuses, tables, folders written whole, Ctrl-C."""

import csv
import json
import os
import signal

import numpy as np
import pytest

import relax.design.compare
import relax.design.path
from relax import screen
from relax.cli import run
from relax.files import load_result


@pytest.fixture
def solved(here):
    assert run(["solve", "hill.toml", "--quiet"]) == 0
    return here


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def table(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def interrupt_at(monkeypatch, module, number):
    """Ctrl-C at the beginning of the run of this number."""
    real, runs = module.solve, []

    def solve(*arguments, **options):
        runs.append(arguments)
        if len(runs) == number:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(module, "solve", solve)


def test_path_writes_table_curve_and_the_design_at_the_knee(here, capfd):
    assert run(["path", "hill.toml"]) == 0
    out, err = capfd.readouterr()
    folder = here / "hill-path"
    assert names(folder) == ["best", "path.csv", "path.json", "trade-off.png"]
    assert (folder / "trade-off.png").read_bytes()[:4] == b"\x89PNG"
    rows = table(folder / "path.csv")
    knee = [row for row in rows if row["knee"] == "True"]
    assert len(knee) == 1 and knee[0]["chosen"] == "True"
    best = load_result(folder / "best")
    for name in ("objective", "rms_distance", "supports"):
        assert float(knee[0][name]) == best.figures[name]  # to the last digit
    assert float(knee[0]["weight"]) == best.figures["settings"]["penalty"]["weight"]
    assert json.loads((folder / "path.json").read_text())[0]["supports"] == 0 == int(rows[0]["supports"])
    assert (
        "the knee of the curve: converged" in out
        and out.count("\n|") == len(rows) + 1
        and err.count("\n") == len(rows)
        and err.startswith("weight 1 of at most 15: ")
    )
    assert run(["check", "hill-path/best", "--quiet"]) == 0


def test_path_json_is_one_flat_object_a_weight(here, capfd):
    assert run(["path", "hill.toml", "--json", "--quiet", "-o", "p"]) == 0
    out, err = capfd.readouterr()
    rows = json.loads(out)
    assert err == "" and json.loads((here / "p" / "path.json").read_text()) == rows
    weights = [row["weight"] for row in rows]
    assert weights == sorted(weights, reverse=True) and len(rows) > 5
    assert all(not isinstance(value, dict | list) for row in rows for value in row.values())


@pytest.mark.parametrize("count", [1, 3])
def test_path_to_a_count(here, capfd, count):
    assert run(["path", "hill.toml", "--count", str(count), "--json", "--quiet"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert max(row["supports"] for row in rows) <= count
    figures = load_result("hill-path/best").figures
    assert figures["supports"] <= count
    assert figures["rms_distance"] == min(row["rms_distance"] for row in rows)


def test_path_to_a_distance(here, capfd):
    assert run(["path", "hill.toml", "--rms", "0.05"]) == 0
    err = capfd.readouterr().err
    assert err.startswith("weight 1 of at most 34: ") and " left" not in err  # when it is reached nobody knows
    best = load_result("hill-path/best").figures
    assert best["rms_distance"] <= 0.05
    rows = table(here / "hill-path" / "path.csv")
    assert [float(row["rms_distance"]) <= 0.05 for row in rows] == [False] * (len(rows) - 1) + [True]


def test_a_distance_that_is_not_reached_is_status_1_and_written(here, capfd):
    assert run(["path", "hill.toml", "--rms", "1e-12", "--quiet", "--set", "supports.candidates=[24]"]) == 1
    err = capfd.readouterr().err
    assert "before the rms distance is as small as 1e-12 m" in err
    assert load_result("hill-path/best").figures["supports"] == 1


def test_another_s_files_stay_and_the_old_best_goes(here, capfd):
    (here / "hill-path").mkdir()
    (here / "hill-path" / "notes.txt").write_text("mine")
    assert run(["path", "hill.toml", "--count", "0", "--quiet"]) == 0
    before = load_result("hill-path/best").figures["objective"]
    assert run(["path", "hill.toml", "--count", "1", "--quiet"]) == 0
    assert load_result("hill-path/best").figures["objective"] != before
    assert names(here / "hill-path") == ["best", "notes.txt", "path.csv", "path.json", "trade-off.png"]
    (here / "hill-path" / "best" / "mine.txt").write_text("mine")
    assert run(["path", "hill.toml", "--quiet"]) == 2
    assert "mine.txt is not ours" in capfd.readouterr().err
    assert (here / "hill-path" / "best" / "mine.txt").exists()


def test_a_path_that_cannot_be_drawn_leaves_what_was_there(here, capfd, monkeypatch):
    assert run(["path", "hill.toml", "--count", "1", "--quiet"]) == 0
    old = (here / "hill-path" / "path.csv").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("relax.plots.curve.draw_trade_off", full)
    assert run(["path", "hill.toml", "--quiet"]) == 1
    assert "No space left" in capfd.readouterr().err
    assert (here / "hill-path" / "path.csv").read_bytes() == old
    assert names(here / "hill-path") == ["best", "path.csv", "path.json", "trade-off.png"]


BAD = [
    (["path", "gone.toml"], "gone.toml: no such file"),
    (["path", "hill.toml", "--count", "-1"], "-1 is not in the range"),
    (["path", "hill.toml", "--count", "1", "--rms", "0.1"], "both a number of supports and an rms distance"),
    (["path", "hill.toml", "--rms", "nan"], "rms is nan"),
    (["path", "hill.toml", "-o", "hill.npy"], "hill.npy: this is a file"),
    (["compare", "hill.toml", "-o", "hill.npy/x"], "is a file"),
    (["compare", "hill.toml", "--set", "penalty.wieght=1"], "unknown key"),
    (["explain", "nowhere"], "nowhere: no such folder"),
    (["explain", ""], "RESULT_DIR: the name is empty"),
    (["path", " "], "SCENE.toml: the name is empty"),
    (["new", ""], "MESH_OR_HEIGHTS: the name is empty"),
    (["new", "hill.npy", "-o", ""], "-o: the name is empty"),
    (["explain", ".", "--gains"], "--gains: the field it makes is only written"),
]


@pytest.mark.parametrize(("arguments", "sentence"), BAD)
def test_bad_input_is_one_sentence_exit_2_and_nothing_written(here, capfd, arguments, sentence):
    before = names(here)
    assert run(arguments) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.startswith("relax: ") and err.count("\n") == 1 and sentence in err
    assert names(here) == before


def test_ctrl_c_keeps_the_path_so_far(here, capfd, monkeypatch):
    interrupt_at(monkeypatch, relax.design.path, 11)
    assert run(["path", "hill.toml", "--quiet", "--json"]) == 130
    rows = json.loads(capfd.readouterr().out)
    assert len(rows) == len(table(here / "hill-path" / "path.csv")) == 3
    load_result("hill-path/best")


def test_ctrl_c_before_there_is_anything_writes_nothing(here, capfd, monkeypatch):
    interrupt_at(monkeypatch, relax.design.path, 1)
    assert run(["path", "hill.toml", "--quiet"]) == 130
    assert capfd.readouterr().err.strip() == "relax: interrupted: nothing was written"
    assert names(here) == ["hill.npy", "hill.toml"]


def test_ctrl_c_while_writing_does_not_lose_a_finished_path(here, monkeypatch):
    def interrupted(_, path, *__):
        path.write_bytes(b"picture")
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("relax.plots.curve.draw_trade_off", interrupted)
    assert run(["path", "hill.toml", "--count", "1", "--quiet"]) == 130
    assert "path.csv" in names(here / "hill-path")


def test_compare_writes_and_prints_one_row_a_run(here, capfd):
    assert run(["compare", "hill.toml"]) == 0
    out, err = capfd.readouterr()
    rows = json.loads((here / "hill-compare" / "compare.json").read_text())
    assert out.count("\n|") == len(rows) + 1 and len(err.splitlines()) >= len(rows)
    assert [row["penalty"] for row in table(here / "hill-compare" / "compare.csv")] == [row["penalty"] for row in rows]
    assert min(row["over_best"] for row in rows if row["over_best"] is not None) <= 0
    assert run(["compare", "hill.toml", "--quiet", "--json", "-o", "again"]) == 0
    again = json.loads(capfd.readouterr().out)
    for one, other in zip(rows, again, strict=True):
        assert one | {"seconds": 0} == other | {"seconds": 0}


def test_ctrl_c_keeps_the_comparison_so_far(here, capfd, monkeypatch):
    interrupt_at(monkeypatch, relax.design.compare, 3)
    assert run(["compare", "hill.toml", "--quiet"]) == 130
    assert len(table(here / "hill-compare" / "compare.csv")) == 2


def test_explain_prints_and_writes_nothing(solved, capfd):
    before = names(solved)
    assert run(["explain", "hill-result"]) == 0
    out, err = capfd.readouterr()
    result = load_result("hill-result")
    heads = np.flatnonzero(result.forces.any(axis=1))
    assert out.count("\n|") == len(heads) + 1 and "stationary point" in out and err == ""
    assert names(solved) == before
    assert run(["explain", "hill-result", "--json", "--quiet"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [row["vertex"] for row in rows] == heads.tolist()
    assert sum(row["price"] for row in rows) == pytest.approx(result.figures["penalty"])


def test_explain_writes_fields_where_it_is_told(solved, capfd):
    import meshio

    assert run(["explain", "hill-result", "-o", "why", "--gains"]) == 0
    assert "written to why/" in capfd.readouterr().out
    assert names(solved / "why") == ["explain.csv", "explain.json", "values.csv", "values.png", "values.vtu"]
    rows = table(solved / "why" / "values.csv")
    result = load_result("hill-result")
    assert len(rows) == len(result.positions)
    np.testing.assert_array_equal([[float(row[axis]) for axis in "xyz"] for row in rows], result.positions)
    pull = np.array([float(row["pull"] or "nan") for row in rows])
    assert np.isnan(pull[result.scene.fixed]).all()
    read = meshio.read(solved / "why" / "values.vtu")
    np.testing.assert_array_equal(read.point_data["pull"], pull)
    assert set(read.point_data) == {"pull", "fit", "gain", "force"}


def test_explain_says_so_where_a_result_did_not_converge(here, capfd):
    impossible = ["--set", "solver.tolerance=1e-300"]
    assert run(["solve", "hill.toml", "--quiet", *impossible]) == 1
    capfd.readouterr()
    assert run(["explain", "hill-result"]) == 1
    assert "nothing is known of it" in capfd.readouterr().out


def test_tables_fit_in_100_columns(solved, capfd):
    assert run(["compare", "hill.toml", "--quiet"]) == 0
    assert run(["path", "hill.toml"]) == 0 and run(["explain", "hill-result"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert max(len(line) for line in lines if line.startswith("|")) <= 100


def test_a_comparison_says_below_its_table_what_went_wrong(here, capfd):
    assert run(["compare", "hill.toml"]) == 0
    out = capfd.readouterr().out
    assert "power, exact, auto: the exact method needs a membrane whose shape is linear" in out
    assert "power, irls, auto: " not in out
    row = {"penalty": "mcp", "method": "irls", "backend": "auto", "stop": "converged", "converged": False}
    screen.print_notes([row])
    assert capfd.readouterr().out == "mcp, irls, auto: the judge does not accept the refitted answer\n"
