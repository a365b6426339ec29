"""The benchmark in the layout of benchopt: its clock, what it makes of a point, others' solvers, and figures drawn from it."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import relax

EXPERIMENTS = Path(__file__).parent.parent / "experiments"
SCENE = "planted[direction=any,side=9]"
SCRIPTED = '''
import numpy as np
from benchmark_utils import Step, Stepwise
import relax


class Solver(Stepwise):
    """Points at times that were written down, whatever the run takes."""

    name = "scripted"

    def warm_up(self):
        pass

    def steps(self, problem):
        scene = problem.scene
        none = np.zeros_like(scene.target)
        design = relax.solve(problem)
        tiny = np.where(scene.candidates[:, None] & ~design.forces.any(axis=1)[:, None], 1e-9, design.forces)
        yield Step(0.5, scene.target, none, "the target without supports, which is not at rest")
        yield Step(1.5, None, None, "no point")
        yield Step(7.0, design.positions, tiny, "an answer with the small forces that a smoothed penalty leaves")
'''


@pytest.fixture(scope="module")
def run_time():
    """The experiment as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        patch.setenv("BENCHOPT_RAISE_ON_ERROR", "1")  # set by the experiment: gone again after these tests
        if "numba" not in sys.modules:
            patch.setenv("NUMBA_DISABLE_JIT", "1")  # read when numba is imported: compiling takes longer than all else here
        import run_time

        yield run_time


@pytest.fixture(scope="module")
def points(run_time, tmp_path_factory):
    """What benchopt writes of the solver in the benchmark's README and of a scripted one; and the problem."""
    reason = "benchopt is not installed: pip install -e '.[benchmark]'"
    pytest.importorskip("benchopt", reason=reason)
    folder = tmp_path_factory.mktemp("solvers")
    readme = (EXPERIMENTS / "benchmark" / "README.md").read_text()
    (folder / "mine.py").write_text(re.search(r"```python\n(.*?)```", readme, re.DOTALL)[1])
    (folder / "scripted.py").write_text(SCRIPTED)
    frame = run_time.curves([SCENE], [str(folder / "mine.py"), str(folder / "scripted.py"), "sequential"])
    from ablation import Kind, planted

    return frame, planted(Kind(sigma=0.005), 9)


def of(frame, name):
    return frame[frame["solver_name"] == name]


def test_the_clock_is_the_method_s_own_and_stops_while_a_point_is_judged(points):
    assert of(points[0], "scripted")["time"].to_numpy() == pytest.approx([0.5, 1.5, 7.0], abs=0.02)
    assert np.all(np.diff(of(points[0], "sequential")["time"]) > 0)


def test_a_point_that_is_not_at_rest_is_judged_where_it_would_come_to_rest(points):
    frame, problem = points
    first, second, _ = of(frame, "scripted").itertuples()
    scene = problem.scene
    assert relax.judge(problem, scene.target, np.zeros_like(scene.target)).objective == 0  # what it must not be taken for
    bare = relax.form(problem, np.zeros_like(scene.target)).positions
    assert first.value == pytest.approx(problem.distance(bare), rel=1e-9)
    assert first.equilibrium > 1e-3 and np.isnan(second.value) and not second.converged
    assert frame["above"].min() == 0


def test_forces_that_the_smoothing_makes_are_left_out(points):
    frame, problem = points
    last = of(frame, "scripted").iloc[-1]
    design = relax.solve(problem)
    assert last["value"] == pytest.approx(design.certificate.objective, rel=1e-12)
    assert last["supports"] == design.certificate.supports and last["converged"]
    assert of(frame, "sequential").iloc[-1]["value"] == pytest.approx(design.certificate.objective, rel=1e-12)


def test_the_solver_in_the_readme_runs_as_it_stands(points):
    frame, problem = points
    mine = of(frame, "mine")
    scene = problem.scene
    forces = np.zeros_like(scene.target)
    free = problem.membrane.free
    forces[free] = -problem.membrane.forces(scene.target) - problem.loads
    assert len(mine) == 1 and mine["value"].item() == pytest.approx(relax.judge(problem, scene.target, forces).objective)


def test_violation_is_that_of_the_supports_or_of_the_steepest_candidate_without_one(points):
    frame, problem = points
    bare = relax.form(problem, np.zeros_like(problem.scene.target))
    said = relax.judge(problem, bare.positions, bare.forces)
    assert said.stationarity == 0 and said.off_support > 1  # nothing stands: stationary, and no answer
    first = of(frame, "scripted").iloc[0]
    assert first["violation"] == pytest.approx(said.off_support - 1, rel=1e-6)
    assert of(frame, "sequential").iloc[-1]["violation"] < 1e-8


def test_profiles_are_shares_of_the_problems_that_a_method_takes(run_time):
    def row(scene, method, seconds):
        return {"scene": scene, "method": method, "1e-4 above, s": seconds}

    rows = [row("a", "slow", 6.0), row("a", "fast", 2.0), row("b", "slow", 1.0), row("b", "fast", np.nan), row("a", "rare", 4.0)]
    found = run_time.profile(rows, "1e-4")
    assert {name: (ratios.tolist(), count) for name, (ratios, count) in found.items()} == {
        "slow": ([1.0, 3.0], 2),
        "fast": ([1.0], 2),
        "rare": ([2.0], 1),
    }


def test_pictures_are_drawn(points, run_time, tmp_path):
    frame = points[0]
    frame = frame[frame["solver_name"].isin(run_time.LOOKS)]
    run_time.draw_curves(frame, [SCENE], tmp_path / "curves.png")
    run_time.draw_profiles(run_time.rows_of(frame), tmp_path / "profiles.png")
    assert all(1000 < path.stat().st_size < 200_000 for path in tmp_path.iterdir())


def test_ipopt_s_iterates_are_kept_from_its_start_to_its_answer(run_time):
    pytest.importorskip("casadi", reason="casadi is not installed: pip install -e '.[peers]'")
    from peers import Ipopt
    from price import planted

    problem = planted(7, 1, 0.005)[0]
    model = Ipopt(problem)
    seconds, _, last = model.descend(problem.scene.start)
    times, way = zip(*model.visited, strict=True)
    assert np.all(np.diff(times) >= 0) and 0 <= times[0] and times[-1] <= seconds
    np.testing.assert_allclose(way[0], problem.scene.start[problem.membrane.free].ravel())
    np.testing.assert_allclose(way[-1], last)
    positions, forces = model.point(last)
    assert relax.judge(problem, positions, forces).equilibrium < 1e-12


def test_skglm_ends_at_the_group_lasso_that_relax_solves(points, run_time):
    pytest.importorskip("skglm", reason="skglm is not installed: pip install -e '.[benchmark]'")
    frame = run_time.curves(["net[side=5]"], ["skglm", "sequential"])
    ends = frame.groupby("solver_name")["value"].last()
    assert ends["skglm"] == pytest.approx(ends["sequential"], rel=1e-9)
    assert of(frame, "skglm")["violation"].iloc[-1] < 1e-6
