"""Greedy moves on planted scenes, and where adding alone goes wrong."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import zoo
from test_exact import Count
from test_solve import FIVE

from relax.design.landscape import Landscape
from relax.design.methods.greedy import Greedy, greedy
from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.design.starts import unsupported
from relax.errors import EquilibriumError
from relax.iterate import Stop, iterate
from relax.sparsity.penalties import GroupLasso

SPRINGS = ["hookean", "tension-only", "force-density"]


def run(problem, *moves, look=8):
    """All states' records, and the last state."""
    method = Greedy(problem, moves or ("add", "drop", "swap"), look)
    done = iterate(method, method.begin(unsupported(problem)), 200)
    return done.state, done.trace


def vertices(problem, shape):
    return np.flatnonzero(problem.all_forces(shape.amplitudes).any(axis=1)).tolist()


@pytest.mark.parametrize("springs", SPRINGS)
@pytest.mark.parametrize(("n", "masts", "sigma"), [(9, zoo.ONE_MAST, 0.01), (9, zoo.TWO_MASTS, 0.01), (13, FIVE, 0.005)])
def test_planted_masts_are_found_from_nothing(n, masts, sigma, springs):
    weight = 5e-3 if springs == "force-density" else 1e-2  # such that no other supports are better than the planted ones
    planted = zoo.planted(n, masts, sigma=sigma, membrane__springs=springs, penalty__weight=weight)
    design = solve(Problem(planted.scene), method=greedy)
    assert np.flatnonzero(design.forces.any(axis=1)).tolist() == planted.vertices.tolist()
    assert design.certificate.converged and design.certificate.stationarity <= 1e-8


@pytest.mark.parametrize(
    "scene",
    [
        lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=1e-2),
        lambda: zoo.planted(9, zoo.TWO_MASTS, 0.02, membrane__loads=[0.02, 0, -0.05], penalty__weight=5e-3).scene,
        lambda: zoo.irregular_scene(8, penalty__weight=3e-3),
        lambda: zoo.planted(7, zoo.TWO_MASTS, sigma=0.02, penalty__weight=2e-3).scene,
    ],
)
def test_every_move_lowers_the_objective_and_the_end_is_certified(scene):
    problem = Problem(scene())
    design = solve(problem, method=greedy)
    judged = [judge(problem, x, p) for x, p in zip(design.trace.positions, design.trace.forces, strict=True)]
    assert len(judged) > 2
    for said, objective in zip(judged, design.trace.objective, strict=True):
        assert said.objective == pytest.approx(objective, rel=1e-12)
        assert said.equilibrium <= 1e-10 and said.stationarity <= 1e-8
    assert all(after < before for before, after in pairwise(design.trace.objective))
    assert judged[-1].converged and judged[-1].off_support <= 1 + 1e-6


def test_every_note_after_the_first_names_a_move():
    problem = Problem(zoo.grid_scene(9, zoo.bumps, penalty__weight=1e-2))
    notes = solve(problem, method=greedy).trace.notes
    assert "where it begins" in notes[0]
    assert all(any(word in note for word in ("add vertex", "drop vertex", "move vertex")) for note in notes[1:])


def test_where_adding_alone_is_wrong_moves_and_drops_mend_it():
    # between two equal masts the membrane bulges: the first support goes there, and its neighbours make it look needed
    masts = (((0.3, 0.5), (0.0, 0.0, 0.3)), ((0.7, 0.5), (0.0, 0.0, 0.3)))
    planted = zoo.planted(11, masts, 0.002, membrane__springs="force-density", penalty__weight=1e-3)
    problem = Problem(planted.scene, penalty=Count())
    pursuit, _ = run(problem, "add", look=1)
    assert len(vertices(problem, pursuit.shape)) == 3
    dropped, _ = run(problem, "add", "drop")
    assert dropped.objective == pytest.approx(pursuit.objective)
    state, trace = run(problem)
    assert vertices(problem, state.shape) == planted.vertices.tolist()
    assert state.objective < 0.5 * pursuit.objective
    kinds = [record["note"].split()[0] for record in trace[1:-1]]
    assert "move" in kinds and "drop" in kinds
    # no single change of what is left pays: each is tried without the model
    for g in np.flatnonzero(state.shape.amplitudes.any(axis=1)):
        fewer = state.shape.amplitudes.copy()
        fewer[g] = 0.0
        refitted = Greedy(problem).begin(replace(state.shape, amplitudes=fewer))
        assert refitted.objective > state.objective


