"""Every reader on hostile files: one sentence each, in little time and memory; `experiments/fuzz.py` runs the same for longer."""

import os
from collections import Counter

import pytest
from folders import refused, write_scene
from hostile import Case, mutants, read_all, result_traps, seeds, traps

from relax.cli import run
from relax.files import load_result, load_scene
from relax.files.heights import read_heights
from relax.files.meshes import read_mesh
from relax.files.schema import HEIGHT_SUFFIXES, MESH_SUFFIXES

EACH = 30  # mutants of each seed; experiments/fuzz.py makes thousands
HARMLESS = {"a bomb in few pixels"}  # a picture of 4 x 4 pixels whatever else lies behind them


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    scene = write_scene(folder, "[penalty]\nweight = 0.02\n")
    assert run(["solve", str(scene), "-o", str(folder / "result"), "--quiet"]) == 0
    return folder / "result"


def test_every_trap_is_refused_in_one_sentence_in_little_time_and_memory(tmp_path, result):
    cases = [*traps(), *result_traps()]
    answers = read_all(cases, tmp_path, result)
    assert len(answers) == len(cases)
    assert not [answer for answer in answers if answer.outcome != "refused" and answer.how not in HARMLESS]


def test_mutants_of_every_format_are_read_or_refused(tmp_path, result):
    sound = seeds(tmp_path, result)
    cases = [case for index, seed in enumerate(sound) for case in (seed, *mutants(seed, EACH, index))]
    answers = read_all(cases, tmp_path, result)
    assert len(answers) == len(cases)
    assert not [answer for answer in answers if answer.outcome not in ("read", "refused")]
    assert all(answer.outcome == "read" for answer in answers if answer.how == "seed")
    # mutants that are all refused, or all read, would try nothing
    counted = Counter(answer.outcome for answer in answers)
    assert min(counted["read"], counted["refused"]) > len(sound)


def test_the_watch_finds_what_goes_wrong(tmp_path, monkeypatch):
    """A fault of each kind, planted in a reader, is seen by the process that reads."""
    (tmp_path / "sitecustomize.py").write_text("""
import relax.files.meshes as meshes, time, numpy
def read(path):
    word = path.read_bytes()
    if word == b"crash": raise KeyError("x")
    if word == b"hang": time.sleep(60)
    if word == b"memory": numpy.zeros(100_000_000)
    if word == b"noise": raise meshes.InputError("two lines, of which\\nthis is the second")
    if word == b"end": import os; os._exit(3)
meshes.read_mesh = read
""")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    faults = ["crash", "hang", "memory", "noise", "end"]
    cases = [Case("mesh", "obj", ".obj", word, word.encode()) for word in faults]
    found = {answer.how: answer.outcome for answer in read_all(cases, tmp_path, seconds=0.2)}
    assert found == {"crash": "crash", "hang": "hang", "memory": "memory", "noise": "noise", "end": "crash"}


READERS = [
    *((read_mesh, f"a{suffix}") for suffix in MESH_SUFFIXES),
    *((read_heights, f"a{suffix}") for suffix in HEIGHT_SUFFIXES),
    (load_scene, "a.toml"),
]


@pytest.mark.parametrize(("read", "name"), READERS, ids=lambda value: value if isinstance(value, str) else "")
def test_what_is_no_file_is_refused(tmp_path, read, name):
    path = tmp_path / name
    assert "no such file" in refused(lambda: read(path))
    path.mkdir()
    assert "this is a folder" in refused(lambda: read(path))
    path.rmdir()
    path.symlink_to(path)
    refused(lambda: read(path))
    path.unlink()
    os.mkfifo(path)  # a reader that opens it waits for ever
    assert "this is a device" in refused(lambda: read(path))


@pytest.mark.parametrize("name", ["result.json", "result.npz"])
def test_a_result_whose_files_are_none_is_refused(tmp_path, result, name):
    for other in ("result.json", "result.npz"):
        (tmp_path / other).write_bytes((result / other).read_bytes())
    (tmp_path / name).unlink()
    (tmp_path / name).mkdir()
    assert "this is a folder" in refused(lambda: load_result(tmp_path))
    (tmp_path / name).rmdir()
    os.mkfifo(tmp_path / name)
    assert "this is a device" in refused(lambda: load_result(tmp_path))
    scene = write_scene(tmp_path, f'[solver]\nstart = "{tmp_path}"\n')
    if name == "result.json":
        assert "no result folder either" in refused(lambda: load_scene(scene))
