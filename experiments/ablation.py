"""What a run skips because its scene does not need it: the same answer without each skip, and what it saves.

Question: does each sentence of a design's `skipped` leave the answer as it is, what time does it save, and does a scene that
offers nothing to skip pay for looking?

    python experiments/ablation.py               two minutes
    python experiments/ablation.py --size small  some seconds

Each row runs one scene as it is and with one skip switched off, in turns, each time on a mesh that was never seen before, so
that what is done once a mesh is in the time; medians of whole solves, and of their ratio, `saved`. `there` says whether the
scene offers that skip: where it does not, `saved` is the price of looking for it. The scenes are planted (price.py), without
noise or with noise of 2 % of the height, so that one answer is right: `net` is a force-density net, `lasso` goes by the group
lasso, `four` are four membranes in a row; `bumps` is the scene of data/. Exit status 1 if the supports differ, the objectives by
more than 1e-8 of them, or the ledger of the run does not say what was skipped.

Finding (one run, rslab, beside another job; ratios move by a tenth or two between runs): every answer keeps its supports, and
its objective to 1e-14. At 2,500 vertices a force-density net takes 2.2 times as long when solved like any other membrane, 1.8
times without the scalar factorisation alone; that it is made once for all shapes hardly counts beside that. Columns for all
candidates cost 3.8 times the run at 625 vertices already, full cone programs 2.3 times; three columns for an upright support
1.2 times. Other starts for a target that is a tensile surface would cost 2.5 times; other first weights for the group lasso,
and a third start after two that agree, 1.5; a new factorisation at each shape 1.5 to 1.9; trials brought to rest whatever
their objective 1.2, a new analysis for each factorisation 1.2; a second round, columns and curvature anew, unknowns for the
fixed vertices 1.1; a trial of every stiffness nothing that can be measured. Four membranes in one scene take 1.6 times as long
in one piece, with noise 1.3; four nets take a seventh less in one piece, because the one factorisation of the whole, which the
judge needs, is then shared. One of each orbit saves a sixth where the target is planted and the run is one factorisation
anyway. Looking for parts, symmetry or a planted target where there is none costs nothing that can be measured. Without cvxpy
and pyplot a process takes two fifths of the time.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np
from price import DATA, MASTS, NOISE, bumps, square
from rows import measured
from scipy.sparse import block_diag, csc_array, eye_array

import relax
from relax.convex.backends import BACKENDS
from relax.design.methods.sequential import Sequential
from relax.design.starts import heavy_starts
from relax.factor import Factor, ScalarFactor, Symbolic
from relax.membrane.chords import Chords
from relax.membrane.membrane import Membrane
from relax.sparsity.reach import Reach

SIDES = {"small": 14, "full": 50}
ROUNDS = {"small": 1, "full": 5}
APART = 1e-8


RING = [(0.5, 0.5, (0.0, 0.0, 0.3))] + [(x, y, (0.0, 0.0, -0.2)) for x in (0.25, 0.75) for y in (0.25, 0.75)]


@dataclass(frozen=True)
class Kind:
    """A kind of planted scene: squares in a row, each under the same masts."""

    squares: int = 1
    masts: int = 5
    sigma: float = 0.0
    springs: str = "hookean"
    start: str = "auto"
    ring: bool = False  # masts and tie-downs that mirrors and turns of the square leave as they are, on an odd number of vertices
    direction: str = "any"
    lasso: float = 0.0  # weight of a group lasso over that of the power penalty; 0: that one


SCENES = {
    "planted": Kind(),
    "noisy": Kind(sigma=NOISE),
    "noisy, heavy starts": Kind(sigma=NOISE, start="heavy"),
    "noisy, up": Kind(sigma=NOISE, masts=1, direction="up"),
    "lasso": Kind(sigma=NOISE, masts=1, lasso=3.0),
    "net": Kind(sigma=NOISE, springs="force-density"),
    "four": Kind(squares=4),
    "four, noisy": Kind(squares=4, sigma=NOISE),
    "ring": Kind(ring=True),
    "four nets": Kind(squares=4, sigma=NOISE, springs="force-density"),
}


def planted(kind: Kind, side: int) -> relax.Problem:
    """Square membranes of `side` x `side` vertices in a row, brought to rest under price.py's forces, as the target."""
    side = side | 1 if kind.ring else side
    mesh, flat = square(side)
    count = mesh.vertices
    which = np.arange(kind.squares)[:, None, None]
    faces = np.where(mesh.faces < 0, -1, mesh.faces + count * which).reshape(-1, 4)
    flat = (flat + [1.25, 0.0, 0.0] * which).reshape(-1, 3)
    mesh = relax.mesh_from_faces(len(flat), faces)
    forces = np.zeros_like(flat)
    for x, y, force in RING if kind.ring else MASTS[kind.masts]:
        forces[round(y * (side - 1)) * side + round(x * (side - 1)) + count * np.arange(kind.squares)] = force
    settings = dict(relax.load_scene(DATA / "tent.toml").settings)
    settings["membrane"] = {**settings["membrane"], "springs": kind.springs}
    settings["solver"] = {**settings["solver"], "start": kind.start}
    settings["supports"] = {**settings["supports"], "direction": kind.direction}
    bare = {**settings, "supports": {**settings["supports"], "direction": "any"}}
    shape = relax.form(relax.Problem(relax.build_scene(bare, mesh, flat, flat)), forces).positions
    settings["target"] = {**settings["target"], "noise": {"sigma": kind.sigma, "seed": 0} if kind.sigma else None}
    scene = relax.build_scene(settings, mesh, shape, flat)
    weight = (0.02 if kind.sigma else 0.001) * (side / 21) ** 2
    if kind.lasso:
        return relax.Problem(scene, relax.GroupLasso(), kind.lasso * weight)
    return relax.Problem(scene, weight=weight)


