from dataclasses import dataclass, replace

import naive
import numpy as np
import pytest
import zoo

from relax.iterate import Stop
from relax.membrane import dynamic_relaxation
from relax.membrane.dynamic_relaxation import MARGIN, relax_dynamically
from relax.membrane.equilibrium import find_equilibrium
from relax.membrane.force_density import ConstantTension
from relax.membrane.membrane import Membrane
from relax.membrane.rest import Balance, differences, stiffness_bound
from relax.membrane.springs import SPRINGS, Hookean, TensionOnly

UP = np.array([[0.0, 0.0, zoo.PYRAMID_FORCE]])
every_law = pytest.mark.parametrize("law", SPRINGS.values(), ids=SPRINGS)


def loaded(law=SPRINGS["hookean"], **changes):
    scene = zoo.irregular_scene(membrane__springs=law.name, membrane__loads=[0.1, 0.0, -0.4], **changes)
    return scene, scene.loads[scene.membrane.free]


def slack(n=8, scale=1.2, law="tension-only"):
    """Longer edges than the flat square has room for."""
    scene = zoo.grid_scene(n, membrane__springs=law, membrane__rest_scale=0.5)
    membrane = replace(scene.membrane, rest_length=2 * scale * scene.membrane.rest_length)
    return membrane, scene.start, np.zeros((len(membrane.free), 3))


# the method


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 20, 60, 150])
def test_each_explicit_step_is_the_naive_one(steps):
    scene, applied = loaded()
    found = relax_dynamically(scene.membrane, scene.start, applied, limit=steps, aim=0.0)
    x = naive.dynamic_relaxation(scene.membrane, scene.start, applied, steps, MARGIN)
    assert found.iterations == steps
    assert np.abs(x - scene.start).max() > 1e-3
    assert np.allclose(found.positions, x, rtol=0, atol=1e-12)


def test_a_batch_that_ends_before_a_peak_swings_on(monkeypatch):
    scene, applied = loaded()
    whole = relax_dynamically(scene.membrane, scene.start, applied)
    monkeypatch.setattr(dynamic_relaxation, "BATCH", 3)
    cut = relax_dynamically(scene.membrane, scene.start, applied)
    assert cut.found and abs(cut.iterations - whole.iterations) <= 3
    assert np.allclose(cut.positions, whole.positions, atol=1e-10)


