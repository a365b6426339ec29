"""The judge against its dense twin, and each figure made to fail."""

from dataclasses import replace

import numpy as np
import pytest
import zoo
from naive_judge import differences, felt, naive_figures, nearest, result_arrays

from relax.design.optimality import Certificate, judge
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.membrane.equilibrium import find_equilibrium

SPRINGS = ("hookean", "tension-only", "force-density")
PENALTIES = {
    "power": {"penalty__exponent": 0.5, "penalty__weight": 5e-3},
    "power, alpha 0.8": {"penalty__exponent": 0.8, "penalty__weight": 5e-3, "penalty__smoothing": 1e-5},
    "power, alpha 1": {"penalty__exponent": 1.0, "penalty__weight": 5e-3},
    "group lasso": {"penalty__name": "group-lasso", "penalty__weight": 5e-3},
    "log-sum": {"penalty__name": "log-sum", "penalty__scale": 0.1, "penalty__weight": 5e-3},
    "mcp": {"penalty__name": "mcp", "penalty__knee": 0.2, "penalty__weight": 5e-3},
    "scad": {"penalty__name": "scad", "penalty__knee": 0.05, "penalty__shape": 3.7, "penalty__weight": 5e-3},
    "count": {"penalty__name": "count", "penalty__weight": 5e-3},
}
REACHES = {
    "vertical": {"supports__direction": "vertical"},
    "up": {"supports__direction": "up", "target__metric": "height"},
    "lean 0": {"supports__direction": {"lean": 0.0}},
    "lean 30": {"supports__direction": {"lean": 30.0}},
    "lean 90": {"supports__direction": {"lean": 90.0}},
    "capped": {"supports__max_force": 0.08},
    "vertical, capped": {"supports__direction": "vertical", "supports__max_force": 0.08},
    "up, capped": {"supports__direction": "up", "supports__max_force": 0.08},
    "lean 20, capped": {"supports__direction": {"lean": 20.0}, "supports__max_force": 0.08, "target__metric": "normal"},
}
KEPT = {"supports__always": [16, 24], "supports__weights": "height", "supports__ground": -0.1}


def scene_with(**changes):
    """A noisy tent with loads, forbidden vertices and uneven group weights."""
    never = [10, 11]
    scene = zoo.planted(7, sigma=0.01, membrane__loads=[0.02, 0, -0.05], supports__never=never, **changes).scene
    return replace(scene, support_weight=np.linspace(0.5, 2.0, scene.mesh.vertices))


def at_rest(problem, forces):
    """Positions at equilibrium under forces (V, 3)."""
    free = problem.membrane.free
    found = find_equilibrium(problem.membrane, problem.scene.start, forces[free] + problem.loads)
    assert found.found, found.stop
    return found.positions


def compared(problem, positions, forces, refit="penalised"):
    """The certificate, found equal to the dense twin's figures."""
    said = judge(problem, positions, forces, refit)
    given = problem.scene.settings
    settings = given | {"rounding": {"refit": refit}, "penalty": given["penalty"] | {"weight": problem.weight}}
    mine = naive_figures(result_arrays(problem.scene, positions, forces), settings)
    assert said.figures().keys() == mine.keys()
    assert differences(said.figures(), mine) == []
    return said


@pytest.fixture(scope="module")
def design():
    """A converged answer with one support on a noisy target, for the perturbations."""
    return solve(Problem(zoo.planted(9, sigma=0.01, penalty__weight=1e-2).scene))


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("springs", SPRINGS)
def test_every_figure_is_what_dense_matrices_say_anywhere(springs, penalty):
    """At shapes that are no solution, in equilibrium and out of it, with three forces, one, and none."""
    problem = Problem(scene_with(membrane__springs=springs, **PENALTIES[penalty]))
    rng = np.random.default_rng(0)
    stands = problem.membrane.free[[3, 8, 16]]
    for refit in ("penalised", "debiased"):
        for count in (3, 1, 0):
            forces = np.zeros_like(problem.scene.target)
            forces[stands[:count]] = rng.normal(0, 0.1, (count, 3))
            positions = at_rest(problem, forces)
            assert compared(problem, positions, forces, refit).equilibrium < 1e-10
            positions = positions.copy()
            positions[~problem.scene.fixed] += rng.normal(0, 0.01, (len(problem.membrane.free), 3))
            assert compared(problem, positions, forces, refit).equilibrium > 1e-4


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("springs", SPRINGS)
def test_what_the_solver_ends_at_is_converged_for_the_twin_too(springs, penalty):
    problem = Problem(scene_with(membrane__springs=springs, **PENALTIES[penalty]))
    design = solve(problem)
    said = compared(problem, design.positions, design.forces)
    assert said == design.certificate
    assert said.converged and said.supports > 0 and said.warnings == ()


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("reach", REACHES)
def test_supports_that_cannot_do_everything_are_judged_as_the_twin_judges_them(reach, penalty):
    """Forces within reach, which lie on its edges, and beyond; two supports kept whatever comes, with a force and without."""
    changes = {**REACHES[reach], **PENALTIES[penalty], "supports__never": [10], **KEPT}
    scene = zoo.planted(7, zoo.TWO_MASTS, 0.01, **changes).scene
    problem, asked = Problem(scene), scene.settings["supports"]
    rng = np.random.default_rng(1)
    met = []
    for stands in ([8, 16, 24, 30], [8, 30], [24], []):
        wild = np.zeros_like(scene.target)
        for vertex in stands:
            wild[vertex] = felt(rng.normal(0, 0.2, 3) if vertex > 8 else np.array([0.1, -0.1, -0.2]), asked)
        for forces in (wild, np.array([nearest(force, asked) for force in wild])):
            positions = at_rest(problem, forces)
            for refit in ("penalised", "debiased"):
                said = compared(problem, positions, forces, refit)
            met.append(not any("supports.direction" in sentence for sentence in said.warnings))
    assert all(met[1::2]) and (reach == "vertical" or not met[0])


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("reach", ["lean 30", "lean 20, capped"])
def test_answers_on_the_edges_of_the_reach_are_converged_for_the_twin_too(reach, penalty):
    problem = Problem(zoo.planted(7, zoo.TWO_MASTS, 0.01, **{**REACHES[reach], **PENALTIES[penalty], **KEPT}).scene)
    design = solve(problem)
    said = compared(problem, design.positions, design.forces)
    assert said == design.certificate and said.converged and said.supports > 0


