import csv
import json
import os
import shutil
from dataclasses import replace

import meshio
import numpy as np
import pytest
from folders import mutations, write_scene

from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.errors import InputError
from relax.files import check_output, load_result, load_scene, write_result
from relax.files.archives import RESULT
from relax.files.meshes import read_mesh
from relax.files.results import OURS
from relax.files.stored import differing

ARRAYS = "target clean_target start rest_length spring_constant loads fixed candidates metric support_weight".split()
TEXT = """noise = { sigma = 0.01, seed = 4 }
diagonals = "none"
[membrane]
loads = [0, 0, -0.01]
[penalty]
weight_fraction = 0.2
"""


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    return solve(Problem(load_scene(write_scene(tmp_path_factory.mktemp("scene"), TEXT))))


@pytest.fixture
def folder(design, tmp_path):
    write_result(tmp_path / "out", design, 0.25, {"picture.png": lambda path: path.write_bytes(b"picture")})
    return tmp_path / "out"


def refusal(function, *arguments):
    with pytest.raises(InputError) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def content(folder):
    return {entry.name: entry.read_bytes() if entry.is_file() else None for entry in folder.iterdir()}


def test_a_folder_gives_the_design_back(design, folder):
    again = load_result(folder).design()
    assert (again.stop, again.iterations, again.factorizations) == (design.stop, design.iterations, design.factorizations)
    assert (again.skipped, again.interrupted, again.seconds) == (design.skipped, design.interrupted, design.seconds)
    assert again.certificate == design.certificate and again.supports == design.supports and str(again) == str(design)
    assert again.trace.notes == design.trace.notes and len(again.trace.notes) > 1
    for name in ("positions", "forces", "objective", "stationarity", "seconds", "unrounded_positions", "unrounded_forces"):
        np.testing.assert_array_equal(getattr(again.trace, name), getattr(design.trace, name))
    (folder / "trace.npz").unlink()
    bare = load_result(folder).design()
    assert bare.certificate == design.certificate and bare.trace.notes == () and bare.trace.positions.shape[0] == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"positions": np.zeros((1, 3, 3))}, "positions has the shape (1, 3, 3), expected (T, V, 3) with V = "),
        ({"seconds": np.zeros(99)}, "seconds has the shape (99,), expected (T,)"),
        ({"notes": np.zeros(0)}, "notes "),
        ({"forces": None}, "it has no array forces"),
    ],
)
def test_a_trace_that_does_not_belong_to_its_result_is_refused(folder, change, said):
    path = folder / "trace.npz"
    with np.load(path) as archive:
        arrays = dict(archive) | change
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    words = refusal(load_result(folder).design)
    assert words.startswith(f"{path}: ") and said in words


@pytest.mark.parametrize("name", ["stop", "iterations", "seconds", "skipped", "interrupted"])
def test_a_run_without_its_figures_is_no_design(folder, name):
    figures = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps(figures | {name: None}))
    assert f"result.json: {name} is missing" in refusal(load_result(folder).design)


def test_a_result_comes_back_as_it_was(design, folder):
    stored = load_result(folder)
    np.testing.assert_array_equal(stored.positions, design.positions)
    np.testing.assert_array_equal(stored.forces, design.forces)
    scene = design.problem.scene
    for name in ARRAYS:
        mine, theirs = getattr(scene, name), getattr(stored.scene, name)
        np.testing.assert_array_equal(theirs, mine)
        assert theirs.dtype == mine.dtype
    np.testing.assert_array_equal(stored.scene.mesh.edges, scene.mesh.edges)
    np.testing.assert_array_equal(stored.scene.mesh.faces, scene.mesh.faces)
    assert stored.scene.settings == design.settings
    assert not stored.positions.flags.writeable


def test_the_judge_says_the_same_from_the_folder_alone(design, folder):
    stored = load_result(folder)
    again = judge(Problem(stored.scene), stored.positions, stored.forces)
    assert again == design.certificate
    assert differing(stored.figures, again.figures()) == []


def test_result_json_holds_what_the_format_asks_for(design, folder):
    said = json.loads((folder / "result.json").read_text())
    assert said["settings"]["penalty"]["weight"] == design.problem.weight > 0
    assert said["settings"]["penalty"]["weight_fraction"] == 0.2
    assert said["settings"]["title"] == "hill" and said["settings"]["target"]["heights"] == "hill.npy"
    assert said["seed"] == 4
    assert set(said["versions"]) == {"python", "relax", "numpy", "scipy", "cvxpy", "clarabel"}
    assert set(said["seconds"]) == {"read", "solve", "write"} and said["seconds"]["read"] == 0.25
    for name, value in design.certificate.figures().items():
        assert said[name] == value
    for name in ("stop", "iterations", "factorizations", "skipped"):
        assert name in said


