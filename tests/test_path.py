import itertools

import numpy as np
import pytest
import zoo

import relax
import relax.design.path
from relax.design.path import BISECTIONS, DOUBLINGS, LONGEST, RATIO, STEPS
from relax.design.starts import unsupported
from relax.errors import InputError

SPRINGS = {"membrane__springs": "force-density", "membrane__stiffness": 1.0}


def noisy(n=9):
    return relax.Problem(zoo.planted(n, zoo.TWO_MASTS, 0.01).scene, weight=1.0)


def convex(n=7):
    """Group lasso on a linear membrane: one minimum at each weight."""
    return relax.Problem(zoo.planted(n, zoo.TWO_MASTS, 0.01, **SPRINGS).scene, relax.GroupLasso(), 1.0)


@pytest.fixture
def counted(monkeypatch):
    """Every run of the solver, as it is made."""
    runs = []
    real = relax.design.path.solve

    def solve(problem, **options):
        runs.append(problem.weight)
        return real(problem, **options)

    monkeypatch.setattr(relax.design.path, "solve", solve)
    return runs


def test_the_largest_weight_is_where_the_dual_test_begins_to_fail():
    problem = convex()
    membrane, shape = problem.membrane, unsupported(problem)
    inverse = np.linalg.inv(membrane.stiffness(shape.positions).toarray())
    lam = 2 * inverse @ (shape.positions - problem.scene.target)[membrane.free].ravel()
    by_hand = np.linalg.norm(lam.reshape(-1, 3), axis=1).max()
    top = relax.largest_weight(problem)
    assert top == pytest.approx(by_hand, rel=1e-10)
    assert relax.solve(problem.replace(weight=1.001 * top)).certificate.supports == 0
    assert relax.solve(problem.replace(weight=0.999 * top)).certificate.supports >= 1
    # another penalty divides by its steepest slope, at t1 for the smoothed power
    power = relax.Power(0.5, 1e-4)
    slopes = power.slope(np.geomspace(1e-4, 1, 200_001))
    assert relax.largest_weight(problem.replace(penalty=power)) == pytest.approx(top / slopes.max(), rel=1e-6)


def test_the_largest_weight_looks_only_where_a_support_may_push():
    scene = zoo.planted(7, (((0.5, 0.5), (0.0, 0.0, -0.1)),), **SPRINGS).scene
    scene.settings["supports"]["direction"] = {"lean": 30.0}
    problem = relax.Problem(scene, relax.GroupLasso(), 1.0)
    shape = unsupported(problem)
    lam = problem.dual(shape.positions, problem.factor_at(shape.positions))
    assert lam[:, 2].min() > 0  # every mast that pushes up would only do harm
    assert np.abs(lam[:, :2]).max() < 1e-12
    assert relax.largest_weight(problem) < 1e-12 < lam[:, 2].max()


def test_one_planted_mast_stands_over_a_wide_range_of_weights():
    planted = zoo.planted(9)
    designs = list(relax.path(relax.Problem(planted.scene, weight=1.0)))
    weights = np.array([design.problem.weight for design in designs])
    assert len(designs) == STEPS
    np.testing.assert_allclose(weights[1:] / weights[:-1], RATIO)
    counts = [design.certificate.supports for design in designs]
    first = counts.index(1)
    assert counts == [0] * first + [1] * (STEPS - first) and first <= 4
    assert {design.supports[0].vertex for design in designs[first:]} == set(planted.vertices.tolist())
    assert all(design.certificate.converged for design in designs)


def test_it_is_lazy(counted):
    designs = relax.path(noisy())
    assert counted == []
    first = next(designs)
    assert first.certificate.supports == 0
    begun = len(counted)
    assert begun <= 2 * DOUBLINGS and counted[-1] == first.problem.weight
    next(designs)
    assert len(counted) == begun + 2


@pytest.mark.parametrize("many", [40, 1])
def test_each_design_is_no_worse_than_afresh_nor_than_the_one_before(monkeypatch, many):
    monkeypatch.setattr(relax.design.path, "MANY", many)
    problem = noisy()
    designs = list(itertools.islice(relax.path(problem), 12))
    for before, design in itertools.pairwise(designs):
        here = design.problem
        amplitudes = here.supports.amplitudes(before.forces[here.membrane.free])
        assert design.certificate.objective <= here.objective(before.positions, amplitudes) * (1 + 1e-9)
        fresh = relax.solve(problem.replace(weight=here.weight))
        assert design.certificate.objective <= fresh.certificate.objective * (1 + 1e-12)


