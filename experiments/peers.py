"""The default solver beside its peers: the same method with full cone programs, and IPOPT on the smoothed problem.

Question: how long do Clarabel, cvxpy and IPOPT take for what `relax.solve` finds, and does one of them end lower?

    python experiments/peers.py               about four minutes
    python experiments/peers.py --size small  some seconds

Noisy planted masts (price.py), then the scenes of data/ (without cvxpy). Every answer is judged by relax's judge.

SCP, Clarabel and SCP, cvxpy: `relax.solve` with every convex step a full cone program by that back-end, from the same start,
and without it, from the heavy starts.

IPOPT (`pip install -e '.[peers]'`): p = -f(x) - g eliminated, x free, eps continued down to the penalty's own from 10,000 times
that, each solve warm at the last one's answer, from the target or from flat. As fast as we could make it: the exact sparse
Hessian is assembled from edge blocks (0.016 s at 2,304 vertices; the one that casadi derives from the objective 0.5 s, and
equal), the elimination order is METIS's, and only as many digits are asked for as pruning needs. Forces up to the penalty's
resolution are then dropped and Newton refits on the rest, as after the convex steps; where more than MANY stand, that is not
tried. Its seconds are its solves alone: `building, s` (model and solvers) and that refit are extra.

`times relax` is over the median of relax in the same process; `relax above` is relax's objective over this one's, less one;
`before rounding` is the objective of what is rounded; `says` is the method's own word. Exit status 1 if a judged answer is
lower than relax's by more than 1e-7.

Finding: no peer ends lower on any of these scenes. On the planted ones all that finish end at the same supports and objective,
to 1e-13; on `bumps`, `pavilion` and `terrain` relax ends 2 to 13 % below IPOPT, and where full cone programs end, with the
search's moves after them, or 0.1 % lower (terrain). At 2,304 vertices with noise IPOPT from flat takes 9 and 16 times as long
as relax with one and five masts; from the target 39 times with five, and with one it fails. Full cone programs take 8 to 10
times as long in Clarabel and 17 to 19 times through cvxpy from the same denoised start, where two or three of them are enough;
without that start, from the heavy ones, 59 to 60 and 80 to 84 times.
"""

import math
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from price import NOISE, planted
from rows import measured
from scipy.sparse import csc_array, csr_array, kron

import relax
from relax.convex.backends import BACKENDS
from relax.design.rounding import round_supports
from relax.design.starts import given
from relax.sparsity.supports import sizes

DATA = Path(__file__).parent.parent / "data"
SIDES = {"small": 12, "full": 50}
MASTS = {"small": (1,), "full": (1, 5)}
PLANTED = ("tent", "five-masts", "tent-noisy")
SCENES = {"small": PLANTED, "full": (*PLANTED, "bumps", "pavilion", "terrain")}
ROUNDS = {"small": 1, "full": 3}  # of relax and IPOPT; the full cone programs take minutes and run once
LADDER = (1e4, 1e3, 1e2, 1e1, 1.0)  # eps over the penalty's own; with fewer rungs IPOPT was slower or found worse
ROUGH, LAST = 0.1, 0.01  # tol of IPOPT on the way and at the end; tighter gave the same supports, later
IPOPT = {"print_level": 0, "sb": "yes", "max_iter": 100, "mumps_pivot_order": 5}  # 5: METIS, a tenth faster than the default
MANY = 500  # forces: a refit on more takes minutes, and its answer says nothing of IPOPT's
SAME = 1e-7


@dataclass(frozen=True)
class Answer:
    """One run of a method: seconds, what it says of itself, and its positions and forces (V, 3) before and after rounding."""

    seconds: float
    said: str
    before: tuple[np.ndarray, np.ndarray]
    after: tuple[np.ndarray, np.ndarray] | None


def by_relax(problem: relax.Problem, backend: str | None = None) -> Answer:
    """The front door, with the default convex step or one by name."""
    design = relax.solve(problem, backend=BACKENDS[backend] if backend else None)
    unrounded = design.trace.unrounded_positions, design.trace.unrounded_forces
    return Answer(design.seconds, design.stop, unrounded, (design.positions, design.forces))


