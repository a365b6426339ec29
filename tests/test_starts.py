from dataclasses import replace

import naive
import numpy as np
import pytest
import zoo

from relax.convex.backends import clarabel, working_set
from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.design.starts import (
    HEAVY,
    PULLS,
    TILT,
    at_target,
    choose_starts,
    given,
    is_planted,
    largest_weight,
    pulled,
    resolve_weight,
    unsupported,
)
from relax.errors import EquilibriumError, InputError
from relax.sparsity.penalties import GroupLasso, Power

LASSO = {"penalty__name": "group-lasso", "penalty__weight": 1e-2}


def noisy(**changes):
    return zoo.planted(7, zoo.TWO_MASTS, sigma=0.01, **changes).scene


def dome():
    """Cut to measure on the target itself, of fabric that cannot push: lying flat it is slack through and through."""
    fabric = {"membrane__rest": "target", "membrane__rest_scale": 0.98, "membrane__springs": "tension-only"}
    return zoo.grid_scene(5, lambda x, y: 3 * zoo.hill(x, y), **fabric)


def unbalanced(problem, shape):
    return problem.membrane.forces(shape.positions) + problem.supports.forces(shape.amplitudes) + problem.loads


@pytest.mark.parametrize("backend", [working_set, clarabel])
@pytest.mark.parametrize("loads", [[0, 0, 0], [0.02, 0, -0.05]])
def test_just_above_the_largest_weight_nothing_stands_and_just_below_something_does(backend, loads):
    scene = replace(noisy(membrane__loads=loads, **LASSO), support_weight=np.linspace(0.5, 2, 49))
    problem = Problem(scene)
    shape = unsupported(problem)
    top = largest_weight(problem, shape)
    for factor, count in ((1 + 1e-6, 0), (1 - 1e-4, 1)):
        weights = factor * top * problem.supports.weights
        solution = backend(problem.linearised(shape.positions, shape.factor, weights), shape.amplitudes)
        assert solution.standing.sum() == count
    # and so the whole way: the answer at these weights, not one convex step
    assert solve(problem.replace(weight=top * (1 + 1e-6))).certificate.supports == 0
    assert solve(problem.replace(weight=top * (1 - 1e-3))).certificate.supports == 1


@pytest.mark.parametrize("penalty", [GroupLasso(), Power(0.5, 1e-6), Power(0.8, 1e-4), Power(1.0, 1e-6)])
def test_a_weight_fraction_is_a_share_of_where_no_support_passes_the_judges_dual_test(penalty):
    scene = noisy(penalty__weight=None, penalty__weight_fraction=0.25)
    problem = resolve_weight(Problem(scene, penalty))
    shape = unsupported(problem)
    bare = np.zeros_like(scene.target)
    assert judge(problem, shape.positions, bare).off_support == pytest.approx(4.0, rel=1e-9)
    assert judge(problem.replace(weight=4 * problem.weight), shape.positions, bare).converged
    assert resolve_weight(problem) is problem


def test_no_fraction_of_nothing_is_a_weight():
    """A roof that hangs below its flat shape, and supports that can only push."""
    changes = {"supports__direction": "up", "penalty__weight": None, "penalty__weight_fraction": 0.1}
    problem = Problem(zoo.grid_scene(5, lambda x, y: -zoo.hill(x, y), **changes))
    with pytest.raises(InputError, match=r"^penalty\.weight_fraction: no support .* nearer to the target \(supports\.direction"):
        resolve_weight(problem)


def test_a_weight_that_is_given_stays_and_a_run_resolves_its_own():
    problem = Problem(noisy(penalty__weight=0.5))
    assert resolve_weight(problem) is problem
    scene = noisy(penalty__weight=None, penalty__weight_fraction=0.3)
    design = solve(Problem(scene))
    assert design.problem.weight == design.settings["penalty"]["weight"] == resolve_weight(Problem(scene)).weight
    assert design.settings["penalty"]["weight_fraction"] == 0.3 and scene.settings["penalty"]["weight"] is None
    assert design.certificate.converged and design.certificate.supports > 0


