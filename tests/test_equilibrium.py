from dataclasses import replace

import naive
import numpy as np
import pytest
import zoo

from relax.factor import Factor
from relax.iterate import Stop
from relax.membrane.equilibrium import find_equilibrium
from relax.membrane.membrane import Membrane
from relax.membrane.springs import SPRINGS, TensionOnly

UP = np.array([[0.0, 0.0, zoo.PYRAMID_FORCE]])
every_law = pytest.mark.parametrize("law", SPRINGS.values(), ids=SPRINGS)


def residual(membrane, x, applied):
    """Largest unbalanced force over the largest of tensions and applied forces, by loops."""
    unbalanced = naive.forces(membrane, x)[membrane.free] + applied
    return np.linalg.norm(unbalanced, axis=1).max() / max(
        np.abs(membrane.tension(x)).max(), np.linalg.norm(applied, axis=1).max()
    )


def loaded(law, load=(0.1, 0.0, -0.4)):
    scene = zoo.irregular_scene(membrane__springs=law.name, membrane__loads=list(load))
    return scene, scene.loads[scene.membrane.free]


# answers by hand


@pytest.mark.parametrize("springs", ["hookean", "tension-only"])
def test_the_pyramid(springs):
    scene = zoo.pyramid(membrane__springs=springs)
    found = find_equilibrium(scene.membrane, scene.start, UP)
    assert found.found
    assert np.allclose(found.positions[4], [0, 0, zoo.PYRAMID_HEIGHT], atol=1e-12)
    spokes = (scene.mesh.edges == 4).any(axis=1)
    assert np.allclose(scene.membrane.tension(found.positions)[spokes], zoo.PYRAMID_TENSION)


def test_the_pyramid_upside_down_under_its_load():
    scene = zoo.pyramid(membrane__loads=[0, 0, -zoo.PYRAMID_FORCE / zoo.PYRAMID_AREA])
    found = find_equilibrium(scene.membrane, scene.start, scene.loads[scene.membrane.free])
    assert np.allclose(found.positions[4], [0, 0, -zoo.PYRAMID_HEIGHT], atol=1e-12)


@pytest.mark.parametrize("pull", [0.0, 1.0, -2.0])
def test_the_line(pull):
    line = zoo.line()
    found = find_equilibrium(line.membrane, line.start, np.array([[pull, 0, 0]]))
    assert found.found
    assert np.allclose(found.positions[1], [line.answer(pull), 0, 0], atol=1e-12)


def test_force_density_is_one_linear_solve():
    scene = zoo.force_density_net()
    applied = scene.loads[scene.membrane.free]
    found = find_equilibrium(scene.membrane, scene.start, applied)
    assert found.found
    assert np.allclose(found.positions, naive.force_density_shape(scene.membrane, scene.start, applied), atol=1e-13)
    assert (found.iterations, found.factorizations) == (1, 1)


# physics


@every_law
def test_every_vertex_is_in_balance_and_held_ones_stay(law):
    scene, applied = loaded(law)
    found = find_equilibrium(scene.membrane, scene.start, applied)
    assert found.stop is Stop.CONVERGED
    assert found.residual <= 1e-12
    assert residual(scene.membrane, found.positions, applied) == pytest.approx(found.residual, abs=1e-14)
    assert np.array_equal(found.positions[scene.fixed], scene.start[scene.fixed])
    # shape and applied forces are those asked for, not those of an early exit
    assert np.abs(found.positions - scene.start).max() > 0.01


@every_law
def test_reactions_balance_the_loads(law):
    scene, applied = loaded(law)
    x = find_equilibrium(scene.membrane, scene.start, applied).positions
    held = np.flatnonzero(scene.fixed)
    reactions = -naive.forces(scene.membrane, x)[held]
    assert np.allclose(reactions.sum(axis=0) + applied.sum(axis=0), 0, atol=1e-12)
    moments = np.cross(x[held], reactions).sum(axis=0) + np.cross(x[scene.membrane.free], applied).sum(axis=0)
    assert np.allclose(moments, 0, atol=1e-12)


@every_law
def test_two_starts_one_answer(law):
    scene, applied = loaded(law)
    far = scene.start.copy()
    far[scene.membrane.free] += np.random.default_rng(1).normal(0, 0.3, applied.shape)
    one, other = (find_equilibrium(scene.membrane, start, applied) for start in (scene.start, far))
    assert one.found and other.found
    assert np.allclose(one.positions, other.positions, atol=1e-10)


