from dataclasses import replace

import numpy as np
import pytest
import zoo
from scipy.optimize import minimize, minimize_scalar

import relax
from relax.design.starts import unsupported
from relax.errors import InputError

SPRINGS = {"membrane__springs": "force-density", "membrane__stiffness": 1.0}


def bare(problem):
    shape = unsupported(problem)
    return shape.positions, problem.all_forces(shape.amplitudes)


@pytest.fixture(scope="module")
def two():
    """A noisy scene of two masts, and its design."""
    problem = relax.Problem(zoo.planted(7, zoo.TWO_MASTS, 0.005).scene, weight=0.02)
    return problem, relax.solve(problem)


def test_a_support_is_explained_by_its_own_figures(two):
    problem, design = two
    found = relax.explain(problem, design.positions, design.forces)
    assert [support.vertex for support in found.supports] == [mast.vertex for mast in design.supports]
    assert len(found.supports) == 2
    for support, mast in zip(found.supports, design.supports, strict=True):
        size = np.array([mast.magnitude])
        assert support.force == pytest.approx(mast.magnitude)
        assert support.price == pytest.approx(problem.weight * problem.penalty.value(size)[0])
        assert support.slope == pytest.approx(problem.weight * problem.penalty.slope(size)[0])
        assert support.dual == pytest.approx(support.slope, rel=1e-8)  # that is stationarity
    assert sum(support.share for support in found.supports) == pytest.approx(1)
    assert sum(support.price for support in found.supports) == pytest.approx(design.certificate.penalty)
    assert found.certificate == design.certificate


def test_the_loss_is_that_of_a_solve_without_the_support(two):
    problem, design = two
    found = relax.explain(problem, design.positions, design.forces)
    for support, other in zip(found.supports, found.supports[::-1], strict=True):
        only = np.zeros(len(problem.scene.target), dtype=bool)
        only[other.vertex] = True

        def objective(force, only=only):
            forces = np.where(only[:, None], force, 0.0)
            shape = relax.form(problem, forces)
            return shape.certificate.objective

        best = minimize(objective, design.forces[other.vertex], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-12})
        assert support.loss_objective == pytest.approx(best.fun - design.certificate.objective, rel=1e-6)
        again = relax.form(problem, np.where(only[:, None], best.x, 0.0)).certificate
        assert support.loss_distance == pytest.approx(again.distance - design.certificate.distance, rel=1e-4)
        assert support.loss_objective > 0 and support.estimate == pytest.approx(support.loss_objective, rel=0.6)


def test_the_estimate_is_exact_on_a_linear_membrane():
    problem = relax.Problem(zoo.planted(7, zoo.TWO_MASTS, 0.002, **SPRINGS).scene, relax.GroupLasso(), 0.002)
    design = relax.solve(problem)
    found = relax.explain(problem, design.positions, design.forces)
    assert found.supports
    for support in found.supports:
        assert support.estimate == pytest.approx(support.loss_objective, rel=1e-2, abs=1e-9)  # the model stops at 1e-3


def test_the_field_is_largest_where_the_mast_was_planted():
    planted = zoo.planted(9)
    problem = relax.Problem(planted.scene, weight=0.01)
    found = relax.explain(problem, *bare(problem))
    assert found.supports == ()
    assert np.nanargmax(found.pull) == planted.vertices[0]
    assert np.isnan(found.pull[problem.scene.fixed]).all() and np.isfinite(found.pull[~problem.scene.fixed]).all()
    # its maximum is what the judge calls off_support
    assert np.nanmax(found.pull) == pytest.approx(found.certificate.off_support)
    assert relax.largest_weight(problem) == pytest.approx(np.nanmax(found.pull) * problem.weight)


@pytest.mark.parametrize("penalty", [relax.GroupLasso(), relax.Power(0.5, 1e-6)], ids=lambda penalty: penalty.name)
def test_a_mast_s_value_is_the_true_fall_on_a_linear_membrane(penalty):
    planted = zoo.planted(7, (((1 / 3, 0.5), (0.0, 0.0, 0.3)),), **SPRINGS)
    problem = relax.Problem(planted.scene, penalty, 0.01)
    positions, none = bare(problem)
    values = relax.mast_values(problem, positions, none)
    free = problem.membrane.free
    inverse = np.linalg.inv(problem.membrane.stiffness(positions).toarray())
    offset = (positions - problem.scene.target)[free].ravel()
    lam = 2 * (inverse @ offset).reshape(-1, 3)
    for group in (0, 7, 12, 20):
        along = -lam[group] / np.linalg.norm(lam[group])
        moved = inverse[:, 3 * group : 3 * group + 3] @ along

        def value(force, moved=moved):
            return np.sum((offset + force * moved) ** 2) - offset @ offset

        def priced(force, value=value):
            return value(force) + problem.weight * penalty.value(np.array([force]))[0]

        fit = minimize_scalar(value)
        assert values.fit[free[group]] == pytest.approx(-fit.fun, rel=1e-9)
        least = penalty.resolution  # a smaller force counts as none
        grid = np.linspace(least, 2 * fit.x, 400)
        near = grid[np.argmin([priced(force) for force in grid])]
        best = minimize_scalar(
            priced, bounds=(max(near - grid[2], least), near + grid[2]), method="bounded", options={"xatol": 1e-12}
        )
        assert values.gain[free[group]] == pytest.approx(max(-best.fun, 0), rel=1e-7, abs=1e-9)
        if best.fun < -1e-6:
            assert values.force[free[group]] == pytest.approx(best.x, rel=1e-4)
    # one planted mast: no other vertex can do as much (Cauchy and Schwarz)
    assert np.nanargmax(values.fit) == np.nanargmax(values.gain) == planted.vertices[0]
    assert np.nanmax(values.fit) == pytest.approx(offset @ offset)