def test_the_unsupported_membrane_rests_and_carries_nothing():
    problem = Problem(noisy(membrane__loads=[0.02, 0, -0.05]))
    shape = unsupported(problem)
    assert not shape.amplitudes.any()
    assert np.abs(unbalanced(problem, shape)).max() < 1e-12
    assert shape.factor.positive_definite and shape.factorizations >= 1


def test_a_membrane_that_does_not_stand_by_itself_is_no_start():
    with pytest.raises(EquilibriumError, match="the membrane without supports does not stand by itself"):
        unsupported(Problem(dome()))


def test_at_the_target_every_force_is_what_its_springs_ask_for():
    planted = zoo.planted(7, zoo.TWO_MASTS)
    problem = Problem(planted.scene)
    shape = at_target(problem)
    np.testing.assert_allclose(shape.positions, planted.positions, atol=1e-12)
    np.testing.assert_allclose(problem.supports.forces(shape.amplitudes), planted.forces[problem.membrane.free], atol=1e-12)
    assert is_planted(problem, shape)
    # with noise a force is asked for everywhere, and the target itself is still at rest
    problem = Problem(noisy())
    shape = at_target(problem)
    np.testing.assert_array_equal(shape.positions, problem.scene.target)
    assert problem.standing(shape.amplitudes).all() and not is_planted(problem, shape)
    assert np.abs(unbalanced(problem, shape)).max() < 1e-12


def test_where_candidates_are_few_the_target_is_met_as_nearly_as_they_allow():
    problem = Problem(noisy(supports__candidates=[24, 25]))
    shape = at_target(problem)
    assert shape.amplitudes.shape == (2, 3) and np.abs(unbalanced(problem, shape)).max() < 1e-12
    assert problem.distance(shape.positions) > 0


def test_a_constant_weight_needs_one_start():
    """Group lasso: a planted target is seen through round-off alone, and elsewhere no first weight leads another way."""
    problem = Problem(zoo.planted(7, **LASSO).scene)
    assert is_planted(problem, at_target(problem))
    problem = Problem(noisy(**LASSO))
    assert not is_planted(problem, at_target(problem))
    said = []
    (start,) = choose_starts(problem, None, said)
    assert (start.name, start.weight) == ("unsupported", None) and not start.shape.amplitudes.any()
    assert "other first weights: the penalty's own never change" in said


def test_a_given_shape_is_brought_to_rest_with_this_scenes_candidates():
    planted = zoo.planted(7, zoo.TWO_MASTS)
    problem = Problem(planted.scene)
    rough = planted.positions + 0.01 * np.cos(np.arange(147).reshape(49, 3))
    shape = given(problem, rough, planted.forces)
    np.testing.assert_allclose(shape.positions, planted.positions, atol=1e-10)
    np.testing.assert_allclose(problem.supports.forces(shape.amplitudes), planted.forces[problem.membrane.free])
    kept, gone = planted.vertices
    less = Problem(zoo.planted(7, zoo.TWO_MASTS, supports__never=[int(gone)]).scene)
    shape = given(less, rough, planted.forces)
    forces = less.all_forces(shape.amplitudes)
    assert np.flatnonzero(forces.any(axis=1)).tolist() == [kept]
    assert np.abs(unbalanced(less, shape)).max() < 1e-12


@pytest.mark.parametrize(
    ("choice", "sigma", "names", "skipped"),
    [
        ("auto", None, ["target"], "a search for other starts: few"),
        ("auto", 0.01, ["pulled"], None),
        ("target", 0.01, ["target"], None),
        ("heavy", None, [f"heavy {share:g}" for share in HEAVY], None),
    ],
)
def test_which_starts_a_run_looks_at_and_what_it_says_of_the_others(choice, sigma, names, skipped):
    problem = Problem(zoo.planted(7, sigma=sigma, solver__start=choice).scene)
    said = []
    starts = choose_starts(problem, None, said)
    assert [start.name for start in starts] == names
    assert [sentence[: len(skipped or "")] for sentence in said] == ([skipped] if skipped else [])
    if len(starts) > 1:
        top = largest_weight(problem, unsupported(problem))
        assert [start.weight / top for start in starts] == pytest.approx(HEAVY)


