from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zoo
from test_units import SCENES as UNITS
from test_units import in_millimetres_and_kilonewtons

import relax
from relax.design.methods.irls import IRLS, Reweighting, irls
from relax.design.methods.lagrangian import lagrangian
from relax.design.methods.smooth import Smoothed
from relax.design.problem import Problem
from relax.design.starts import Start, pulled
from relax.design.trace import Journal
from relax.errors import InputError
from relax.iterate import iterate
from relax.sparsity.supports import sizes

DATA = Path(__file__).parent.parent / "data"


def problem_of(name, every=5, **changes):
    return Problem(zoo.uneven(name, every, **{"penalty__smoothing": 1e-4, **changes}))


def reweighting(problem, last=1e-3):
    return Reweighting(problem, IRLS(), last)


@pytest.mark.parametrize("every", [0, 5])
@pytest.mark.parametrize("name", zoo.UNEVEN)
def test_one_system_is_the_quadratic_programme_solved_densely(name, every):
    """min |r + d|^2_M + d T d / 2 + sum b |s + K d|^2 over d, K d = 0 in all rows that no candidate has."""
    problem = problem_of(name, every)
    rng = np.random.default_rng(0)
    start = pulled(problem)
    bend = rng.uniform(0.5, 2.0, len(problem.supports.vertices))
    stiffness = problem.membrane.stiffness(start.positions)
    turn = problem.membrane.stiffness_turn(start.positions, 1e-2 * rng.normal(size=(problem.supports.free, 3)))
    offset = 2 * (problem.metric @ problem.offset(start.positions).ravel())
    shift, multipliers = reweighting(problem).solve(stiffness, turn, bend, (-offset, start.amplitudes))
    # eliminate by the null space of the rows without a candidate: there K d = 0
    k, rows = stiffness.toarray(), problem.supports.rows.ravel()
    none = np.setdiff1d(np.arange(len(k)), rows)
    basis = np.linalg.svd(k[none])[2][len(none) :].T
    curved = np.repeat(bend, problem.supports.width)
    hessian = 2 * problem.metric.toarray() + turn.toarray() + k[rows].T @ (curved[:, None] * k[rows])
    slope = offset + k[rows].T @ (curved * start.amplitudes.ravel())
    dense = -basis @ np.linalg.solve(basis.T @ hessian @ basis, basis.T @ slope)
    np.testing.assert_allclose(shift, dense, rtol=0, atol=1e-10 * np.abs(dense).max())
    forces = start.amplitudes.ravel() + k[rows] @ dense
    np.testing.assert_allclose(multipliers[rows], curved * forces, rtol=0, atol=1e-9 * np.abs(curved * forces).max())