def test_arrays_are_those_of_the_format(design, folder):
    with np.load(folder / "result.npz", allow_pickle=False) as archive:
        assert set(archive) == set(RESULT)
        assert archive["fixed"].dtype == archive["candidates"].dtype == np.bool_
    with np.load(folder / "trace.npz", allow_pickle=False) as archive:
        steps, vertices = len(design.trace.objective), len(design.positions)
        assert archive["positions"].shape == archive["forces"].shape == (steps, vertices, 3)
        assert archive["objective"].shape == archive["stationarity"].shape == archive["seconds"].shape == (steps,)
        np.testing.assert_array_equal(archive["unrounded_positions"], design.trace.unrounded_positions)
        assert archive["notes"].dtype.kind == "U" and tuple(archive["notes"]) == design.trace.notes


def test_supports_are_listed(design, folder):
    with (folder / "supports.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(design.supports) == design.certificate.supports > 0
    for row, mast in zip(rows, design.supports, strict=True):
        assert int(row["vertex"]) == mast.vertex and row["kind"] == mast.kind
        assert [float(row[f"head_{axis}"]) for axis in "xyz"] == list(mast.head)
        assert [float(row[f"force_{axis}"]) for axis in "xyz"] == list(mast.force)
        assert float(row["magnitude"]) == mast.magnitude and float(row["lean"]) == mast.lean
        assert row["length"] == "" if mast.length is None else float(row["length"]) == mast.length


def test_a_stay_has_neither_foot_nor_length(design, tmp_path):
    forces = np.zeros_like(design.forces)
    forces[24, 0] = 1.0
    write_result(tmp_path / "out", replace(design, forces=forces), 0.0)
    with (tmp_path / "out" / "supports.csv").open(newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["kind"], row["foot_x"], row["foot_z"], row["length"], row["lean"]) == ("stay", "", "", "", "90.0")


def test_the_shape_is_exported_to_the_last_digit(design, folder):
    mesh = design.problem.scene.mesh
    for name in ("membrane.obj", "membrane.vtu"):
        positions, faces = read_mesh(folder / name)
        np.testing.assert_array_equal(positions, design.positions)
        np.testing.assert_array_equal(faces, mesh.faces)
    vtu = meshio.read(folder / "membrane.vtu")
    np.testing.assert_array_equal(vtu.point_data["support_force"], design.forces)
    np.testing.assert_array_equal(vtu.point_data["displacement"], design.positions - design.problem.scene.target)
    tension = dict(zip([block.type for block in vtu.cells], vtu.cell_data["tension"], strict=True))
    np.testing.assert_array_equal(vtu.cells_dict["line"], mesh.edges)
    np.testing.assert_array_equal(tension["line"], design.problem.scene.membrane.tension(design.positions))
    assert np.isnan(tension["quad"]).all()


def test_an_existing_result_is_replaced_and_other_files_are_kept(design, folder):
    (folder / "notes.txt").write_text("mine")
    (folder / "sub").mkdir()
    (folder / "view.html").write_text("old page")
    (folder / "result.npz").write_text("old")
    write_result(folder, design, 0.0)
    assert (folder / "notes.txt").read_text() == "mine" and (folder / "sub").is_dir()
    assert not (folder / "view.html").exists() and not (folder / "picture.png").exists()
    load_result(folder)
    left = set(content(folder)) - set(OURS)
    assert left == {"notes.txt", "sub"}
    assert [entry.name for entry in folder.parent.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_crash_while_drawing_leaves_the_old_result(design, folder, error):
    before = content(folder)

    def fail(path):
        path.write_bytes(b"half")
        raise error

    with pytest.raises(error):
        write_result(folder, design, 9.0, {"picture.png": fail})
    assert content(folder) == before
    with pytest.raises(error):
        write_result(folder.parent / "new", design, 9.0, {"picture.png": fail})
    assert [entry.name for entry in folder.parent.iterdir()] == ["out"]


@pytest.mark.parametrize("count", range(1, 15))
def test_a_crash_while_the_files_change_places_leaves_the_old_result(design, folder, monkeypatch, count):
    before = content(folder)
    real, calls = os.replace, []

    def failing(*arguments):
        calls.append(arguments)
        if len(calls) == count:
            raise OSError("disk gone")
        real(*arguments)

    monkeypatch.setattr(os, "replace", failing)
    try:
        write_result(folder, design, 9.0)
    except OSError:
        assert content(folder) == before
    else:
        assert len(calls) < count


def test_figures_that_are_no_number_become_null(design, tmp_path):
    certificate = replace(design.certificate, stationarity=float("nan"), off_support=None, converged=False)
    write_result(tmp_path / "out", replace(design, certificate=certificate), 0.0)
    said = json.loads((tmp_path / "out" / "result.json").read_text())
    assert said["stationarity"] is None and said["off_support"] is None
    assert load_result(tmp_path / "out").figures["converged"] is False


def test_a_result_whose_settings_lack_a_section_has_its_defaults(folder):
    edit_json(folder, lambda said: said["settings"].pop("solver") and said.update(supports=10**400))
    stored = load_result(folder)
    again = judge(Problem(stored.scene), stored.positions, stored.forces).figures()
    assert differing(stored.figures, again) == ["supports"]


def test_places_that_cannot_hold_a_result(tmp_path, design):
    assert "empty" in refusal(check_output, "") and "empty" in refusal(write_result, "", design)
    (tmp_path / "file").write_text("x")
    assert "file: this is a file, so no result folder" in refusal(check_output, tmp_path / "file")
    assert f"{tmp_path / 'file'} is a file" in refusal(check_output, tmp_path / "file" / "below" / "deeper")
    (tmp_path / "taken" / "picture.png").mkdir(parents=True)
    assert "picture.png is a folder" in refusal(check_output, tmp_path / "taken")
    assert "this is a file" in refusal(write_result, tmp_path / "file", design, 0.0)
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    assert "dangling" in refusal(check_output, tmp_path / "dangling")
    check_output(tmp_path / "a" / "b")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["dangling", "file", "taken"]
    write_result(tmp_path / "a" / "b", design, 0.0)
    load_result(tmp_path / "a" / "b")


def test_a_folder_without_write_permission(tmp_path, monkeypatch):
    # the tests may run as root, who may write anywhere
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "cannot be written to" in refusal(check_output, tmp_path / "a")


def edit_json(folder, change):
    said = json.loads((folder / "result.json").read_text())
    change(said)
    (folder / "result.json").write_text(json.dumps(said))


def edit_arrays(folder, **changes):
    with np.load(folder / "result.npz") as archive:
        arrays = {**archive, **changes}
    np.savez(folder / "result.npz", **{name: array for name, array in arrays.items() if array is not None})


def changed(name, place, value):
    def change(folder):
        with np.load(folder / "result.npz") as archive:
            array = archive[name]
        array[place] = value
        edit_arrays(folder, **{name: array})

    return change


def set_penalty(**changes):
    return lambda folder: edit_json(folder, lambda said: said["settings"]["penalty"].update(changes))


def set_always(*vertices):
    return lambda folder: edit_json(folder, lambda said: said["settings"]["supports"].update(always=list(vertices)))


BROKEN = [
    (shutil.rmtree, "no such folder"),
    (lambda folder: [entry.unlink() for entry in folder.iterdir()], "this folder holds no result"),
    (lambda folder: (folder / "result.npz").unlink(), "result.npz: no such file"),
    (lambda folder: (folder / "result.json").unlink(), "result.json: no such file"),
    (lambda folder: (folder / "result.json").write_text("{"), "result.json: this is not valid JSON"),
    (lambda folder: (folder / "result.json").write_text("[]"), "result.json: it has no settings"),
    (lambda folder: (folder / "result.json").write_text('{"settings": {}, "x": NaN}'), "result.json: it holds NaN"),
    (lambda folder: edit_json(folder, lambda said: said["settings"]["penalty"].update(name="l1")), "settings: penalty.name"),
    (lambda folder: edit_json(folder, lambda said: said["settings"]["supports"].pop("ground")), "supports.ground is missing"),
    (lambda folder: edit_json(folder, lambda said: said.pop("settings")), "it has no settings"),
    (lambda folder: (folder / "result.json").write_text('{"settings": {}, "x": ' + 6000 * "9" + "}"), "this is not valid JSON"),
    (set_penalty(weight=None, weight_fraction=0.1), "result.json: settings: penalty.weight is missing"),
    (set_penalty(weight_fraction="x"), 'settings: penalty.weight_fraction = "x": expected a number'),
    (lambda folder: edit_json(folder, lambda said: said["settings"].pop("penalty")), "settings: penalty.weight is missing"),
    (lambda folder: (folder / "result.npz").write_bytes(b"PK rubbish"), "result.npz: "),
    (lambda folder: edit_arrays(folder, metric=None), "result.npz: it has no array metric"),
    (lambda folder: edit_arrays(folder, forces=np.zeros((3, 3))), "forces has the shape (3, 3), expected (V, 3) with V = 49"),
    (lambda folder: edit_arrays(folder, edges=np.zeros((3,), int)), "edges has the shape (3,), expected (E, 2)"),
    (lambda folder: edit_arrays(folder, fixed=np.zeros(49)), "fixed holds float64, expected bool"),
    (lambda folder: edit_arrays(folder, fixed=np.array([None] * 49)), "fixed: it holds pickled objects"),
    (changed("positions", (3, 1), np.nan), "positions is not finite at index [3, 1]"),
    (changed("edges", (2, 1), 99), "edges: edge 2 names vertex 99; there are vertices 0 to 48"),
    (changed("edges", 2, [5, 4]), "edges: edge 2 is not in the order a < b"),
    (changed("edges", 1, [0, 1]), "edges: an edge is there twice"),
    (changed("faces", (1, 0), -1), "faces: face 1 names vertex -1"),
    (changed("rest_length", 7, 0), "rest_length: entry 7 is 0.0, expected a number above 0"),
    (changed("spring_constant", 0, -1), "spring_constant: entry 0 is -1.0"),
    (changed("support_weight", 8, -1), "support_weight: entry 8 is -1.0"),
    (changed("support_weight", slice(None), 0), "support_weight: entry 8 is 0.0, expected a number above 0 where"),
    (changed("support_weight", 24, 0), "support_weight: entry 24 is 0.0, expected a number above 0 where a support may stand"),
    (set_always(24), "result.npz: support_weight: entry 24 is 1.0, expected 0, as supports.always lists that vertex"),
    (set_always(24, 49), "supports.always in result.json names vertex 49, but there are vertices 0 to 48 here"),
    (set_always(0), "candidates: vertex 0 is none, but supports.always in result.json lists it"),
    (changed("start", (3, 2), -1e200), "start is -1e+200 at index [3, 2], beyond 1e+30"),
    (changed("positions", (0, 0), 1e200), "positions is 1e+200 at index [0, 0], beyond 1e+30"),
    (changed("fixed", slice(None), 1), "fixed: every vertex is fixed"),
    (changed("candidates", 0, 1), "candidates: vertex 0 is fixed"),
]


@pytest.mark.parametrize(("breaking", "sentence"), BROKEN)
def test_broken_results_get_one_sentence_that_starts_with_the_folder(folder, breaking, sentence):
    breaking(folder)
    said = refusal(load_result, folder)
    assert said.startswith(str(folder))
    assert sentence.replace("it is no", "this is no") in said


def test_a_support_that_always_stands_has_no_weight(folder):
    set_always(24)(folder)
    changed("support_weight", 24, 0)(folder)
    stored = load_result(folder)
    assert stored.scene.settings["supports"]["always"] == [24]
    assert np.flatnonzero(stored.scene.support_weight == 0).tolist() == [24]


@pytest.mark.parametrize("name", ["result.json", "result.npz"])
def test_damaged_results_end_in_a_result_or_one_sentence(folder, name):
    for mutant in mutations((folder / name).read_bytes(), 150, seed=5):
        (folder / name).write_bytes(mutant)
        try:
            load_result(folder)
        except InputError as error:
            assert "\n" not in str(error)


def test_an_edited_figure_or_array_is_found_out(folder):
    figures = load_result(folder).figures
    for name in ("objective", "rms_distance", "supports", "tension_max", "off_support"):
        said = dict(figures) | {name: 1.001 * figures[name]}
        stored = load_result(folder)
        again = judge(Problem(stored.scene), stored.positions, stored.forces).figures()
        assert differing(said, again) == [name]
    assert differing(dict(figures) | {"stable": False}, again) == ["stable"]
    assert differing(dict(figures) | {"stable": 1}, again) == ["stable"]
    assert differing(dict(figures) | {"off_support": None}, again) == ["off_support"]
    assert differing({"settings": figures["settings"]}, again) == list(again)