@pytest.mark.parametrize("rest_scale", [0.7, 1.1])
@every_law
def test_units_change_nothing(law, rest_scale):
    scene = zoo.grid_scene(6, lambda x, y: 4 * zoo.hill(x, y), membrane__springs=law.name, membrane__rest_scale=rest_scale)
    membrane, applied = scene.membrane, np.tile([0.0, 0.01, -0.05], (16, 1))
    # metres and newtons to millimetres and kilonewtons; rest_scale 1.1 starts slack
    other = replace(membrane, rest_length=1e3 * membrane.rest_length, spring_constant=1e-6 * membrane.spring_constant)
    one = find_equilibrium(membrane, scene.start, applied)
    two = find_equilibrium(other, 1e3 * scene.start, 1e-3 * applied)
    assert one.found and two.found
    assert np.allclose(two.positions, 1e3 * one.positions, atol=1e-5)
    assert two.factorizations == pytest.approx(one.factorizations, abs=2)  # round-off may cost a step


def test_the_shape_found_is_a_minimum_of_the_potential():
    scene, applied = loaded(SPRINGS["hookean"])
    x = find_equilibrium(scene.membrane, scene.start, applied).positions
    rng = np.random.default_rng(2)
    free = scene.membrane.free

    def potential(y):
        return naive.energy(scene.membrane, y) - np.vdot(applied, y[free])

    for _ in range(10):
        y = x.copy()
        y[free] += rng.normal(0, 1e-3, applied.shape)
        assert potential(y) > potential(x)


@pytest.mark.parametrize("rest_scale", [1.0, 1.05, 1.3])
@pytest.mark.parametrize("springs", ["hookean", "tension-only"])
def test_without_prestress_it_still_hangs(springs, rest_scale):
    scene = zoo.grid_scene(6, lambda x, y: 4 * zoo.hill(x, y), membrane__springs=springs, membrane__rest_scale=rest_scale)
    applied = np.tile([0.0, 0.0, -0.05], (16, 1))
    found = find_equilibrium(scene.membrane, scene.start, applied)
    assert found.found
    assert residual(scene.membrane, found.positions, applied) <= 1e-10
    assert found.positions[scene.membrane.free, 2].max() < 0


# what it says when it is lost


@every_law
def test_a_part_that_lost_its_support(law):
    found = find_equilibrium(*zoo.loose(law), zoo.LOST)
    assert not found.found
    assert found.stop is Stop.LOST_SUPPORT


def test_a_loose_part_under_balanced_forces_needs_no_support():
    found = find_equilibrium(*zoo.loose(SPRINGS["hookean"]), zoo.BALANCED)
    assert found.found
    assert np.allclose(np.diff(found.positions[:, 0]), 1.3)


def test_out_of_steps_in_a_slack_region():
    scene = zoo.pyramid(membrane__springs="tension-only", membrane__rest_scale=1.2)
    found = find_equilibrium(scene.membrane, scene.start, UP, limit=1)
    assert not found.found
    assert found.stop is Stop.SLACK
    assert find_equilibrium(scene.membrane, scene.start, UP).found


def test_out_of_steps_in_a_mechanism():
    """Two springs in line at their rest lengths resist nothing across until they are stretched."""
    line = Membrane(np.array([[0, 1], [1, 2]]), np.ones(2), np.ones(2), TensionOnly(), np.array([True, False, True]))
    start = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    across = np.array([[0.0, 0, 1]])
    found = find_equilibrium(line, start, across, limit=1)
    assert not found.found
    assert found.stop is Stop.MECHANISM
    z = find_equilibrium(line, start, across).positions[1, 2]
    assert 2 * (np.hypot(1, z) - 1) * z / np.hypot(1, z) == pytest.approx(1, rel=1e-12)


def test_out_of_steps_with_nothing_amiss():
    pendulum = Membrane(np.array([[0, 1]]), np.ones(1), np.ones(1), TensionOnly(), np.array([True, False]))
    start = np.array([[0.0, 0, 0], [1.2, 0, 0]])
    assert find_equilibrium(pendulum, start, np.array([[0.0, 0, 1]]), limit=2).stop is Stop.LIMIT
    found = find_equilibrium(pendulum, start, np.array([[0.0, 0, 1]]))
    assert np.allclose(found.positions[1], [0, 0, 2], atol=1e-9)


def test_figures_that_are_not_finite():
    scene = zoo.pyramid()
    found = find_equilibrium(scene.membrane, scene.start, np.array([[0.0, 0.0, np.nan]]))
    assert not found.found
    assert found.stop is Stop.NON_FINITE


@pytest.mark.parametrize("limit", range(14))
@pytest.mark.parametrize("rest_scale", [0.75, 1.2])
def test_found_is_true_of_balanced_shapes_alone(limit, rest_scale):
    scene = zoo.pyramid(membrane__springs="tension-only", membrane__rest_scale=rest_scale)
    found = find_equilibrium(scene.membrane, scene.start, UP, limit=limit)
    assert found.iterations <= limit
    assert found.found == (residual(scene.membrane, found.positions, UP) <= 1e-10)
    assert found.found or found.stop is not Stop.CONVERGED


