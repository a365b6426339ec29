"""The answer moves with the scene: turned, mirrored, shifted, renumbered or written in other units as it is built; and doubled.

Scenes are small, irregular and without symmetry, so that the answer is generic; hypothesis draws scene and move. Where
test_units.py moves the arrays of a scene, here its mesh, target and settings are moved and the scene is built again.
"""

from functools import cache

import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st
from test_units import agree, turned

from relax.design.problem import Problem
from relax.design.solve import solve
from relax.membrane.mesh import mesh_from_faces
from relax.membrane.scene import build_scene

SIDE = 6
SEEDS = st.integers(0, 2)
DECADES = st.floats(-4, -0.3) | st.floats(0.3, 4)
LEAN = {"lean": 20.0}
KINDS = {
    "any": {},
    "loaded": {"membrane__loads": [0.05, 0.0, -0.1]},
    "vertical": {"supports__direction": "vertical"},
    "up, height": {"supports__direction": "up", "target__metric": "height"},
    "lean, normal": {"supports__direction": LEAN, "target__metric": "normal"},
    "capped": {"supports__max_force": 0.1},
    "net, by height": {"membrane__material": "cables", "supports__weights": "height", "supports__ground": -1.0},
    "fabric that goes slack": {"membrane__springs": "tension-only", "membrane__rest_scale": 0.9},
    "linear": {"membrane__springs": "force-density", "penalty__exponent": 0.8, "penalty__weight": 0.02},
    "log-sum": {"penalty__name": "log-sum", "penalty__scale": 0.05, "penalty__weight": 0.03},
    "group lasso": {"penalty__name": "group-lasso", "penalty__weight": 0.02},
    "area weights, debiased": {"target__area_weights": True, "penalty__weight": 2e-4, "rounding__refit": "debiased"},
    "corners": {"supports__fixed": "corners", "membrane__rest_scale": 0.5},
}
FREE = ("any", "capped", "linear", "fabric that goes slack", "log-sum")  # kinds that know no upright
UNITS = {  # of a setting: metres, newtons
    "membrane__loads": (-2, 1),
    "supports__max_force": (0, 1),
    "supports__ground": (1, 0),
    "penalty__scale": (0, 1),
    "penalty__smoothing": (0, 2),
}


def shape(seed):
    """Mesh and target: irregular, with a hill off the middle."""
    mesh, target = zoo.irregular(SIDE, seed)
    x, y, _ = target.T
    target[:, 2] += 0.3 * np.exp(-8 * ((x - 0.4) ** 2 + (y - 0.6) ** 2)) * 16 * x * (1 - x) * y * (1 - y)
    return mesh, target


def chosen(kind):
    return {"penalty__weight": 3e-3, "supports__ground": 0.0, **KINDS[kind]}


def solved(mesh, target, asked):
    """Scene and design of a scene that is built from mesh, target and settings."""
    scene = build_scene(zoo.settings(**asked), mesh, target, None)
    return scene, solve(Problem(scene))


@cache
def design_of(kind, seed):
    """A scene as it is, and its design, once."""
    scene, design = solved(*shape(seed), chosen(kind))
    assert design.certificate.converged and design.certificate.supports, (kind, seed, design.stop)
    return scene, design


def same(found, wanted, unit=1.0):
    """The answers (positions, forces) agree, and the designs' objectives but for a unit."""
    (answer, design), (wish, other) = found, wanted
    agree(answer, wish)
    assert design.certificate.converged
    assert design.certificate.objective / unit == pytest.approx(other.certificate.objective, rel=1e-9)
    assert design.certificate.off_support == pytest.approx(other.certificate.off_support, rel=1e-6, abs=1e-9)


def about_z(angle, mirror=1.0):
    """The rotation about the vertical, after a mirror for -1."""
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]) @ np.diag([mirror, 1, 1])


@pytest.mark.parametrize("kind", KINDS)
@given(seed=SEEDS, angle=st.floats(0.1, 6.2), mirror=st.sampled_from([1.0, -1.0]))
@settings(max_examples=2)
def test_turned_about_the_vertical_and_mirrored(kind, seed, angle, mirror):
    (mesh, target), asked = shape(seed), chosen(kind)
    turn = about_z(angle, mirror)
    if "membrane__loads" in asked:
        asked["membrane__loads"] = (turn @ asked["membrane__loads"]).tolist()
    _, other = solved(mesh, target @ turn.T, asked)
    _, design = design_of(kind, seed)
    same(((other.positions @ turn, other.forces @ turn), other), ((design.positions, design.forces), design))


