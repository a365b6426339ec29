"""The search on scenes with planted masts, and what it must never do, whatever the scene."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import zoo
from test_refit import start
from test_reweighted import LogSum
from test_solve import FIVE

from relax.convex.backends import clarabel
from relax.design import search, trial
from relax.design.landscape import Landscape
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.rounding import round_supports
from relax.design.search import Search
from relax.design.shape import Shape, loaded
from relax.design.solve import solve
from relax.design.starts import at_target, pulled, unsupported
from relax.iterate import Stop, iterate
from relax.sparsity.supports import sizes

SCENES = {
    "two masts": lambda: zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3).scene,
    "five masts": lambda: zoo.planted(13, FIVE, sigma=0.005, penalty__weight=5e-3).scene,
    "bumps": lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=1e-2),
    "loads": lambda: zoo.planted(9, zoo.TWO_MASTS, sigma=0.02, membrane__loads=[0.02, 0, -0.05], penalty__weight=5e-3).scene,
    "force density": lambda: zoo.planted(9, zoo.TWO_MASTS, 0.01, membrane__springs="force-density", penalty__weight=5e-3).scene,
    "fabric": lambda: zoo.planted(9, zoo.TWO_MASTS, 0.01, membrane__springs="tension-only", penalty__weight=5e-3).scene,
    "no mesh of squares": lambda: zoo.irregular_scene(8, penalty__weight=3e-3),
    "so light that most stand": lambda: zoo.planted(7, zoo.TWO_MASTS, sigma=0.02, penalty__weight=3e-4).scene,
    "few candidates": lambda: (
        zoo.planted(9, zoo.TWO_MASTS, 0.01, supports__candidates=[20, 30, 31, 42], penalty__weight=5e-3).scene
    ),
}
every_scene = pytest.mark.parametrize("name", SCENES)


def searched(problem, shape):
    """The last state, why it ended and the record of each step."""
    method = Search(problem)
    run = iterate(method, method.begin(shape), 60)
    return run.state, run.stop, run.trace


def vertices(problem, shape):
    return np.flatnonzero(problem.all_forces(shape.amplitudes).any(axis=1)).tolist()


def unbalanced(problem, shape):
    return problem.membrane.forces(shape.positions) + problem.supports.forces(shape.amplitudes) + problem.loads


def test_a_trial_that_is_broken_off_would_not_have_paid(monkeypatch):
    """Each of them brought to rest after all, on every scene and on larger ones: none has an objective that counts."""
    ended = []

    def both(problem, shape, amplitudes, below):
        moved, broken = trial.tried(problem, shape, amplitudes, below)
        if broken:
            whole = loaded(problem, shape, amplitudes)
            ended.append(np.inf if whole is None else problem.objective(whole.positions, whole.amplitudes) / below)
        return moved, broken

    monkeypatch.setattr(search, "tried", both)
    larger = [zoo.grid_scene(n, zoo.bumps, penalty__weight=weight) for n in (13, 17) for weight in (3e-3, 1e-2, 3e-2)]
    for scene in [*(make() for make in SCENES.values()), *larger]:
        solve(Problem(scene))
    assert len(ended) > 10 and min(ended) >= 1


@pytest.mark.parametrize("springs", ["hookean", "tension-only", "force-density"])
@pytest.mark.parametrize(
    ("n", "masts", "sigma", "weight"), [(9, zoo.ONE_MAST, 0.01, 1e-2), (9, zoo.TWO_MASTS, 0.01, 1e-2), (13, FIVE, 0.005, 5e-3)]
)
def test_noisy_planted_masts_are_found_from_forces_everywhere(n, masts, sigma, weight, springs):
    for seed in range(3):
        planted = zoo.planted(n, masts, sigma=sigma, seed=seed, membrane__springs=springs, penalty__weight=weight)
        problem = Problem(planted.scene)
        dense = pulled(problem)
        assert problem.standing(dense.amplitudes).all()
        state, stop, _ = searched(problem, dense)
        assert stop is Stop.CONVERGED
        rounded = round_supports(problem, state.shape, np.zeros(len(dense.amplitudes), dtype=bool), lambda _: None).shape
        assert vertices(problem, rounded) == planted.vertices.tolist()
        # debiased, the forces are off by what noise of this size does to them: its root mean square times the worst lever
        fine = refit(problem, rounded, "debiased")
        truth = problem.supports.amplitudes(planted.forces[problem.membrane.free])
        stands = np.flatnonzero(truth.any(axis=1))
        columns = problem.factor_at(planted.positions).inverse_columns(problem.supports.rows[stands].ravel())
        covariance = np.linalg.inv(columns.T @ columns) * sigma**2
        off = (fine.amplitudes - truth)[stands].ravel()
        assert (np.abs(off) <= 5 * np.sqrt(np.diag(covariance))).all() and off.any()


@every_scene
def test_after_the_first_step_the_objective_never_rises_and_every_shape_rests(name):
    problem = Problem(SCENES[name]())
    state, stop, trace = searched(problem, pulled(problem) or unsupported(problem))
    assert stop in (Stop.CONVERGED, Stop.STALLED) and len(trace) < 30
    objective = [record["objective"] for record in trace[1:]]
    assert all(after <= before for before, after in pairwise(objective))
    for record in trace:
        shape = record["shape"]
        assert np.abs(unbalanced(problem, shape)).max() < 1e-9
        assert record["objective"] == problem.objective(shape.positions, shape.amplitudes)
        assert record["supports"] == len(vertices(problem, shape))
    bare = unsupported(problem)
    assert objective[-1] <= problem.objective(bare.positions, bare.amplitudes) and state.shape is trace[-1]["shape"]


@every_scene
def test_what_the_search_ends_with_is_left_alone_when_searched_again(name):
    problem = Problem(SCENES[name]())
    state, _, _ = searched(problem, pulled(problem) or unsupported(problem))
    fine = refit(problem, state.shape)
    again, stop, trace = searched(problem, fine)
    assert stop in (Stop.CONVERGED, Stop.STALLED)
    assert len(trace) == 2
    np.testing.assert_array_equal(again.shape.amplitudes, fine.amplitudes)


def test_the_planted_answer_stays():
    planted = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-4)
    problem = Problem(planted.scene)
    amplitudes = problem.supports.amplitudes(planted.forces[problem.membrane.free])
    shape = refit(problem, Shape(planted.positions, amplitudes, None, 0))
    state, stop, trace = searched(problem, shape)
    assert stop is Stop.CONVERGED and len(trace) == 2 and not state.failure
    np.testing.assert_array_equal(state.shape.amplitudes, shape.amplitudes)


@pytest.mark.parametrize("apart", [1, 8, 9])
def test_two_neighbours_that_share_one_masts_force_become_one(apart):
    """The mast stands in vertex 40 of 9 x 9; its force is given to 40 and a neighbour, or to both beside it."""
    planted = zoo.planted(9, sigma=0.005, penalty__weight=5e-3)
    (mast,) = planted.vertices
    problem = Problem(planted.scene)
    free = problem.membrane.free
    group = {int(vertex): place for place, vertex in enumerate(free[problem.supports.vertices])}
    half = planted.forces[mast] / 2
    for pair in ((mast, mast + apart), (mast - apart, mast + apart)):
        shape = start(problem, {group[int(vertex)]: half for vertex in pair})
        state, _, trace = searched(problem, shape)
        assert vertices(problem, state.shape) == [mast]
        assert trace[-1]["objective"] < trace[0]["objective"]


def test_two_supports_are_one_only_where_they_stand_close_and_pull_the_same_way():
    planted = zoo.planted(9, sigma=0.005, penalty__weight=5e-3)
    problem = Problem(planted.scene)
    place = {int(vertex): g for g, vertex in enumerate(problem.membrane.free[problem.supports.vertices])}
    method = Search(problem)

    def pairs(forces):
        return method._close_pairs(start(problem, {place[vertex]: (0.0, 0.0, force) for vertex, force in forces.items()}))

    close, halfway = pairs({39: 0.15, 41: 0.15})
    assert close.tolist() == [[place[39], place[41]]] and halfway.tolist() == [place[40]]
    assert pairs({39: 0.25, 41: 0.01})[1].tolist() == [place[39]]  # nearer to the stronger
    for forces in ({10: 0.15, 70: 0.15}, {39: 0.15, 41: -0.15}, {40: 0.3}, {}):
        assert pairs(forces)[0].shape == (0, 2)


def test_a_mast_split_in_two_becomes_one_where_the_proposals_do_not_see_it(monkeypatch):
    """With no other proposal taken, rearranging alone gets there: it is the way out of a minimum with a mast in two."""
    planted = zoo.planted(9, sigma=0.005, penalty__weight=5e-3)
    problem = Problem(planted.scene)
    place = {int(vertex): g for g, vertex in enumerate(problem.membrane.free[problem.supports.vertices])}
    method = Search(problem)
    tried = Search._tried
    calls = []

    def second_alone(self, state, model, proposals, *promise):
        calls.append(len(proposals))
        return tried(self, state, model, [] if len(calls) == 1 else proposals, *promise)

    monkeypatch.setattr(Search, "_tried", second_alone)
    moved = method.step(method.begin(start(problem, {place[40]: (0.0, 0.0, 0.2), place[41]: (0.0, 0.0, 0.1)})))
    assert len(calls) == 2 and vertices(problem, moved.shape) == [40] and moved.stop is None


@pytest.mark.parametrize(
    "changes",
    [
        {"supports__never": [20, 42]},
        {"supports__candidates": [20, 30, 31, 42]},
        {"supports__candidates": {"box": [[0.0, 0.0], [0.5, 1.0]]}},
    ],
)
def test_only_candidates_carry_a_force(changes):
    """The planted masts stand in 20 and 42."""
    scene = zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3, **changes).scene
    problem = Problem(scene)
    allowed = set(np.flatnonzero(scene.candidates & ~scene.fixed).tolist())
    assert len(allowed) < 49
    state, _, trace = searched(problem, pulled(problem))
    assert state.shape.amplitudes.any()
    for record in trace:
        assert set(vertices(problem, record["shape"])) <= allowed


@pytest.mark.parametrize("candidates", [[], [40], [0, 40]])
def test_one_candidate_or_none(candidates):
    scene = zoo.planted(9, sigma=0.01, penalty__weight=5e-3).scene
    chosen = np.zeros(81, dtype=bool)
    chosen[candidates] = True
    problem = Problem(replace(scene, candidates=chosen))
    shape = pulled(problem)
    state, stop, _ = searched(problem, shape)
    assert stop is Stop.CONVERGED and vertices(problem, state.shape) == [40] * (40 in candidates)


@pytest.mark.parametrize("weight", [1.0, 1e3, 1e9])
def test_weights_under_which_nothing_may_stand(weight):
    problem = Problem(zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=weight).scene)
    state, stop, _ = searched(problem, pulled(problem))
    bare = unsupported(problem)
    assert stop is Stop.CONVERGED and not state.shape.amplitudes.any()
    np.testing.assert_allclose(state.shape.positions, bare.positions, atol=1e-9)


@pytest.mark.parametrize("weight", [1e-8, 1e-5, 1e-3])
def test_weights_so_light_that_forces_everywhere_pay_leave_the_target_held_by_them(weight):
    """At the target E_dist is 0; what few supports reach is worse, by orders of magnitude."""
    problem = Problem(zoo.planted(9, zoo.TWO_MASTS, sigma=0.02, penalty__weight=weight).scene)
    shape = at_target(problem)
    state, stop, trace = searched(problem, shape)
    assert stop is Stop.CONVERGED and not state.failure
    np.testing.assert_array_equal(state.shape.amplitudes, shape.amplitudes)
    assert trace[-1]["objective"] == problem.sparsity(shape.amplitudes)


def test_forces_everywhere_are_not_kept_where_the_membrane_would_not_stand_under_them():
    problem = Problem(zoo.planted(11, zoo.TWO_MASTS, sigma=0.02, penalty__weight=1e-3).scene)
    shape = at_target(problem)
    assert not problem.factor_at(shape.positions).positive_definite
    state, _, trace = searched(problem, shape)
    assert trace[0]["objective"] < trace[-1]["objective"]  # what it would have been worth
    assert problem.factor_at(state.shape.positions).positive_definite and not problem.standing(state.shape.amplitudes).all()


def test_a_target_at_distance_zero_has_nothing_better_and_nothing_failed():
    problem = Problem(zoo.pyramid(0.0, penalty__weight=1e-3))
    bare = unsupported(problem)
    state, stop, _ = searched(problem, bare)
    assert problem.distance(bare.positions) == 0 and stop is Stop.CONVERGED and not state.failure


@pytest.mark.parametrize("penalty", [LogSum(0.02), LogSum(0.05)])
def test_a_penalty_of_the_users_own_is_searched_with(penalty):
    planted = zoo.planted(9, zoo.TWO_MASTS, sigma=0.01)
    design = solve(Problem(planted.scene, penalty, 5e-3))
    assert design.certificate.converged and np.flatnonzero(design.forces.any(axis=1)).tolist() == planted.vertices.tolist()
    assert any("model of" in note for note in design.trace.notes)


@every_scene
def test_peaks_and_neighbours_are_those_of_the_mesh(name):
    problem = Problem(SCENES[name]())
    land = Landscape(problem)
    place = problem.membrane.free[problem.supports.vertices]
    near = [{i} for i in range(len(place))]
    for a, b in problem.membrane.edges:
        i, j = np.flatnonzero(place == a), np.flatnonzero(place == b)
        if i.size and j.size:
            near[i[0]].add(int(j[0]))
            near[j[0]].add(int(i[0]))
    assert [{i, *land.beside(i).tolist()} for i in range(len(place))] == near
    field = np.random.default_rng(0).random(len(place))
    tops = [i for i in range(len(place)) if all(field[i] >= field[j] for j in near[i])]
    assert land.peaks(field).tolist() == sorted(tops, key=lambda i: -field[i])
    every = np.arange(len(place))
    assert land.uphill(field, every).tolist() == [max(near[i], key=lambda j: field[j]) for i in range(len(place))]


def test_a_model_that_promises_what_is_not_so_ends_the_search_with_the_reason(monkeypatch):
    problem = Problem(SCENES["bumps"]())
    monkeypatch.setattr(trial, "loaded", lambda *_: None)
    bare = unsupported(problem)
    method = Search(problem)
    state = method.step(method.begin(bare))
    assert state.stop is Stop.STALLED and "nothing that the model proposed lowers the objective" in state.failure
    np.testing.assert_array_equal(state.shape.positions, bare.positions)


def stages(design):
    """Which starts the trace tells of."""
    return {note.split(":")[0].split(",")[0].split(";")[0] for note in design.trace.notes}


def test_where_nothing_comes_of_the_pulled_start_the_heavy_ones_are_taken(monkeypatch):
    planted = zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3)
    assert stages(solve(Problem(planted.scene))) == {"start pulled"}
    real = trial.loaded

    def refused(*asked):
        """No rest for what is proposed from the dense shape."""
        return None if dense and dense.pop() else real(*asked)

    dense = [True]
    monkeypatch.setattr(trial, "loaded", refused)
    design = solve(Problem(planted.scene))
    assert {"start pulled", "start heavy 0.5"} <= stages(design)
    monkeypatch.undo()
    heavy = solve(Problem(zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3, solver__start="heavy").scene))
    assert design.certificate.converged and design.certificate.objective == pytest.approx(heavy.certificate.objective, rel=1e-8)


def test_a_backend_that_was_named_takes_the_convex_steps_and_the_search_has_the_last_word(monkeypatch):
    scene = zoo.planted(7, sigma=0.01, penalty__weight=5e-3).scene
    called, step = [], Search.step
    monkeypatch.setattr(Search, "step", lambda *given: (called.append("search"), step(*given))[1])

    def counted(given, shape):
        called.append("convex step")
        return clarabel(given, shape)

    design = solve(Problem(scene), backend=counted)
    assert design.certificate.converged
    assert called[0] == "convex step" and called[-1] == "search"
    first = called.index("search")
    assert set(called[:first]) == {"convex step"} and set(called[first:]) == {"search"}
    stages = [note.split(":")[0] for note in design.trace.notes]
    moves = [stage for stage in stages if "moves" in stage]
    assert design.trace.objective[-1] <= design.trace.objective[len(stages) - len(moves) - 1] * (1 + 1e-12)


def test_force_sizes_of_the_dense_start_are_not_what_is_kept():
    """The pulled forces only show where: at the end every force is the problem's own, stationary under R."""
    problem = Problem(SCENES["two masts"]())
    dense = pulled(problem)
    state, _, _ = searched(problem, dense)
    stands = problem.standing(state.shape.amplitudes)
    assert (np.abs(sizes(state.shape.amplitudes)[stands] / sizes(dense.amplitudes)[stands] - 1) > 0.05).all()
