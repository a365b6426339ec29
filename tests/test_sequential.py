"""Sequential convex steps: each accepted one pays at true equilibrium, found here again with no help from the algorithm."""

import itertools

import numpy as np
import pytest
import zoo

from relax.convex.backends import BACKENDS, working_set
from relax.convex.subproblem import certify
from relax.design.problem import Problem
from relax.design.sequential import FIRST_DAMPING, SequentialConvex, State
from relax.design.starts import at_target, unsupported
from relax.errors import BackendError
from relax.iterate import Stop, iterate

SCENES = {
    "tent": lambda: zoo.planted(9, penalty__weight=1e-3).scene,
    "noisy tent": lambda: zoo.planted(9, sigma=0.01, penalty__weight=1e-2).scene,
    "noisy, two masts, loads": lambda: (
        zoo.planted(9, zoo.TWO_MASTS, sigma=0.02, penalty__weight=3e-3, membrane__loads=[0.02, 0, -0.1]).scene
    ),
    "bumps": lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=3e-2),
    "bumps, low weight": lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=1e-3),
    "bumps, little prestress": lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=1e-2, membrane__rest_scale=0.95),
    "bumps, tension-only": lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=1e-2, membrane__springs="tension-only"),
    "force density": lambda: zoo.force_density_net(penalty__weight=1e-3),
    "group lasso": lambda: zoo.grid_scene(9, zoo.bumps, penalty__weight=3e-2, penalty__name="group-lasso"),
}


@pytest.fixture(scope="module", params=SCENES)
def problem(request):
    return Problem(SCENES[request.param]())


def run_from(problem, shape, weights=None, backend=working_set, limit=60):
    """The run and its shapes, one a state."""
    seen = []
    method = SequentialConvex(problem, weights or problem.group_weights, backend)
    return iterate(method, State(shape), limit, seen.append), [record["shape"] for record in seen], seen


def energy_of(problem, positions):
    """Internal forces on the free vertices by plain differences of the energy: nothing of the membrane's own forces."""
    step = 1e-6
    force = np.zeros((len(problem.membrane.free), 3))
    for row, vertex in enumerate(problem.membrane.free):
        for axis in range(3):
            near = [positions.copy(), positions.copy()]
            near[0][vertex, axis] += step
            near[1][vertex, axis] -= step
            force[row, axis] = -(problem.membrane.energy(near[0]) - problem.membrane.energy(near[1])) / (2 * step)
    return force


def norms(amplitudes):
    return np.linalg.norm(amplitudes, axis=1)


@pytest.mark.parametrize("beginning", ["unsupported", "target"])
def test_no_accepted_step_raises_the_weighted_objective_at_true_equilibrium(problem, beginning):
    shape = unsupported(problem) if beginning == "unsupported" else at_target(problem)
    run, shapes, _ = run_from(problem, shape)
    steps = 0
    for before, after in itertools.pairwise(shapes):
        if after.positions is before.positions:
            continue
        weights = problem.group_weights(before.amplitudes)
        value = [problem.distance(shape.positions) + weights @ norms(shape.amplitudes) for shape in (before, after)]
        assert value[1] < value[0]
        steps += 1
    assert steps >= 1
    last = run.state.shape
    balance = energy_of(problem, last.positions) + problem.supports.forces(last.amplitudes) + problem.loads
    assert np.abs(balance).max() < 1e-8


def test_the_sequence_settles_within_its_steps(problem):
    run, shapes, _ = run_from(problem, unsupported(problem))
    assert run.stop is Stop.CONVERGED and run.steps < 60
    state = run.state
    assert state.settled or state.exhausted
    assert len(shapes) == run.steps + 1
    assert state.shape.factorizations >= (1 if problem.membrane.linear else run.steps)


def test_a_converged_group_lasso_step_has_nothing_more_to_gain():
    problem = Problem(zoo.planted(7, sigma=0.01, penalty__name="group-lasso", penalty__weight=1e-2).scene)
    shape = unsupported(problem)
    for _ in range(12):
        run, _, records = run_from(problem, shape)
        shape = run.state.shape
        if run.state.exhausted:
            break
    assert run.state.exhausted and "nothing more to gain" in run.state.note
    assert records[-1]["supports"] == int(shape.amplitudes.any(axis=1).sum()) > 0


