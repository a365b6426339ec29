from dataclasses import replace
from inspect import signature

import naive
import numpy as np
import pytest
import zoo

from relax.iterate import Stop
from relax.membrane import formers
from relax.membrane.equilibrium import find_equilibrium
from relax.membrane.formers import FORMERS, form_find
from relax.membrane.membrane import Membrane
from relax.membrane.springs import SPRINGS, Hookean, TensionOnly

every_former = pytest.mark.parametrize("former", FORMERS.values(), ids=FORMERS)
every_law = pytest.mark.parametrize("law", SPRINGS)


def scene_and_forces(name):
    """Scenes with one stable shape, at which every edge pulls."""
    if name in SPRINGS:
        scene = zoo.irregular_scene(membrane__springs=name, membrane__loads=[0.1, 0.0, -0.4])
        return scene, scene.loads[scene.membrane.free]
    if name == "net":
        scene = zoo.force_density_net()
        return scene, scene.loads[scene.membrane.free]
    if name == "pyramid":
        return zoo.pyramid(), np.array([[0.0, 0.0, zoo.PYRAMID_FORCE]])
    plant = zoo.planted(9, zoo.TWO_MASTS, **{"one": {}, "loaded": {"membrane__loads": [0.0, 0.0, -0.2]}}[name])
    return plant.scene, (plant.forces + plant.scene.loads)[plant.scene.membrane.free]


SCENES = [*SPRINGS, "net", "pyramid", "one", "loaded"]


@pytest.mark.parametrize("name", SCENES)
@every_former
def test_all_agree_with_newton(former, name):
    """As closely as their residuals say: x - y = K^-1 (r_x - r_y), with K between them, which the factor 2 is for."""
    scene, applied = scene_and_forces(name)
    found, newton = former(scene.membrane, scene.start, applied), find_equilibrium(scene.membrane, scene.start, applied)
    assert found.found and newton.found
    left = [naive.forces(scene.membrane, each.positions)[scene.membrane.free] + applied for each in (found, newton)]
    weakest = np.linalg.eigvalsh(naive.stiffness(scene.membrane, newton.positions))[0]
    bound = 2 * sum(np.linalg.norm(each) for each in left) / weakest + 1e-14
    apart = np.linalg.norm(found.positions - newton.positions)
    assert apart <= bound and apart <= 1e-8


@every_law
@every_former
def test_reactions_balance_the_loads(former, law):
    scene, applied = scene_and_forces(law)
    x = former(scene.membrane, scene.start, applied).positions
    held = np.flatnonzero(scene.fixed)
    reactions = -naive.forces(scene.membrane, x)[held]
    assert np.abs(reactions).max() > 0.01
    assert np.allclose(reactions.sum(axis=0) + applied.sum(axis=0), 0, atol=1e-9)
    moments = np.cross(x[held], reactions).sum(axis=0) + np.cross(x[scene.membrane.free], applied).sum(axis=0)
    assert np.allclose(moments, 0, atol=1e-9)


@every_former
def test_a_spring_by_hand(former):
    """A weight of 3 newtons on a spring of 2 N/m and 0.5 m: it hangs 2 m below."""
    spring = Membrane(np.array([[0, 1]]), np.array([0.5]), np.array([2.0]), TensionOnly(), np.array([True, False]))
    found = former(spring, np.array([[0.0, 0, 0], [0.3, 0.1, -0.6]]), np.array([[0.0, 0, -3.0]]))
    assert found.found and np.allclose(found.positions[1], [0, 0, -2.0], atol=1e-8)


@pytest.mark.parametrize("rest", [0.05, 0.08, 0.12])
@every_former
def test_a_chain_under_equal_weights(former, rest):
    """Eleven springs between two points 1 m apart; of 0.12 m each it starts slack, hangs and is taut."""
    count = 10
    edges = np.column_stack([np.arange(count + 1), np.arange(1, count + 2)])
    fixed = np.isin(np.arange(count + 2), [0, count + 1])
    chain = Membrane(edges, np.full(count + 1, rest), np.full(count + 1, 50.0), TensionOnly(), fixed)
    start = np.column_stack([np.linspace(0, 1, count + 2), np.zeros((count + 2, 2))])
    found = former(chain, start, np.tile([0.0, 0.0, -0.1], (count, 1)))
    shape = naive.chain_shape(count, 1.0, rest, 50.0, 0.1)
    assert shape[-1] == pytest.approx([1, 0], abs=1e-12) and shape[:, 1].min() < -0.01
    assert found.found
    assert np.allclose(found.positions[:, [0, 2]], shape, atol=1e-8) and not found.positions[:, 1].any()


