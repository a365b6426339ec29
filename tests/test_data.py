"""The files of data/ are what their generator makes, and the planted shapes are what they claim to be."""

import csv
import runpy
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import relax
from relax.arrays import Floats
from relax.files import load_scene
from relax.files.meshes import read_mesh
from relax.membrane.scene import Scene

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "data"
SCENES = ("tent", "tent-noisy", "bumps", "pavilion", "five-masts", "scalloped", "sail", "terrain")
PLANTED = ("tent", "five-masts", "scalloped", "sail")


@pytest.fixture(scope="module")
def generator() -> dict:
    return runpy.run_path(str(ROOT / "experiments" / "make_data.py"))


@pytest.fixture(scope="module")
def made(generator, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    generator["make_data"](folder)
    return folder


def words(path: Path) -> list[str]:
    if path.suffix == ".npy":
        return [repr(number) for number in np.load(path).ravel().tolist()]
    return path.read_text(encoding="ascii").replace(",", " ").split()


def differences(one: Path, other: Path) -> list[tuple[str, str]]:
    """Words of two files that differ by more than 1e-12, as numbers where they are numbers."""
    pairs = list(zip(words(one), words(other), strict=True))

    def same(a: str, b: str) -> bool:
        try:
            return abs(float(a) - float(b)) <= 1e-12 * max(1.0, abs(float(b)))
        except ValueError:
            return a == b

    return [pair for pair in pairs if not same(*pair)]


def test_the_generator_makes_every_file_that_is_not_written_by_hand(made):
    by_hand = {f"{scene}.toml" for scene in SCENES} | {"README.md"}
    assert {path.name for path in made.iterdir()} == {path.name for path in DATA.iterdir() if path.is_file()} - by_hand


def test_the_files_are_what_the_generator_makes(made):
    for path in made.iterdir():
        assert differences(path, DATA / path.name) == [], path.name


def test_a_second_run_writes_the_same_bytes(generator, made, tmp_path):
    generator["make_data"](tmp_path)
    for path in made.iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_the_comparison_sees_a_moved_vertex(made, tmp_path):
    text = (made / "tent.obj").read_text()
    moved = tmp_path / "tent.obj"
    moved.write_text(text.replace("v 0.05000000000000000", "v 0.05000000001000000", 1))
    assert moved.read_text() != text
    assert len(differences(moved, DATA / "tent.obj")) == 1


@pytest.mark.parametrize("name", SCENES)
def test_the_scenes_load_without_a_warning(name):
    scene = load_scene(DATA / f"{name}.toml")
    assert scene.warnings == ()
    assert scene.candidates.sum() > 300


def planted_forces(name: str, vertices: int) -> Floats:
    forces = np.zeros((vertices, 3))
    with (DATA / "planted.csv").open(newline="") as handle:
        for row in csv.DictReader(handle):
            if row["scene"] == name:
                forces[int(row["vertex"])] = [float(row[key]) for key in ("fx", "fy", "fz")]
    return forces


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_shape_is_in_equilibrium_and_taut(name):
    scene: Scene = load_scene(DATA / f"{name}.toml")
    forces = planted_forces(name, scene.mesh.vertices)
    tension = scene.membrane.tension(scene.target)
    unbalanced = scene.membrane.forces(scene.target) + forces[~scene.fixed]
    assert np.linalg.norm(unbalanced, axis=1).max() <= 1e-10 * tension.max()
    assert tension.min() > 0
    assert not forces[scene.fixed].any()


def test_the_supports_that_the_planted_scenes_promise():
    tent = planted_forces("tent", 441)
    assert np.flatnonzero(tent.any(axis=1)).tolist() == [181]
    five = load_scene(DATA / "five-masts.toml")
    forces = planted_forces("five-masts", five.mesh.vertices)
    stand = np.flatnonzero(forces.any(axis=1))
    assert len(stand) == 5
    assert sorted(np.sign(forces[stand, 2])) == [-1, -1, 1, 1, 1]
    assert (np.abs(forces[stand, :2]).sum(axis=1) > 0).all()
    places = five.target[stand]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)[~np.eye(5, dtype=bool)]
    assert apart.min() > 3.0  # five mesh widths
    assert (five.mesh.faces[:, 3] == -1).all()


