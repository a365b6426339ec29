"""Numbers of single precision, or whole numbers, are taken as the doubles that they are: no figure is computed in less."""

from dataclasses import fields, replace

import numpy as np
import pytest
import zoo

from relax.design.form import form
from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.membrane.scene import build_scene

SIDE = 7


def single(array):
    return array.astype(np.float32) if isinstance(array, np.ndarray) and array.dtype.kind == "f" else array


def noisy():
    return zoo.planted(SIDE, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3).scene


def test_a_target_of_single_precision_is_the_target_of_its_doubles():
    mesh, target = zoo.grid(SIDE)
    target[:, 2] = zoo.hill(*target.T[:2])
    rough = target.astype(np.float32)
    mine, doubles = (build_scene(zoo.settings(), mesh, one, one) for one in (rough, rough.astype(float)))
    for field in fields(mine):
        if isinstance(getattr(mine, field.name), np.ndarray):
            np.testing.assert_array_equal(getattr(mine, field.name), getattr(doubles, field.name))
    assert solve(Problem(mine)).certificate.converged


def test_a_scene_of_single_precision_is_solved_in_doubles():
    """The target of whole numbers, too, of which noise could not be added to an array of integers."""
    scene = noisy()
    rough = replace(scene, **{field.name: single(getattr(scene, field.name)) for field in fields(scene)})
    assert {getattr(rough, name).dtype for name in ("target", "start", "rest_length", "metric")} == {np.dtype(float)}
    design, exact = solve(Problem(rough)), solve(Problem(scene))
    assert design.certificate.converged and design.certificate.equilibrium < 1e-12
    assert design.certificate.objective == pytest.approx(exact.certificate.objective, rel=1e-5)


def test_a_target_of_whole_numbers_takes_noise():
    mesh, flat = zoo.grid(SIDE, span=SIDE - 1.0)
    whole = flat.astype(int)
    settings = zoo.settings(target__noise={"sigma": 0.01, "seed": 0})
    np.testing.assert_array_equal(build_scene(settings, mesh, whole, None).target, build_scene(settings, mesh, flat, None).target)


def test_forces_and_starts_of_single_precision_are_doubles_from_there_on():
    scene = noisy()
    problem, design = Problem(scene), solve(Problem(scene))
    rough = design.forces.astype(np.float32)
    formed = form(problem, rough)
    assert formed.positions.dtype == formed.forces.dtype == np.dtype(float)
    assert formed.certificate.equilibrium < 1e-12  # in single precision no better than 1e-7
    again = solve(problem, start=(design.positions.astype(np.float32), rough))
    assert again.certificate.converged
    assert again.certificate.objective == pytest.approx(design.certificate.objective, rel=1e-12)
    # judged as doubles: what is off is the rounding of the positions, 1e-7, and the figures agree with those of doubles
    said = judge(problem, design.positions.astype(np.float32), rough)
    assert said == judge(problem, design.positions.astype(np.float32).astype(float), rough.astype(float))
