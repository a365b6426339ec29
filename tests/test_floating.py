"""Membranes without a fixed vertex: forces that must balance, translations that E_dist chooses, and what methods make of them."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
import zoo
from naive import stiffness
from naive_judge import differences, naive_figures, result_arrays
from scipy.spatial.transform import Rotation

from relax.convex.backends import clarabel
from relax.convex.reweighted import Reweighted
from relax.convex.subproblem import certify
from relax.design.explain import explain
from relax.design.form import form
from relax.design.mast_values import mast_values
from relax.design.optimality import judge
from relax.design.path import largest_weight, path
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.shape import Shape, rest, with_dual
from relax.design.solve import solve
from relax.errors import EquilibriumError, InputError
from relax.membrane.formers import FORMERS
from relax.membrane.mesh import mesh_from_faces
from relax.membrane.scene import build_scene
from relax.sparsity.count import Count
from relax.sparsity.folded import MCP
from relax.sparsity.log_sum import LogSum
from relax.sparsity.penalties import make_penalty
from relax.sparsity.power import Power
from relax.sparsity.resultants import Resultants

LOADS = {"membrane__loads": [0.1, 0.0, -0.2]}
LAWS = ("hookean", "tension-only", "force-density")


def twin(design, refit="penalised"):
    """Where the judge and its dense twin differ on a design."""
    given = design.problem.scene.settings
    settings = given | {"rounding": {"refit": refit}, "penalty": given["penalty"] | {"weight": design.problem.weight}}
    said = design.certificate.figures()
    return differences(said, naive_figures(result_arrays(design.problem.scene, design.positions, design.forces), settings))


def shape_of(planted):
    """The problem of a planted scene and its clean target under the planted forces, placed."""
    problem = Problem(planted.scene, weight=0.01)
    shape = rest(problem, Shape(planted.positions, problem.supports.amplitudes(planted.forces), None, 0))
    assert shape is not None
    return problem, shape


@pytest.mark.parametrize("law", LAWS)
def test_a_planted_tent_is_found_again(law):
    planted = zoo.floating(membrane__springs=law, penalty__weight=0.01, rounding__refit="debiased")
    design = solve(Problem(planted.scene))
    assert design.certificate.converged and design.certificate.stable, design.stop
    assert np.allclose(design.forces, planted.forces, atol=1e-8)
    assert design.certificate.rms_distance < 1e-9
    assert twin(design, "debiased") == []


@pytest.mark.parametrize("changes", [{}, LOADS, {"target__area_weights": True}])
def test_a_noisy_tent_is_certified_and_its_forces_balance(changes):
    weight = 1e-4 if changes.get("target__area_weights") else 0.01
    design = solve(Problem(zoo.floating(sigma=0.01, **changes).scene, weight=weight))
    assert design.certificate.converged, design.stop
    assert np.allclose((design.forces + design.problem.scene.loads).sum(axis=0), 0, atol=1e-12)
    pull = np.einsum("vij,vj->vi", design.problem.scene.metric, design.positions - design.problem.scene.target)
    assert np.allclose(pull.sum(axis=0), 0, atol=1e-12)
    assert twin(design) == []


def test_newton_reaches_the_last_digits_where_the_penalty_is_dropped():
    problem, shape = shape_of(zoo.floating(sigma=0.01, **LOADS))
    seen = []
    refit(problem, shape, "debiased", lambda record: seen.append(record["residual"]))
    assert seen[-1] < 1e-9 and len(seen) < 12


def test_the_other_supports_that_were_planted_are_found_in_noise():
    planted = zoo.floating(9, sigma=0.01)
    penalties = {Power(0.5): 0.01, LogSum(scale=0.05): 0.1, MCP(knee=0.3): 0.1, Count(): 0.01}
    for penalty, weight in penalties.items():
        design = solve(Problem(planted.scene, penalty, weight))
        assert design.certificate.converged, (penalty, design.stop)
        assert np.array_equal(np.flatnonzero(design.forces.any(axis=1)), planted.vertices), penalty


@pytest.mark.parametrize("law", ["hookean", "force-density"])
def test_a_step_that_lets_go_of_a_part_is_shortened(law):
    """A count dear enough that the first cone step would let all supports go: damped ones come to the four corners."""
    scene = zoo.floating(5, sigma=0.01, membrane__springs=law).scene
    design = solve(Problem(scene, Count(), 10.0))
    assert design.certificate.converged, design.stop
    assert np.array_equal(np.flatnonzero(design.forces.any(axis=1)), [0, 4, 20, 24])


def test_the_judge_sees_a_shape_moved_as_a_whole_and_an_unbalanced_force():
    design = solve(Problem(zoo.floating(sigma=0.01).scene, weight=0.01))
    problem, moved, pushed = design.problem, design.positions + 1e-4 * np.eye(3)[0], design.forces.copy()
    pushed[0, 2] += 1e-6
    for positions, forces in ((moved, design.forces), (design.positions, pushed)):
        said = judge(problem, positions, forces)
        assert not said.converged
        assert twin(replace(design, positions=positions, forces=forces, certificate=said)) == []
    said = judge(problem, moved, design.forces)
    assert said.equilibrium < 1e-12 and said.stationarity > 1e-4


def test_a_membrane_without_stress_or_supports_is_never_called_stable():
    scene = zoo.floating().scene
    flat = np.array(scene.start) * scene.settings["membrane"]["rest_scale"]
    problem = Problem(scene, weight=0.01)
    said = judge(problem, problem.placed(flat), np.zeros_like(flat))
    assert said.tension_max < 1e-12 and not said.stable and not said.converged


def test_the_gradient_of_e_dist_along_balanced_forces():
    """Central differences of the distance at true equilibrium, against the dual with its multiplier."""
    problem, shape = shape_of(zoo.floating(sigma=0.02, **LOADS))
    shape, _, dual = with_dual(problem, shape)
    rng, step = np.random.default_rng(1), 1e-5
    for _ in range(4):
        along = rng.normal(size=shape.amplitudes.shape)
        along -= along.mean(axis=0)
        ends = [rest(problem, replace(shape, amplitudes=shape.amplitudes + sign * step * along)) for sign in (1, -1)]
        slope = (problem.distance(ends[0].positions) - problem.distance(ends[1].positions)) / (2 * step)
        assert abs(slope - np.vdot(problem.supports.duals(dual), along)) < 1e-6 * np.abs(dual).sum()


def test_an_answer_is_stationary_along_every_balanced_change_of_its_forces():
    design = solve(Problem(zoo.floating(sigma=0.01).scene, weight=0.01))
    problem = design.problem
    amplitudes, free = problem.supports.amplitudes(design.forces), np.flatnonzero(design.forces.any(axis=1))
    rng = np.random.default_rng(2)
    for _ in range(4):
        along = np.zeros_like(amplitudes)
        along[free] = rng.normal(size=(len(free), 3))
        along[free] -= along[free].mean(axis=0)

        def value(step, along=along):
            shape = rest(problem, Shape(design.positions, amplitudes + step * along, None, 0))
            return problem.objective(shape.positions, shape.amplitudes)

        here = design.certificate.objective
        assert abs(value(1e-5) - value(-1e-5)) / 2e-5 < 1e-7
        assert value(1e-3) > here and value(-1e-3) > here


def test_a_turned_and_shifted_scene_has_the_same_answer():
    scene = zoo.floating(sigma=0.01, **LOADS).scene
    turn, shift = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix(), np.array([3.0, -2.0, 0.5])
    moved = {name: getattr(scene, name) @ turn.T + shift for name in ("target", "clean_target", "start")}
    designs = [solve(Problem(each, weight=0.01)) for each in (scene, replace(scene, loads=scene.loads @ turn.T, **moved))]
    assert designs[0].certificate.converged and designs[1].certificate.converged
    assert np.isclose(designs[0].certificate.objective, designs[1].certificate.objective, rtol=1e-9)
    assert np.allclose(designs[0].forces @ turn.T, designs[1].forces, atol=1e-7)
    assert np.allclose(designs[0].positions @ turn.T + shift, designs[1].positions, atol=1e-7)


def test_a_convex_problem_against_cvxpy():
    """Force densities under the group lasso: one cone program in positions and forces, with no reduction at all."""
    planted = zoo.floating(5, sigma=0.02, membrane__springs="force-density", **LOADS)
    problem = Problem(planted.scene, make_penalty({"name": "group-lasso"}), 0.02)
    scene = problem.scene
    x, p = cp.Variable(scene.target.size), cp.Variable(scene.target.shape)
    whole = stiffness(problem.membrane, scene.target)
    cost = cp.sum_squares(x - scene.target.ravel()) + 0.02 * cp.sum(cp.norm(p, 2, axis=1))
    balance = whole @ x == scene.loads.ravel() + cp.vec(p, order="C")
    optimum = cp.Problem(cp.Minimize(cost), [balance]).solve(solver="CLARABEL")
    design = solve(problem)
    assert design.certificate.converged and np.isclose(design.certificate.objective, optimum, rtol=1e-7)
    assert np.allclose(design.positions.ravel(), x.value, atol=1e-5)
    explained = explain(problem, design.positions, design.forces)
    assert explained.assurance.kind == "duality gap" and abs(explained.assurance.gap) < 1e-7


@pytest.mark.parametrize("kept", [[], [12], [3, 20]])
def test_a_cone_step_and_its_bound(kept):
    problem, shape = shape_of(zoo.floating(5, sigma=0.02, **LOADS))
    weights = np.full(25, 0.01)
    weights[kept] = 0.0
    step = problem.linearised(shape.positions, problem.factor_at(shape.positions), weights)
    found = clarabel(step, shape.amplitudes)
    assert 0 <= found.gap < 1e-6  # an interior point, not polished
    d, s = cp.Variable(75), cp.Variable((25, 3))
    cost = cp.sum_squares(d + step.offset) + weights @ cp.norm(s, 2, axis=1)
    balance = stiffness(problem.membrane, shape.positions) @ d == step.load + cp.vec(s, order="C")
    optimum = cp.Problem(cp.Minimize(cost), [balance]).solve(solver="CLARABEL")
    assert np.isclose(found.value, optimum, rtol=1e-6)
    poor = certify(step, shape.amplitudes)  # any point gives a bound below the optimum and a value above it
    assert poor.bound <= optimum * (1 + 1e-7) and poor.value >= optimum * (1 - 1e-7)


def test_translations_leave_the_inverse_as_it_is_under_balanced_forces():
    problem, shape = shape_of(zoo.floating(5, target__area_weights=True))
    factor, rng = problem.factor_at(shape.positions), np.random.default_rng(0)
    whole = stiffness(problem.membrane, shape.positions)
    forces = rng.normal(size=(25, 3))
    forces -= forces.mean(axis=0)
    moved = factor.solve(forces)
    assert np.allclose(whole @ moved.ravel(), forces.ravel(), atol=1e-11) and factor.positive_definite
    assert np.allclose((problem.metric @ moved.ravel()).reshape(-1, 3).sum(axis=0), 0, atol=1e-13)
    inverse = factor.solve(np.eye(75))
    assert np.allclose(inverse, inverse.T, atol=1e-11)
    assert np.allclose(factor.matrix.toarray(), whole, atol=1e-12)


def test_a_small_problem_keeps_the_balance_and_knows_what_a_group_is_worth():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(12, 12))
    resultants = Resultants(np.array([0, 0, 0, 0]), np.array([[0.3, -0.2, 0.5]]))
    small = Reweighted(root @ root.T, rng.normal(size=(4, 3)), Power(0.5), np.full(4, 0.05), resultants=resultants)
    fitted = small.settled(rng.normal(size=(4, 3)))
    assert np.allclose(fitted.sum(axis=0), resultants.total) and np.isfinite(small.value(fitted))
    assert np.isinf(small.value(fitted + 0.1))
    # the same with the last force eliminated by hand
    whole = np.vstack([np.eye(9), -np.tile(np.eye(3), 3)])
    origin = np.r_[np.zeros(9), resultants.total[0]]
    quadratic, linear = small.quadratic + np.kron(np.diag([1.0, 2, 3, 4]), np.eye(3)), small.linear.ravel()
    by_hand = origin + whole @ np.linalg.solve(whole.T @ quadratic @ whole, -whole.T @ (linear + quadratic @ origin))
    assert np.allclose(small._fit(np.arange(4), np.array([1.0, 2, 3, 4])).ravel(), by_hand, atol=1e-11)


@pytest.mark.parametrize("seed", range(20))
def test_a_group_is_left_out_only_where_that_lowers_the_value(seed):
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(30, 18))
    resultants = Resultants(np.zeros(6, dtype=int), rng.normal(size=(1, 3)) * (seed % 2))
    linear = -(columns.T @ columns @ rng.normal(size=18)).reshape(6, 3)
    small = Reweighted(columns.T @ columns, linear, Power(0.5), np.full(6, 25.0), resultants=resultants)
    settled = small.settled(rng.normal(size=(6, 3)))
    pruned = small.pruned(settled)
    assert resultants.met(pruned) and small.value(pruned) <= small.value(settled) + 1e-8 * abs(small.value(settled))


def test_forces_are_repaired_in_proportion():
    resultants = Resultants(np.array([0, 0, -1, 1, 1]), np.array([[1.0, 0, 0], [0, 0, 0]]))
    forces = np.array([[3.0, 0, 0], [1, 0, 0], [7, 0, 0], [1, 0, 0], [-1, 0, 0]])
    repaired = resultants.repaired(forces)
    assert np.allclose(repaired[:, 0], [3 - 3 * 0.75, 1 - 0.75, 7, 1, -1])
    assert resultants.met(repaired) and not resultants.met(forces)
    alone = forces.copy()
    alone[4] = 0.0
    assert resultants.repaired(alone) is None  # one force cannot balance itself
    assert np.allclose(resultants.of(np.array([0, 3, 4])).directions.T @ resultants.of(np.array([0, 3, 4])).matrix.T, 0)


def test_every_way_of_form_finding_comes_to_the_same_shape_with_its_mean_kept():
    planted = zoo.floating(5, **LOADS)
    membrane, start, applied = planted.scene.membrane, planted.scene.start, planted.forces + planted.scene.loads
    for name, former in FORMERS.items():
        found = former(membrane, start, applied)
        assert found.found, name
        assert np.allclose(found.positions.mean(axis=0), start.mean(axis=0), atol=1e-12)
        assert np.allclose(found.positions - found.positions[0], planted.positions - planted.positions[0], atol=1e-6), name
    design = form(Problem(planted.scene, weight=0.01), planted.forces)
    assert design.certificate.equilibrium < 1e-12 and design.certificate.rms_distance < 1e-9


def test_a_held_and_a_floating_part_are_two_problems():
    one, other = zoo.planted(5, sigma=0.01).scene, zoo.floating(5, sigma=0.01).scene
    count, aside = one.mesh.vertices, np.array([3.0, 0, 0])
    mesh = mesh_from_faces(2 * count, np.vstack([one.mesh.faces, np.where(other.mesh.faces < 0, -1, other.mesh.faces + count)]))
    flat = np.vstack([one.start, other.start + aside])
    fixed = np.flatnonzero(one.fixed).tolist()
    bare = build_scene(zoo.settings(supports__fixed=fixed), mesh, flat, None)
    assert "no fixed vertex" in bare.warnings[0]
    targets = {name: np.vstack([getattr(one, name), getattr(other, name) + aside]) for name in ("target", "clean_target")}
    both = replace(bare, **targets)
    design = solve(Problem(both, weight=0.01))
    apart = [solve(Problem(scene, weight=0.01)).certificate for scene in (one, other)]
    assert design.certificate.converged and all(each.converged for each in apart)
    assert np.isclose(design.certificate.objective, sum(each.objective for each in apart), rtol=1e-9)
    assert twin(design) == []
    # and as one problem: the refit of both at once
    shape = refit(
        design.problem, Shape(design.positions, design.problem.supports.amplitudes(design.forces[~both.fixed]), None, 0)
    )
    assert np.isclose(design.problem.objective(shape.positions, shape.amplitudes), design.certificate.objective, rtol=1e-10)


@pytest.mark.parametrize("method", ["irls", "lagrangian", "greedy", "exact"])
def test_methods_that_know_no_balance_say_so(method):
    scene = zoo.floating(5, sigma=0.01, solver__method=method, membrane__springs="force-density").scene
    with pytest.raises(InputError, match="without a fixed vertex, whose support forces must balance"):
        solve(Problem(scene, weight=0.01))


def test_what_begins_without_supports_is_refused():
    scene = zoo.floating(5, sigma=0.01).scene
    problem = Problem(scene, weight=0.01)
    with pytest.raises(EquilibriumError, match="has no fixed vertex, so it shrinks"):
        largest_weight(problem)
    with pytest.raises(InputError, match=r"path: it begins where nothing stands, and a part .* has no fixed vertex"):
        path(problem)
    with pytest.raises(InputError, match=r'solver.start "heavy" begins without supports, and a part .* has no fixed vertex'):
        solve(Problem(zoo.floating(5, sigma=0.01, solver__start="heavy").scene, weight=0.01))
    fraction = zoo.floating(5, sigma=0.01, penalty__weight=None, penalty__weight_fraction=0.1).scene
    with pytest.raises(InputError, match="no weight is the largest useful one"):
        solve(Problem(fraction))
    with pytest.raises(InputError, match="rests nowhere"):
        form(problem, np.eye(25, 3))
    with pytest.raises(InputError, match="would have to balance"):
        mast_values(problem, scene.target, np.zeros((25, 3)))
    weights = [design.certificate.converged for design in path(problem, weights=[0.05, 0.01])]
    assert weights == [True, True]


def test_a_start_without_forces_is_not_sent_to_where_nothing_begins():
    planted = zoo.floating(5)
    with pytest.raises(EquilibriumError, match=r"start elsewhere \(auto\)"):
        solve(Problem(planted.scene, weight=0.01), (planted.positions, np.zeros((25, 3))))


def test_candidates_that_cannot_hold_a_part_are_named():
    """Two corners alone leave the sail a rope."""
    scene = zoo.floating(sigma=0.01, supports__candidates=[0, 48]).scene
    with pytest.raises(EquilibriumError, match="widen supports"):
        solve(Problem(scene, weight=0.01))


def test_each_support_is_worth_what_the_others_lose_without_it():
    design = solve(Problem(zoo.floating(5, sigma=0.01).scene, weight=0.05))
    explained = explain(design.problem, design.positions, design.forces)
    assert len(explained.supports) == design.certificate.supports
    for value in explained.supports:
        assert np.isclose(value.dual, value.slope, rtol=1e-6)
        assert value.loss_objective is None or value.loss_objective > 0
    assert np.nanmax(explained.pull) <= 1 + 1e-6 or design.certificate.off_support <= 1


def test_a_part_that_its_supports_let_collapse_is_said():
    """A weight that no useful force is worth: small forces balance a sail of some hundredths of a millimetre."""
    scene = zoo.floating(5, sigma=0.01, membrane__springs="force-density").scene
    design = solve(Problem(scene, weight=3.0))
    assert np.ptp(design.positions, axis=0).max() < 1e-3 * np.ptp(scene.target, axis=0).max()
    assert any("has shrunk from" in word and "lower penalty.weight" in word for word in design.certificate.warnings)
    kept = solve(Problem(scene, weight=3e-3))
    assert kept.certificate.converged and not kept.certificate.warnings
