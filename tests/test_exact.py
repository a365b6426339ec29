"""The tree against the search through all supports, its cuts against the objective itself, and what it refuses."""

import sys
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pytest
import zoo
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from test_reweighted import Capped, LogSum, descended

from relax.design.methods.exact import best_subset, exact
from relax.design.methods.pieces import pieces_of
from relax.design.methods.quadratic import quadratic_of, small_problem
from relax.design.methods.relaxation import relaxation_of
from relax.design.problem import Problem
from relax.design.solve import solve
from relax.errors import InputError
from relax.sparsity.penalties import Count, GroupLasso, Power
from relax.sparsity.supports import sizes

pytest.importorskip("pyscipopt", reason="pip install 'relax-tensile[exact]'")


TWELVE = [7, 8, 10, 13, 14, 15, 16, 20, 21, 22, 25, 28]  # of the 16 free vertices of a net of 6 x 6


@dataclass(frozen=True)
class Flat(Capped):
    """Flat beyond its knee (MCP), with the curvature that it has."""

    name: str = "flat"

    def curvature(self, size):
        return np.where(np.asarray(size) < self.knee, -1 / self.knee, 0.0)


CONCAVE = [Power(0.5, 1e-6), Power(0.9, 1e-4), LogSum(), Flat()]


def net(seed=0, penalty=None, weight=2e-3, candidates=TWELVE, **changes):
    """A loaded net of 6 x 6 vertices with two planted supports and noise of 1 %, and few candidates."""
    chosen = {"membrane__springs": "force-density", "supports__candidates": candidates, **changes}
    scene = zoo.planted(6, (((0.4, 0.4), (0.02, 0, 0.3)), ((0.6, 0.8), (0, 0.05, -0.2))), 0.02, seed, **chosen).scene
    return Problem(scene, penalty=penalty or Count(), weight=weight)


def uneven(problem, seed):
    """Another price for each support; the first stands whatever comes."""
    weights = np.random.default_rng(seed).uniform(0.3, 3.0, problem.scene.mesh.vertices)
    weights[problem.membrane.free[problem.supports.vertices[0]]] = 0.0
    return problem.replace(scene=replace(problem.scene, support_weight=weights))


def fitted(quadratic, index, low=-np.inf):
    """Least squares on some amplitudes, by the normal equations' root: forces and E_dist."""
    gram = quadratic.gram[np.ix_(index, index)]
    root = np.linalg.cholesky(gram).T
    right = np.linalg.solve(root.T, -quadratic.linear.ravel()[index])
    s = lsq_linear(root, right, (low, np.inf), method="bvls").x if np.isfinite(low) else np.linalg.solve(root, right)
    flat = np.zeros(quadratic.linear.size)
    flat[index] = s
    return flat.reshape(quadratic.linear.shape)


def best_of_all(problem, low=-np.inf):
    """Every set of supports, fitted: the lowest E_dist + count, and which."""
    quadratic = quadratic_of(problem)
    count, width = quadratic.linear.shape
    always = np.flatnonzero(quadratic.costs == 0).tolist()
    best, which = np.inf, None
    for size in range(count + 1 - len(always)):
        for chosen in combinations(np.flatnonzero(quadratic.costs > 0).tolist(), size):
            members = sorted([*always, *chosen])
            cost = quadratic.costs[members].sum()
            if cost >= best:
                continue
            index = np.array([width * g + i for g in members for i in range(width)], dtype=int)
            value = cost + quadratic.distance(fitted(quadratic, index, low))
            if value < best:
                best, which = value, members
    return best, which


@pytest.mark.parametrize(("seed", "weight"), [(0, 2e-3), (1, 5e-4), (2, 2e-4), (3, 1e-2)])
def test_counted_supports_are_the_best_of_all(seed, weight):
    problem = net(seed, weight=weight)
    value, members = best_of_all(problem)
    found = best_subset(problem)
    assert found.status == "optimal" and found.gap <= 2e-6
    assert found.value == pytest.approx(value, rel=1e-9)
    assert np.flatnonzero(found.amplitudes.any(axis=1)).tolist() == members
    assert found.bound <= value * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_prices_differ_and_one_support_always_stands(seed):
    problem = uneven(net(seed, weight=1e-3), seed)
    value, members = best_of_all(problem)
    found = best_subset(problem)
    assert found.status == "optimal"
    assert found.value == pytest.approx(value, rel=1e-9)
    assert np.flatnonzero(found.amplitudes.any(axis=1)).tolist() == members


@pytest.mark.parametrize(("direction", "low"), [("vertical", -np.inf), ("up", 0.0)])
def test_vertical_supports_and_those_that_only_push(direction, low):
    problem = net(1, weight=1e-3, supports__direction=direction)
    value, _ = best_of_all(problem, low)
    found = best_subset(problem)
    assert found.amplitudes.min() >= low
    assert found.status == "optimal"
    assert found.value == pytest.approx(value, rel=2e-6)