@given(st.sampled_from(FREE), SEEDS, st.integers(0, 99), st.sampled_from([1.0, -1.0]))
@settings(max_examples=6)
def test_turned_any_way_where_nothing_knows_the_upright(kind, seed, which, mirror):
    scene, design = design_of(kind, seed)
    turn = np.linalg.qr(np.random.default_rng(which).normal(size=(3, 3)))[0] * mirror
    other = solve(Problem(turned(scene, turn)))
    same(((other.positions @ turn, other.forces @ turn), other), ((design.positions, design.forces), design))


@given(st.sampled_from(list(KINDS)), SEEDS, st.floats(-30, 30), st.floats(-30, 30))
@settings(max_examples=6)
def test_shifted_in_plan(kind, seed, east, north):
    (mesh, target), shift = shape(seed), np.array([east, north, 0.0])
    _, other = solved(mesh, target + shift, chosen(kind))
    _, design = design_of(kind, seed)
    same(((other.positions - shift, other.forces), other), ((design.positions, design.forces), design))


@given(st.sampled_from(list(KINDS)), SEEDS, st.integers(0, 99))
@settings(max_examples=8)
def test_vertices_and_faces_numbered_otherwise(kind, seed, which):
    """Vertices and faces in another order, each face from another corner on."""
    (mesh, target), rng = shape(seed), np.random.default_rng(which)
    new = rng.permutation(mesh.vertices)
    faces = new[mesh.faces[rng.permutation(len(mesh.faces)), :3]]
    faces = np.take_along_axis(faces, (np.arange(3) + rng.integers(3, size=(len(faces), 1))) % 3, axis=1)
    moved = mesh_from_faces(mesh.vertices, np.column_stack([faces, np.full(len(faces), -1)]))
    _, other = solved(moved, target[np.argsort(new)], chosen(kind))
    _, design = design_of(kind, seed)
    same(((other.positions[new], other.forces[new]), other), ((design.positions, design.forces), design))


@pytest.mark.parametrize("kind", KINDS)
@given(seed=SEEDS, lengths=DECADES, forces=DECADES)
@settings(max_examples=2)
def test_written_in_other_units(kind, seed, lengths, forces):
    """A metre is so many of the new unit of length, a newton of force: no power of two, so that every digit changes."""
    metre, newton = 10.0**lengths, 10.0**forces
    (mesh, target), asked = shape(seed), chosen(kind)
    filled = zoo.settings(**asked)
    asked["penalty__smoothing"] = filled["penalty"]["smoothing"]
    for name in UNITS.keys() & asked.keys():
        along, pull = UNITS[name]
        if asked[name] is not None:
            asked[name] = (np.asarray(asked[name]) * metre**along * newton**pull).tolist()
    net = filled["membrane"]["material"] == "cables"
    asked["membrane__stiffness"] = newton if net else newton / metre
    power = filled["penalty"]["exponent"] if filled["penalty"]["name"] == "power" else 1.0
    area = 4 if filled["target"]["area_weights"] else 2
    asked["penalty__weight"] *= metre**area / newton**power
    _, other = solved(mesh, metre * target, asked)
    _, design = design_of(kind, seed)
    answer = (other.positions / metre, other.forces / newton)
    same((answer, other), ((design.positions, design.forces), design), metre**area)


@given(st.sampled_from(list(KINDS)), SEEDS, SEEDS)
@settings(max_examples=6)
def test_two_membranes_beside_each_other_have_the_answers_of_each(kind, one, other):
    first, second = shape(one), shape(other)
    count, away = first[0].vertices, np.array([3.0, 0.0, 0.0])
    faces = [np.where(mesh.faces < 0, -1, mesh.faces + add) for (mesh, _), add in ((first, 0), (second, count))]
    asked = chosen(kind)
    if kind == "net, by height":  # a height is weighed by the mean of all candidates
        asked["supports__weights"] = "uniform"
        alone = [solved(*shape(seed), asked) for seed in (one, other)]
    else:
        alone = [design_of(kind, seed) for seed in (one, other)]
    _, both = solved(mesh_from_faces(2 * count, np.concatenate(faces)), np.concatenate([first[1], second[1] + away]), asked)
    assert both.certificate.converged
    for (_, design), part, shift in zip(alone, (slice(count), slice(count, None)), (0 * away, away), strict=True):
        agree((both.positions[part] - shift, both.forces[part]), (design.positions, design.forces))
    assert both.certificate.objective == pytest.approx(sum(design.certificate.objective for _, design in alone), rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_scenes_of_this_file_have_supports_that_stand_apart(seed):
    """Else "the same supports" would say nothing: some stand and some do not, in every kind."""
    for kind in KINDS:
        scene, design = design_of(kind, seed)
        assert 0 < design.certificate.supports < np.count_nonzero(scene.candidates), kind
