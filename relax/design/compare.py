"""Every penalty, method and back-end on one problem: same start, one judge, one flat row a run.

Each answer, whatever penalty or method it comes from, is pruned and refitted on its support under the paper's R by the same
rule (rounding.py), and what is compared is the paper's objective there.
"""

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.convex.backends import BACKENDS, Backend
from relax.convex.subproblem import Solution, Subproblem
from relax.design.methods import METHODS, method_by_name
from relax.design.optimality import Certificate, judge
from relax.design.problem import Problem
from relax.design.rounding import round_supports
from relax.design.shape import Shape
from relax.design.solve import Design, solve
from relax.design.starts import choose_starts, resolve_weight
from relax.design.trace import Callback
from relax.errors import BackendError, EquilibriumError, RelaxError
from relax.sparsity.penalties import PENALTIES, Penalty, Power
from relax.sparsity.supports import sizes

SEQUENTIAL, AUTO = "sequential", "auto"
DENSE = 0.5  # share of the candidates: what ends with more than this has chosen nothing that could be refitted
SCALE = 0.1  # of the typical force: where the log-sum's slope has halved


@dataclass(frozen=True)
class Row:
    """One run; figures are None where it gave no answer, and `stop` says why.

    `objective` to `converged` are of the answer pruned and refitted under the paper's R; `own_objective` is of the answer as it
    came, under its own penalty, `parameters` and `weight`. `seconds` is the solve alone. `over_best` is None until all runs are
    known (`ranked`). Lengths in metres, forces in newtons.
    """

    penalty: str
    method: str
    backend: str
    parameters: str = ""
    objective: float | None = None
    over_best: float | None = None
    own_objective: float | None = None
    weight: float | None = None
    distance: float | None = None
    rms_distance: float | None = None
    supports: int | None = None
    total_force: float | None = None
    stationarity: float | None = None
    off_support: float | None = None
    converged: bool | None = None
    seconds: float | None = None
    stop: str = ""
    interrupted: bool = False

    def flat(self) -> dict[str, Any]:
        """The fields by name, for a table."""
        return asdict(self)


def compare(problem: Problem, start: tuple[Floats, Floats] | None = None, callback: Callback | None = None) -> Iterator[Row]:
    """A row for the sequential method on the paper's problem, then for every other penalty, method and back-end, as they come.

    Parameters
    ----------
    problem : Problem
        The paper's: with another penalty than Power, Power(0.5) takes its place, with the same weight.
    start : positions and forces (V, 3), optional
        From which every run begins; default: the first start of the scene, by its symmetry in the first row, as `solve` does.
    callback : function, optional
        As for `solve`, which hears of every run.

    Raises
    ------
    EquilibriumError
        No start finds a membrane at rest.

    Notes
    -----
    Another penalty's weight is such that a typical force t0 costs as much as under the paper's, k' phi'(t0) = k phi(t0); its
    parameters follow t0 too (`penalties_for`). t0 is the median force of the first row's answer, or of the start where that has
    none. A run that cannot be made is a row with the reason. A run that was interrupted is the last.
    """
    reference = paper_problem(problem)
    begin = start or _first_start(reference)
    runs = _Runs(reference, callback)
    row, design = runs.row(reference, SEQUENTIAL, AUTO, start)
    yield row
    typical = _typical_force(design.forces if design else begin[1], begin[1])
    others = [(other, SEQUENTIAL, AUTO) for other in penalties_for(reference, typical).values()]
    others += [(reference, method, AUTO) for method in METHODS if method != SEQUENTIAL]
    others += [(reference, SEQUENTIAL, backend) for backend in BACKENDS]
    for other, method, backend in others:
        if row.interrupted:
            return
        row, _ = runs.row(other, method, backend, begin)
        yield row


def ranked(rows: Iterable[Row]) -> list[Row]:
    """The rows with `over_best`: objective / the lowest objective of those at rest and stationary - 1."""
    rows = list(rows)
    values = [row.objective for row in rows if row.objective is not None and row.converged]
    values = values or [row.objective for row in rows if row.objective is not None]
    best = min(values, default=None)
    return [row if row.objective is None or not best else replace(row, over_best=row.objective / best - 1) for row in rows]


