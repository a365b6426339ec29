"""`relax new`: the scene file it writes says what is read, holds every key, and solves as it is, for every format."""

import re
import tomllib

import meshio
import numpy as np
import pytest
import zoo
from folders import bump, refused, write
from PIL import Image

import relax
from relax.cli import run
from relax.files import load_scene
from relax.files.draft import MEANING, draft_scene
from relax.files.schema import HEIGHT_SUFFIXES, MESH_SUFFIXES, SCHEMA, resolve

ONLY_HEIGHTS = {"spacing", "height_scale", "diagonals"}


def tent(folder, suffix):
    """The same small tent in any mesh format."""
    scene = zoo.planted(7).scene
    faces = scene.mesh.faces[:, :3]
    path = folder / f"tent{suffix}"
    if suffix == ".ply":
        faces = faces.astype(np.int32)
    meshio.write(path, meshio.Mesh(scene.target, [("triangle", faces)]), **({"binary": False} if suffix == ".vtk" else {}))
    return path


def field(folder, suffix):
    """The same hill in any height format."""
    z, path = bump(), folder / f"hill{suffix}"
    text = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in z)
    if suffix in (".png", ".tif", ".tiff"):
        Image.fromarray((z * 500).astype(np.uint8)).save(path)
    elif suffix == ".npy":
        np.save(path, z)
    elif suffix == ".npz":
        np.savez(path, z=z)
    elif suffix == ".asc":
        write(folder, path.name, f"ncols 7\nnrows 7\nxllcorner 0\nyllcorner 0\ncellsize 0.2\n{text}\n")
    else:
        write(folder, path.name, text.replace(" ", ",") if suffix == ".csv" else text)
    return path


@pytest.mark.filterwarnings("ignore:VTK ASCII")
@pytest.mark.parametrize("suffix", [*MESH_SUFFIXES, *HEIGHT_SUFFIXES])
def test_what_is_written_for_each_format_solves_as_it_is(tmp_path, monkeypatch, capfd, suffix):
    source = (tent if suffix in MESH_SUFFIXES else field)(tmp_path, suffix)
    capfd.readouterr()
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path / "there")
    assert run(["new", f"../{source.name}"]) == 0
    out, err = capfd.readouterr()
    assert f"written to {source.stem}.toml" in out and err == ""
    assert ("to be put right: spacing" in out) == (suffix in HEIGHT_SUFFIXES and suffix != ".asc")
    scene = load_scene(f"{source.stem}.toml")  # the path in it is relative to it
    design = relax.solve(relax.Problem(scene))
    assert design.certificate.converged and 1 <= design.certificate.supports <= 8


@pytest.mark.parametrize("name", ["hill.npy", "tent.obj"])
def test_every_key_is_there_with_its_default_and_its_meaning(tmp_path, name):
    source = (tent if name == "tent.obj" else field)(tmp_path, name[4:])
    text, scene = draft_scene(source, tmp_path / "scene.toml")
    lines = {}
    for line in text.splitlines():
        if line.startswith("["):
            section = line[1:-1]
        elif found := re.match(r"(# )?(\w+) = (.*?)  # (.+)", line):
            lines[section, found[2]] = found
    wanted = {(section, key) for section, keys in SCHEMA.items() for key in keys}
    wanted -= {
        ("target", "mesh" if name == "hill.npy" else "heights"),
        ("penalty", "scale"),
        ("penalty", "knee"),
        ("penalty", "shape"),
    }
    if name == "tent.obj":
        wanted -= {("target", key) for key in ONLY_HEIGHTS}
    assert set(lines) == wanted and set(MEANING) <= {(section, key) for section, keys in SCHEMA.items() for key in keys}
    said = resolve(tomllib.loads(text), "scene")
    for (section, key), found in lines.items():
        value = tomllib.loads(f"value = {found[3]}")["value"]
        SCHEMA[section][key].check(value)
        default = SCHEMA[section][key].default
        if found[1] and default is not None:
            assert value == (list(default) if isinstance(default, tuple) else default)
        if not found[1] and (section, key) != ("penalty", "smoothing"):
            assert said[section][key] == value
    # each comment taken away alone leaves a scene, but for the other way to give the weight
    for at, found in lines.items():
        if found[1] and at != ("penalty", "weight"):
            resolve(tomllib.loads(text.replace(found[0], found[0][2:])), "scene")
    assert scene.ground == pytest.approx(tomllib.loads(f"value = {lines['supports', 'ground'][3]}")["value"])


def test_the_smoothing_follows_the_size(tmp_path):
    for scale, smoothing in ((1.0, 1e-6), (30.0, 1e-3), (1000.0, 1.0)):
        write(
            tmp_path,
            "a.obj",
            f"v 0 0 0\nv {scale} 0 0\nv {scale} {scale} 0\nv 0 {scale} 0\nv {scale / 2} {scale / 2} {scale / 9}\n"
            "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n",
        )
        assert draft_scene(tmp_path / "a.obj", tmp_path / "a.toml")[1].settings["penalty"]["smoothing"] == smoothing


def test_what_is_there_is_not_replaced(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    field(tmp_path, ".npy")
    write(tmp_path, "hill.toml", "mine")
    assert run(["new", "hill.npy"]) == 2
    assert capfd.readouterr().err.startswith("relax: hill.toml: this is there already, and is not replaced")
    assert (tmp_path / "hill.toml").read_text() == "mine"
    (tmp_path / "link.toml").symlink_to(tmp_path / "nowhere")
    assert run(["new", "hill.npy", "-o", "link.toml"]) == 2
    assert run(["new", "hill.npy", "-o", "no/where.toml"]) == 2 and "its folder does not exist" in capfd.readouterr().err
    assert run(["new", "hill.npy", "-o", "other.toml", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "") and (tmp_path / "other.toml").exists()


def test_what_no_membrane_can_be_made_of_is_refused_and_nothing_written(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, "a.doc", "x")
    write(tmp_path, "bad.obj", "v 0 0 0\nf 1 1 1\n")
    closed = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv .3 .3 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    write(tmp_path, "closed.obj", closed)
    before = sorted(tmp_path.iterdir())
    for name, sentence in [
        ("a.doc", "neither a mesh nor a height field"),
        ("gone.obj", "no such file"),
        ("bad.obj", "names a vertex twice"),
    ]:
        assert run(["new", name]) == 2
        assert sentence in capfd.readouterr().err
    assert "fixed" in refused(lambda: draft_scene("closed.obj", "closed.toml"))
    assert sorted(tmp_path.iterdir()) == before


def test_a_strange_name_survives(tmp_path):
    name = 'a "b" \\ é.npy'
    np.save(tmp_path / name, bump())
    text, scene = draft_scene(tmp_path / name, tmp_path / "s.toml")
    assert scene.settings["target"]["heights"] == name and scene.title == name.removesuffix(".npy")
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    load_scene(tmp_path / "s.toml")
