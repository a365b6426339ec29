"""Sweeps lose and repeat nothing when their workers or their runner are killed, and give the same rows wherever they run."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import recovered
import rows_file
import sweep_runner
import sweeps
from recovery import all_cases
from sweep_runner import COLUMNS, cases, measure

RUNNER = Path(sweep_runner.__file__)
ONE = sweeps.Processes()
PLACE = {"seconds", "machine", "process"}  # what may differ from run to run
# two threads are asked for, so that one is the sweep's doing
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
ENVIRONMENT |= {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}  # Dask's own retries, 3, would hide ours


def read(path):
    with path.open(newline="") as handle:
        return list(csv.DictReader(handle))


def figures(rows):
    return [{name: text for name, text in row.items() if name not in PLACE} for row in rows]


def run(output, *options):
    return [sys.executable, str(RUNNER), str(output), *options]


def whole(rows, count=12):
    """Whether each case is there once, in whatever order."""
    return sorted(int(row["seed"]) for row in rows) == list(range(count))


def test_rows_come_in_the_order_of_the_cases_with_versions_seed_and_machine(tmp_path):
    output = tmp_path / "new" / "runs.csv"
    rows = sweeps.sweep(measure, COLUMNS, cases(tmp_path), output, ONE)
    assert rows == read(output) and whole(rows)
    assert [row["seed"] for row in rows] == [str(seed) for seed in range(12)]
    said = ("python", "numpy", "relax-tensile", "relax", "code", "machine", "seconds")
    assert all(row[name] for row in rows for name in said)
    assert float(rows[3]["value"]) == measure(cases(tmp_path)[3])["value"]  # to the last digit
    half = tmp_path / "half.csv"
    sweeps.sweep(measure, COLUMNS, cases(tmp_path)[6:], half, ONE)
    assert figures(sweeps.sweep(measure, COLUMNS, cases(tmp_path), half, ONE)) == figures(rows)
    assert [row["seed"] for row in read(half)] == [str(seed) for seed in (*range(6, 12), *range(6))]
    backwards = sweeps.sweep(measure, COLUMNS, cases(tmp_path)[::-1], output, ONE)
    assert backwards == rows[::-1] == read(output)[::-1]  # nothing was measured again


def test_an_exception_is_a_row_and_not_the_end(tmp_path):
    rows = sweeps.sweep(measure, COLUMNS, cases(tmp_path, case4="raise"), tmp_path / "runs.csv", ONE)
    assert whole(rows)
    assert [row["error"] for row in rows if row["error"]] == ["ArithmeticError: no figure for this one"]
    assert rows[4]["value"] == ""
    short = sweeps.sweep(measure, COLUMNS[:2], cases(tmp_path, 1), tmp_path / "other.csv", ONE)
    assert short[0]["error"] == "measure gives ['process', 'threads', 'value'], expected ['threads', 'value']"


def test_a_torn_line_is_cut_off_and_its_case_run_again(tmp_path):
    output = tmp_path / "runs.csv"
    sweeps.sweep(measure, COLUMNS, cases(tmp_path), output, ONE)
    text = output.read_bytes()
    lines = text.splitlines(keepends=True)
    for torn in (b"".join(lines[:7]) + lines[7][:-20], b"".join(lines[:7]), lines[0][:10], b""):
        output.write_bytes(torn)
        rows = sweeps.sweep(measure, COLUMNS, cases(tmp_path), output, ONE)
        kept = torn[: torn.rfind(b"\n") + 1]
        assert output.read_bytes().startswith(kept) and whole(read(output)) and whole(rows)


def test_rows_of_other_versions_stay_and_do_not_count(tmp_path, monkeypatch):
    output = tmp_path / "runs.csv"
    sweeps.sweep(measure, COLUMNS, cases(tmp_path, 3), output, ONE)
    before = output.read_bytes()
    now = {**sweeps.versions(), "relax": "another"}
    monkeypatch.setattr(sweeps, "versions", lambda: now)
    rows = sweeps.sweep(measure, COLUMNS, cases(tmp_path, 3), output, ONE)
    assert output.read_bytes().startswith(before) and len(read(output)) == 6
    assert [row["relax"] for row in rows] == ["another"] * 3


def test_what_an_experiment_says_is_not_what_it_does(tmp_path, monkeypatch):
    text = '"""{0}"""\nfrom beside import two\n\n\ndef measure(case):\n    """{0}"""\n    return {1}  # {0}\n'
    beside = tmp_path / "beside.py"
    (tmp_path / "said.py").write_text(text.format("a question", "two"))
    beside.write_text("two = 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    import said

    before = sweeps.code_of(said.measure)
    (tmp_path / "said.py").write_text(text.format("a question and its finding", "two"))
    assert sweeps.code_of(said.measure) == before
    (tmp_path / "said.py").write_text(text.format("a question", "two + 1"))
    assert sweeps.code_of(said.measure) != before
    (tmp_path / "said.py").write_text(text.format("a question", "two"))
    beside.write_text("two = 3\n")
    assert sweeps.code_of(said.measure) != before


def test_a_measure_that_is_in_no_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.delattr(sweep_runner, "__file__")
    with pytest.raises(rows_file.SweepError, match="put it into a module"):
        sweeps.sweep(measure, COLUMNS, cases(tmp_path), tmp_path / "runs.csv", ONE)


def test_two_runners_cannot_write_one_file(tmp_path):
    header = ["key"]
    with (
        rows_file.RowsFile(tmp_path / "runs.csv", header),
        pytest.raises(rows_file.SweepError, match="another sweep is writing it"),
        rows_file.RowsFile(tmp_path / "runs.csv", header),
    ):
        pass


def test_cases_and_files_that_do_not_fit_are_refused(tmp_path):
    output = tmp_path / "runs.csv"
    for wrong in ([], cases(tmp_path, 2) + cases(tmp_path, 1), [{"no": 1}], [{"seed": 1}, {"seed": 2, "more": 1}]):
        with pytest.raises(rows_file.SweepError, match="two alike"):
            sweeps.sweep(measure, COLUMNS, wrong, output, ONE)
    sweeps.sweep(measure, COLUMNS, cases(tmp_path, 2), output, ONE)
    with pytest.raises(rows_file.SweepError, match="its columns are not those of this sweep"):
        sweeps.sweep(measure, COLUMNS[:1], cases(tmp_path, 2), output, ONE)
    lines = output.read_text().splitlines(keepends=True)
    output.write_text(lines[0] + "cut out\n" + lines[1])
    with pytest.raises(rows_file.SweepError, match="line 2 has 1 fields"):
        sweeps.sweep(measure, COLUMNS, cases(tmp_path, 2), output, ONE)


def test_a_cluster_that_is_not_there_is_said(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="sweeps on a cluster run on Dask: pip install distributed")
    monkeypatch.setattr(sweeps, "PATIENCE", 0.2)
    with pytest.raises(rows_file.SweepError, match="no scheduler answers"):
        sweeps.sweep(measure, COLUMNS, cases(tmp_path), tmp_path / "runs.csv", sweeps.Cluster("tcp://127.0.0.1:1"))


@pytest.mark.slow
def test_killed_workers_cost_no_row_and_a_case_that_kills_them_all_says_so(tmp_path):
    pytest.importorskip("joblib", reason="sweeps on several processes run on joblib: pip install joblib")
    output = tmp_path / "runs.csv"
    command = run(output, "--jobs", "2", "--does", "case3", "die once", "--does", "case6", "die")
    subprocess.run(command, env=ENVIRONMENT, check=True, timeout=120)
    rows = read(output)
    assert whole(rows)
    assert [(row["seed"], row["error"][:30]) for row in rows if row["error"]] == [("6", "3 times its worker died over t")]
    alone = sweeps.sweep(measure, COLUMNS, cases(tmp_path), tmp_path / "alone.csv", ONE)
    assert {row["seed"]: row["value"] for row in rows} == {row["seed"]: row["value"] * (row["seed"] != "6") for row in alone}
    assert {row["threads"] for row in rows if not row["error"]} == {"1"}


@pytest.mark.slow
def test_a_killed_runner_goes_on_where_it_stopped(tmp_path):
    pytest.importorskip("joblib", reason="sweeps on several processes run on joblib: pip install joblib")
    output = tmp_path / "runs.csv"
    command = run(output, "--jobs", "2", "--seconds", "0.2")
    runner = subprocess.Popen(command, env=ENVIRONMENT, start_new_session=True)
    wait(lambda: output.exists() and output.read_bytes().count(b"\n") >= 4)
    os.kill(runner.pid, signal.SIGKILL)
    runner.wait()
    before = output.read_bytes()
    assert 3 <= before.count(b"\n") - 1 < 12
    done = subprocess.run(command, env=ENVIRONMENT, check=False, timeout=120)
    end_group(runner.pid)  # workers of the first outlive it for a while
    after = output.read_bytes()
    assert done.returncode == 0 and after.startswith(before[: before.rfind(b"\n") + 1]) and whole(read(output))
    again = subprocess.run(command, env=ENVIRONMENT, check=False, timeout=120)
    assert again.returncode == 0 and output.read_bytes() == after


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a scheduler with two workers, each started in a folder of its own as a user would start it."""
    pytest.importorskip("distributed", reason="sweeps on a cluster run on Dask: pip install distributed")
    folder = tmp_path_factory.mktemp("cluster")
    dask = [sys.executable, "-m", "dask"]
    about = folder / "scheduler.json"
    started = []

    def start(name, *command):
        (folder / name).mkdir()
        options = {"cwd": folder / name, "env": ENVIRONMENT, "start_new_session": True}
        with (folder / f"{name}.log").open("wb") as log:
            started.append(subprocess.Popen([*dask, *command], stdout=log, stderr=log, **options))

    start("scheduler", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(about))
    try:
        wait(lambda: about.exists() and about.read_text().strip().endswith("}"))
        address = json.loads(about.read_text())["address"]
        for name in ("one", "two"):
            start(name, "worker", address, "--no-dashboard")
        yield address
    finally:
        for process in started[::-1]:
            end_group(process.pid)
            process.wait()