def test_the_scalloped_roof_hangs_from_its_corners_by_the_cables_along_its_sides():
    scene = load_scene(DATA / "scalloped.toml")
    forces = planted_forces("scalloped", 529)
    assert np.flatnonzero(forces.any(axis=1)).tolist() == [192, 337]
    corners = [0, 22, 506, 528]
    assert np.flatnonzero(scene.fixed).tolist() == corners
    np.testing.assert_allclose(scene.target[corners, 2], [5, 2, 2, 5])
    # the cables run along the whole outline, once
    sides = [tuple(sorted(pair)) for cable in scene.settings["membrane"]["cables"] for pair in pairwise(cable["path"])]
    faces = [[v for v in face if v >= 0] for face in scene.mesh.faces.tolist()]
    count = Counter(tuple(sorted(pair)) for face in faces for pair in zip(face, face[1:] + face[:1], strict=True))
    assert sorted(sides) == sorted(side for side, uses in count.items() if uses == 1)
    cabled = np.array([tuple(edge) in set(sides) for edge in scene.mesh.edges.tolist()])
    tension = scene.membrane.tension(scene.target)
    assert tension[cabled].min() > 5 * tension[~cabled].max()
    # drawn in further than cut, and without cables the shape is none
    flat, middle = read_mesh(DATA / "scalloped-flat.obj")[0], [11, 253, 275, 517]
    assert (np.linalg.norm(scene.target[middle, :2], axis=1) < np.linalg.norm(flat[middle, :2], axis=1) - 0.1).all()
    bare = load_scene(DATA / "scalloped.toml", {"membrane.cables": []})
    unbalanced = np.linalg.norm(bare.membrane.forces(bare.target) + forces[~bare.fixed], axis=1)
    assert unbalanced.max() > 0.5 * tension[~cabled].max()


def test_the_bumps_follow_the_formula_in_the_readme():
    heights = np.load(DATA / "bumps.npy")
    grid = np.arange(26) * 0.04
    for u, v, radius, height in ((0.28, 0.30, 0.24, 0.16), (0.72, 0.38, 0.22, 0.20), (0.44, 0.74, 0.22, 0.18)):
        row, column = np.argmin(abs(grid - v)), np.argmin(abs(grid - u))
        away = (grid[column] - u) ** 2 + (grid[row] - v) ** 2
        assert heights[row, column] == pytest.approx(height * (1 - away / radius**2))
    assert not heights[[0, -1]].any()
    assert not heights[:, [0, -1]].any()


def test_six_high_and_six_low_points_alternate_round_the_pavilion():
    scene = load_scene(DATA / "pavilion.toml")
    crest = scene.target[1 + 7 * 48 : 1 + 8 * 48, 2]
    np.testing.assert_allclose(crest[::8], 7.0)
    np.testing.assert_allclose(crest[4::8], 3.0)
    assert scene.target[:, 2].min() > scene.ground + 1.0


def test_the_terrain_has_squares_of_250_metres_and_measured_heights():
    scene = load_scene(DATA / "terrain.toml")
    np.testing.assert_allclose(np.ptp(scene.target, axis=0)[:2], [8750.0, 7250.0])
    assert 230 < scene.target[:, 2].min() < scene.target[:, 2].max() < 1080  # what the source holds


def test_the_sail_is_held_by_supports_alone():
    scene, forces = load_scene(DATA / "sail.toml"), planted_forces("sail", 361)
    assert not scene.fixed.any()
    assert np.flatnonzero(forces.any(axis=1)).tolist() == [0, 18, 180, 342, 360]
    assert not forces.sum(axis=0).any()
    noisy = relax.load_scene(DATA / "sail.toml", {"target.noise": {"sigma": 0.03, "seed": 0}})
    design = relax.solve(relax.Problem(noisy, weight=0.003))
    assert design.certificate.converged and design.certificate.stable
    assert np.flatnonzero(design.forces.any(axis=1)).tolist() == [0, 18, 180, 342, 360]
