import numpy as np
import pytest
from folders import bump, mutations, write_scene

from relax.errors import InputError
from relax.files.scenes import load_scene, start_folder

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.4 0.3\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
FLAT = SQUARE.replace("0.5 0.4 0.3", "0.45 0.4 0")


def mesh_scene(tmp_path, text="", obj=SQUARE):
    (tmp_path / "tent.obj").write_text(obj)
    path = tmp_path / "tent.toml"
    path.write_text(f'[target]\nmesh = "tent.obj"\n{text}')
    return path


def refusal(path, overrides=()):
    with pytest.raises(InputError) as caught:
        load_scene(path, overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_height_field_becomes_a_grid(tmp_path):
    heights = np.arange(12.0).reshape(3, 4) ** 2
    np.save(tmp_path / "h.npy", heights)
    path = tmp_path / "s.toml"
    path.write_text(
        'title = "T"\n[target]\nheights = "h.npy"\nspacing = [0.5, 2]\nheight_scale = 0.1\n[membrane]\nrest_scale = 0.5\n'
        '[supports]\nfixed = "corners"'
    )
    scene = load_scene(path)
    for vertex in range(12):
        row, column = divmod(vertex, 4)
        np.testing.assert_allclose(scene.clean_target[vertex], [0.5 * column, 2 * row, 0.1 * heights[row, column]])
    np.testing.assert_array_equal(scene.clean_target, scene.target)
    assert scene.title == "T" and scene.ground == 0.0
    assert scene.settings["target"]["heights"] == "h.npy" and scene.settings["target"]["spacing"] == [0.5, 2.0]
    assert scene.settings["supports"]["ground"] == 0.0
    edges = {tuple(edge) for edge in scene.mesh.edges.tolist()}
    assert (0, 5) in edges and (1, 4) not in edges and (2, 5) in edges


def test_an_esri_grid_needs_no_spacing_and_may_have_one(tmp_path):
    (tmp_path / "h.asc").write_text("ncols 3\nnrows 3\nxllcorner 0\nyllcorner 0\ncellsize 2\n0 0 0\n0 1 0\n0 0 5\n")
    path = tmp_path / "s.toml"
    path.write_text('[target]\nheights = "h.asc"')
    scene = load_scene(path)
    np.testing.assert_allclose(scene.clean_target[2], [4, 0, 5])  # the last line of the file is the southern edge, y = 0
    assert scene.settings["target"]["spacing"] == [2.0, 2.0]
    assert load_scene(path, {"target.spacing": [1, 1]}).settings["target"]["spacing"] == [1.0, 1.0]


def test_a_mesh_keeps_its_numbering_and_the_title_is_the_file(tmp_path):
    scene = load_scene(mesh_scene(tmp_path))
    np.testing.assert_array_equal(scene.clean_target[4], [0.5, 0.4, 0.3])
    np.testing.assert_array_equal(scene.fixed, [True, True, True, True, False])
    assert scene.title == "tent" and scene.ground == 0.0
    assert scene.settings["target"]["diagonals"] is None


def test_ground_is_the_lowest_point_of_the_clean_target(tmp_path):
    path = mesh_scene(tmp_path, "noise = { sigma = 5.0, seed = 1 }", SQUARE.replace("v 0 0 0", "v 0 0 -2"))
    scene = load_scene(path)
    assert scene.ground == -2.0
    assert load_scene(path, ["supports.ground=-7"]).ground == -7.0
    noise = np.random.default_rng(1).normal(0, 5.0, (1, 3))
    np.testing.assert_allclose(scene.target[4], [0.5, 0.4, 0.3] + noise[0])


def test_a_rest_mesh_is_read_beside_the_scene(tmp_path):
    (tmp_path / "flat.obj").write_text(FLAT)
    scene = load_scene(mesh_scene(tmp_path, '[membrane]\nrest = "flat.obj"\nrest_scale = 1.0'))
    edge = scene.mesh.edges.tolist().index([0, 4])
    assert scene.rest_length[edge] == pytest.approx(np.hypot(0.45, 0.4))
    assert scene.settings["membrane"]["rest"] == "flat.obj"


def test_paths_are_relative_to_the_scene_whatever_the_current_folder(tmp_path, monkeypatch):
    folder = tmp_path / "deep"
    folder.mkdir()
    write_scene(folder)
    monkeypatch.chdir(tmp_path)
    scene = load_scene("deep/hill.toml")
    np.testing.assert_array_equal(scene.clean_target[:, 2], bump().ravel())
    assert refusal("deep/hill.toml", ["membrane.stiffness=0"]).startswith("deep/hill.toml: membrane.stiffness = 0: ")


def test_overrides_as_text_and_as_values_agree(tmp_path):
    path = write_scene(tmp_path, "[penalty]\nweight = 0.5")
    text = load_scene(path, ["penalty.weight = 0.25", 'title="x"', "target.noise={sigma=0.1, seed=2}"])
    values = load_scene(path, {"penalty.weight": 0.25, "title": "x", "target.noise": {"sigma": 0.1, "seed": 2}})
    assert text.settings == values.settings
    assert text.settings["penalty"]["weight"] == 0.25
    assert load_scene(path, ["target.noise.sigma=0.3"]).settings["target"]["noise"] == {"sigma": 0.3, "seed": 0}


def test_an_override_replaces_what_would_contradict_it(tmp_path):
    path = write_scene(tmp_path, '[penalty]\nname = "power"\nweight_fraction = 0.1\nexponent = 0.7\nsmoothing = 1e-5')
    penalty = load_scene(path, ["penalty.weight=0.25"]).settings["penalty"]
    assert (penalty["weight"], penalty["weight_fraction"], penalty["exponent"]) == (0.25, None, 0.7)
    penalty = load_scene(path, ['penalty.name="group-lasso"']).settings["penalty"]
    assert (penalty["weight_fraction"], penalty["exponent"], penalty["smoothing"]) == (0.1, None, None)
    (tmp_path / "tent.obj").write_text(SQUARE)
    target = load_scene(path, ['target.mesh="tent.obj"']).settings["target"]
    assert (target["mesh"], target["heights"], target["spacing"]) == ("tent.obj", None, None)
    assert "both weight and weight_fraction" in refusal(path, ["penalty.weight=1", "penalty.weight_fraction=0.5"])
    assert "penalty.exponent" in refusal(path, ['penalty.name="group-lasso"', "penalty.exponent=0.5"])


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("penalty.weight", "--set penalty.weight: expected section.key=VALUE"),
        ("=3", "--set =3: expected section.key=VALUE"),
        (
            "penalty.name=power",
            "--set penalty.name=power: power is not a TOML value; text needs quotes: --set 'penalty.name=\"...\"'",
        ),
        ("penalty.weight=", "--set penalty.weight=: nothing is not a TOML value"),
        ("penalty.weight=1\ntitle=2", "is not a TOML value"),
        ("penalty.weight.x=1", "penalty.weight: weight = 0.5 is no section"),
        ("penalti.weight=1", 'penalti: unknown section; perhaps "penalty" is meant'),
        ("penalty=1", "penalty = 1: expected a section"),
        ("penalty.weight=nan", "penalty.weight = nan: expected a number above 0"),
    ],
)
def test_bad_overrides(tmp_path, override, sentence):
    path = write_scene(tmp_path, "[penalty]\nweight = 0.5")
    with pytest.raises(InputError) as caught:
        load_scene(path, [override])
    assert sentence.split(":")[-1].strip() in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x = oops\n", "this is not valid TOML: invalid value (at line 4, column 5); mend"),
        ("[target]", "this is not valid TOML: cannot declare"),
        ("x = " + "[" * 5000, "this is not valid TOML"),
        ("[membrane]\nstiffness = 0", "membrane.stiffness = 0: expected a number above 0"),
        ("[membrane]\nstiffness = -2", "membrane.stiffness = -2"),
        ("[membrane]\nrest_scale = 1.5", "membrane.rest_scale: every edge is slack"),
        ('[membrane]\nrest = "nope.obj"', 'membrane.rest = "nope.obj": no such file'),
        (
            '[supports]\nfixed = "none"\nmax_force = 1.0',
            "supports.max_force: the part of the membrane that holds vertex 0",
        ),
        ("[supports]\nfixed = [99]", "supports.fixed: vertex 99 does not exist; the target has vertices 0 to 48"),
        ("[supports]\ncandidates = [0]", "supports.candidates: vertex 0 is fixed"),
        ("[supports]\nnever = [49]", "supports.never: vertex 49 does not exist"),
        ('[solver]\nstart = "tent-result"', 'solver.start = "tent-result": this is neither "auto", "target" nor "heavy"'),
        ("height_scale = 1e29", "farther than 1e+30"),
    ],
)
def test_bad_scenes_get_one_sentence_that_starts_with_the_file(tmp_path, text, sentence):
    path = write_scene(tmp_path, text)
    if "height_scale" in text:
        np.save(tmp_path / "hill.npy", 1e9 * bump())
    said = refusal(path)
    assert said.startswith(f"{path}: ")
    assert sentence in said