@pytest.mark.parametrize("direction", ["vertical", "up"])
def test_a_sideways_force_where_supports_are_vertical_is_not_accepted(direction):
    problem = Problem(zoo.planted(7, supports__direction=direction).scene)
    found = solve(problem)
    forces = found.forces.copy()
    forces[24, 0] = 1e-6
    said = judge(problem, at_rest(problem, forces), forces)
    assert found.certificate.converged and not said.converged and "supports.direction" in said.warnings[-1]


def test_a_debiased_answer_is_stationary_without_the_penalty_alone():
    problem = Problem(zoo.planted(9, sigma=0.01, penalty__weight=1e-2, rounding__refit="debiased").scene)
    design = solve(problem)
    said = compared(problem, design.positions, design.forces, "debiased")
    assert said == design.certificate and said.converged and said.supports == 1
    other = compared(problem, design.positions, design.forces, "penalised")
    assert other.stationarity > 0.1 and not other.converged
    # only stationarity and what follows from it depend on the last solve
    assert replace(other, stationarity=said.stationarity, converged=True) == said


def test_the_pyramid_by_hand():
    scene = zoo.pyramid(penalty__weight=0.5, penalty__name="group-lasso")
    problem = Problem(scene)
    forces = np.zeros((5, 3))
    forces[4, 2] = zoo.PYRAMID_FORCE
    said = judge(problem, scene.target, forces)
    # nothing is off the target, so lam = 0 and the whole slope of R is what is left: 1 in units of the mean slope
    edges = scene.mesh.edges
    rim = scene.target[edges[:, 1]] - scene.target[edges[:, 0]]
    rim_tension = scene.spring_constant[0] * (np.linalg.norm(rim[0]) - scene.rest_length[0])
    assert said.figures() == pytest.approx(
        {
            "objective": 0.6,
            "distance": 0.0,
            "penalty": 0.6,
            "rms_distance": 0.0,
            "supports": 1,
            "equilibrium": 0.0,
            "stationarity": 1.0,
            "off_support": 0.0,
            "stable": True,
            "tension_min": min(zoo.PYRAMID_TENSION, rim_tension),
            "tension_max": max(zoo.PYRAMID_TENSION, rim_tension),
            "slack_share": 0.0,
            "converged": False,
        },
        abs=1e-15,
    )
    assert judge(problem, scene.target, forces, "debiased").converged
    assert problem.slope_scale(forces[4:]) == pytest.approx(0.5)
    assert problem.slope_scale(0 * forces[4:]) == 1.0


def test_figures_have_the_names_of_the_format():
    names = "objective distance penalty rms_distance supports equilibrium stationarity off_support stable tension_min"
    assert set(names.split()) | {"tension_max", "slack_share", "converged"} == set(Certificate.__dataclass_fields__) - {
        "warnings"
    }


def test_a_vertex_off_its_place_is_no_equilibrium(design):
    problem = design.problem
    assert design.certificate.converged
    positions = design.positions.copy()
    positions[40, 2] += 1e-9
    said = compared(problem, positions, design.forces)
    assert 1e-10 < said.equilibrium < 1e-7 and not said.converged
    assert said.stationarity < 1e-6 and said.stable
    # nothing but equilibrium is wrong
    settings = problem.scene.settings
    lax = replace(problem.scene, settings=settings | {"solver": settings["solver"] | {"tolerance": 1.0}})
    assert judge(Problem(lax), design.positions, design.forces).converged
    assert not judge(Problem(lax), positions, design.forces).converged