def test_plain_pursuit_adds_the_steepest_first():
    planted = zoo.planted(9, zoo.TWO_MASTS, 0.01, penalty__weight=5e-3)
    problem = Problem(planted.scene)
    bare = unsupported(problem)
    dual = problem.supports.duals(problem.dual(bare.positions, bare.factor))
    steepest = int(np.argmax(np.linalg.norm(dual, axis=1)))
    method = Greedy(problem, ("add",), 1)
    first = method.step(method.begin(bare))
    assert vertices(problem, first.shape) == [int(problem.membrane.free[problem.supports.vertices[steepest]])]


def test_a_candidate_that_the_dual_asks_for_is_added_though_it_pays_little():
    # group lasso: convex, so that the dual test is the whole truth, and greedy must end at the one minimum
    problem = Problem(zoo.planted(7, zoo.TWO_MASTS, 0.01).scene, penalty=GroupLasso(), weight=3e-3)
    design = solve(problem, method=greedy)
    assert design.certificate.converged
    assert design.certificate.objective == pytest.approx(solve(problem).certificate.objective, rel=1e-9)


def test_supports_that_always_stand_are_there_from_the_start_and_stay():
    planted = zoo.planted(9, zoo.TWO_MASTS, 0.01, membrane__springs="force-density", penalty__weight=5e-3)
    weights = planted.scene.support_weight.copy()
    weights[40] = 0.0
    problem = Problem(replace(planted.scene, support_weight=weights))
    state, trace = run(problem)
    for record in trace:
        assert 40 in vertices(problem, record["shape"])
    assert trace[0]["supports"] == 1 and state.stop is Stop.CONVERGED


def test_where_the_membrane_does_not_stand_it_begins_at_the_start():
    # as long as they are flat, the springs hold nothing up: only the target's own forces do
    scene = zoo.grid_scene(7, zoo.hill, membrane__rest_scale=1.0, membrane__springs="tension-only", penalty__weight=1e-3)
    flat = replace(scene, rest_length=np.linalg.norm(np.diff(scene.start[scene.mesh.edges], axis=1)[:, 0], axis=1))
    problem = Problem(flat)
    with pytest.raises(EquilibriumError):
        unsupported(problem)
    design = solve(problem, method=greedy)
    assert all(after < before for before, after in pairwise(design.trace.objective))


def test_peaks_are_those_of_a_loop():
    problem = Problem(
        zoo.planted(7, zoo.ONE_MAST, supports__candidates=[8, 9, 11, 16, 17, 18, 19, 23, 25, 26, 31, 33, 37, 38, 40]).scene
    )
    landscape = Landscape(problem)
    vertices = problem.membrane.free[problem.supports.vertices].tolist()
    beside = {v: set() for v in vertices}
    for a, b in problem.membrane.edges.tolist():
        if a in beside and b in beside:
            beside[a].add(b)
            beside[b].add(a)
    field = np.random.default_rng(0).random(len(vertices))
    field[3] = 0.0
    at = dict(zip(vertices, field, strict=True))
    wanted = [i for i, v in enumerate(vertices) if at[v] > 0 and all(at[v] >= at[w] for w in beside[v])]
    assert landscape.peaks(field).tolist() == sorted(wanted, key=lambda i: -field[i])
    for i, v in enumerate(vertices):
        assert {vertices[j] for j in landscape.beside(i)} == beside[v]