def scene(name: str, side: int) -> relax.Problem:
    """The scene of a row."""
    return bumps(side) if name == "bumps" else planted(SCENES[name], side)


# --- each skip switched off ---


def linear_as_any_other() -> AbstractContextManager[Any]:
    """A linear membrane solved like any other: linearised, and factorised in all directions, at each shape."""
    return patch.object(Membrane, "linear", new=False)


def general_factorisations() -> AbstractContextManager[Any]:
    """A new factorisation at each shape of a linear membrane too."""

    def factor_at(membrane: Membrane, positions: np.ndarray) -> Factor:
        kept = membrane._linear_factor
        return ScalarFactor(kept.matrix, Factor(kept.scalar.matrix, kept.scalar.symbolic, kept.pivot_bound))

    return patch.object(Membrane, "factor_at", factor_at)


def all_three_directions() -> AbstractContextManager[Any]:
    """One factorisation of a linear membrane, but of x, y and z together."""
    return patch.object(Membrane, "factor_at", _whole_factor)


def _whole_factor(membrane: Membrane, positions: np.ndarray) -> Factor:
    if "whole" not in membrane.__dict__:
        kept = membrane._linear_factor
        membrane.__dict__["whole"] = Factor(kept.matrix, membrane._symbolic, kept.pivot_bound)
    return membrane.__dict__["whole"]


def three_columns() -> AbstractContextManager[Any]:
    """Upright supports as forces in three directions that lean by nothing: three columns a candidate."""
    return patch("relax.design.problem.reach_of", lambda direction, largest: Reach(tangent=0.0))


def analyses_anew() -> AbstractContextManager[Any]:
    """The sparsity pattern analysed for each factorisation."""
    return patch.object(
        Symbolic, "factorise", lambda self, matrix, bound: self._engine(matrix, self.block).factorise(matrix, bound)
    )


def pivots_tried() -> AbstractContextManager[Any]:
    """Pivots looked at, and a trial solve, of each factorisation."""
    return patch.object(Membrane, "_pivot_bound", lambda *_: 0.0)


@contextmanager
def no_chords() -> Iterator[None]:
    """A factorisation at each shape: no chord steps, no refinement."""
    with (
        patch.object(Chords, "pay", lambda *_: False),
        patch.object(Factor, "refine", lambda *_: None),
    ):
        yield


def all_trials_to_the_end() -> AbstractContextManager[Any]:
    """Each trial brought to rest, whatever its objective is on the way."""
    return patch("relax.design.trial.lies_above", lambda *_: False)


def all_columns() -> AbstractContextManager[Any]:
    """All columns of K^-1 for each factorisation that is asked for one."""
    some = Factor.inverse_columns

    def columns(factor: Factor, rows: np.ndarray) -> np.ndarray:
        if "inverse" not in factor.__dict__:
            factor.__dict__["inverse"] = some(factor, np.arange(factor.matrix.shape[0]))
        return factor.__dict__["inverse"][:, rows]

    return patch.object(Factor, "inverse_columns", columns)