def test_a_force_a_little_wrong_is_not_stationary(design):
    problem = design.problem
    forces = design.forces * (1 + 1e-6)
    said = compared(problem, at_rest(problem, forces), forces)
    assert said.equilibrium <= 1e-10 and said.off_support < 1
    assert 1e-8 < said.stationarity < 1e-3 and not said.converged


def test_a_support_left_out_is_missed(design):
    problem = design.problem.replace(weight=1e-3)
    forces = 0 * design.forces
    said = compared(problem, at_rest(problem, forces), forces)
    assert (said.supports, said.penalty, said.stationarity) == (0, 0.0, 0.0)
    assert said.off_support > 1 and said.equilibrium <= 1e-10 and not said.converged


def test_a_support_in_a_forbidden_place_is_not_accepted(design):
    (vertex,) = np.flatnonzero(design.forces.any(axis=1))
    candidates = design.problem.scene.candidates.copy()
    candidates[vertex] = False
    problem = Problem(replace(design.problem.scene, candidates=candidates))
    said = compared(problem, design.positions, design.forces)
    # the force is there for equilibrium, but no support: only the rule on candidates can see it
    assert said.supports == 0 and said.equilibrium <= 1e-10 and not said.converged
    assert any("where the scene allows none" in sentence for sentence in said.warnings)


def test_a_force_on_a_fixed_vertex_is_not_accepted(design):
    forces = design.forces.copy()
    forces[0, 2] = 1.0
    said = judge(design.problem, design.positions, forces)
    assert not said.converged
    assert replace(said, converged=True, warnings=()) == design.certificate


def test_the_tolerance_is_the_scenes_own(design):
    settings = design.problem.scene.settings
    for tolerance, met in ((design.certificate.stationarity, True), (0.99 * design.certificate.stationarity, False)):
        strict = replace(design.problem.scene, settings=settings | {"solver": settings["solver"] | {"tolerance": tolerance}})
        assert judge(Problem(strict), design.positions, design.forces).converged is met


def test_a_pushing_membrane_is_slack_and_does_not_stand():
    """The flat square with rest lengths 1.12 times too long: in equilibrium by symmetry, ready to buckle."""
    scene = zoo.grid_scene(7)
    scene = replace(scene, rest_length=1.6 * scene.rest_length)
    said = compared(Problem(scene), scene.start, np.zeros_like(scene.start))
    assert said.equilibrium <= 1e-10 and said.off_support == pytest.approx(0, abs=1e-12)
    assert not said.stable and said.slack_share == 1.0 and said.tension_max < 0 and not said.converged
    assert any("100.0% of the edges are slack" in sentence for sentence in said.warnings)
    assert any("does not stand" in sentence for sentence in said.warnings)


def test_the_share_of_slack_edges_is_counted_and_said(design):
    rest = design.problem.scene.rest_length.copy()
    rest[[3, 5, 8]] = 1.0
    said = compared(Problem(replace(design.problem.scene, rest_length=rest)), design.positions, design.forces)
    assert said.slack_share == pytest.approx(3 / len(rest))
    assert said.tension_min < 0
    assert any(f"{3 / len(rest):.1%} of the edges are slack" in sentence for sentence in said.warnings)


def test_a_membrane_without_stiffness_has_no_dual():
    scene = zoo.grid_scene(5, membrane__springs="tension-only")
    scene = replace(scene, rest_length=2 * scene.rest_length)
    said = judge(Problem(scene), scene.start, np.zeros_like(scene.start))
    assert (said.stationarity, said.off_support, said.stable, said.converged) == (None, None, False, False)
    assert (said.equilibrium, said.tension_max, said.slack_share) == (0.0, 0.0, 1.0)


def test_off_support_is_one_exactly_where_the_first_support_is_allowed(design):
    """A weight at which the dual of the bare membrane touches what R allows: FORMATS's formula against the largest slope."""
    forces = 0 * design.forces
    positions = at_rest(design.problem, forces)
    said = judge(design.problem, positions, forces)
    weight = design.problem.weight * said.off_support
    assert judge(design.problem.replace(weight=weight), positions, forces).off_support == pytest.approx(1.0, rel=1e-12)
    assert judge(design.problem.replace(weight=weight * (1 + 1e-9)), positions, forces).converged
    assert not judge(design.problem.replace(weight=weight * (1 - 1e-5)), positions, forces).converged
    # the steepest slope, searched for on a fine scale of forces
    size = np.geomspace(1e-6, 1.0, 100_001)
    steepest = (np.diff(design.problem.penalty.value(size)) / np.diff(size)).max()
    free = design.problem.supports.amplitudes(design.problem.dual(positions, design.problem.factor_at(positions)))
    assert said.off_support == pytest.approx(np.linalg.norm(free, axis=1).max() / (design.problem.weight * steepest), rel=1e-6)


def test_a_fixed_vertex_out_of_its_place_is_not_accepted():
    design = solve(Problem(zoo.planted(7).scene))
    lifted = design.positions + np.array([0.0, 0.0, 7.0])
    said = judge(design.problem, lifted, design.forces)
    assert said.equilibrium <= 1e-10 and not said.converged and "a fixed vertex is not in its place" in said.warnings[-1]
