"""Whole runs with supports that cannot do everything: by hand, against a general solver, and held to what they may do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zoo
from scipy.optimize import minimize

from relax.design.optimality import judge
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.shape import Shape, rest
from relax.design.solve import solve
from relax.files import load_scene
from relax.sparsity.reach import reach_of
from relax.sparsity.supports import sizes

DIRECTIONS = {
    "vertical": {"supports__direction": "vertical"},
    "up": {"supports__direction": "up"},
    "lean 5": {"supports__direction": {"lean": 5.0}},
    "lean 0": {"supports__direction": {"lean": 0.0}},
    "lean 90": {"supports__direction": {"lean": 90.0}},
    "largest": {"supports__max_force": 0.2},
    "up, largest": {"supports__direction": "up", "supports__max_force": 0.15},
    "lean 10, largest": {"supports__direction": {"lean": 10.0}, "supports__max_force": 0.2},
}
BINDING = ("lean 5", "largest", "up, largest", "lean 10, largest")  # where the two supports of the small scene feel it
LEANING = (((0.25, 0.25), (0.06, 0.0, 0.25)), ((0.75, 0.5), (-0.05, 0.02, 0.3)), ((0.5, 0.8), (0.02, 0.0, -0.1)))


def test_the_pyramid_by_hand():
    """One free vertex that wants to stand where 6/5 newtons would hold it, with a weight that changes next to nothing."""
    tiny = {"penalty__weight": 1e-9, "penalty__exponent": 1.0, "penalty__smoothing": 1e-12}
    force = zoo.PYRAMID_FORCE
    free = solve(Problem(zoo.pyramid(supports__direction="up", **tiny)))
    assert free.forces[4] == pytest.approx([0, 0, force], rel=1e-6)
    capped = solve(Problem(zoo.pyramid(supports__max_force=0.5, **tiny)))
    assert capped.forces[4] == pytest.approx([0, 0, 0.5], rel=1e-12)
    assert capped.certificate.converged
    # upside down: it would have to pull, which supports that push cannot
    down = solve(Problem(zoo.pyramid(height=-zoo.PYRAMID_HEIGHT, supports__direction="up", **tiny)))
    assert down.certificate.supports == 0 and down.certificate.converged
    pulls = solve(Problem(zoo.pyramid(height=-zoo.PYRAMID_HEIGHT, supports__direction="vertical", **tiny)))
    assert pulls.forces[4] == pytest.approx([0, 0, -force], rel=1e-6)


@pytest.mark.parametrize("changes", DIRECTIONS.values(), ids=DIRECTIONS)
@pytest.mark.parametrize("law", ["hookean", "force-density"])
def test_supports_keep_to_what_they_can_do_and_the_answer_is_stationary(changes, law):
    scene = zoo.planted(9, LEANING, sigma=0.01, penalty__weight=5e-3, membrane__springs=law, **changes).scene
    design = solve(Problem(scene))
    assert design.certificate.converged, design.stop
    assert design.certificate.supports >= 1
    said = scene.settings["supports"]
    forces = design.forces[design.forces.any(axis=1)]
    size, across = sizes(forces), np.hypot(forces[:, 0], forces[:, 1])
    if said["max_force"]:
        assert (size <= said["max_force"] * (1 + 1e-12)).all()
    if said["direction"] in ("vertical", "up"):
        assert not across.any()
    if said["direction"] == "up":
        assert (forces[:, 2] > 0).all()
    if isinstance(said["direction"], dict):
        lean = np.radians(said["direction"]["lean"])
        assert (np.arctan2(across, forces[:, 2]) <= lean + 1e-9).all()


def test_a_planted_answer_within_reach_is_found_as_without():
    scene = zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-4).scene
    free = solve(Problem(scene))
    lean = solve(Problem(zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-4, supports__direction={"lean": 15.0}).scene))
    assert np.allclose(free.forces, lean.forces, atol=1e-12)


def test_vertical_supports_take_one_column_a_candidate():
    scene = zoo.planted(9, LEANING, supports__direction="vertical").scene
    problem = Problem(scene)
    factor = problem.factor_at(scene.target)
    groups = np.array([3, 7])
    columns = problem.columns(factor, groups)
    assert columns.shape == (3 * len(problem.membrane.free), 2)
    whole = Problem(zoo.planted(9, LEANING).scene).columns(factor, groups)
    assert np.allclose(columns, whole[:, [2, 5]], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", DIRECTIONS)
def test_newton_on_a_support_ends_where_a_general_solver_ends(name):
    """Two supports on a small membrane: minimise E_dist + R over their six components by SLSQP with finite differences."""
    scene = zoo.planted(5, LEANING[:2], sigma=0.02, penalty__weight=5e-3, **DIRECTIONS[name]).scene
    problem = Problem(scene)
    reach = problem.supports.reach
    groups = np.array([0, 5])
    first = reach.project(np.array([[0.03, 0.0, 0.1], [0.0, -0.02, 0.12]])[:, list(reach.axes)])
    amplitudes = problem.supports.none.copy()
    amplitudes[groups] = first
    shape = rest(problem, Shape(scene.start, amplitudes, None, 0))

    def value(flat):
        forces = amplitudes.copy()
        forces[groups] = flat.reshape(first.shape)
        there = rest(problem, replace(shape, amplitudes=forces))
        return 1e3 * problem.objective(there.positions, forces)

    def force(flat, g):
        return flat.reshape(first.shape)[g]

    def lean(flat, g):
        return reach.tangent * force(flat, g)[-1] - np.linalg.norm(force(flat, g)[:-1])

    rules = []
    for g in range(2):
        if reach.tangent is not None:
            rules.append({"type": "ineq", "fun": lean, "args": (g,)})
        if np.isfinite(reach.largest):
            rules.append({"type": "ineq", "fun": lambda v, g=g: reach.largest**2 - force(v, g) @ force(v, g)})
    other = minimize(value, first.ravel(), method="SLSQP", constraints=rules, options={"ftol": 1e-14, "maxiter": 300})
    mine = refit(problem, shape)
    assert problem.objective(mine.positions, mine.amplitudes) * 1e3 <= other.fun * (1 + 1e-7)
    assert np.allclose(mine.amplitudes[groups], other.x.reshape(first.shape), atol=2e-4)
    if name in BINDING:
        doubled = 2 * mine.amplitudes[groups] - [[0.0] * (first.shape[1] - 1) + [0.02]]
        assert (sizes(reach.project(doubled) - doubled) > 1e-9).any()


class TestAlways:
    """Supports that stand whatever comes: no price, never dropped, stationary without R."""

    def problem(self, vertices, **changes):
        scene = zoo.planted(9, zoo.TWO_MASTS, sigma=0.01, penalty__weight=5e-3, **changes).scene
        weight = scene.support_weight.copy()
        weight[vertices] = 0.0
        said = {**scene.settings, "supports": {**scene.settings["supports"], "always": vertices}}
        return Problem(replace(scene, support_weight=weight, settings=said))

    @pytest.mark.parametrize("changes", [{}, DIRECTIONS["up"], DIRECTIONS["lean 10, largest"]])
    def test_they_stand_without_a_price(self, changes):
        problem = self.problem([33, 60], **changes)
        design = solve(problem)
        assert design.certificate.converged, design.stop
        others = np.delete(design.forces, [33, 60], axis=0)
        assert design.certificate.penalty == pytest.approx(5e-3 * problem.penalty.value(sizes(others)).sum(), rel=1e-12)
        free = solve(self.problem([], **changes))
        assert design.certificate.objective < free.certificate.objective

    def test_their_dual_vanishes(self):
        problem = self.problem([33, 60])
        design = solve(problem)
        factor = problem.factor_at(design.positions)
        lam = problem.dual(design.positions, factor)
        at = np.searchsorted(problem.membrane.free, [33, 60])
        assert np.abs(lam[at]).max() < 1e-10
        assert np.abs(lam).max() > 1e-4

    def test_nothing_but_them_under_a_heavy_weight(self):
        problem = self.problem([33]).replace(weight=10.0)
        design = solve(problem)
        assert np.flatnonzero(design.forces.any(axis=1)).tolist() == [33]
        assert design.certificate.converged


def test_the_judge_sees_what_a_support_cannot_do():
    planted = zoo.planted(9, LEANING)
    for changes in (DIRECTIONS["vertical"], DIRECTIONS["up"], DIRECTIONS["lean 5"], DIRECTIONS["largest"]):
        scene = zoo.planted(9, LEANING, **changes).scene
        said = judge(Problem(scene), planted.positions, planted.forces)
        assert not said.converged
        assert any("supports.direction and supports.max_force do not allow" in warning for warning in said.warnings)
        assert said.equilibrium < 1e-10  # of the forces as they are


@pytest.mark.parametrize(
    ("direction", "vector", "allowed"),
    [
        ("any", [1, 2, -3], True),
        ("vertical", [0, 0, -3], True),
        ("up", [0, 0, 3], True),
        ("up", [0, 0, -3], False),
        ({"lean": 45.0}, [1, 0, 1.001], True),
        ({"lean": 45.0}, [1, 0, 0.999], False),
        ({"lean": 90.0}, [1, 0, 1e-9], True),
        ({"lean": 90.0}, [1, 0, -1e-3], False),
        ({"lean": 0.0}, [0, 0, 1], True),
    ],
)
def test_directions_of_a_scene(direction, vector, allowed):
    reach = reach_of(direction, None)
    amplitudes = np.array([vector], dtype=float)[:, list(reach.axes)]
    assert np.allclose(reach.project(amplitudes), amplitudes, atol=1e-6) == allowed


def test_newton_leaves_a_saddle_that_its_first_step_finds():
    """Five supports at their largest force, two that cannot both stay: from there the value falls by 1e-10 of itself first."""
    fabric = {"membrane__springs": "tension-only", "membrane__rest_scale": 0.9}
    penalty = {"penalty__name": "mcp", "penalty__knee": 0.02, "penalty__weight": None, "penalty__weight_fraction": 0.01}
    asked = {"supports__direction": {"lean": 30.0}, "supports__max_force": 0.06200752400390723, "solver__backend": "working-set"}
    design = solve(Problem(zoo.planted(7, **fabric, **penalty, **asked).scene))
    assert design.certificate.converged, design.stop


def test_a_newcomer_is_tried_alone_where_many_at_once_come_to_nothing():
    """Up on the scalloped roof: five neighbours are missing, which pushing at once raise the value and fall back to nothing."""
    scene = load_scene(Path(__file__).parents[1] / "data" / "scalloped.toml", ['supports.direction="up"'])
    design = solve(Problem(scene))
    assert design.certificate.converged, design.stop
