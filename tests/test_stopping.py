"""A run that is broken off, by Ctrl-C in a process of its own or by a callback, keeps the best so far and says who ended it."""

import csv
import json
import signal
import subprocess
import sys

import numpy as np
import pytest
import zoo
from folders import bump, write_scene

import relax
from relax import screen
from relax.cli import run
from relax.design.methods import METHODS, method_by_name
from relax.files import load_result
from relax.iterate import Stop


def stopping(step):
    """A callback that stops the run at a step, and the objectives that it heard."""
    heard = []

    def callback(record):
        heard.append(record["objective"])
        if record["step"] == step:
            raise relax.StopRun

    return callback, heard


@pytest.mark.parametrize("name", METHODS)
def test_a_callback_stops_every_method_and_the_best_so_far_is_returned(name):
    scene = zoo.force_density_net(6) if name == "exact" else zoo.planted(9, zoo.TWO_MASTS, 0.01).scene
    problem = relax.Problem(scene, weight=0.02)
    step = 0 if name == "exact" else 2  # the tree tells its answer alone
    callback, heard = stopping(step)
    design = relax.solve(problem, method=method_by_name(name), callback=callback)
    assert len(heard) == step + 1 and design.interrupted and design.stop == Stop.STOPPED.value
    assert design.certificate.objective == pytest.approx(min(heard), rel=1e-9)
    assert design.certificate.equilibrium < 1e-8


def test_a_stop_in_a_part_keeps_the_others_at_rest():
    edge = [v for v in range(81) if v % 9 in (0, 4, 8) or v // 9 in (0, 8)]
    two = zoo.grid_scene(9, lambda x, y: zoo.hill(2 * x % 1, y), supports__fixed=edge)
    callback, heard = stopping(1)
    design = relax.solve(relax.Problem(two, weight=0.02), callback=callback)
    assert len(two.parts) == 2 and len(heard) == 2
    assert design.interrupted and design.stop == Stop.STOPPED.value and design.certificate.equilibrium < 1e-8


def test_a_stopped_path_and_comparison_end_there():
    problem = relax.Problem(zoo.grid_scene(7, zoo.hill), weight=0.02)
    designs = list(relax.path(problem, callback=stopping(1)[0]))
    assert len(designs) == 1 and designs[0].interrupted and designs[0].stop == Stop.STOPPED.value
    rows = list(relax.compare(problem, callback=stopping(1)[0]))
    assert len(rows) == 1 and rows[0].interrupted


def test_a_shape_that_is_found_cannot_be_stopped_any_more():
    planted = zoo.planted(7)
    found = relax.form(relax.Problem(planted.scene, weight=1.0), planted.forces, callback=stopping(0)[0])
    assert not found.interrupted and found.certificate.equilibrium < 1e-8


def test_a_stopped_explanation_has_the_supports_that_were_looked_at():
    problem = relax.Problem(zoo.planted(9, zoo.TWO_MASTS).scene, weight=0.001)
    design = relax.solve(problem)
    whole = relax.explain(problem, design.positions, design.forces)
    assert len(whole.supports) == 2 and not whole.interrupted

    def stop(record):
        assert record == {"done": 1, "total": 2}
        raise relax.StopRun

    part = relax.explain(problem, design.positions, design.forces, callback=stop)
    assert part.interrupted and len(part.supports) == 1 and part.supports[0].share is None
    assert part.supports[0].loss_objective == whole.supports[0].loss_objective


# --- Ctrl-C, sent to a process ---


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """A scene of 11 x 11 vertices whose commands take seconds, and a result of some supports."""
    folder = tmp_path_factory.mktemp("large")
    write_scene(folder, "[penalty]\nweight = 0.002\n")
    np.save(folder / "hill.npy", bump(11))
    assert run(["solve", str(folder / "hill.toml"), "-o", str(folder / "result"), "--quiet"]) in (0, 1)
    return folder


def interrupted(folder, arguments, lines):
    """Status and stderr of a command that gets SIGINT once it has said `lines` lines."""
    command = [sys.executable, "-m", "relax", *arguments]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        said = [process.stderr.readline() for _ in range(lines)]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert "Traceback" not in err
    return process.returncode, out, "".join(said) + err


@pytest.mark.parametrize("command", ["path", "compare"])
def test_ctrl_c_writes_the_rows_there_are(large, command):
    status, out, err = interrupted(large, [command, "hill.toml"], 2)
    assert status == 130, err
    rows = json.loads((large / f"hill-{command}" / f"{command}.json").read_text())
    with (large / f"hill-{command}" / f"{command}.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == len(rows)
    assert 2 <= len(rows) < 15 and out.count("\n|") == len(rows) + 1
    if command == "path":
        load_result(large / "hill-path" / "best")


def test_ctrl_c_in_an_explanation_prints_what_was_looked_at(large, capfd, monkeypatch):
    real, taken = relax.design.explain._without, []

    def without(*arguments):
        taken.append(1)
        if len(taken) == 3:
            signal.raise_signal(signal.SIGINT)
        return real(*arguments)

    monkeypatch.setattr("relax.design.explain._without", without)
    assert run(["explain", str(large / "result"), "-o", str(large / "why")]) == 130
    assert capfd.readouterr().out.count("\n|") == 1 + 2
    assert len(json.loads((large / "why" / "explain.json").read_text())) == 2


def test_ctrl_c_in_form_writes_nothing(large, capfd, monkeypatch):
    monkeypatch.setattr("relax.design.form.Outcome", lambda *_: signal.raise_signal(signal.SIGINT))
    assert run(["form", str(large / "result"), "-o", str(large / "formed")]) == 130
    assert capfd.readouterr().err.strip() == "relax: interrupted: nothing was written" and not (large / "formed").exists()


# --- how long it still takes ---


def test_the_time_left_is_the_pace_of_the_latest_parts_times_what_is_left(monkeypatch):
    clock, said = [0.0], []
    monkeypatch.setattr(screen.time, "perf_counter", lambda: clock[0])
    work = screen.Work("run", 10, said.append)
    for pause in (1.0, 1.0, 4.0, 4.0, 4.0, 4.0):
        clock[0] += pause
        work.done("x")
    assert said == [
        "run 1 of 10: x",  # one part is no pace
        "run 2 of 10, about 8 s left: x",
        "run 3 of 10, about 14 s left: x",
        "run 4 of 10, about 15 s left: x",
        "run 5 of 10, about 16 s left: x",
        "run 6 of 10, about 16 s left: x",
    ]
    work.done("", parts=4)
    assert len(said) == 6 and work.left() == ""
    slow = screen.Work("weight", 100, said.append, "at most")
    for _ in range(2):
        clock[0] += 60
        slow.done("y")
    assert said[-1] == "weight 2 of at most 100, about 98 min left: y"


def test_a_pipe_hears_of_parts_without_words_now_and_then(monkeypatch):
    clock, said = [0.0], []
    monkeypatch.setattr(screen.time, "perf_counter", lambda: clock[0])
    work = screen.Work("support", 100, said.append)
    for _ in range(100):
        clock[0] += 0.1
        work.done("")
    assert 8 <= len(said) <= 10