@pytest.mark.slow
def test_one_process_two_and_a_cluster_give_the_same_rows(tmp_path, cluster):
    asked = [case for case in all_cases("small") if case["method"] == "sequential"][:6]
    rows = [
        sweeps.sweep(recovered.measure, recovered.COLUMNS, asked, tmp_path / f"{number}.csv", where)
        for number, where in enumerate((ONE, sweeps.Processes(2), sweeps.Cluster(cluster)))
    ]
    assert not any(row["error"] for row in rows[0]) and {row["converged"] for row in rows[0]} == {"True"}
    assert figures(rows[0]) == figures(rows[1]) == figures(rows[2])


@pytest.mark.slow
def test_killed_workers_of_a_cluster_cost_no_row(tmp_path, cluster):
    output = tmp_path / "runs.csv"
    command = run(output, "--scheduler", cluster, "--does", "case3", "die once", "--does", "case5", "raise")
    subprocess.run(command, env=ENVIRONMENT, check=True, timeout=120)  # a script of its own: what it measures with is in __main__
    asked = cases(tmp_path, case3="die once", case5="raise")
    rows = sweeps.sweep(measure, COLUMNS, asked, output, ONE)
    assert (tmp_path / "3 was here").exists() and whole(read(output)) and whole(rows)
    assert [row["seed"] for row in rows if row["error"]] == ["5"]
    assert {row["threads"] for row in rows if not row["error"]} == {"1"}
    alone = sweeps.sweep(measure, COLUMNS, asked, tmp_path / "alone.csv", ONE)
    assert figures(rows) == figures(alone)


def wait(ready, seconds=60):
    """Until it is so."""
    end = time.monotonic() + seconds
    while not ready():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def end_group(leader):
    """End the processes of a session that a test started."""
    try:
        os.killpg(leader, signal.SIGKILL)
    except ProcessLookupError:
        pass