def full_cone_programs() -> AbstractContextManager[Any]:
    """Convex steps with all candidates at once, in the place of the working set."""
    return patch("relax.design.methods.sequential.working_set", BACKENDS["clarabel"])


def new_curvature() -> AbstractContextManager[Any]:
    """Columns and curvature made anew in each Newton step on a support."""
    return patch("relax.design.refit.FAST", 0.0)


def in_one_piece() -> AbstractContextManager[Any]:
    """The membrane taken as one problem."""
    return patch("relax.design.solve.split", lambda problem: ())


def no_symmetry() -> AbstractContextManager[Any]:
    """Not even asked whether the scene has a symmetry."""
    return patch("relax.design.race.symmetric_problem", lambda problem: None)


def second_round() -> AbstractContextManager[Any]:
    """Steps and rounding once more from where they ended."""
    once = Sequential.__call__

    def twice(self: Any, problem: Any, start: Any, journal: Any) -> Any:
        shape, unrounded = once(self, problem, start, journal)
        return once(self, problem, replace(start, shape=shape, weight=None), journal)[0], unrounded

    return patch.object(Sequential, "__call__", twice)


def other_starts() -> AbstractContextManager[Any]:
    """The target never taken for a tensile surface."""
    return patch("relax.design.starts.is_planted", lambda problem, shape: False)


def all_starts() -> AbstractContextManager[Any]:
    """Every start followed to its end, whether two agree or not."""
    return patch("relax.design.race._agree", lambda outcomes: False)


def first_weights() -> AbstractContextManager[Any]:
    """Heavy first weights although the penalty's own never change."""
    return patch("relax.design.starts._automatic", lambda problem, skipped: heavy_starts(problem))


def fixed_kept() -> AbstractContextManager[Any]:
    """The unknowns of the fixed vertices kept, their rows those of the identity: as many as the edge of a square has."""
    factorise = Symbolic.factorise

    def with_fixed(symbolic: Symbolic, matrix: csc_array, bound: float) -> Any:
        size = matrix.shape[0]
        fixed = symbolic.block * 4 * round(np.sqrt(size / symbolic.block) + 1)
        unit = float(matrix.diagonal().mean())
        numeric = factorise(symbolic, csc_array(block_diag([matrix, unit * eye_array(fixed)], format="csc")), bound)
        return _WithFixed(numeric, size, fixed)

    return patch.object(Symbolic, "factorise", with_fixed)


@dataclass(frozen=True)
class _WithFixed:
    numeric: Any
    size: int
    fixed: int

    @property
    def definite(self) -> bool:
        return self.numeric.definite

    def solve(self, right: np.ndarray) -> np.ndarray:
        return self.numeric.solve(np.pad(right, [(0, self.fixed), *[(0, 0)] * (right.ndim - 1)]))[: self.size]


def nothing_looked_at() -> AbstractContextManager[Any]:
    """Not even asked whether few supports hold the target."""
    return patch("relax.design.starts.at_target", lambda problem: None)


@dataclass(frozen=True)
class Skip:
    """One row: what is skipped, in which scene, how to switch it off, and what the ledger says of it ("": nothing to skip)."""

    name: str
    scene: str
    without: Callable[[], AbstractContextManager[Any]]
    said: str
    share: float = 1.0  # of the side of the square: less where the row would else take minutes, more where a scene needs them


SKIPS = (
    Skip("linear membrane", "net", linear_as_any_other, "all factorisations of K but one"),
    Skip("one factorisation for all shapes", "net", general_factorisations, "all factorisations of K but one"),
    Skip("x, y and z share a scalar factorisation", "net", all_three_directions, "share a scalar one"),
    Skip("fixed vertices eliminated", "planted", fixed_kept, "fixed vertices are eliminated"),
    Skip("columns never made", "noisy", all_columns, "were never looked at", 0.5),
    Skip("candidates never looked at", "lasso", full_cone_programs, "were never looked at", 0.5),
    Skip("one column a candidate", "noisy, up", three_columns, "needs one, not three"),
    Skip("pattern analysed once", "noisy", analyses_anew, "the analysis of the sparsity pattern"),
    Skip("factorisation reused", "planted", no_chords, "one from nearby served"),
    Skip("factorisation reused", "noisy", no_chords, "one from nearby served"),
    Skip("trials broken off", "bumps", all_trials_to_the_end, "broken off, the objective lay above", 1.9),
    Skip("pivots proven, no trial", "planted", pivots_tried, "every pivot is proven positive"),
    Skip("columns and curvature kept", "planted", new_curvature, "those of an earlier step served"),
    Skip("parts apart", "four", in_one_piece, "4 parts solved apart"),
    Skip("parts apart", "four, noisy", in_one_piece, "4 parts solved apart"),
    Skip("parts apart", "four nets", in_one_piece, "4 parts solved apart"),
    Skip("parts apart", "planted", in_one_piece, ""),
    Skip("one of each orbit", "ring", no_symmetry, "parts of the membrane: it has"),
    Skip("one of each orbit", "noisy", no_symmetry, ""),
    Skip("no second round", "noisy", second_round, "a second round of steps"),
    Skip("no search for other starts", "planted", other_starts, "a search for other starts"),
    Skip("no search for other starts", "noisy", nothing_looked_at, ""),
    Skip("no other first weights", "lasso", first_weights, "other first weights", 0.5),
    Skip("no third start", "noisy, heavy starts", all_starts, "two starts ended at the same supports"),
)