@every_former
def test_at_rest_already_nothing_is_done(former):
    scene = zoo.pyramid()
    found = former(scene.membrane, scene.target, np.array([[0.0, 0.0, zoo.PYRAMID_FORCE]]))
    assert (found.iterations, found.factorizations) == (0, 0)
    assert np.array_equal(found.positions, scene.target)


@every_former
def test_nothing_handed_in_is_changed(former):
    scene, applied = scene_and_forces("hookean")
    start, forces = scene.start.copy(), applied.copy()
    former(scene.membrane, start, forces)
    assert np.array_equal(start, scene.start) and np.array_equal(forces, applied)


@pytest.mark.parametrize(("name", "former"), FORMERS.items(), ids=FORMERS)
def test_each_says_what_ran_and_keeps_its_limit(name, former):
    scene, applied = scene_and_forces("hookean")
    assert former(scene.membrane, scene.start, applied).ran == (name,)
    assert former(scene.membrane, scene.start, applied, limit=0).iterations == 0 or name == "newton"
    assert list(signature(former).parameters)[:4] == ["membrane", "positions", "applied", "limit"]


# where Newton is lost


def buckled():
    """Pushing springs a third too long for their square, started far above it: Newton goes round in circles."""
    scene = zoo.grid_scene(20, membrane__rest_scale=0.5)
    membrane = replace(scene.membrane, rest_length=2.6 * scene.membrane.rest_length)
    start = scene.start.copy()
    start[membrane.free] += [0.0, 0.0, 20.0]
    return membrane, start, np.zeros((len(membrane.free), 3))


def crumpled(scale=1.3):
    """A slack cloth without loads, crumpled so that some of it pulls."""
    scene = zoo.grid_scene(8, membrane__springs="tension-only", membrane__rest_scale=0.5)
    membrane = replace(scene.membrane, rest_length=2 * scale * scene.membrane.rest_length)
    start = scene.start.copy()
    start[membrane.free] = np.random.default_rng(0).uniform(0, 1, (len(membrane.free), 3))
    return membrane, start, np.zeros((len(membrane.free), 3))


def test_dynamic_relaxation_takes_over_and_newton_finishes():
    membrane, start, applied = buckled()
    lost = find_equilibrium(membrane, start, applied)
    assert not lost.found and lost.stop in formers.WAYLAID
    found = form_find(membrane, start, applied)
    assert found.found and found.stop is Stop.CONVERGED
    assert found.ran == ("newton", "dynamic-relaxation", "newton")
    assert found.iterations > lost.iterations and found.factorizations > lost.factorizations
    assert (
        np.abs(naive.forces(membrane, found.positions)[membrane.free]).max()
        <= 1e-10 * np.abs(membrane.tension(found.positions)).max()
    )


def test_a_cloth_that_nothing_pulls_rests_where_it_lies():
    membrane, start, applied = crumpled()
    assert not find_equilibrium(membrane, start, applied).found
    found = form_find(membrane, start, applied)
    assert found.found and found.ran == ("newton", "dynamic-relaxation")
    assert membrane.tension(found.positions).max() == 0


def test_where_none_finds_rest_newton_s_reason_stays(monkeypatch):
    """Cut exactly to the square: the tension fades with the distance, and so does what the residual is relative to."""
    monkeypatch.setattr(formers, "RESCUE_LIMIT", 500)
    membrane, start, applied = crumpled(1.0)
    first, found = find_equilibrium(membrane, start, applied), form_find(membrane, start, applied)
    assert not found.found and found.stop is first.stop is Stop.SLACK
    assert found.ran == ("newton", "dynamic-relaxation") and found.iterations == first.iterations + 500


def test_it_does_not_take_over_where_newton_knows():
    scene, applied = scene_and_forces("hookean")
    first = find_equilibrium(scene.membrane, scene.start, applied)
    found = form_find(scene.membrane, scene.start, applied)
    assert np.allclose(found.positions, first.positions, rtol=0, atol=1e-12)  # but for the last digits, which cost a solve or two
    assert found.ran == ("newton",) and found.factorizations == first.factorizations
    loose = Membrane(np.array([[0, 1]]), np.ones(1), np.ones(1), Hookean(), np.zeros(2, dtype=bool))
    gone = form_find(loose, np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 1], [0, 0, 0]]))
    assert gone.stop is Stop.LOST_SUPPORT and gone.ran == ("newton",)


def test_where_newton_cannot_finish_dynamic_relaxation_does(monkeypatch):
    membrane, start, applied = buckled()
    first = find_equilibrium(membrane, start, applied)
    monkeypatch.setattr(formers, "find_equilibrium", lambda *_args, **_more: first)
    found = form_find(membrane, start, applied)
    assert found.found
    assert found.ran == ("newton", "dynamic-relaxation", "newton", "dynamic-relaxation")
