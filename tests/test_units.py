"""The answer does not depend on how a scene is written down: units, rotation, mirror, numbering (MATH, "Masts and units")."""

from dataclasses import replace

import numpy as np
import pytest
import zoo

from relax.design.problem import Problem
from relax.design.solve import solve
from relax.membrane.mesh import Mesh

MILLI, KILO = 1e3, 1e-3  # metres as millimetres, newtons as kilonewtons

SCENES = {
    "planted": lambda: zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-3).scene,
    "noisy": lambda: zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3).scene,
    "bumps": lambda: zoo.grid_scene(8, zoo.bumps, penalty__weight=1e-2, membrane__loads=[0.01, 0.0, -0.05]),
    "debiased": lambda: zoo.planted(9, sigma=0.01, penalty__weight=5e-3, rounding__refit="debiased").scene,
    "alpha 0.8": lambda: zoo.planted(9, sigma=0.01, penalty__weight=5e-3, penalty__exponent=0.8).scene,
    "group lasso": lambda: zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=2e-2, penalty__name="group-lasso").scene,
    "force density": lambda: zoo.force_density_net(8, penalty__weight=3e-3),
    "cables": lambda: zoo.irregular_scene(6, membrane__material="cables", penalty__weight=3e-3),
    "fraction": lambda: zoo.planted(9, sigma=0.01, penalty__weight=None, penalty__weight_fraction=0.05).scene,
}


@pytest.fixture(scope="module", params=SCENES)
def case(request):
    """A scene and its design."""
    scene = SCENES[request.param]()
    design = solve(Problem(scene))
    assert design.certificate.converged and design.certificate.supports > 0
    return scene, design


def with_settings(scene, section, **changes):
    return replace(scene, settings=scene.settings | {section: scene.settings[section] | changes})


def in_millimetres_and_kilonewtons(scene):
    """k_sparse is length^2 / force^alpha, eps force^2, spring constants (force densities too) force / length."""
    penalty = scene.settings["penalty"]
    alpha = 1.0 if penalty["name"] == "group-lasso" else penalty["exponent"]
    changes = {"smoothing": None if penalty["smoothing"] is None else penalty["smoothing"] * KILO**2}
    if penalty["weight"] is not None:
        changes["weight"] = penalty["weight"] * MILLI**2 / KILO**alpha
    moved = replace(
        scene,
        **{name: MILLI * getattr(scene, name) for name in ("target", "clean_target", "start", "rest_length")},
        spring_constant=scene.spring_constant * KILO / MILLI,
        loads=KILO * scene.loads,
    )
    return with_settings(with_settings(moved, "penalty", **changes), "supports", ground=MILLI * scene.ground)


def turned(scene, turn):
    """Every position and load turned by the orthogonal matrix `turn` (3, 3)."""
    arrays = {name: getattr(scene, name) @ turn.T for name in ("target", "clean_target", "start", "loads")}
    return replace(scene, **arrays)


def renumbered(scene, new):
    """Vertex i becomes vertex new[i]; edges and faces follow, in an order of their own."""
    old = np.argsort(new)
    edges = np.sort(new[scene.mesh.edges], axis=1)
    order = np.lexsort(edges.T[::-1])
    faces = np.where(scene.mesh.faces >= 0, new[scene.mesh.faces], -1)[::-1]
    names = ("target", "clean_target", "start", "loads", "fixed", "candidates", "metric", "support_weight")
    arrays = {name: getattr(scene, name)[old] for name in names}
    arrays |= {name: getattr(scene, name)[order] for name in ("rest_length", "spring_constant")}
    return replace(scene, mesh=Mesh(scene.mesh.vertices, faces, edges[order]), **arrays)


def agree(found, wanted, tolerance=1e-6):
    """Positions and forces within `tolerance` of the largest, and the same supports."""
    for mine, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=tolerance * np.abs(theirs).max())
    np.testing.assert_array_equal(found[1].any(axis=1), wanted[1].any(axis=1))


def test_millimetres_and_kilonewtons_give_the_same_supports(case):
    scene, design = case
    other = solve(Problem(in_millimetres_and_kilonewtons(scene)))
    agree((other.positions / MILLI, other.forces / KILO), (design.positions, design.forces))
    mine, theirs = design.certificate, other.certificate
    assert theirs.converged
    for name, unit in (("objective", MILLI**2), ("distance", MILLI**2), ("penalty", MILLI**2), ("rms_distance", MILLI)):
        assert getattr(theirs, name) / unit == pytest.approx(getattr(mine, name), rel=1e-6, abs=1e-14)
    assert theirs.tension_max / KILO == pytest.approx(mine.tension_max, rel=1e-6)
    assert theirs.off_support == pytest.approx(mine.off_support, rel=1e-6, abs=1e-9)
    for one, two in zip(design.supports, other.supports, strict=True):
        assert (one.vertex, one.kind) == (two.vertex, two.kind)
        assert two.lean == pytest.approx(one.lean, abs=1e-4)
        assert (one.length is None) == (two.length is None)
        assert one.length is None or two.length / MILLI == pytest.approx(one.length, rel=1e-5)


def test_units_matter_where_the_weight_is_not_moved_along(case):
    """The conversion of k_sparse is no formality: without it the answer is another one."""
    scene, design = case
    moved = in_millimetres_and_kilonewtons(scene)
    wrong = solve(Problem(with_settings(moved, "penalty", weight=design.settings["penalty"]["weight"], weight_fraction=None)))
    assert abs(wrong.certificate.penalty / MILLI**2 - design.certificate.penalty) > 1e-3 * design.certificate.penalty


@pytest.mark.parametrize(
    "turn",
    [
        np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]),
        np.diag([-1.0, 1.0, 1.0]),
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    ],
    ids=["turned about z", "mirrored", "mirrored at the diagonal"],
)
def test_rotation_and_mirror_move_the_answer_along(case, turn):
    scene, design = case
    other = solve(Problem(turned(scene, turn)))
    agree((other.positions @ turn, other.forces @ turn), (design.positions, design.forces))
    assert other.certificate.objective == pytest.approx(design.certificate.objective, rel=1e-9)


def test_numbering_the_vertices_otherwise_changes_nothing_else(case):
    scene, design = case
    new = np.random.default_rng(1).permutation(scene.mesh.vertices)
    other = solve(Problem(renumbered(scene, new)))
    agree((other.positions[new], other.forces[new]), (design.positions, design.forces))
    assert other.certificate.objective == pytest.approx(design.certificate.objective, rel=1e-9)
