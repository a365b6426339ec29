"""Every scene of data/ through the command line: what its result folder says holds, recomputed with numpy and FORMATS alone."""

import csv
import json

import numpy as np
import pytest
from data_results import SCENES, SLOW, solved
from naive_judge import differences, naive_figures

from relax.cli import run

RUNS = {name: (name,) for name in SCENES} | {
    "tent, debiased": ("tent", "--set", 'rounding.refit="debiased"'),
    "tent-noisy, group lasso": ("tent-noisy", "--penalty", "group-lasso", "--weight", "0.5"),
    "five-masts, loaded": ("five-masts", "--set", "membrane.loads=[0.0, 1.0, -5.0]", "--weight", "0.01"),
    "tent, force density": ("tent", "--set", 'membrane.springs="force-density"', "--exponent", "0.8", "--weight", "0.05"),
}
FILES = ("result.json", "result.npz", "trace.npz", "supports.csv", "membrane.obj", "membrane.vtu", "picture.png", "view.html")
KEYS = """settings stop iterations factorizations seconds skipped objective distance penalty rms_distance supports equilibrium
stationarity off_support stable tension_min tension_max slack_share converged versions seed""".split()
SHAPES = {
    **dict.fromkeys(["positions", "target", "clean_target", "start", "forces", "loads"], ("V", 3)),
    **dict.fromkeys(["fixed", "candidates", "support_weight"], ("V",)),
    **dict.fromkeys(["rest_length", "spring_constant"], ("E",)),
    **{"faces": ("F", 4), "edges": ("E", 2), "metric": ("V", 3, 3)},
}


@pytest.fixture(params=[pytest.param(name, marks=pytest.mark.slow if RUNS[name][0] in SLOW else ()) for name in RUNS])
def result(request, tmp_path_factory):
    return solved(tmp_path_factory, *RUNS[request.param])


def complaints(result):
    """What does not hold of the figures."""
    return differences(result.said, naive_figures(result.arrays, result.said["settings"]))


def test_it_converges_and_the_judge_of_the_package_agrees(result, capfd):
    assert result.status == 0 and result.said["converged"] is True and result.said["stop"] == "converged"
    assert run(["check", str(result.folder)]) == 0
    assert "every figure agrees; converged" in capfd.readouterr().out


def test_the_folder_is_complete(result):
    for name in FILES:
        assert (result.folder / name).stat().st_size > 0, name
    assert (result.folder / "picture.png").read_bytes()[:4] == b"\x89PNG"
    assert [key for key in KEYS if key not in result.said] == []
    assert set(result.said["seconds"]) == {"read", "solve", "write"}
    size = {}
    for name, shape in SHAPES.items():
        array = result.arrays[name]
        assert len(array.shape) == len(shape), name
        for letter, length in zip(shape, array.shape, strict=True):
            assert length == (letter if isinstance(letter, int) else size.setdefault(letter, length)), name
        assert array.dtype.kind != "f" or np.isfinite(array).all(), name
    assert result.arrays["fixed"].dtype == result.arrays["candidates"].dtype == bool


def test_every_figure_is_what_dense_matrices_say(result):
    assert complaints(result) == []


def test_the_arrays_agree_with_each_other_and_the_settings(result):
    arrays, settings = result.arrays, result.said["settings"]
    assert (arrays["edges"][:, 0] < arrays["edges"][:, 1]).all()
    assert not arrays["forces"][~arrays["candidates"]].any() and not (arrays["candidates"] & arrays["fixed"]).any()
    np.testing.assert_array_equal(arrays["positions"][arrays["fixed"]], arrays["clean_target"][arrays["fixed"]])
    noise = settings["target"]["noise"]
    wanted = arrays["clean_target"].copy()
    if noise:
        free = np.flatnonzero(~arrays["fixed"])
        wanted[free] += np.random.default_rng(noise["seed"]).normal(0, noise["sigma"], (len(free), 3))
    np.testing.assert_array_equal(arrays["target"], wanted)
    assert result.said["seed"] == (noise["seed"] if noise else None)
    # every side of every face is an edge
    corners = [[v for v in face if v >= 0] for face in arrays["faces"].tolist()]
    sides = {tuple(sorted(pair)) for face in corners for pair in zip(face, face[1:] + face[:1], strict=True)}
    assert sides <= set(map(tuple, arrays["edges"].tolist()))