@pytest.mark.parametrize("name", zoo.UNEVEN)
def test_the_promised_fall_is_the_slope_of_the_smoothed_objective(name):
    """Down the step from a shape at rest: F(t) - F(0) - t F'(0) is of second order, at true equilibrium."""
    problem = problem_of(name)
    method, shape, width = reweighting(problem), pulled(problem), 0.05
    smooth = Smoothed(problem.penalty, width)
    bend = method._costs * smooth.across(sizes(shape.amplitudes))
    stiffness = problem.membrane.stiffness(shape.positions)
    offset = 2 * (problem.metric @ problem.offset(shape.positions).ravel())
    shift, _ = method.solve(stiffness, 0.0 * stiffness, bend, (-offset, shape.amplitudes))
    slope = offset @ shift + np.vdot(bend[:, None] * shape.amplitudes, (stiffness @ shift)[problem.supports.rows])
    assert slope < 0
    errors = [
        abs(method.value(method._displaced(shape, t * shift), width) - method.value(shape, width) - t * slope)
        for t in (1e-2, 5e-3)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("name", zoo.UNEVEN)
def test_the_smoothed_objective_falls_at_each_step_and_every_step_is_at_rest(name):
    problem = problem_of(name)
    method = reweighting(problem)
    state = method.begin(pulled(problem), 0.5)
    falls = 0
    while not state.ended:
        after = method.step(state)
        if after.shape is not state.shape:
            assert method.value(after.shape, state.width) < method.value(state.shape, state.width)
            falls += 1
        nodal = problem.supports.forces(after.shape.amplitudes)
        left = problem.membrane.forces(after.shape.positions) + problem.loads + nodal
        assert np.abs(left).max() <= 1e-10
        state = after
    assert falls >= 5


@pytest.mark.parametrize("factor", [8.0, -1.0])
def test_a_step_that_does_not_pay_is_shortened_or_refused(factor, monkeypatch):
    problem = problem_of("hookean")
    method = reweighting(problem)
    state = method.begin(pulled(problem), 0.3)
    true = Reweighting.solve

    def wrong(self, *asked):
        shift, multipliers = true(self, *asked)
        return factor * shift, multipliers

    monkeypatch.setattr(Reweighting, "solve", wrong)
    after = method.step(state)
    if factor < 0:
        assert after.shape is state.shape and "refused" in after.note and after.width < state.width
    else:
        assert method.value(after.shape, state.width) < method.value(state.shape, state.width)


def test_under_a_wide_smoothing_the_steps_are_newton_s():
    """There R is a parabola and its touching parabolas are R, so with T each step squares what is left."""
    problem = problem_of("hookean", 0, penalty__weight=2.0, penalty__exponent=1.0)
    method = Reweighting(problem, IRLS(steps=100, gain=-1.0), 1e-3)
    state = method.begin(pulled(problem), 100.0)
    moves = []
    for _ in range(5):
        before, state = state.shape.positions, method.step(state)
        moves.append(np.abs(state.shape.positions - before).max())
    home = next(step for step, move in enumerate(moves) if move < 1e-2)
    assert moves[home + 1] < 2 * moves[home] ** 2, moves


def test_smoothing_goes_down_the_schedule():
    problem = problem_of("hookean")
    widths = []
    method = Reweighting(problem, IRLS(shrink=0.5, steps=1, last_steps=1), 0.01)
    state = method.begin(pulled(problem), 0.08)
    while not state.ended:
        widths.append(state.width)
        state = method.step(state)
    np.testing.assert_allclose(widths, [0.08, 0.04, 0.02, 0.01])
    # the last one goes on until nothing falls
    long = Reweighting(problem, IRLS(shrink=0.5, steps=1), 0.01)
    run = iterate(long, long.begin(pulled(problem), 0.08), 1000)
    assert run.steps > 8 and run.state.ended
    shorter = replace(run.state, ended=False, width=0.01)
    assert long.value(long.step(shorter).shape, 0.01) == pytest.approx(long.value(run.state.shape, 0.01), rel=2e-8)
    # one that is repeated while it pays
    often = Reweighting(problem, IRLS(shrink=0.5, steps=4, gain=0.0, last_steps=1), 0.01)
    assert iterate(often, often.begin(pulled(problem), 0.08), 100).steps > 4


@pytest.mark.parametrize("changes", zoo.PLANTED, ids=str)
def test_planted_masts_are_found(changes):
    planted = zoo.planted(9, zoo.TWO_MASTS, **{"penalty__weight": 1e-4, **changes})
    design = relax.solve(Problem(planted.scene), method=irls)
    assert design.certificate.converged and design.certificate.stationarity <= 1e-10, design.stop
    assert [mast.vertex for mast in design.supports] == planted.vertices.tolist()
    # before rounding forces stood elsewhere too: continuation forgets the start
    assert (sizes(design.trace.unrounded_forces) > 0).sum() > 20


@pytest.mark.parametrize("scene", ["tent", "tent-noisy"])
def test_the_tent_s_mast_is_found_with_and_without_noise(scene):
    problem = Problem(relax.load_scene(DATA / f"{scene}.toml"))
    design = relax.solve(problem, method=irls)
    assert design.certificate.converged and [mast.vertex for mast in design.supports] == [181]
    default = relax.solve(problem)
    assert design.certificate.objective == pytest.approx(default.certificate.objective, rel=1e-9)


def test_the_group_lasso_ends_where_the_cone_programs_do():
    planted = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-2, penalty__name="group-lasso", sigma=0.01)
    problem = Problem(planted.scene)
    design, cones = relax.solve(problem, method=irls), relax.solve(problem)
    assert design.certificate.converged
    assert design.certificate.objective == pytest.approx(cones.certificate.objective, rel=1e-9)
    assert [mast.vertex for mast in design.supports] == [mast.vertex for mast in cones.supports]