def test_values_are_given_where_they_are_asked_for(two):
    problem, design = two
    whole = relax.mast_values(problem, design.positions, design.forces)
    vertex = int(problem.membrane.free[2])
    one = relax.mast_values(problem, design.positions, design.forces, [vertex])
    assert np.flatnonzero(np.isfinite(one.gain)).tolist() == [vertex]
    assert one.fit[vertex] == pytest.approx(whole.fit[vertex])
    heads = [mast.vertex for mast in design.supports]
    assert np.isnan(whole.gain[heads]).all() and np.isnan(whole.gain[problem.scene.fixed]).all()
    assert np.isfinite(whole.fit).sum() == len(problem.membrane.free) - len(heads)
    with pytest.raises(InputError, match="vertex 0: no support may stand there"):
        relax.mast_values(problem, design.positions, design.forces, [0])


def test_a_largest_force_caps_what_a_mast_can_do():
    problem = relax.Problem(zoo.planted(7, **SPRINGS).scene, relax.GroupLasso(), 1e-6)
    positions, none = bare(problem)
    free = relax.mast_values(problem, positions, none)
    problem.scene.settings["supports"]["max_force"] = 0.1
    capped = relax.mast_values(problem.replace(weight=1e-6), positions, none)
    top = int(np.nanargmax(free.fit))
    assert free.force[top] == pytest.approx(0.3, rel=1e-3) and capped.force[top] == pytest.approx(0.1, rel=1e-6)
    assert capped.fit[top] < free.fit[top]


def test_how_sure_depends_on_what_is_known(two):
    convex = relax.Problem(zoo.planted(7, zoo.TWO_MASTS, 0.01, **SPRINGS).scene, relax.GroupLasso(), 0.002)
    design = relax.solve(convex)
    sure = relax.assurance(convex, design.positions, design.forces)
    assert sure.kind == "duality gap" and -1e-12 < sure.gap < 1e-9
    # half the forces are no optimum, and the gap is at least what they lose
    half = relax.form(convex, 0.5 * design.forces)
    worse = relax.assurance(convex, half.positions, half.forces)
    lost = 1 - design.certificate.objective / half.certificate.objective
    assert worse.gap >= lost > 0.01
    problem, found = two
    assert relax.assurance(problem, found.positions, found.forces).kind == "stationarity"
    known = relax.assurance(problem, found.positions, found.forces, 0.5 * found.certificate.objective)
    assert known.kind == "known optimum" and known.gap == pytest.approx(0.5)
    moved = relax.form(problem, 0.9 * found.forces)
    assert relax.assurance(problem, moved.positions, moved.forces).kind == "none"


def test_a_debiased_answer_is_explained_without_the_penalty():
    scene = zoo.planted(9, zoo.TWO_MASTS, 0.005, rounding__refit="debiased").scene
    problem = relax.Problem(scene, weight=0.02)
    design = relax.solve(problem)
    found = relax.explain(problem, design.positions, design.forces)
    assert found.certificate.converged
    for support in found.supports:
        assert support.slope == 0 and abs(support.dual) < 1e-9


def test_the_estimate_of_a_debiased_answer_is_exact_on_a_linear_membrane():
    """The others settle without R, in the model as in the refit; R is what the objective counts."""
    scene = zoo.planted(9, zoo.TWO_MASTS, 0.005, rounding__refit="debiased", **SPRINGS).scene
    problem = relax.Problem(scene, weight=0.005)
    design = relax.solve(problem)
    found = relax.explain(problem, design.positions, design.forces).supports
    assert len(found) >= 2
    for support in found:
        assert support.estimate == pytest.approx(support.loss_objective, rel=1e-8)


def test_a_support_that_always_stands_is_taken_out_too():
    """It has no price, and is not to come back by that: the estimate is of the same removal as the loss."""
    scene = zoo.planted(9, zoo.TWO_MASTS, 0.005, supports__always=[30], **SPRINGS).scene
    problem = relax.Problem(scene, weight=0.002)
    design = relax.solve(problem)
    [always] = [s for s in relax.explain(problem, design.positions, design.forces).supports if s.vertex == 30]
    assert always.loss_objective > 1e-6
    assert always.estimate == pytest.approx(always.loss_objective, rel=1e-2)


@pytest.mark.parametrize("springs", [{}, SPRINGS], ids=["hookean", "force density"])
def test_an_answer_that_pays_a_count_is_explained(springs):
    """The judge has no off_support for it: the count's slope at zero has no bound."""
    problem = relax.Problem(zoo.planted(7, zoo.TWO_MASTS, 0.005, penalty__name="count", **springs).scene, weight=0.02)
    design = relax.solve(problem)
    assert design.certificate.converged and design.certificate.off_support is None
    found = relax.explain(problem, design.positions, design.forces)
    assert found.assurance.kind == "stationarity" and "None" not in found.assurance.sentence
    assert all(support.price == 0.02 and support.slope == 0 for support in found.supports)


def test_an_explanation_does_not_change(two):
    problem, design = two
    found = relax.explain(problem, design.positions, design.forces)
    with pytest.raises(ValueError, match="read-only"):
        found.pull[0] = 1.0
    assert replace(found, supports=()).supports == ()
