import errno
import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from folders import LIGHT, bump, write_scene

import relax.cli
from relax.cli import run
from relax.convex.backends import BACKENDS
from relax.design.form import NOTES
from relax.design.methods import METHODS
from relax.files import load_result
from relax.membrane.formers import FORMERS
from relax.sparsity.penalties import PENALTIES

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def solved(here, capfd):
    assert run(["solve", "hill.toml", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    return here


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_solve_writes_a_result_and_says_what_it_is(here, capfd):
    assert run(["solve", "hill.toml"]) == 0
    out, err = capfd.readouterr()
    design = load_result("hill-result")
    assert "hill: converged" in out and "written to hill-result/" in out
    assert f"{design.figures['supports']} support" in out
    vertex = int(np.flatnonzero(design.forces.any(axis=1))[0])
    assert f"{vertex:8}  mast" in out
    assert err.startswith("step 0: objective ") and len(err.splitlines()) > 3
    assert names(here / "hill-result") == [
        *("membrane.obj", "membrane.vtu", "picture.png", "result.json", "result.npz", "supports.csv", "trace.npz", "view.html")
    ]
    assert (here / "hill-result" / "picture.png").read_bytes()[:4] == b"\x89PNG"


def test_json_is_the_content_of_result_json(here, capfd):
    assert run(["solve", "hill.toml", "--json", "--quiet", "-o", "a/b"]) == 0
    out, err = capfd.readouterr()
    assert out == (here / "a" / "b" / "result.json").read_text() and err == ""


def test_options_stand_for_keys(here, capfd):
    penalty = ["--penalty", "group-lasso", "--weight", "0.1"]
    solver = ["--backend", "clarabel", "--method", "sequential", "--start", "heavy"]
    assert run(["solve", "hill.toml", "--json", "--quiet", *penalty, *solver, "--set", 'rounding.refit="debiased"']) == 0
    settings = json.loads(capfd.readouterr().out)["settings"]
    assert settings["penalty"]["name"] == "group-lasso" and settings["penalty"]["weight"] == 0.1
    assert settings["penalty"]["exponent"] is None
    assert settings["solver"] == {"method": "sequential", "backend": "clarabel", "start": "heavy", "tolerance": 1e-8}
    assert settings["rounding"]["refit"] == "debiased"
    assert run(["check", "hill-result"]) == 0
    assert run(["solve", "hill.toml", "--json", "--quiet", "--exponent", "0.8", "--set", "penalty.exponent=0.7"]) == 0
    assert json.loads(capfd.readouterr().out.split("converged\n")[-1])["settings"]["penalty"]["exponent"] == 0.7


def test_a_start_folder_typed_here_or_named_in_the_scene(solved, capfd):
    (solved / "deep").mkdir()
    write_scene(solved / "deep", LIGHT)
    assert run(["solve", "deep/hill.toml", "--start", "hill-result", "--json", "--quiet", "-o", "again"]) == 0
    said = json.loads(capfd.readouterr().out)
    assert said["settings"]["solver"]["start"] == os.path.join("..", "hill-result")
    assert said["objective"] == pytest.approx(load_result("hill-result").figures["objective"], rel=1e-9)
    np.save(solved / "deep" / "hill.npy", bump(6))
    assert run(["solve", "deep/hill.toml", "--start", "hill-result"]) == 2
    assert "has 49 vertices, this scene 36" in capfd.readouterr().err


def test_check_agrees_prints_and_finds_out(solved, capfd):
    assert run(["check", "hill-result"]) == 0
    out, err = capfd.readouterr()
    assert "every figure agrees; converged" in out and err == ""
    assert run(["check", "hill-result", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    path = solved / "hill-result" / "result.json"
    said = json.loads(path.read_text())
    path.write_text(json.dumps(said | {"rms_distance": 2 * said["rms_distance"]}))
    assert run(["check", "hill-result"]) == 1
    out, err = capfd.readouterr()
    assert "differs" in out and err == "relax: hill-result: result.json does not hold for rms_distance\n"
    assert run(["check", "hill-result", "--json"]) == 1
    judged = json.loads(capfd.readouterr().out)
    assert judged["differing"] == ["rms_distance"] and judged["agrees"] is False
    assert judged["rms_distance"] == pytest.approx(said["rms_distance"])


def test_check_needs_nothing_but_two_files(solved, capfd):
    moved = solved / "moved"
    moved.mkdir()
    for name in ("result.json", "result.npz"):
        (solved / "hill-result" / name).rename(moved / name)
    (solved / "hill.toml").unlink()
    (solved / "hill.npy").unlink()
    assert run(["check", "moved"]) == 0


def test_check_warns_of_slack_edges(solved, capfd):
    with np.load("hill-result/result.npz") as archive:
        arrays = dict(archive)
    arrays["rest_length"][:3] = 9.0
    np.savez("hill-result/result.npz", **arrays)
    assert run(["check", "hill-result", "--quiet"]) == 1
    err = capfd.readouterr().err
    assert "relax: warning: " in err and "slack" in err
    assert "result.json does not hold for objective" in err or "slack_share" in err


def test_form_finds_the_same_shape_again(solved, capfd):
    assert run(["form", "hill-result"]) == 0
    out = capfd.readouterr().out
    assert "hill-form-result" in out
    np.testing.assert_allclose(load_result("hill-form-result").positions, load_result("hill-result").positions, atol=1e-9)
    assert run(["check", "hill-form-result", "--quiet"]) == 0
    assert run(["form", "hill-result", "-o", "x", "--quiet"]) == 0 and "x" in names(solved)


@pytest.mark.parametrize("method", FORMERS)
def test_form_by_each_method(method, solved, capfd):
    assert run(["form", "hill-result", "--method", method]) == 0
    out, err = capfd.readouterr()
    assert "hill: converged" in out and NOTES[method] in err
    formed = load_result("hill-form-result")
    np.testing.assert_allclose(formed.positions, load_result("hill-result").positions, atol=1e-9)
    assert run(["check", "hill-form-result", "--quiet"]) == 0
    assert names(solved / "hill-form-result") == names(solved / "hill-result")


def test_form_offers_the_methods_that_there_are(capfd):
    run(["form", "--help"])
    assert f"[{'|'.join(FORMERS)}]" in capfd.readouterr().out


def test_a_run_that_does_not_converge_says_so_and_is_written(here, capfd):
    # no run gets below a tolerance of nothing
    impossible = ["--set", "solver.tolerance=1e-300", "--set", "penalty.weight=0.001"]
    assert run(["solve", "hill.toml", "--quiet", "--json", *impossible]) == 1
    said = json.loads(capfd.readouterr().out)
    assert said["converged"] is False and said["stop"] != "converged"
    assert run(["check", "hill-result", "--quiet"]) == 1


BAD = [
    (["solve", "gone.toml"], "gone.toml: no such file"),
    (["solve", "broken.toml"], "broken.toml: this is not valid TOML"),
    (["solve", "hill.toml", "--set", "penalty.wieght=1"], 'hill.toml: penalty.wieght: unknown key; perhaps "weight" is meant'),
    (["solve", "hill.toml", "--penalty", "l1"], 'hill.toml: penalty.name = "l1": expected "group-lasso" or "power"'),
    (["solve", "hill.toml", "--penalty", "mcp"], 'hill.toml: penalty.knee is missing: penalty.name = "mcp" needs it'),
    (["solve", "hill.toml", "--method", "newton"], 'hill.toml: solver.method = "newton": expected "sequential" or'),
    (["solve", "hill.toml", "--quiet", "--backend", "osqp"], "OSQP takes no second-order cones, so not the norm of a force"),
    (["solve", "hill.toml", "--method", "greedy", "--backend", "clarabel"], "the method greedy solves no convex steps"),
    (["solve", "hill.toml", "--method", "lagrangian", "--set", "supports.direction='up'"], "sequential"),
    (["solve", "hill.toml", "--method", "exact"], "the exact method needs a membrane whose shape is linear in the forces"),
    (["solve", "hill.toml", "--penalty", "count", "--backend", "working-set"], 'the penalty "count" jumps at zero'),
    (
        ["solve", "hill.toml", "--penalty", "count", "--set", "penalty.weight_fraction=0.1"],
        "jumps at zero, so no weight is the largest",
    ),
    (
        ["solve", "hill.toml", "--penalty", "count", "--method", "reweighted-l1"],
        'use the method "sequential" and the back-end "auto"',
    ),
    (
        ["solve", "hill.toml", "--set", "membrane.cables=[{ path = [0, 1], stifness = 1.0 }]"],
        "(entry 0: stifness is unknown in it): expected a list of tables { path = [vertices], stiffness = ",
    ),
    (
        ["solve", "hill.toml", "--set", 'membrane.cables=[{ path = [0, "x"], stiffness = 1.0 }]'],
        '(entry 0: path: entry 1 is "x"): expected a list of tables',
    ),
    (
        ["solve", "hill.toml", "--set", "supports.candidates={ box = [[1, 1], [0, 0]] }"],
        "(box: its second corner lies left of the first or below it: swap them)",
    ),
    (
        ["solve", "hill.toml", "--set", "supports.candidates={ box = [[5, 5], [6, 6]] }"],
        "no vertex lies in the box; the target reaches from x = 0 to 1.2 and from y = 0 to 1.2: move the box",
    ),
    (["solve", "hill.toml", "--set", "weight=1"], "weight: unknown section; perhaps penalty.weight is meant"),
    (["solve", "hill.npy"], "hill.npy: this is a shape, and a scene file is expected: relax new writes one for it"),
    (["check", "hill.toml"], "hill.toml: this is a file, and a result folder is expected"),
    (["solve", "hill.toml", "--weight", "-1"], "penalty.weight = -1.0: expected a number above 0"),
    (["solve", "hill.toml", "--weight", "nan"], "penalty.weight = nan: expected a number above 0"),
    (["solve", "hill.toml", "--weight", "x"], "'x' is not a valid float"),
    (["solve", "hill.toml", "--set", 'target.heights="nan.npy"'], 'target.heights = "nan.npy": row 2, column 1 is nan'),
    (["solve", "hill.toml", "--set", 'target.heights="line.npy"'], "it has 1 rows and 5 columns"),
    (["solve", "hill.toml", "--set", 'target.heights="huge.npy"'], "it has 40,000 x 40,000 samples"),
    (["solve", "hill.toml", "--set", 'target.heights="pickle.npy"'], "pickled objects"),
    (["solve", "hill.toml", "--set", 'target.mesh="range.obj"'], "face 0 names vertex 8"),
    (["solve", "hill.toml", "--set", 'target.mesh="lonely.obj"'], "vertex 3 belongs to no face"),
    (["solve", "hill.toml", "--set", 'target.mesh="steep.obj"', "--set", "supports.fixed=[0]"], "a rest length of zero"),
    (["solve", "hill.toml", "--set", 'supports.fixed="none"', "--set", 'supports.direction="up"'], "has no fixed vertex"),
    (["solve", "hill.toml", "--set", "membrane.stiffness=0"], "membrane.stiffness = 0: expected a number above 0"),
    (["solve", "hill.toml", "--set", "membrane.stiffness=-1"], "membrane.stiffness = -1"),
    (["solve", "hill.toml", "--set", "membrane.rest_scale=3.0"], "every edge is slack"),
    (["solve", "hill.toml", "-o", "hill.npy"], "hill.npy: this is a file"),
    (["solve", "hill.toml", "-o", "hill.npy/x"], "is a file"),
    (["solve", "hill.toml", "--start", "nowhere"], '--start nowhere: this is neither "auto"'),
    (["solve", "hill.toml", "--start", ""], "--start (empty): this is neither"),
    (["solve", "hill.toml", "--set", 'solver.start="nowhere"'], 'hill.toml: solver.start = "nowhere": this is neither'),
    (["solve", "hill.toml", "-o", ""], "-o: the name of the result folder is empty"),
    (["solve"], "Missing argument 'SCENE.toml'; relax solve --help"),
    (["solve", "hill.toml", "--bogus"], "No such option '--bogus'"),
    (["sovle"], "No such command 'sovle'"),
    (["plot", "x"], "x: no such folder"),
    (["check", "nowhere"], "nowhere: no such folder"),
    (["check", "."], "this folder holds no result"),
    (["form", "nowhere"], "nowhere: no such folder"),
    (["form", ".", "--method", "magic"], "'magic' is not one of"),
]


@pytest.mark.parametrize(("arguments", "sentence"), BAD)
def test_bad_input_is_one_sentence_exit_2_and_nothing_written(here, capfd, arguments, sentence):
    (here / "broken.toml").write_text("[target\n")
    heights = bump()
    heights[2, 1] = np.nan
    np.save(here / "nan.npy", heights)
    np.save(here / "line.npy", np.zeros((1, 5)))
    np.save(here / "pickle.npy", np.array([[{}, 1], [2, 3]], dtype=object), allow_pickle=True)
    with (here / "huge.npy").open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (40_000, 40_000)})
    (here / "range.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (here / "lonely.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nf 1 2 3\n")
    (here / "steep.obj").write_text("v 0 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 3\n")
    before = names(here)
    assert run(arguments) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.startswith("relax: ") and err.count("\n") == 1
    assert sentence in err
    assert names(here) == before


def test_round_off_in_a_place_is_zero_in_the_summary(here, capfd):
    assert run(["solve", str(DATA / "sail.toml"), "-o", "sail"]) == 0  # its mast stands at x = y = 0
    rows = [line for line in capfd.readouterr().out.splitlines() if " mast " in line or " tie-down " in line]
    assert len(rows) == 5 and len({len(row) for row in rows}) == 1
    assert next(row for row in rows if " mast " in row).split()[2:4] == ["0", "0"]


def test_nothing_is_solved_where_nothing_can_be_written(here, monkeypatch):
    monkeypatch.setattr("relax.files.scenes.load_scene", lambda *_: pytest.fail("the scene was read"))
    (here / "taken").write_text("")
    assert run(["solve", "hill.toml", "-o", "taken"]) == 2


def test_help_shows_examples_and_no_command_of_later_versions(capfd):
    assert run(["--help"]) == 0
    out = capfd.readouterr().out
    assert "relax solve data/tent.toml" in out and "relax check tent-result" in out
    for command in ("solve", "form", "check", "compare", "path", "explain", "plot", "new", "export", "completion"):
        assert f"\n  {command} " in out
    assert run([]) == 0
    assert capfd.readouterr().out.rstrip() == out.rstrip()
    for command in ("solve", "check", "compare", "path", "explain", "form"):
        assert run([command, "-h"]) == 0
    assert "<name>-form-result" in " ".join(capfd.readouterr().out.split()).replace("<name>- form", "<name>-form")
    assert run(["--version"]) == 0
    assert capfd.readouterr().out == f"relax {importlib.metadata.version('relax-tensile')}\n"


def test_ctrl_c_while_solving_writes_the_best_so_far(here, capfd, monkeypatch):
    real = relax.cli.progress

    def interrupting(*, quiet):
        class Progress:
            def __enter__(self):
                self.inner = real(quiet=quiet)
                self.inner.__enter__()
                return self.say

            def __exit__(self, *error):
                return self.inner.__exit__(*error)

            def say(self, record):
                if record["step"] == 3:
                    raise KeyboardInterrupt

        return Progress()

    monkeypatch.setattr(relax.cli, "progress", interrupting)
    assert run(["solve", "hill.toml", "--quiet"]) == 130
    figures = load_result("hill-result").figures
    assert figures["interrupted"] is True and "interrupted" in figures["stop"]
    monkeypatch.undo()
    monkeypatch.chdir(here)
    assert run(["check", "hill-result"]) in (0, 1)
    assert "every figure agrees" in capfd.readouterr().out


@pytest.mark.parametrize("command", ["solve", "form"])
def test_ctrl_c_while_writing_keeps_the_finished_run(solved, monkeypatch, command):
    def interrupted(_, path):
        path.write_bytes(b"picture")
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr("relax.plots.picture.draw_picture", interrupted)
    assert run([command, "hill.toml" if command == "solve" else "hill-result", "-o", "out", "--quiet"]) == 130
    assert load_result("out").figures["converged"] is True
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_while_the_summary_is_printed_does_not_say_that_nothing_was_written(here, capfd, monkeypatch):
    monkeypatch.setattr(relax.cli, "print_design", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    assert run(["solve", "hill.toml"]) == 130
    assert "nothing was written" not in capfd.readouterr().err
    load_result("hill-result")


def test_a_full_disk_is_one_sentence(here, capfd, monkeypatch):
    def full(_, path):
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("relax.plots.picture.draw_picture", full)
    assert run(["solve", "hill.toml", "--quiet"]) == 1
    err = capfd.readouterr().err
    assert err.startswith("relax: cannot be written (No space left on device)") and err.count("\n") == 1
    assert names(here) == ["hill.npy", "hill.toml"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_a_full_screen_is_one_sentence(solved):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "relax", "check", "hill-result"]
        said = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert said.returncode == 1
    assert said.stderr.startswith("relax: cannot be written (No space left") and said.stderr.count("\n") == 1


def test_a_damaged_start_is_named_as_it_was_typed(solved, capfd):
    (solved / "sub").mkdir()
    write_scene(solved / "sub", LIGHT)
    (solved / "hill-result" / "result.npz").unlink()
    assert run(["solve", "sub/hill.toml", "--start", "hill-result"]) == 2
    assert capfd.readouterr().err.startswith("relax: hill-result/result.npz: no such file")


def test_ctrl_c_before_there_is_anything_writes_nothing(here, capfd, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("relax.files.scenes._build", interrupt)
    assert run(["solve", "hill.toml"]) == 130
    assert capfd.readouterr().err.strip() == "relax: interrupted: nothing was written"
    assert names(here) == ["hill.npy", "hill.toml"]


def test_progress_is_one_line_kept_up_to_date_on_a_terminal(here, capfd, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert run(["solve", "hill.toml"]) == 0
    err = capfd.readouterr().err
    assert "\n" not in err and err.count("\rstep ") > 3 and err.endswith("\r\x1b[K")


def test_the_module_runs_and_a_signal_ends_it_with_130(here):
    """The whole way, once: a process of its own, interrupted while it solves."""
    np.save(here / "hill.npy", bump(15))
    command = [sys.executable, "-m", "relax", "solve", "hill.toml", "--set", "penalty.weight=1e-5"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        for _ in range(4):
            process.stderr.readline()
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=120)
    assert process.returncode in (0, 1, 130)
    assert process.returncode != 130 or "interrupted" in out


def test_help_does_not_import_what_is_slow():
    code = "import sys, relax.cli; print(sorted({'cvxpy', 'matplotlib', 'meshio', 'PIL'} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == "[]\n"


def test_help_names_every_method_back_end_and_penalty(capsys):
    assert run(["solve", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for name in (*METHODS, "auto", *BACKENDS, *PENALTIES):
        assert re.search(rf"[ ,]{name}[ ,.;]", said), name