def test_candidates_that_are_missing_are_let_in():
    """Cut off too early all but the largest force is dropped; the dual certificate brings back what is missing."""
    planted = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-4)
    problem = Problem(planted.scene)
    design = relax.solve(problem, method=IRLS(first=1.0, last=0.9, steps=1))
    assert design.certificate.off_support <= 1 + 1e-6 and design.certificate.stationarity <= 1e-10
    assert set(planted.vertices) <= {mast.vertex for mast in design.supports}


@pytest.mark.parametrize("name", ["hookean", "force density", "group lasso"])
@pytest.mark.parametrize("method", [irls, lagrangian], ids=["irls", "lagrangian"])
def test_vertices_that_are_no_candidates_stay_free(method, name):
    problem = problem_of(name)
    design = relax.solve(problem, method=method)
    assert design.certificate.converged, design.stop
    assert not design.forces[~problem.scene.candidates].any() and design.certificate.supports >= 2


@pytest.mark.parametrize("scene", ["noisy", "force density", "group lasso"])
@pytest.mark.parametrize("method", [irls, lagrangian], ids=["irls", "lagrangian"])
def test_the_answer_does_not_depend_on_the_units(method, scene):
    metres = UNITS[scene]()
    one = relax.solve(Problem(metres), method=method)
    other = relax.solve(Problem(in_millimetres_and_kilonewtons(metres)), method=method)
    assert one.certificate.converged and other.certificate.converged
    assert other.certificate.objective == pytest.approx(1e6 * one.certificate.objective, rel=1e-10)
    np.testing.assert_array_equal(one.forces != 0, other.forces != 0)


@pytest.mark.parametrize("method", [irls, lagrangian], ids=["irls", "lagrangian"])
def test_without_candidates_the_membrane_is_left_as_it_is(method):
    scene = zoo.planted(6, sigma=0.01, penalty__weight=1e-3).scene
    design = relax.solve(Problem(replace(scene, candidates=np.zeros_like(scene.candidates))), method=method)
    assert design.certificate.converged and design.certificate.supports == 0


def test_an_interrupt_keeps_the_best():
    problem = problem_of("hookean", 0)

    def stop(record):
        if record["step"] == 4:
            raise KeyboardInterrupt

    design = relax.solve(problem, method=irls, callback=stop)
    assert design.interrupted and design.certificate.equilibrium <= 1e-10
    assert design.certificate.objective == min(design.trace.objective)


def test_what_it_cannot_treat_is_refused():
    problem = problem_of("hookean", supports__max_force=1.0)
    with pytest.raises(InputError, match=r'"irls" cannot treat .*supports\.max_force'):
        irls(problem, Start("pulled", pulled(problem_of("hookean"))), Journal(problem, None))


@pytest.mark.parametrize("wrong", [{"shrink": 1.0}, {"last": 0.0}, {"first": 0.5, "last": 0.6}, {"steps": 0}], ids=str)
def test_parameters_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match="expected 0 < last <= first"):
        IRLS(**wrong)


class MCP:
    """phi'(t) = max(1 - t / knee, 0): beyond the knee a force costs nothing more, and no parabola bends there."""

    name, resolution = "mcp", 0.0

    def __init__(self, knee):
        self.knee = knee

    def value(self, size):
        return np.where(size < self.knee, size - size**2 / (2 * self.knee), self.knee / 2)

    def slope(self, size):
        return np.maximum(1 - size / self.knee, 0.0)

    def curvature(self, size):
        return np.where(size < self.knee, -1 / self.knee, 0.0)

    weight = slope


@pytest.mark.parametrize("method", [irls, lagrangian], ids=["irls", "lagrangian"])
def test_a_penalty_that_becomes_flat(method):
    planted = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-3)
    design = relax.solve(Problem(planted.scene, penalty=MCP(0.1)), method=method)
    assert design.certificate.converged, design.stop
    assert [mast.vertex for mast in design.supports] == planted.vertices.tolist()