def test_a_refused_step_is_damped_until_one_is_kept():
    """A back-end whose undamped answers are far too long: the step is shortened, and the state says by how much."""
    problem = Problem(zoo.planted(7, penalty__weight=1e-3, penalty__name="group-lasso").scene)
    asked = []

    def hasty(step, start):
        damping = step.metric.diagonal()[0] - 1
        asked.append(damping)
        solution = working_set(step, start)
        if damping >= 1:
            return solution
        # the model is kept in the belief that it gains, and the membrane is thrown far beyond the target
        far = certify(step, 30 * solution.amplitudes)
        return type(solution)(far.amplitudes, solution.displacement, solution.dual, solution.value, solution.bound, "hasty")

    shape = unsupported(problem)
    method = SequentialConvex(problem, lambda amplitudes: np.full(len(amplitudes), 1e-6), hasty)
    state = method.step(State(shape))
    assert asked[:2] == pytest.approx([0.0, FIRST_DAMPING])
    assert len(asked) >= 3 and asked[-1] >= 1 and np.all(np.diff(asked) > 0)
    assert state.shape.amplitudes.any() and f"damping {asked[-1]:.2g}" in state.note
    # the next step begins with what this one needed, or less where it kept its promise
    assert 0 < state.damping <= asked[-1] * (1 + 1e-12)
    again = asked.copy()
    method.step(state)
    assert asked[len(again)] == pytest.approx(state.damping)


def test_where_every_step_is_refused_the_shape_stays():
    problem = Problem(zoo.planted(7, penalty__weight=1e-3).scene)
    solved = {}

    def backwards(step, start):
        solution = working_set(step, start)
        solved["damping"] = step.metric.diagonal()[0] - 1
        return type(solution)(
            -solution.amplitudes, solution.displacement, solution.dual, solution.value, solution.bound, "backwards"
        )

    shape = unsupported(problem)
    # at this weight a support pays, so the wrong one costs: pushing down where the target is up
    method = SequentialConvex(problem, lambda amplitudes: np.full(len(amplitudes), 1e-4), backwards)
    state = method.step(State(shape))
    assert state.exhausted and state.note == "every step was refused"
    assert state.shape.positions is shape.positions and state.shape.amplitudes is shape.amplitudes
    assert method.done(state) is Stop.CONVERGED
    assert solved["damping"] > 1


def test_a_backend_that_fails_ends_the_sequence_with_what_was_reached():
    problem = Problem(zoo.planted(7, sigma=0.01, penalty__weight=1e-2).scene)
    calls = []

    def fails_second(step, start):
        calls.append(1)
        if len(calls) == 2:
            raise BackendError("the solver lost its way")
        return working_set(step, start)

    run, shapes, _ = run_from(problem, unsupported(problem), lambda a: np.full(len(a), 1e-2), fails_second)
    assert run.stop is Stop.CONVERGED and len(calls) == 2
    assert run.state.exhausted and run.state.failure == "the solver lost its way"
    assert run.state.shape.positions is shapes[1].positions and run.state.shape.amplitudes.any()


@pytest.mark.parametrize("backend", ["clarabel", "cvxpy"])
def test_other_backends_take_the_same_step(backend):
    problem = Problem(zoo.planted(7, zoo.TWO_MASTS, sigma=0.01, penalty__weight=1e-2).scene)
    shape = unsupported(problem)
    weights = np.full(len(problem.supports.vertices), 1e-2)
    one = SequentialConvex(problem, lambda _: weights, working_set).step(State(shape)).shape
    other = SequentialConvex(problem, lambda _: weights, BACKENDS[backend]).step(State(shape)).shape
    assert one.amplitudes.any()
    np.testing.assert_array_equal(problem.standing(one.amplitudes), problem.standing(other.amplitudes))
    np.testing.assert_allclose(other.amplitudes, one.amplitudes, atol=1e-6)
    np.testing.assert_allclose(other.positions, one.positions, atol=1e-6)