def test_the_largest_force_is_kept():
    free = best_subset(net(0))
    largest = 0.5 * float(sizes(free.amplitudes).max())
    held = best_subset(net(0, supports__max_force=largest))
    assert sizes(held.amplitudes).max() <= largest * (1 + 1e-12)
    assert free.value < held.bound <= held.value


@pytest.mark.parametrize("penalty", CONCAVE, ids=repr)
@pytest.mark.parametrize("seed", range(2))
def test_concave_penalties_end_with_a_bound_below_every_local_minimum(penalty, seed):
    problem = net(seed, penalty, 5e-3, TWELVE[:8])
    quadratic = quadratic_of(problem)
    small = small_problem(problem, quadratic)
    lowest = quadratic.constant
    for size in range(1, 9):
        for members in combinations(range(8), size):
            index = np.array([3 * g + i for g in members for i in range(3)])
            s = descended(small, fitted(quadratic, index), 60)
            # a smoothed penalty gains next to nothing by tiny forces everywhere, which no answer keeps
            s = descended(small, np.where((sizes(s) > 2 * penalty.resolution)[:, None], s, 0.0), 60)
            if (sizes(s)[s.any(axis=1)] <= penalty.resolution).any():
                continue
            lowest = min(lowest, small.value(s) + quadratic.constant)
    found = best_subset(problem)
    assert found.status in ("optimal", "gap") and found.gap <= 0.01
    assert found.bound <= lowest
    assert found.value <= lowest * (1 + 1e-9)


def test_a_convex_penalty_has_no_gap():
    problem = net(0, GroupLasso())
    found = best_subset(problem)
    assert found.status == "optimal" and found.nodes <= 5
    assert found.value == pytest.approx(solve(problem).certificate.objective, rel=1e-9)


@pytest.mark.parametrize("penalty", [*CONCAVE, Count(), GroupLasso()], ids=repr)
@given(st.integers(0, 10_000))
def test_no_cut_is_above_the_objective_of_any_point(penalty, seed):
    problem = uneven(net(0, penalty, 5e-3), 0)
    quadratic = quadratic_of(problem)
    relaxation = relaxation_of(problem, quadratic, 0.7 * quadratic.constant)
    rng = np.random.default_rng(seed)
    pieces, count = relaxation.pieces, len(quadratic.costs)
    # a segment for each group, a size in it, any direction
    segment = np.array([rng.choice(np.flatnonzero(row)) for row in relaxation.everywhere])
    segment[rng.random(count) < 0.5] = 0
    high = np.minimum(np.maximum.reduceat(pieces.end, pieces.first)[segment], relaxation.caps)
    size = pieces.low[segment] + rng.random(count) * np.maximum(high - pieces.low[segment], 0.0)
    size = np.where(relaxation.chosen, size, rng.random(count) * relaxation.caps)
    way = rng.normal(size=quadratic.linear.shape)
    s = size[:, None] * way / sizes(way)[:, None]
    # a counted force of no size at all is still counted in its segment
    cost = np.where(size > 0, penalty.value(size), pieces.base[segment])
    value = quadratic.distance(s) + float(quadratic.costs @ cost)
    for point in (s, quadratic.fitted, 10 ** rng.uniform(-3, 1) * rng.normal(size=s.shape)):
        cut = relaxation.cut(point)
        assert cut.constant + cut.values[np.arange(count), segment].sum() <= value + 1e-12 * quadratic.constant
        better, _ = relaxation.tightest(relaxation.everywhere, point, 0.7 * quadratic.constant)
        assert better.bound(relaxation.everywhere) >= cut.bound(relaxation.everywhere)
        assert better.constant + better.values[np.arange(count), segment].sum() <= value + 1e-12 * quadratic.constant


def test_what_is_split_off_leaves_a_quadratic_that_bends_up_and_no_more_could_be():
    for problem in (net(0), net(1, supports__direction="vertical")):
        quadratic = quadratic_of(problem)
        width = quadratic.linear.shape[1]
        values = np.linalg.eigvalsh(quadratic.gram - np.diag(np.repeat(quadratic.split, width)))
        assert -1e-14 < values[0] / values[-1] < 1e-8
        assert (quadratic.split > 0).all()


@pytest.mark.parametrize("direction", ["any", "up", {"lean": 20.0}], ids=str)
@pytest.mark.parametrize("share", [1e-2, 3e-3])
def test_newton_on_the_smoothed_bound_climbs_and_ends_quadratically(direction, share):
    problem = net(1, Power(0.5, 1e-6), 5e-3, supports__direction=direction)
    quadratic = quadratic_of(problem)
    relaxation = relaxation_of(problem, quadratic, quadratic.constant)
    allowed, smoothing = relaxation.everywhere, share * quadratic.constant
    point = quadratic.fitted
    value, step, gain = relaxation._newton(allowed, point, smoothing)
    ahead, behind = (relaxation._newton(allowed, point + t * step, smoothing)[0] for t in (1e-6, -1e-6))
    assert gain == pytest.approx((ahead - behind) / 2e-6, rel=1e-4)
    point = relaxation._climbed(allowed, point, smoothing)
    gains = []
    for _ in range(4):
        after, step, gain = relaxation._newton(allowed, point, smoothing)
        assert after >= value - 1e-12
        gains.append(gain / quadratic.constant)
        point = point + step
    assert min(gains) <= 1e-12