def paper_problem(problem: Problem) -> Problem:
    """The problem under a power penalty, solved by default means and refitted with R: what all answers are judged in."""
    said: dict[str, Any] = copy.deepcopy(dict(problem.scene.settings))
    said["solver"] |= {"method": SEQUENTIAL, "backend": AUTO}
    said["rounding"]["refit"] = "penalised"
    reference = replace(problem, scene=replace(problem.scene, settings=said))
    if not isinstance(problem.penalty, Power):
        reference = replace(reference, penalty=Power())
    return resolve_weight(reference)


def penalties_for(problem: Problem, typical: float) -> Mapping[str, Problem]:
    """The problem under each penalty but its own, by name, with parameters and a weight that suit a typical force (newtons).

    log-sum: scale t0 / 10; MCP: knee t0; SCAD: flat from t0 on (knee t0 / shape); so a typical force is hardly shrunk.
    """
    suited = {"log-sum": {"scale": SCALE * typical}, "mcp": {"knee": typical}, "scad": {"knee": typical / 3.7}}
    size = np.array([typical])
    cost = problem.strength * float(problem.penalty.value(size)[0])
    found = {}
    for name, kind in PENALTIES.items():
        if name != problem.penalty.name:
            penalty: Penalty = kind(**suited.get(name, {}))
            found[name] = problem.replace(penalty=penalty, weight=cost / float(penalty.value(size)[0]))
    return found


def _first_start(problem: Problem) -> tuple[Floats, Floats]:
    shape = choose_starts(problem, None, [])[0].shape
    return shape.positions, problem.all_forces(shape.amplitudes)


def _typical_force(forces: Floats, otherwise: Floats) -> float:
    """Median size of the forces (V, 3) that are not zero, else of the others; 1 N if there are none at all."""
    for field in (forces, otherwise):
        size = sizes(field)
        if size.any():
            return float(np.median(size[size > 0]))
    return 1.0


class _Watched:
    """A back-end that remembers how many steps it took, and its last refusal."""

    def __init__(self, backend: Backend) -> None:
        self.backend, self.steps, self.refusal = backend, 0, ""

    def __call__(self, step: Subproblem, start: Floats) -> Solution:
        """The back-end's answer."""
        try:
            solution = self.backend(step, start)
        except BackendError as error:
            self.refusal = str(error)
            raise
        self.steps += 1
        return solution


@dataclass(frozen=True)
class _Runs:
    """What the runs share: the problem that judges, where they begin, and who hears of them."""

    reference: Problem
    callback: Callback | None

    def row(self, problem: Problem, method: str, backend: str, begin: tuple[Floats, Floats] | None) -> tuple[Row, Design | None]:
        """One run, and its design where there is one; without a start it finds its own, as `relax.solve` does."""
        row = Row(problem.penalty.name, method, backend, repr(problem.penalty), weight=problem.strength)
        solver = None if backend == AUTO else _Watched(BACKENDS[backend])
        try:
            design = solve(problem, begin, solver, method_by_name(method), self.callback)
        except RelaxError as error:
            return replace(row, stop=str(error)), None
        if solver is not None and solver.refusal and not solver.steps:
            return replace(row, stop=solver.refusal), None  # what Newton made of the start is no answer of this back-end
        row = replace(row, seconds=design.seconds, stop=design.stop, interrupted=design.interrupted)
        said = design.certificate
        if said.supports > DENSE * len(problem.supports.vertices) and not said.converged:
            return row, None
        row = replace(row, own_objective=said.objective)
        try:
            refitted, forces = self._refitted(design)
        except EquilibriumError as error:
            return replace(row, stop=f"{design.stop}; refitted under the paper's R: {error}"), design
        return replace(
            row,
            **{name: getattr(refitted, name) for name in _JUDGED},
            total_force=float(sizes(forces).sum()),
        ), design

    def _refitted(self, design: Design) -> tuple[Certificate, Floats]:
        """The judge's word on a design pruned and refitted under the paper's R, and its forces (V, 3)."""
        problem = self.reference
        amplitudes = problem.supports.amplitudes(design.forces[problem.membrane.free])
        keep = problem.supports.always
        rounded = round_supports(problem, Shape(design.positions, amplitudes, None, 0), keep, lambda _: None).shape
        forces = problem.all_forces(rounded.amplitudes)
        return judge(problem, rounded.positions, forces), forces


_JUDGED = ("objective", "distance", "rms_distance", "supports", "stationarity", "off_support", "converged")