@pytest.mark.parametrize("stretch", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("law", [*SPRINGS.values(), ConstantTension()], ids=lambda law: law.name)
def test_no_frequency_is_beyond_the_step(law, stretch):
    """Leap-frog with a unit step is stable while the largest eigenvalue of M^-1 K is at most 4."""
    scene, _ = loaded()
    membrane = replace(scene.membrane, springs=law)
    x = scene.start + np.random.default_rng(0).normal(0, 0.1 * stretch, scene.start.shape)
    x *= stretch
    mass = MARGIN / 2 * (abs(differences(membrane)[0]).T @ stiffness_bound(membrane, x))
    root = np.repeat(np.sqrt(mass), 3)
    largest = np.linalg.eigvalsh(naive.stiffness(membrane, x) / root[:, None] / root)[-1]
    assert largest <= 4 / MARGIN
    assert largest > 0.8 or stretch < 1


def test_the_bound_is_tight():
    """A chain swings along itself at the limit: with less than half the masses the same step would blow up."""
    count = 40
    edges = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    fixed = np.isin(np.arange(count + 1), [0, count])
    chain = Membrane(edges, np.full(count, 0.5), np.ones(count), Hookean(), fixed)
    x = np.column_stack([np.arange(count + 1.0), np.zeros((count + 1, 2))])
    mass = MARGIN / 2 * (abs(differences(chain)[0]).T @ stiffness_bound(chain, x))
    root = np.repeat(np.sqrt(mass), 3)
    assert np.linalg.eigvalsh(naive.stiffness(chain, x) / root[:, None] / root)[-1] == pytest.approx(4 / MARGIN, rel=0.01)


def test_the_first_peak_of_a_slow_swing_is_at_rest(monkeypatch):
    """One linear oscillator is fastest where it is in balance; with heavy masses the parabola meets that closely."""
    monkeypatch.setattr(dynamic_relaxation, "MARGIN", 100.0)
    line = zoo.line()
    for steps in range(1, 40):
        found = relax_dynamically(line.membrane, line.start, np.array([[2.0, 0, 0]]), limit=steps, aim=0.0)
        if found.positions[1, 0] > line.answer(2.0) - 1e-2:
            break
    # the step after the one that overshot goes back to the peak
    found = relax_dynamically(line.membrane, line.start, np.array([[2.0, 0, 0]]), limit=steps + 1, aim=0.0)
    assert 5 < steps < 39
    assert found.positions[1, 0] == pytest.approx(line.answer(2.0), abs=2e-3)


@pytest.mark.parametrize("rest", [0.7, 0.9])
def test_fast_swings_do_not_hold_up_the_slow_ones(rest):
    """Kinetic energy that peaks at every other step stops everything; two vertices a side more are a few steps more."""
    counts = []
    for n in range(12, 20):
        scene = zoo.grid_scene(n, membrane__rest_scale=rest)
        applied = np.zeros((len(scene.membrane.free), 3))
        applied[len(applied) // 3] = [0.02, 0.0, 0.1]
        counts.append(relax_dynamically(scene.membrane, scene.start, applied).iterations)
    assert max(counts) <= 2 * min(counts)


def test_nothing_is_factorised(monkeypatch):
    def refuse(*_):
        raise AssertionError("a factorisation")

    for name in ("factor_at", "lifted_factor_at", "stiffness"):
        monkeypatch.setattr(Membrane, name, refuse)
    scene, applied = loaded()
    found = relax_dynamically(scene.membrane, scene.start, applied)
    assert found.found and (found.factorizations, found.factor, found.ran) == (0, None, ("dynamic-relaxation",))


@dataclass(frozen=True)
class Stiffening:
    """A spring that stiffens as it stretches: tension s + 40 s^3 of the stretch s, in constants."""

    name: str = "stiffening"

    def energy(self, length, rest, constant):
        return constant * ((length - rest) ** 2 / 2 + 10 * (length - rest) ** 4)

    def tension(self, length, rest, constant):
        return constant * ((length - rest) + 40 * (length - rest) ** 3)

    def stiffness(self, length, rest, constant):
        return constant * (1 + 120 * (length - rest) ** 2)

    def stiffness_slope(self, length, rest, constant):
        return 240 * constant * (length - rest)


def test_masses_follow_a_law_that_stiffens():
    scene = zoo.pyramid()
    membrane = replace(scene.membrane, springs=Stiffening())
    found = relax_dynamically(membrane, scene.start, 100 * UP)
    newton = find_equilibrium(membrane, scene.start, 100 * UP)
    at_start, at_rest = (stiffness_bound(membrane, x).max() for x in (scene.start, found.positions))
    assert at_rest > 5 * at_start  # with the first masses the end would be unstable
    assert found.found and np.allclose(found.positions, newton.positions, atol=1e-9)


# answers


@pytest.mark.parametrize("springs", ["hookean", "tension-only"])
def test_the_pyramid(springs):
    scene = zoo.pyramid(membrane__springs=springs)
    found = relax_dynamically(scene.membrane, scene.start, UP)
    assert found.stop is Stop.CONVERGED
    assert np.allclose(found.positions[4], [0, 0, zoo.PYRAMID_HEIGHT], atol=1e-9)


@pytest.mark.parametrize("start", ["folded", "far", "as one"])
@pytest.mark.parametrize("law", ["hookean", "tension-only"])
def test_bad_starts_come_to_the_same_rest(law, start):
    scene, applied = loaded(SPRINGS[law])
    x = scene.start.copy()
    free = scene.membrane.free
    rng = np.random.default_rng(3)
    x[free] = {"folded": rng.uniform(0, 1, applied.shape), "far": rng.normal(0, 30, applied.shape), "as one": [0.5, 0.4, 2]}[
        start
    ]
    found = relax_dynamically(scene.membrane, x, applied)
    assert found.found
    assert np.array_equal(found.positions[scene.fixed], scene.start[scene.fixed])
    rest = find_equilibrium(scene.membrane, scene.start, applied).positions
    assert np.allclose(found.positions, rest, atol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 1.2])
def test_a_slack_membrane_under_its_load(scale):
    membrane, start, applied = slack(scale=scale)
    applied[:, 2] = -1e-3
    found = relax_dynamically(membrane, start, applied)
    assert found.found
    unbalanced = naive.forces(membrane, found.positions)[membrane.free] + applied
    assert np.linalg.norm(unbalanced, axis=1).max() <= 1e-10 * membrane.tension(found.positions).max()
    assert found.positions[membrane.free, 2].max() < 0


def test_a_slack_membrane_without_load_lies_anywhere():
    membrane, start, applied = slack()
    start = start + np.where(membrane.fixed[:, None], 0.0, np.random.default_rng(0).normal(0, 0.3, start.shape))
    assert membrane.tension(start).max() > 0
    found = relax_dynamically(membrane, start, applied)
    assert found.found and membrane.tension(found.positions).max() == 0


def test_units_change_nothing():
    scene, applied = loaded()
    one = relax_dynamically(scene.membrane, scene.start, applied)
    two = relax_dynamically(*zoo.rest_in_millimetres(scene.membrane, scene.start, applied))
    assert np.allclose(two.positions, 1e3 * one.positions, atol=1e-6)
    assert two.iterations == pytest.approx(one.iterations, rel=0.1)


# why it stops


@every_law
def test_a_part_that_lost_its_support(law):
    loose, start = zoo.loose(law)
    found = relax_dynamically(loose, start, zoo.LOST)
    assert not found.found and found.stop is Stop.LOST_SUPPORT
    held = relax_dynamically(loose, start, zoo.BALANCED)
    assert held.found


def test_a_vertex_on_no_edge_goes_where_it_is_pushed():
    membrane = Membrane(np.array([[0, 1]]), np.array([0.8]), np.ones(1), TensionOnly(), np.array([True, False, False]))
    start = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert relax_dynamically(membrane, start, np.array([[0, 0, 0], [0, 0, 1.0]])).stop is Stop.LOST_SUPPORT


def test_pushing_force_densities_do_not_stand():
    scene = zoo.force_density_net()
    membrane = replace(scene.membrane, spring_constant=-scene.membrane.spring_constant)
    assert relax_dynamically(membrane, scene.start, scene.loads[membrane.free]).stop is Stop.LOST_SUPPORT


def test_figures_that_are_not_finite():
    scene = zoo.pyramid()
    found = relax_dynamically(scene.membrane, scene.start, np.array([[0.0, 0.0, np.nan]]))
    assert not found.found and found.stop is Stop.NON_FINITE


@pytest.mark.parametrize("limit", [0, 1, 10, 100, 150, 200, 250, 300, 1000])
def test_found_is_true_of_balanced_shapes_alone(limit):
    scene, applied = loaded()
    found = relax_dynamically(scene.membrane, scene.start, applied, limit=limit)
    unbalanced = naive.forces(scene.membrane, found.positions)[scene.membrane.free] + applied
    scale = max(np.abs(scene.membrane.tension(found.positions)).max(), np.linalg.norm(applied, axis=1).max())
    assert found.iterations <= limit
    assert found.found == (np.linalg.norm(unbalanced, axis=1).max() / scale <= 1e-10)
    assert found.stop is (Stop.CONVERGED if found.found else Stop.LIMIT)


def test_round_off_above_the_aim_is_no_reason_to_go_on():
    scene, applied = loaded()
    found = relax_dynamically(scene.membrane, scene.start, applied, aim=0.0)
    assert found.stop is Stop.CONVERGED and found.iterations < 5000
    # a thousand kilometres from the origin nothing finer than 1e-10 can be seen; it says so in time
    off = relax_dynamically(scene.membrane, scene.start + 1e3, applied)
    assert off.found and off.iterations < 5000


def test_what_the_digits_of_the_potential_are_counted_from():
    """Where energy and work cancel, round-off does not shrink with their difference."""
    scene = zoo.pyramid()
    balance = Balance(scene.membrane, UP, scene.start)
    work = zoo.PYRAMID_FORCE * np.abs(scene.target - scene.start[0]).max()
    assert balance.magnitude(scene.target) == pytest.approx(abs(balance.potential(scene.target)) + work, rel=1e-12)
    moved = scene.target + np.array([1e6, 0, 0])
    assert Balance(scene.membrane, UP, moved).magnitude(moved) == pytest.approx(balance.magnitude(scene.target), rel=1e-6)