def test_where_the_bare_membrane_does_not_stand_the_target_is_the_start_and_that_is_said():
    problem = Problem(dome())
    said = []
    assert [start.name for start in choose_starts(problem, None, said)] == ["target"]
    assert said == ["heavy starts: the membrane does not stand without supports"]


def test_a_start_that_is_a_folder_needs_its_arrays():
    problem = Problem(zoo.planted(5, solver__start="../other").scene)
    with pytest.raises(InputError, match=r"solver.start is '../other'"):
        choose_starts(problem, None, [])
    planted = zoo.planted(5)
    (start,) = choose_starts(problem, (planted.positions, planted.forces), [])
    assert (start.name, start.weight) == ("given", None)


def test_a_target_at_which_the_stiffness_is_singular_does_not_end_the_run():
    """Tension-only, all edges of one vertex slack at the target and no candidate near it: K has no inverse there."""
    mesh, flat = zoo.grid(7)
    target = flat.copy()
    near = [16, 17, 18, 23, 24, 25, 30, 31, 32]
    target[near] = flat[24] + 0.3 * (flat[near] - flat[24])
    target[10, 2] = 0.1
    changes = {"membrane__springs": "tension-only", "supports__candidates": [10, 38], "membrane__rest_scale": 0.9}
    scene = zoo.build_scene(zoo.settings(**changes), mesh, target, flat)
    problem = Problem(scene)
    assert problem.factor_at(target).singular
    assert at_target(problem) is None or np.abs(unbalanced(problem, at_target(problem))).max() < 1e-10
    design = solve(problem)
    assert design.certificate.converged and design.certificate.equilibrium <= 1e-10


def stiff_and_pull(problem, share):
    """K + t M and its right-hand side at the flat start, dense."""
    membrane, start = problem.membrane, problem.scene.start
    stiffness = naive.stiffness(membrane, start)
    metric = problem.metric.toarray()
    pull = share * np.trace(stiffness) / np.trace(metric)
    right = naive.forces(membrane, start)[membrane.free] + problem.loads
    return stiffness + pull * metric, right.ravel() - pull * metric @ (start - problem.scene.target)[membrane.free].ravel()


PULLED = {
    "hookean": {},
    "loads": {"membrane__loads": [0.02, 0.0, -0.05]},
    "force density": {"membrane__springs": "force-density"},
    "tension-only": {"membrane__springs": "tension-only"},
    "cables": {"membrane__material": "cables", "membrane__stiffness": 0.3},
}


@pytest.mark.parametrize("name", PULLED)
def test_the_pulled_membrane_solves_its_own_linear_system_and_rests_under_its_forces(name):
    problem = Problem(noisy(**PULLED[name]))
    shape = pulled(problem)
    free = problem.membrane.free
    matrix, right = stiff_and_pull(problem, PULLS[0])
    moved = (shape.positions - problem.scene.start)[free].ravel()
    assert np.linalg.norm(matrix @ moved - right) <= 1e-12 * np.linalg.norm(right)
    wanted = -naive.forces(problem.membrane, shape.positions)[free] - problem.loads
    np.testing.assert_allclose(problem.supports.forces(shape.amplitudes), wanted, atol=1e-13)
    assert shape.factor.positive_definite
    # as the metric is only told up to a factor by the weight beside it, the shape does not know that factor
    told = Problem(replace(problem.scene, metric=1e4 * problem.scene.metric))
    np.testing.assert_allclose(pulled(told).positions, shape.positions, atol=1e-12)