def test_the_table_of_supports_has_their_geometry(result):
    with (result.folder / "supports.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [int(row["vertex"]) for row in rows] == result.stands and len(rows) == result.said["supports"]
    ground = result.said["settings"]["supports"]["ground"]
    for row in rows:
        vertex = int(row["vertex"])
        head, force = ([float(row[f"{what}_{axis}"]) for axis in "xyz"] for what in ("head", "force"))
        np.testing.assert_array_equal(head, result.arrays["positions"][vertex])
        np.testing.assert_array_equal(force, result.arrays["forces"][vertex])
        assert float(row["magnitude"]) == pytest.approx(np.linalg.norm(force))
        assert float(row["lean"]) == pytest.approx(np.degrees(np.arctan2(np.hypot(*force[:2]), abs(force[2]))), abs=1e-5)
        if head[2] < ground or force[2] == 0:
            assert row["kind"] == "stay" and row["foot_x"] == row["length"] == ""
            continue
        assert row["kind"] == ("mast" if force[2] > 0 else "tie-down")
        foot = [float(row[f"foot_{axis}"]) for axis in "xyz"]
        np.testing.assert_allclose(
            foot, np.subtract(head, np.multiply(force, (head[2] - ground) / force[2])), atol=1e-9 * (1 + abs(head[2]))
        )
        assert float(row["length"]) == pytest.approx(np.linalg.norm(np.subtract(head, foot)))


def test_the_trace_ends_at_the_result(result):
    with np.load(result.folder / "trace.npz", allow_pickle=False) as archive:
        trace = dict(archive)
    steps = result.said["iterations"] + 1
    assert trace["positions"].shape == trace["forces"].shape == (steps, *result.arrays["positions"].shape)
    assert all(len(trace[name]) == steps for name in ("objective", "stationarity", "seconds"))
    same = (trace["positions"] == result.arrays["positions"]).all(axis=(1, 2)) & (trace["forces"] == result.arrays["forces"]).all(
        axis=(1, 2)
    )
    assert same.any()
    assert trace["objective"][np.argmax(same)] == pytest.approx(result.said["objective"])
    assert trace["unrounded_positions"].shape == result.arrays["positions"].shape


def test_the_exported_mesh_is_the_shape(result):
    words = [line.split() for line in (result.folder / "membrane.obj").read_text().splitlines()]
    vertices = np.array([[float(word) for word in line[1:4]] for line in words if line and line[0] == "v"])
    np.testing.assert_array_equal(vertices, result.arrays["positions"])
    assert sum(bool(line) and line[0] == "f" for line in words) == len(result.arrays["faces"])


# each figure that the twin recomputes is seen when it is said wrongly, and so is an array that was touched


@pytest.fixture(scope="module")
def tent(tmp_path_factory):
    return solved(tmp_path_factory, "tent-noisy")


def test_a_figure_said_wrongly_is_seen(tent):
    mine = naive_figures(tent.arrays, tent.said["settings"])
    for name, value in mine.items():
        # a residual at the round-off is wrong from where it would no longer be round-off
        false = not value if isinstance(value, bool) else value + 1 if isinstance(value, int) else 1.00001 * value + 1e-9
        assert [line.split()[0] for line in differences(tent.said | {name: false}, mine)] == [name]


@pytest.mark.parametrize(
    ("name", "figure"),
    [
        ("positions", "equilibrium"),
        ("forces", "equilibrium"),
        ("target", "distance"),
        ("rest_length", "tension_max"),
        ("spring_constant", "equilibrium"),
        ("support_weight", "penalty"),
        ("metric", "distance"),
        ("loads", "equilibrium"),
    ],
)
def test_an_array_that_was_touched_is_seen(tent, tmp_path, name, figure, capfd):
    touched = tent.arrays | {name: tent.arrays[name] * 1.001 + (1e-3 if name == "loads" else 0)}
    wrong = differences(tent.said, naive_figures(touched, tent.said["settings"]))
    assert any(line.startswith(figure) for line in wrong)
    folder = tmp_path / "touched"
    folder.mkdir()
    np.savez(folder / "result.npz", **touched)
    (folder / "result.json").write_text(json.dumps(tent.said))
    assert run(["check", str(folder), "--quiet"]) == 1
    assert figure in capfd.readouterr().err