@pytest.mark.parametrize(
    ("obj", "sentence"),
    [
        (SQUARE.replace("0.3", "nan"), 'target.mesh = "tent.obj": vertex 4 is at [0.5, 0.4, nan]'),
        (SQUARE.replace("f 4 1 5", "f 4 1 6"), "face 3 names vertex 5, but the mesh has vertices 0 to 4"),
        (SQUARE + "v 3 3 3\n", "vertex 5 belongs to no face"),
        (SQUARE.replace("f 4 1 5", "f 4 4 5"), "face 3 names a vertex twice"),
        (SQUARE.replace("0.5 0.4", "0 0"), "membrane.rest: edge 2 (vertices 0 and 4) has a rest length of zero"),
    ],
)
def test_bad_meshes_get_one_sentence_that_starts_with_the_file(tmp_path, obj, sentence):
    path = mesh_scene(tmp_path, "", obj)
    said = refusal(path)
    assert said.startswith(f"{path}: ")
    assert sentence in said


def test_missing_files_and_text_that_is_none(tmp_path):
    assert refusal(tmp_path / "a.toml") == f"{tmp_path / 'a.toml'}: no such file: check the path"
    assert "this is a folder" in refusal(tmp_path)
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    assert "byte 0 is no text" in refusal(tmp_path / "a.toml")
    (tmp_path / "a.toml").write_text('[target]\nmesh = "gone.obj"')
    assert 'target.mesh = "gone.obj": no such file' in refusal(tmp_path / "a.toml")
    (tmp_path / "flat.obj").write_text(FLAT + "v 2 2 2\nf 1 2 6\n")
    assert "membrane.rest: flat.obj has 6 vertices, the target 5" in refusal(
        mesh_scene(tmp_path, '[membrane]\nrest = "flat.obj"')
    )


def test_the_start_folder_is_relative_to_the_scene(tmp_path):
    path = write_scene(tmp_path, '[solver]\nstart = "old"')
    (tmp_path / "old").mkdir()
    assert "no result folder" in refusal(path)
    (tmp_path / "old" / "result.json").write_text("{}")
    assert start_folder(path, load_scene(path)) == tmp_path / "old"
    assert start_folder(path, load_scene(path, ['solver.start="heavy"'])) is None


def test_slack_edges_are_a_warning_where_the_run_can_go_on(tmp_path):
    scene = load_scene(write_scene(tmp_path, "[membrane]\nrest_scale = 1.1"))
    assert "of the edges are slack" in scene.warnings[0]


def test_damaged_scene_files_end_in_a_scene_or_one_sentence(tmp_path):
    text = "[penalty]\nweight = 0.5\n[supports]\nfixed = [0, 6, 42, 48]\n[membrane]\nloads = [0.0, 0.0, -0.1]\n"
    path = write_scene(tmp_path, text)
    for mutant in mutations(path.read_bytes(), 200, seed=1):
        path.write_bytes(mutant)
        try:
            load_scene(path)
        except InputError as error:
            assert "\n" not in str(error)