def test_a_convex_path_is_monotone_and_solved_once_a_weight(counted):
    problem = convex()
    designs = list(relax.path(problem))
    assert len(counted) <= STEPS + 2  # warm and afresh at the first weight alone
    curve = relax.trade_off(designs)
    assert (np.diff(curve.weight) < 0).all()
    assert (np.diff(curve.distance) <= 1e-12).all() and (np.diff(curve.force) >= -1e-9).all()
    assert curve.supports[0] == 0 and curve.supports[-1] > 2
    for design in designs[2::5]:
        assert relax.solve(design.problem).certificate.objective == pytest.approx(design.certificate.objective, rel=1e-9)


def test_at_most_so_many_supports():
    problem = noisy()
    designs = list(relax.path(problem, count=2))
    weights = [design.problem.weight for design in designs]
    assert weights == sorted(weights, reverse=True)
    assert [design.certificate.supports for design in designs][-1] == 2
    assert max(design.certificate.supports for design in designs) == 2
    # the lightest: a little lighter, from this very design, more stand
    for share in (0.99, 0.97, 0.9):
        if list(relax.path(problem, [weights[-1], share * weights[-1]]))[-1].certificate.supports > 2:
            break
    else:
        pytest.fail("two supports stand well below the weight at which the path ended")
    rms = [design.certificate.rms_distance for design in designs]
    assert rms[-1] == min(rms)


def test_at_most_so_far():
    problem = noisy()
    designs = list(relax.path(problem, rms=0.015))
    *before, last = designs
    assert last.certificate.rms_distance <= 0.015 and "rms" not in last.stop
    assert all(design.certificate.rms_distance > 0.015 for design in before)
    assert all(one.problem.weight > other.problem.weight for one, other in itertools.pairwise(designs))
    # the heaviest, to the width of the last bisection
    assert last.problem.weight >= before[-1].problem.weight * RATIO ** (1 / 2**BISECTIONS) * (1 - 1e-9)


def test_what_cannot_be_reached_is_said_after_a_bounded_number_of_runs(counted):
    problem = noisy()
    designs = list(relax.path(problem, rms=1e-9))
    assert "before the rms distance is as small as 1e-09 m" in designs[-1].stop
    assert all("rms" not in design.stop for design in designs[:-1])
    assert len(counted) <= 2 * (DOUBLINGS + LONGEST)
    (only,) = relax.path(problem, [designs[-1].problem.weight], count=1)
    assert "no design with at most 1 supports" in only.stop
    assert relax.choose([only], count=1) == (0, False)
    assert relax.choose(designs, rms=1e-9) == (len(designs) - 1, False)


def test_given_weights_are_taken_from_the_heaviest():
    problem = noisy()
    designs = list(relax.path(problem, [0.01, 0.1, 0.03]))
    assert [design.problem.weight for design in designs] == [0.1, 0.03, 0.01]
    assert next(relax.path(problem, [0.03])).certificate.objective == pytest.approx(
        relax.solve(problem.replace(weight=0.03)).certificate.objective
    )


def test_a_fraction_in_the_scene_is_not_carried_along():
    scene = zoo.planted(7, penalty__weight=None, penalty__weight_fraction=0.1).scene
    first = next(relax.path(relax.Problem(scene)))
    assert first.settings["penalty"]["weight_fraction"] is None
    assert first.settings["penalty"]["weight"] == first.problem.weight
    assert scene.settings["penalty"]["weight_fraction"] == 0.1


def test_an_interrupted_design_is_the_last():
    calls = []

    def callback(record):
        calls.append(record)
        if len(calls) == 12:
            raise KeyboardInterrupt

    designs = list(relax.path(noisy(), callback=callback))
    assert designs[-1].interrupted and "interrupted" in designs[-1].stop
    assert not any(design.interrupted for design in designs[:-1])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"count": 1, "rms": 0.1}, "both"),
        ({"count": -1}, "count is -1"),
        ({"rms": 0.0}, "rms is 0.0"),
        ({"rms": float("nan")}, "rms is nan"),
        ({"weights": []}, "at least one"),
        ({"weights": [1.0, -1.0]}, "positive"),
        ({"weights": [float("inf")]}, "positive"),
    ],
)
def test_what_makes_no_sense_is_refused_at_once(options, sentence):
    with pytest.raises(InputError, match=sentence):
        relax.path(noisy(), **options)


def test_no_weight_is_useful_where_nothing_is_wanted():
    flat = relax.Problem(zoo.grid_scene(6), weight=1.0)
    with pytest.raises(InputError, match="no weight is useful"):
        next(relax.path(flat))