def timed(problem: relax.Problem, solve: Callable[[relax.Problem], relax.Design] = relax.solve) -> tuple[float, relax.Design]:
    """Seconds of a solve on a mesh that was never seen, and the design."""
    fresh = problem.replace(scene=replace(problem.scene))
    begin = time.perf_counter()
    design = solve(fresh)
    return time.perf_counter() - begin, design


def row(skip: Skip, side: int, rounds: int) -> dict[str, object]:
    """One row."""
    problem = scene(skip.scene, round(side * skip.share))
    timed(problem)  # once before the clock: imports
    given, left_out = [], []
    for _ in range(rounds):
        seconds, design = timed(problem)
        given.append(seconds)
        with skip.without():
            seconds, other = timed(problem)
        left_out.append(seconds)
    one, two = design.certificate, other.certificate
    there = any(skip.said in sentence for sentence in design.skipped) if skip.said else False
    return {
        "skip": skip.name,
        "scene": skip.scene,
        "vertices": problem.scene.mesh.vertices,
        "there": there,
        "with, s": statistics.median(given),
        "without, s": statistics.median(left_out),
        "saved": statistics.median(np.divide(left_out, given)),
        "apart": abs(one.objective - two.objective) / one.objective,
        "same supports": bool(np.array_equal(design.forces.any(axis=1), other.forces.any(axis=1))),
        "supports": one.supports,
        "converged": one.converged and two.converged,
        "as said": there == bool(skip.said),
    }


def import_row(rounds: int) -> dict[str, object]:
    """The row of a fresh process that solves the tent, and of one that imports cvxpy and pyplot first."""
    script = f"import relax; design = relax.solve(relax.Problem(relax.load_scene({str(DATA / 'tent.toml')!r}))); "
    script += "print(*design.skipped, repr(design.certificate.objective), design.certificate.converged)"
    seconds: dict[str, list[float]] = {"": [], "import cvxpy, matplotlib.pyplot; ": []}
    said = []
    for _ in range(rounds):
        for first, times in seconds.items():
            begin = time.perf_counter()
            done = subprocess.run([sys.executable, "-c", first + script], check=True, capture_output=True, text=True)
            times.append(time.perf_counter() - begin)
            said.append(done.stdout)
    given, left_out = (statistics.median(times) for times in seconds.values())
    one, two = (float(text.split()[-2]) for text in said[:2])
    there = "the import of cvxpy" in said[0]
    return {
        "skip": "cvxpy and plots not imported",
        "scene": "tent, process",
        "vertices": 441,
        "there": there,
        "with, s": given,
        "without, s": left_out,
        "saved": statistics.median(np.divide(*reversed(seconds.values()))),
        "apart": abs(one - two) / one,
        "same supports": True,
        "supports": 1,
        "converged": said[0].split()[-1] == said[1].split()[-1] == "True",
        "as said": there,
    }


def main() -> int:
    """Measure and print."""

    def all_rows(size: str) -> list[dict[str, object]]:
        rows = [row(skip, SIDES[size], ROUNDS[size]) for skip in SKIPS]
        return [*rows, import_row(ROUNDS[size])]

    rows = measured(__doc__, SIDES, all_rows)
    right = (row["same supports"] and row["converged"] and row["as said"] and row["apart"] <= APART for row in rows)
    return 0 if all(right) else 1


if __name__ == "__main__":
    sys.exit(main())