@pytest.mark.parametrize("name", PULLED)
def test_the_highest_peaks_of_the_pulled_forces_are_the_planted_masts(name):
    for seed in range(4):
        planted = zoo.planted(9, zoo.TWO_MASTS, sigma=0.005, seed=seed, **PULLED[name])
        problem = Problem(planted.scene)
        force = np.linalg.norm(problem.all_forces(pulled(problem).amplitudes), axis=1)
        assert sorted(np.argsort(-force)[:2].tolist()) == planted.vertices.tolist()
        assert force[planted.vertices].min() > 2 * np.median(force[problem.membrane.free])


def test_a_stronger_pull_that_would_not_stand_gives_way_to_a_weaker(monkeypatch):
    """Noise that leaves a shape with pushing edges at the first pull: the next, weaker one is taken, and so says its system."""
    problem = Problem(noisy())
    real = Problem.factor_at
    refused = []

    class Fallen:
        positive_definite = False

    def once(self, positions):
        if not refused:
            refused.append(positions)
            return Fallen()
        return real(self, positions)

    monkeypatch.setattr(Problem, "factor_at", once)
    shape = pulled(problem)
    moved = (shape.positions - problem.scene.start)[problem.membrane.free].ravel()
    matrix, right = stiff_and_pull(problem, PULLS[1])
    assert np.linalg.norm(matrix @ moved - right) <= 1e-12 * np.linalg.norm(right)
    monkeypatch.setattr(Problem, "factor_at", lambda *_: Fallen())
    assert pulled(problem) is None


@pytest.mark.parametrize(("n", "sigma"), [(21, 0.0), (21, 0.01), (21, 0.04), (41, 0.02)])
def test_the_noisier_the_target_the_weaker_the_pull(n, sigma):
    """An eighth, and no more than 0.05 of an edge over the noise, which the target alone tells to a tenth."""
    problem = Problem(zoo.planted(n, zoo.TWO_MASTS, sigma=sigma or None).scene)
    edge = np.linalg.norm(problem.membrane.edge_vectors(problem.scene.start), axis=1).mean()
    assert problem.roughness == pytest.approx(sigma / edge, rel=0.1, abs=0.02)
    share = min(PULLS[0], TILT / problem.roughness)
    assert (share < PULLS[0]) == (sigma > 0.5 * edge)
    matrix, right = stiff_and_pull(problem, share)
    moved = (pulled(problem).positions - problem.scene.start)[problem.membrane.free].ravel()
    assert np.linalg.norm(matrix @ moved - right) <= 1e-12 * np.linalg.norm(right)


def test_a_slack_membrane_is_not_pulled():
    assert pulled(Problem(dome())) is None


def test_the_pulled_membrane_rests_under_the_candidates_it_has():
    problem = Problem(noisy(supports__candidates=[24, 25]))
    shape = pulled(problem)
    assert shape.amplitudes.shape == (2, 3) and np.abs(unbalanced(problem, shape)).max() < 1e-12
    whole = pulled(Problem(noisy()))
    np.testing.assert_allclose(shape.amplitudes, Problem(noisy()).all_forces(whole.amplitudes)[[24, 25]], atol=1e-13)
    assert problem.distance(shape.positions) > problem.distance(whole.positions)


@pytest.mark.parametrize(("length", "force"), [(1e-6, 1e3), (1e3, 1e-3), (1e6, 1e6)])
def test_the_pull_knows_no_units(length, force):
    scene = noisy(membrane__loads=[0.02, 0.0, -0.05])
    names = ("target", "clean_target", "start", "rest_length")
    moved = replace(scene, **{name: length * getattr(scene, name) for name in names}, loads=force * scene.loads)
    moved = replace(moved, spring_constant=scene.spring_constant * force / length)
    one, other = pulled(Problem(scene)), pulled(Problem(moved))
    np.testing.assert_allclose(other.positions / length, one.positions, atol=1e-10)
    np.testing.assert_allclose(other.amplitudes / force, one.amplitudes, atol=1e-10)
