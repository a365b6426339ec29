"""The verdict of experiments/stability.py sees what a judge should: it is planted with faults here, one by one."""

from dataclasses import replace

import numpy as np
import pytest
import zoo

from relax.design.form import form
from relax.design.problem import Problem
from relax.design.solve import solve

TOLERANCE = 1e-8


@pytest.fixture
def judged():
    """`judged` of experiments/stress/verdict.py."""
    from stress.verdict import judged

    return judged


@pytest.fixture(scope="module")
def design():
    """Three supports under noise, converged."""
    found = solve(Problem(zoo.planted(7, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3).scene))
    assert found.certificate.converged and found.certificate.supports == 3
    return found


def faults(judged, design):
    return judged(design).faults(design.certificate, TOLERANCE)


def test_a_converged_answer_has_no_fault_and_the_figures_are_the_judges(judged, design):
    verdict, said = judged(design), design.certificate
    assert not verdict.faults(said, TOLERANCE)
    assert verdict.objective == pytest.approx(said.objective, rel=1e-12)
    assert verdict.off_support == pytest.approx(said.off_support, rel=1e-9)
    assert verdict.stationarity < 1e-10 and verdict.equilibrium < 1e-14 and verdict.drift < 1e-14 and verdict.pushed > 0


def test_a_vertex_that_moved_is_out_of_balance(judged, design):
    positions = design.positions.copy()
    positions[24] += 1e-8
    assert any(word.startswith("equilibrium") for word in faults(judged, replace(design, positions=positions)))


def test_a_force_that_is_too_large_by_a_millionth_is_not_stationary(judged, design):
    problem = design.problem
    forces = design.forces * (1 + 1e-6)
    moved = replace(design, forces=forces, positions=form(problem, forces).positions)
    assert any(word.startswith("stationarity") for word in faults(judged, moved))


def test_a_support_left_out_is_missed(judged, design):
    forces = np.zeros_like(design.forces)
    bare = replace(design, forces=forces, positions=form(design.problem, forces).positions)
    said = faults(judged, replace(bare, certificate=replace(design.certificate, objective=judged(bare).objective)))
    assert len(said) == 1 and said[0].startswith("off_support")


def test_a_membrane_that_pushes_does_not_stand(judged):
    """A flat membrane longer than its frame: in balance, and any push lets it go."""
    scene = zoo.grid_scene(5, zoo.hill, membrane__rest_scale=1.02)
    design = solve(Problem(zoo.planted(5, penalty__weight=1e-3).scene))
    flat = replace(design, problem=Problem(scene), positions=scene.start, forces=0 * scene.start)
    verdict = judged(flat)
    assert verdict.pushed < 0 and "not stable" in verdict.faults(design.certificate, TOLERANCE)


def test_an_objective_of_its_own_is_a_fault_of_any_answer(judged, design):
    said = replace(design.certificate, objective=1.001 * design.certificate.objective, converged=False)
    assert faults(judged, replace(design, certificate=said))
