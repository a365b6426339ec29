"""A result is saved and loaded without loss, and solved again from its own settings gives the same digits."""

from dataclasses import fields

import numpy as np
import pytest
import zoo
from data_results import DATA

import relax
from relax.files import load_result, load_scene

PLANTED = {
    "plain": {},
    "noise": {"sigma": 0.01},
    "a fraction": {"sigma": 0.01, "penalty__weight_fraction": 0.1, "penalty__weight": None},
    "irls": {"sigma": 0.01, "solver__method": "irls"},
    "lagrangian": {"solver__method": "lagrangian"},
    "greedy": {"sigma": 0.01, "solver__method": "greedy"},
    "reweighted-l1": {"sigma": 0.01, "solver__method": "reweighted-l1"},
    "clarabel": {"sigma": 0.01, "solver__backend": "clarabel"},
    "heavy": {"sigma": 0.01, "solver__start": "heavy"},
    "debiased": {"sigma": 0.01, "rounding__refit": "debiased"},
    "tension-only": {"sigma": 0.01, "membrane__springs": "tension-only"},
    "up": {"sigma": 0.01, "supports__direction": "up"},
    "lean": {"sigma": 0.01, "supports__direction": {"lean": 20.0}},
    "capped": {"sigma": 0.01, "supports__max_force": 0.2},
    "always": {"sigma": 0.01, "supports__always": [24], "supports__never": [25]},
    "normal": {"sigma": 0.01, "target__metric": "normal", "target__area_weights": True},
    "loads": {"membrane__loads": [0.01, 0.0, -0.02]},
}


def planted(name):
    changes = {"penalty__weight": 0.02, **PLANTED[name]}
    return zoo.planted(7, zoo.TWO_MASTS, changes.pop("sigma", None), **changes).scene


def same(one, other):
    """Whether two designs are the same to the last digit, but for the time that they took."""
    for name in ("positions", "forces"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("positions", "forces", "objective", "unrounded_positions", "unrounded_forces", "stationarity"):
        np.testing.assert_array_equal(getattr(one.trace, name), getattr(other.trace, name), err_msg=name)
    assert one.trace.notes == other.trace.notes and one.certificate == other.certificate
    for name in ("stop", "iterations", "factorizations", "skipped", "interrupted", "settings"):
        assert getattr(one, name) == getattr(other, name), name


def replayed(scene, folder):
    """Solve, write, load, and solve again from what was loaded."""
    design = relax.solve(relax.Problem(scene))
    relax.write_result(folder, design)
    stored = load_result(folder)
    for item in fields(scene):
        one, other = getattr(scene, item.name), getattr(stored.scene, item.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other, err_msg=item.name)
            assert one.dtype == other.dtype
    np.testing.assert_array_equal(scene.mesh.faces, stored.scene.mesh.faces)
    np.testing.assert_array_equal(scene.mesh.edges, stored.scene.mesh.edges)
    same(stored.design(), design)
    again = relax.solve(relax.Problem(stored.scene))
    same(again, design)
    # and once more, from the folder of the second
    relax.write_result(folder, again)
    same(load_result(folder).design(), design)
    assert load_result(folder).scene.settings == stored.scene.settings


@pytest.mark.parametrize("name", PLANTED)
def test_a_tiny_scene_comes_out_the_same_from_its_folder(name, tmp_path):
    replayed(planted(name), tmp_path / "result")


def test_a_net_solved_exactly_comes_out_the_same(tmp_path):
    pytest.importorskip("pyscipopt", reason="the exact method needs SCIP (pip install 'relax-tensile[exact]')")
    changes = {"solver__method": "exact", "penalty__weight": 0.02}
    replayed(zoo.force_density_net(5, **changes), tmp_path / "result")


@pytest.mark.parametrize("name", ["tent", "tent-noisy", "five-masts", "scalloped"])
def test_a_scene_of_data_comes_out_the_same_from_its_folder(name, tmp_path):
    replayed(load_scene(DATA / f"{name}.toml"), tmp_path / "result")


def test_a_design_of_a_path_comes_out_the_same(tmp_path):
    *_, design = relax.path(relax.Problem(planted("noise")), weights=[0.1, 0.02])
    relax.write_result(tmp_path / "result", design)
    loaded = load_result(tmp_path / "result").design()
    np.testing.assert_array_equal(loaded.positions, design.positions)
    assert loaded.certificate == design.certificate and loaded.problem.strength == design.problem.strength
    start = design.positions, design.forces
    again = relax.solve(loaded.problem, start=start)
    assert again.certificate.objective == pytest.approx(design.certificate.objective, rel=1e-12)
