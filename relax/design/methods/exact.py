"""The best supports of all, for small linear membranes: a tree search by SCIP that ends with a proof, or with a gap.

With force densities E_dist is exactly quadratic in the support forces, so that the only difficulty left is which supports stand
and, for penalties that tell forces apart, how large each is (MATHEMATICS.md, "Other methods").
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats
from relax.convex.reweighted import Reweighted
from relax.design.methods.greedy import LIMIT as MOVES
from relax.design.methods.greedy import Greedy
from relax.design.methods.quadratic import Quadratic, quadratic_of, small_problem
from relax.design.methods.relaxation import relaxation_of
from relax.design.methods.smooth import refuse_floating
from relax.design.methods.tree import SAME, explore
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.shape import Shape, figures
from relax.design.starts import Start, resolve_weight
from relax.design.trace import Journal
from relax.errors import InputError
from relax.iterate import iterate
from relax.sparsity.supports import sizes

LARGEST = 60  # candidates: beyond, a tree within minutes leaves gaps that say nothing
SECONDS = 60.0
FAINT = 1e-6  # of the largest force: a smaller one is what Newton on the relaxation left
ROUNDS = 4  # trees one after the other, each with the bounds that a better point gives: the first has the best as a rule


@dataclass(frozen=True)
class Optimum:
    """The best supports known, and how much better others could be.

    Parameters
    ----------
    value : float
        E_dist + R of `amplitudes`, square metres.
    bound : float
        No supports have a lower value: valid whatever was found.
    amplitudes : (m, c) newtons
    status : str
        "optimal" where value and bound are the same to 2e-6, "gap" where the pieces of the penalty leave one, else "time limit".
    seconds : float
    nodes : int
        Of the tree.
    """

    value: float
    bound: float
    amplitudes: Floats
    status: str
    seconds: float
    nodes: int

    @property
    def gap(self) -> float:
        """(value - bound) / value."""
        return (self.value - self.bound) / self.value if self.value > 0 else 0.0


def best_subset(problem: Problem, seconds: float = SECONDS) -> Optimum:
    """The global minimum of E_dist + R, or a lower bound and the best point within `seconds`.

    Exact for a penalty that counts supports. For others that never fall and are concave past their resolution (group lasso,
    power, log-sum, MCP, SCAD) the bound is that of a piecewise linear penalty that lies at most 0.4 % below.

    Raises
    ------
    InputError
        The membrane is not linear, there are more candidates than 60, some forces do not change E_dist, or pyscipopt is not
        installed.
    """
    begin = time.perf_counter()
    problem = resolve_weight(problem)
    _refuse(problem)
    quadratic = quadratic_of(problem)
    shape = _rested(problem, _by_greedy(problem, quadratic).amplitudes)
    value = problem.objective(shape.positions, shape.amplitudes)
    bound, nodes, finished = min(quadratic.least, value), 0, value <= quadratic.least
    candidate = _candidates(quadratic, small_problem(problem, quadratic))
    for _ in range(ROUNDS):
        left = seconds - (time.perf_counter() - begin)
        if value <= quadratic.least or left <= 0 or not len(quadratic.costs):
            break
        tree = explore(relaxation_of(problem, quadratic, value), value, candidate, left)
        bound, nodes = max(bound, tree.bound), nodes + tree.nodes
        finished = tree.finished
        better = shape if tree.amplitudes is None else _rested(problem, tree.amplitudes)
        lower, before = problem.objective(better.positions, better.amplitudes), value
        if lower < value:
            shape, value = better, lower
        if bound >= (1 - 2 * SAME) * value or value >= (1 - SAME) * before:
            break  # proven, or the same tree again would say the same
    close = bound >= (1 - 2 * SAME) * value
    status = "optimal" if close else "gap" if finished else "time limit"
    return Optimum(value, min(bound, value), shape.amplitudes, status, time.perf_counter() - begin, nodes)


def exact(problem: Problem, start: Start, journal: Journal) -> tuple[Shape, Shape]:
    """`best_subset` as a method: the start does not matter; the note says what is proven."""
    found = best_subset(problem)
    shape = _rested(problem, found.amplitudes)
    proven = f"{found.status}, no supports have an objective below {found.bound:.8g} ({found.nodes} nodes)"
    shape = replace(shape, factorizations=shape.factorizations + start.shape.factorizations)
    journal(figures(problem, shape, proven, np.arange(len(found.amplitudes))))
    return shape, shape


def _refuse(problem: Problem) -> None:
    """Raise InputError where the problem is none for a tree."""
    refuse_floating(problem, "exact")
    if not problem.membrane.linear:
        raise InputError(
            f"the exact method needs a membrane whose shape is linear in the forces, and membrane.springs is "
            f'{problem.membrane.springs.name!r}: use "force-density", or solver.method "greedy"'
        )
    count = len(problem.supports.vertices)
    if count > LARGEST:
        raise InputError(
            f"the exact method looks at every choice among at most {LARGEST} candidates, and the scene has {count}: name fewer "
            'in supports.candidates, or use solver.method "greedy"'
        )


def _by_greedy(problem: Problem, quadratic: Quadratic) -> Shape:
    """A first point: greedy moves from no supports."""
    method = Greedy(problem)
    bare = _at(problem, np.zeros_like(quadratic.linear))
    return iterate(method, method.begin(bare), MOVES).state.shape


def _at(problem: Problem, amplitudes: Floats) -> Shape:
    """The linear membrane at rest under amplitudes (m, c): one solve."""
    start = problem.scene.start
    factor = problem.factor_at(start)
    applied = problem.membrane.forces(start) + problem.loads + problem.supports.forces(amplitudes)
    positions = start.copy()
    positions[problem.membrane.free] += factor.solve(applied.ravel()).reshape(-1, 3)
    return Shape(positions, amplitudes, factor, 1)


def _rested(problem: Problem, amplitudes: Floats) -> Shape:
    """The shape under these supports, their forces refitted to the last digit where that leaves them within reach and gains."""
    shape = _at(problem, problem.supports.reach.project(amplitudes))
    if not amplitudes.any():
        return shape
    fine = refit(problem, shape)
    held = problem.supports.reach.project(fine.amplitudes)
    if not np.array_equal(held, fine.amplitudes):
        fine = _at(problem, held)
    return min(shape, fine, key=lambda each: problem.objective(each.positions, each.amplitudes))


def _candidates(quadratic: Quadratic, small: Reweighted) -> Callable[[Floats], tuple[float, Floats]]:
    """What the relaxation's forces are worth in truth: as they are, or refitted without those that do not earn their cost."""

    def candidate(found: Floats) -> tuple[float, Floats]:
        size = sizes(found)
        forces = np.where((size > max(FAINT * size.max(initial=0.0), small.penalty.resolution))[:, None], found, 0.0)
        forces = quadratic.reach.project(forces)
        offers = [forces, quadratic.reach.project(small.pruned(forces))]
        values = [small.value(each) + quadratic.constant for each in offers]
        best = int(np.argmin(values))
        return values[best], offers[best]

    return candidate