def test_supports_that_push_are_cut_at_their_own_value():
    problem = net(1, supports__direction="up")
    quadratic = quadratic_of(problem)
    relaxation = relaxation_of(problem, quadratic, quadratic.constant)
    members = list(range(len(quadratic.costs)))
    wanted = fitted(quadratic, np.array(members), 0.0)
    assert (wanted == 0).any() and (wanted > 0).any()
    allowed = np.tile([False, True], (len(members), 1))
    cut, point = relaxation.tightest(allowed, quadratic.fitted, quadratic.constant)
    assert cut.bound(allowed) == pytest.approx(quadratic.distance(wanted) + quadratic.costs.sum(), rel=1e-6)
    assert np.allclose(relaxation.forces(allowed, point), wanted, atol=1e-3)


def test_a_choice_of_counted_supports_is_cut_at_its_own_value():
    problem = net(0)
    quadratic = quadratic_of(problem)
    relaxation = relaxation_of(problem, quadratic, quadratic.constant)
    for members in ([0], [1, 5], [2, 3, 7, 11]):
        index = np.array([3 * g + i for g in members for i in range(3)])
        value = quadratic.distance(fitted(quadratic, index)) + quadratic.costs[members].sum()
        allowed = np.zeros((len(quadratic.costs), 2), dtype=bool)
        allowed[:, 0] = True
        allowed[members] = [False, True]
        cut, point = relaxation.tightest(allowed, quadratic.fitted, quadratic.constant)
        assert cut.bound(allowed) == pytest.approx(value, rel=1e-6)
        assert np.allclose(relaxation.forces(allowed, point), fitted(quadratic, index), atol=1e-4)


@pytest.mark.parametrize("penalty", [*CONCAVE, Count(), GroupLasso()], ids=repr)
@pytest.mark.parametrize("bend", [0.5, 30.0, 1e4])
def test_pieces_lie_below_the_profile_and_leave_out_only_what_bends_down(penalty, bend):
    pieces = pieces_of(penalty, 3.0, bend)
    size = np.concatenate([[0.0], np.geomspace(1e-6, 3.0, 3001)])
    below, phi = pieces.value(size), penalty.value(size)
    there = np.isfinite(below)
    assert (below[there] <= phi[there] + 1e-12).all()
    large = there & (size > 2 * penalty.resolution) & (size > 0)
    assert (below[large] >= 0.99 * phi[large]).all()
    assert (penalty.curvature(size[~there]) < -bend).all()
    assert there[0] and there[-1]


def test_forces_stay_below_their_caps():
    problem = net(1, weight=5e-4)
    quadratic = quadratic_of(problem)
    value = 0.5 * quadratic.constant
    caps = quadratic.caps(value)
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(quadratic.inverse)
    reached = 0.0
    for _ in range(300):  # points on the ellipsoid E_dist = value, towards one group each
        g = rng.integers(len(caps))
        way = (
            quadratic.inverse[:, 3 * g : 3 * g + 3] @ rng.normal(size=3)
            if rng.random() < 0.5
            else root @ rng.normal(size=len(root))
        )
        length = np.sqrt((value - quadratic.least) / (way @ quadratic.gram @ way))
        s = quadratic.fitted + length * way.reshape(-1, 3)
        assert quadratic.distance(s) == pytest.approx(value)
        assert (sizes(s) <= caps * (1 + 1e-9)).all()
        reached = max(reached, float((sizes(s) / caps).max()))
    assert reached > 0.9


def test_no_time_leaves_a_bound_and_a_point():
    found = best_subset(net(0), 0.0)
    whole = best_subset(net(0))
    assert found.status == "time limit"
    assert found.bound <= whole.value <= found.value * (1 + 1e-12)


@pytest.mark.parametrize("penalty", [Power(0.5, 1e-6), Count()], ids=repr)
def test_as_a_method_it_is_judged_and_says_what_is_proven(penalty):
    problem = net(0, penalty)
    design = solve(problem, method=exact)
    assert design.certificate.converged and design.certificate.stationarity <= 1e-8
    assert design.certificate.objective == pytest.approx(best_subset(problem).value, rel=1e-9)
    assert any("no supports have an objective below" in note for note in design.trace.notes)


def refused(problem):
    with pytest.raises(InputError) as caught:
        best_subset(problem)
    return str(caught.value)


def test_what_it_refuses_and_what_to_do():
    assert "membrane.springs is 'hookean'" in refused(net(membrane__springs="hookean"))
    many = Problem(zoo.force_density_net(10), weight=1e-3)
    assert "64" in refused(many) and "supports.candidates" in refused(many)
    problem = net()
    heights = np.zeros_like(problem.scene.metric)
    heights[:, 2, 2] = 1.0
    assert "do not change E_dist" in refused(problem.replace(scene=replace(problem.scene, metric=heights)))


def test_without_scip_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    assert refused(net(0)).startswith("pyscipopt is not installed: pip install")