# factorisations


def test_chord_steps_spare_factorisations():
    scene, applied = loaded(SPRINGS["hookean"])
    first = find_equilibrium(scene.membrane, scene.start, applied)
    assert 0 < first.factorizations < first.iterations
    there = Factor(scene.membrane.stiffness(first.positions))
    warm = find_equilibrium(scene.membrane, first.positions, 1.01 * applied, there)
    cold = find_equilibrium(scene.membrane, first.positions, 1.01 * applied)
    assert warm.found and warm.factorizations == 0 < cold.factorizations
    assert np.allclose(warm.positions, cold.positions, atol=1e-11)
    assert warm.factor is there


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3, -1.0])
def test_a_factor_of_no_use_does_no_harm(scale):
    scene, applied = loaded(SPRINGS["hookean"])
    useless = Factor(scale * scene.membrane.stiffness(scene.start))
    with_it, without = (find_equilibrium(scene.membrane, scene.start, applied, factor) for factor in (useless, None))
    assert with_it.found and np.allclose(with_it.positions, without.positions, atol=1e-11)
    assert with_it.factorizations <= without.factorizations


def test_a_support_that_moves_by_a_vertex_takes_one_factorisation():
    """The stiffness has changed around two vertices: chord steps by that of before come near, plain ones do not."""
    planted = zoo.planted(13, zoo.TWO_MASTS)
    membrane = planted.scene.membrane
    rests = planted.positions
    old = Factor(membrane.stiffness(rests))
    forces = planted.forces.copy()
    vertex = planted.vertices[0]
    forces[vertex + 1], forces[vertex] = forces[vertex], 0.0
    applied = (forces + planted.scene.loads)[membrane.free]
    guess = rests.copy()
    guess[membrane.free] += old.solve((forces - planted.forces)[membrane.free])
    warm, cold = (find_equilibrium(membrane, guess, applied, factor) for factor in (old, None))
    assert warm.found and np.allclose(warm.positions, cold.positions, atol=1e-10)
    assert warm.factorizations <= 1
    plain = guess.copy()
    for _ in range(warm.iterations):
        plain[membrane.free] += old.solve(membrane.forces(plain) + applied)
    assert residual(membrane, plain, applied) > 1e-3


@pytest.mark.parametrize("seed", [1, 2, 8, 18, 19, 20])
def test_chord_steps_do_not_undo_what_newton_gained(seed):
    """Slack fabric that few forces pull: by the potential and by the residual in turns it went round in circles."""
    scene = zoo.grid_scene(9, membrane__springs="tension-only", membrane__rest_scale=0.5)
    slack = replace(scene.membrane, rest_length=2.04 * scene.membrane.rest_length)
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-2, 1.5)
    applied = np.zeros((len(slack.free), 3))
    for _ in range(1 + seed % 3):
        applied[rng.integers(len(applied))] += np.array([*rng.normal(0, 0.3, 2), 1]) * size * rng.uniform(0.3, 1)
    if seed % 2:
        applied[:, 2] -= 10 ** rng.uniform(-2, 1) / len(applied)
    found = find_equilibrium(slack, scene.start, applied)
    assert found.found and found.iterations < 60


def test_a_chord_step_that_leads_astray_is_not_taken():
    """By a stiffness a millionth of the true one the first step lands far away: Newton goes on from where it began."""
    scene, applied = loaded(SPRINGS["tension-only"])
    soft = Factor(1e-6 * scene.membrane.stiffness(scene.start))
    asked = []
    found = find_equilibrium(scene.membrane, scene.start, applied, soft, hopeless=lambda x: bool(asked.append(x)))
    assert found.found
    size = np.ptp(scene.start, axis=0).max()
    assert all(np.abs(x - scene.start).max() < size for x in asked)


def test_it_is_broken_off_where_it_is_told_to():
    scene, applied = loaded(SPRINGS["hookean"])
    asked = []

    def enough(positions):
        asked.append(positions)
        return len(asked) == 3

    found = find_equilibrium(scene.membrane, scene.start, applied, hopeless=enough)
    assert not found.found and found.stop is Stop.HOPELESS and found.iterations == 2
    assert np.array_equal(found.positions, asked[-1]) and np.array_equal(asked[0], scene.start)


def test_at_rest_already_nothing_is_done():
    scene = zoo.pyramid()
    found = find_equilibrium(scene.membrane, scene.target, UP)
    assert (found.iterations, found.factorizations, found.factor) == (0, 0, None)
    assert np.array_equal(found.positions, scene.target)