class Ipopt:
    """The smoothed problem in casadi, and IPOPT for it; `building` is the time that this took.

    `visited` holds the iterates of the last solve: its seconds so far, and positions of the free vertices (3n,).
    """

    def __init__(self, problem: relax.Problem) -> None:
        begin = time.perf_counter()
        self.problem = problem
        self.visited: list[tuple[float, np.ndarray]] = []
        self._begin = 0.0
        self._watch = _watch(3 * len(problem.membrane.free), self._visit)
        self.rough, self.last = (_solver(*_model(problem), tolerance, self._watch) for tolerance in (ROUGH, LAST))
        self.building = time.perf_counter() - begin

    def _visit(self, x: np.ndarray) -> None:
        self.visited.append((time.perf_counter() - self._begin, x))

    def point(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and forces (V, 3) of an iterate: p = -f - g, so it is in equilibrium."""
        problem = self.problem
        positions = problem.scene.target.copy()
        positions[problem.membrane.free] = x.reshape(-1, 3)
        amplitudes = problem.supports.amplitudes(-problem.membrane.forces(positions) - problem.loads)
        return positions, problem.all_forces(amplitudes)

    def descend(self, start: np.ndarray) -> tuple[float, str, np.ndarray]:
        """Down the ladder from positions (V, 3); a solve that fails ends it. Seconds, IPOPT's word, and the last iterate."""
        problem, free = self.problem, self.problem.membrane.free
        x, seconds, said = start[free].ravel(), 0.0, ""
        self.visited.clear()
        for rung in LADDER:
            solver = self.last if rung == LADDER[-1] else self.rough
            smoothing = rung * problem.penalty.smoothing
            begin = time.perf_counter()
            self._begin = begin - seconds
            found = solver(x0=x, p=smoothing)
            seconds += time.perf_counter() - begin
            x, said = found["x"].full().ravel(), solver.stats()["return_status"]
            if not solver.stats()["success"]:
                said += f" at eps {smoothing:.0e}"
                break
        positions, forces = self.point(x)
        value = problem.objective(positions, problem.supports.amplitudes(forces[free]))
        if smoothing == problem.penalty.smoothing and not np.isclose(value, float(found["f"]), rtol=1e-9):
            raise RuntimeError(f"IPOPT's model is not relax's problem: {float(found['f'])} and {value}")
        return seconds, said, x

    def solve(self, start: np.ndarray) -> Answer:
        """Down the ladder from positions (V, 3), then rounded."""
        problem = self.problem
        seconds, said, x = self.descend(start)
        positions, forces = self.point(x)
        amplitudes = problem.supports.amplitudes(forces[problem.membrane.free])
        stands = sizes(amplitudes) > problem.penalty.resolution
        after = None
        if stands.sum() > MANY:
            said += f", {stands.sum()} forces stand: not refitted"
        else:
            try:
                after = pruned(problem, positions, np.where(stands[:, None], amplitudes, 0.0))
            except relax.EquilibriumError as error:
                said += f", not refitted: {error}"
        return Answer(seconds, said, (positions, forces), after)


def _model(problem: relax.Problem) -> tuple[dict[str, Any], dict[str, Any]]:
    """The objective of x (3n) and eps, and its exact derivatives, each edge and vertex mapped over one small function.

    With p = -f - g, K = dp/dx and y = dR/dp, the gradient is 2 r + K y and the Hessian 2 I + K R'' K + T(y); K and T are edge
    blocks e''(v) and d(e''(v) w)/dv between the incidence matrix, w the edge vectors of y.
    """
    import casadi as ca

    membrane, free = problem.membrane, problem.membrane.free
    edges, count, size = len(membrane.edges), len(membrane.fixed), len(free)
    v, w, rest, spring, force, eps = (ca.SX.sym(name, n) for name, n in zip("vwLkpe", (3, 3, 1, 1, 3, 1), strict=True))
    pull = ca.gradient(spring / 2 * (ca.norm_2(v) - rest) ** 2, v)
    block = ca.jacobian(pull, v)
    half = problem.penalty.exponent / 2
    phi = (ca.sumsqr(force) + eps) ** half - eps**half
    slope = ca.gradient(phi, force)

    def mapped(inputs: list[Any], output: Any, times: int) -> Any:
        return ca.Function("mapped", inputs, [ca.densify(output)]).map(times)

    ends = csr_array(
        (np.repeat([-1.0, 1.0], edges), (membrane.edges.T.ravel(), np.tile(np.arange(edges), 2))), shape=(count, edges)
    )
    incidence = _matrix(ends[free])
    wide = _matrix(kron(ends[free], np.eye(3)))
    fixed = np.where(membrane.fixed[:, None], problem.scene.target, 0.0)
    cost = ca.DM(problem.strength * problem.supports.weights).T

    x, smoothing = ca.MX.sym("x", 3 * size), ca.MX.sym("eps")
    points, level = ca.reshape(x, 3, size), ca.repmat(smoothing, 1, size)
    springs = (
        ca.mtimes(points, incidence) + ca.DM(fixed.T @ ends),
        ca.DM(membrane.rest_length).T,
        ca.DM(membrane.spring_constant).T,
    )
    forces = ca.mtimes(mapped([v, rest, spring], pull, edges)(*springs), incidence.T) - ca.DM(problem.loads.T)
    offset = points - ca.DM(problem.scene.target[free].T)
    value = ca.sumsqr(offset) + ca.dot(cost, mapped([force, eps], phi, size)(forces, level))

    steep = ca.repmat(cost, 3, 1) * mapped([force, eps], slope, size)(forces, level)
    bend = ca.repmat(ca.kron(cost, ca.DM.ones(1, 3)), 3, 1) * mapped([force, eps], ca.jacobian(slope, force), size)(forces, level)
    along = ca.mtimes(steep, incidence)
    stiffness = mapped([v, rest, spring], block, edges)(*springs)
    turn = mapped([v, rest, spring, w], ca.jacobian(ca.mtimes(block, w), v), edges)(*springs, along)

    def assembled(blocks: Any) -> Any:
        return ca.mtimes(ca.mtimes(wide, _diagonal(blocks, edges)), wide.T)

    k = assembled(stiffness)
    gradient = 2 * ca.vec(offset) + ca.mtimes(k, ca.vec(steep))
    hessian = ca.mtimes(ca.mtimes(k, _diagonal(bend, size)), k) + assembled(turn) + 2 * ca.DM.eye(3 * size)
    factor, none = ca.MX.sym("factor"), ca.MX.sym("none", 0)
    triangle = ca.triu(factor * hessian)
    derivatives = {
        "grad_f": ca.Function("gradient", [x, smoothing], [value, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "hess_lag": ca.Function(
            "hessian", [x, smoothing, factor, none], [triangle], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
    }
    return {"x": x, "p": smoothing, "f": value}, derivatives


def _matrix(matrix: Any) -> Any:
    """A scipy matrix as casadi's."""
    import casadi as ca

    matrix = csc_array(matrix)
    matrix.sort_indices()
    return ca.DM(ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist()), matrix.data)


def _diagonal(blocks: Any, count: int) -> Any:
    """The block-diagonal matrix of (3, 3 count) blocks side by side."""
    import casadi as ca

    rows = 3 * (np.arange(3 * count) // 3)[:, None] + np.arange(3)
    return ca.MX(ca.Sparsity(3 * count, 3 * count, list(range(0, 9 * count + 1, 3)), rows.ravel().tolist()), ca.vec(blocks))


def _solver(model: dict[str, Any], derivatives: dict[str, Any], tolerance: float, watch: Any) -> Any:
    import casadi as ca

    options = {**derivatives, "iteration_callback": watch, "print_time": False, "ipopt": {**IPOPT, "tol": tolerance}}
    return ca.nlpsol("peer", "ipopt", model, options)


def _watch(size: int, visit: Callable[[np.ndarray], None]) -> Any:
    """What IPOPT calls with each iterate: a function of all that nlpsol gives, of which only x (size,) is looked at."""
    import casadi as ca

    class Watch(ca.Callback):
        """Its shapes are casadi's protocol."""

        def __init__(self) -> None:
            super().__init__()
            self.construct("watch", {})

        def get_n_in(self) -> int:
            return ca.nlpsol_n_out()

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, index: int) -> Any:
            name = ca.nlpsol_out(index)
            count = size if name in ("x", "lam_x") else int(name == "f")
            return ca.Sparsity.dense(count, 1) if count else ca.Sparsity(0, 0)

        def eval(self, arg: Any) -> list[int]:
            visit(arg[0].full().ravel())
            return [0]

    return Watch()


def pruned(
    problem: relax.Problem,
    positions: np.ndarray,
    amplitudes: np.ndarray,
    progress: Callable[[Any], None] = lambda record: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and forces after the rounding that relax's own convex steps get; `progress` hears of its steps."""
    shape = given(problem, positions, problem.all_forces(amplitudes))
    if shape is None:
        raise relax.EquilibriumError("the membrane finds no rest under the forces that were kept")
    keep = np.zeros(len(amplitudes), dtype=bool)
    shape = round_supports(problem, shape, keep, progress).shape
    return shape.positions, problem.all_forces(shape.amplitudes)


def compared(case: str, problem: relax.Problem, rounds: int, peers: list[str]) -> list[dict[str, Any]]:
    """One row for relax and one for each of its peers; relax and IPOPT take turns, the full cone programs run once."""
    problem = relax.resolve_weight(problem)
    runs: dict[str, Callable[[], Answer]] = {"relax": lambda: by_relax(problem)}
    building = 0.0
    if "IPOPT" in peers:
        model = Ipopt(problem)
        building = model.building
        runs["IPOPT, from the target"] = lambda: model.solve(problem.scene.target)
        runs["IPOPT, from flat"] = lambda: model.solve(problem.scene.start)
    by_relax(problem)  # once before the clock: imports, and what is computed once a mesh
    turns = [{name: run() for name, run in runs.items()} for _ in range(rounds)]
    answers = {name: [turn[name] for turn in turns] for name in runs}
    heavy = _heavy(problem)
    for name in peers:
        if name != "IPOPT":
            answers[f"SCP, {name}"] = [by_relax(problem, name.lower())]
            answers[f"SCP, {name}, heavy starts"] = [by_relax(heavy, name.lower())]
    own = answers["relax"]
    return [
        {
            "case": case,
            "free vertices": len(problem.membrane.free),
            "method": name,
            "seconds": _median(found),
            "times relax": _median(found) / _median(own),
            "building, s": building if name.startswith("IPOPT") else 0.0,
            **_figures(problem, found[-1], own[-1]),
        }
        for name, found in answers.items()
    ]


def _heavy(problem: relax.Problem) -> relax.Problem:
    """The same problem, started without the denoised target."""
    settings = dict(problem.scene.settings)
    settings["solver"] = {**settings["solver"], "start": "heavy"}
    return problem.replace(scene=replace(problem.scene, settings=settings))


def _figures(problem: relax.Problem, answer: Answer, own: Answer) -> dict[str, Any]:
    """What the judge says of an answer, and of relax's own beside it; nan where there is nothing to judge."""
    before, forces = answer.before
    row = {"before rounding": problem.objective(before, problem.supports.amplitudes(forces[problem.membrane.free]))}
    if answer.after is None:
        nothing = dict.fromkeys(("objective", "relax above", "supports", "same supports", "stationarity"), math.nan)
        return {**row, **nothing, "converged": False, "says": answer.said}
    said, ours = (relax.judge(problem, *each.after) for each in (answer, own) if each.after)
    stand, also = (each.after[1].any(axis=1) for each in (answer, own) if each.after)
    return {
        **row,
        "objective": said.objective,
        "relax above": ours.objective / said.objective - 1,
        "supports": said.supports,
        "same supports": bool(np.array_equal(stand, also)),
        "stationarity": said.stationarity,
        "converged": said.converged,
        "says": answer.said,
    }


def _median(answers: list[Answer]) -> float:
    return statistics.median(answer.seconds for answer in answers)


def all_rows(size: str) -> list[dict[str, Any]]:
    """The planted cases with every peer, then the scenes of data/ with Clarabel."""
    peers = ["Clarabel", "cvxpy", "IPOPT"]
    if find_spec("casadi") is None:
        print("casadi is not installed, so the rows of IPOPT are left out: pip install -e '.[peers]'", file=sys.stderr)
        peers.remove("IPOPT")
    rows = []
    for masts in MASTS[size]:
        case = "1 mast" if masts == 1 else f"{masts} masts"
        rows += compared(case, planted(SIDES[size], masts, NOISE)[0], ROUNDS[size], peers)
    for name in SCENES[size]:
        rows += compared(
            name,
            relax.Problem(relax.load_scene(DATA / f"{name}.toml")),
            ROUNDS[size],
            [peer for peer in peers if peer != "cvxpy"],
        )
    return rows


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__, SIDES, all_rows)
    return 1 if any(row["relax above"] > SAME for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
