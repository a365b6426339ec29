"""Iteratively reweighted least squares (IRLS) on the membrane itself: Newton in x, the smoothing of R continued down.

Each reweighting replaces R by parabolas that touch it from above, so a step is one sparse system in the displacement and the
multipliers of equilibrium, which takes candidates and other vertices alike and never squares K (MATHEMATICS.md, "Other methods").
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array

from relax.arrays import Floats, Mask
from relax.design.methods.smooth import Smoothed, refuse_constraints, steepest_slope
from relax.design.problem import Problem
from relax.design.rounding import Rounded, round_supports, seated
from relax.design.shape import Shape, figures, rest
from relax.design.starts import Start
from relax.design.trace import Journal
from relax.errors import InputError
from relax.factor import Factor, Symbolic
from relax.iterate import Stop, iterate
from relax.sparsity.supports import sizes

LEAST_BEND = 1e-9  # of the steepest slope over the smoothing: the bend of a parabola where a penalty is flat
SETTLED = 1e-8  # relative fall under the last smoothing that is none any more; forces on their way to nothing fall slowly
NONE = 10  # times the last smoothing: a smaller force is one that it made, its dual 0.5 % inside the bound of a kink
HALVINGS = 12  # a step shorter than 1/4000 of Newton's leads nowhere
DESCENT = 1e-4  # Armijo's share of the promised fall
STEPS = 1000  # more than any schedule that is worth waiting for
ROUNDS = 8  # of rounding, while the certificate names candidates that are missing


@dataclass(frozen=True)
class _State:
    shape: Shape
    width: float  # smoothing of the next step, newtons
    multipliers: Floats  # (n, 3), minus lam as far as the last step knows it
    taken: int = 0  # steps under this width
    note: str = ""
    ended: bool = False


@dataclass(frozen=True)
class Reweighting:
    """The steps: an algorithm for `iterate`.

    Parameters
    ----------
    problem : Problem
    settings : IRLS
    last : float
        Width at which smoothing ends, newtons.
    """

    problem: Problem
    settings: "IRLS"
    last: float

    def begin(self, shape: Shape, width: float) -> _State:
        """The first state."""
        return _State(shape, width, np.zeros((self.problem.supports.free, 3)))

    def value(self, shape: Shape, width: float) -> float:
        """E_dist + R at a shape, R smoothed over `width`."""
        smooth = Smoothed(self.problem.penalty, width).value(sizes(shape.amplitudes))
        return self.problem.distance(shape.positions) + float(self._costs @ smooth)

    @cached_property
    def _costs(self) -> Floats:
        return self.problem.strength * self.problem.supports.weights

    def step(self, state: _State) -> _State:
        """One reweighting, kept if the smoothed objective falls at true equilibrium; then less smoothing, or none is left."""
        shape, width = state.shape, state.width
        moved = self._moved(state)
        before = self.value(shape, width)
        note = f"smoothing {width:.2g} N"
        if moved is None:
            moved, gained = replace(state, note=f"{note}, every step was refused"), 0.0
        else:
            gained = before - self.value(moved.shape, width)
            moved = replace(moved, note=note)
        ended = width <= self.last
        gain, steps = (SETTLED, self.settings.last_steps) if ended else (self.settings.gain, self.settings.steps)
        if gained > gain * before and state.taken + 1 < steps:
            return replace(moved, taken=state.taken + 1)
        return replace(moved, width=max(width * self.settings.shrink, self.last), taken=0, ended=ended)

    def _moved(self, state: _State) -> _State | None:
        """The state after a step that lowers the smoothed objective: Newton's, or without T where that has none."""
        problem, shape = self.problem, state.shape
        bend = np.maximum(self._costs * Smoothed(problem.penalty, state.width).across(sizes(shape.amplitudes)), 0.0)
        bend = np.maximum(bend, LEAST_BEND * steepest_slope(problem) / state.width)  # 2 b
        pull = bend[:, None] * shape.amplitudes
        multipliers = state.multipliers.copy().ravel()
        multipliers[problem.supports.rows] = pull
        stiffness = problem.membrane.stiffness(shape.positions)
        turn = problem.membrane.stiffness_turn(shape.positions, multipliers.reshape(-1, 3))
        offset = 2 * (problem.metric @ problem.offset(shape.positions).ravel())
        before = self.value(shape, state.width)
        spent = shape.factorizations
        for part in (turn, 0.0 * turn):
            shift, multipliers = self.solve(stiffness, part, bend, (-offset, shape.amplitudes))
            spent += 1
            promised = float(offset @ shift + np.vdot(pull, (stiffness @ shift)[problem.supports.rows]))
            length = 1.0
            for _ in range(HALVINGS if promised < 0 else 0):
                moved = self._displaced(replace(shape, factorizations=spent), length * shift)
                if moved is not None:
                    spent = moved.factorizations
                    if self.value(moved, state.width) <= before + DESCENT * length * promised:
                        return replace(state, shape=moved, multipliers=multipliers.reshape(-1, 3))
                length *= 0.5
        return None

    def _displaced(self, shape: Shape, shift: Floats) -> Shape | None:
        """The membrane displaced (3n,), under the forces that its candidates need there, and at rest."""
        problem = self.problem
        positions = shape.positions.copy()
        positions[problem.membrane.free] += shift.reshape(-1, 3)
        amplitudes = problem.supports.amplitudes(-problem.membrane.forces(positions) - problem.loads)
        return rest(problem, replace(shape, positions=positions, amplitudes=amplitudes))

    def solve(self, stiffness: csc_array, turn: csc_array, bend: Floats, state: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
        """Displacement d and multipliers w (3n,) of one reweighting.

            [ 2 M + T    K         ] [ d ]   [ -2 M r ]
            [ K         -1 / (2 b) ] [ w ] = [ -s     ]      rows of the second block without a candidate: 0 and 0

        `bend` (m,) is 2 b; `state` has -2 M r (3n,) and the amplitudes s (m, c).
        """
        problem, unit = self.problem, self._unit
        count = problem.supports.free
        pointer, column = problem.membrane.neighbours
        blocks = np.zeros((len(column), 6, 6))
        blocks[:, :3, :3] = _blocks(turn)
        blocks[:, :3, 3:] = blocks[:, 3:, :3] = _blocks(stiffness) / unit
        own = np.flatnonzero(column == np.repeat(np.arange(count), np.diff(pointer)))
        blocks[own, :3, :3] += 2 * problem.scene.metric[problem.membrane.free]
        softness = np.zeros(3 * count)
        softness[problem.supports.rows] = 1 / (bend[:, None] * unit**2)
        blocks[own[:, None], np.arange(3, 6), np.arange(3, 6)] = -softness.reshape(-1, 3)
        rows = bsr_array((blocks, column, pointer), shape=(6 * count, 6 * count)).tocsr()
        factor = Factor(csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape), self._symbolic)
        right = np.zeros((count, 6))
        right[:, :3] = state[0].reshape(-1, 3)
        right[:, 3:] = -problem.supports.forces(state[1]) / unit
        found = factor.solve(right.ravel()).reshape(-1, 6)
        return found[:, :3].ravel(), found[:, 3:].ravel() / unit

    @cached_property
    def _unit(self) -> float:
        """Newtons per metre: the multipliers times this are lengths, as the displacements are."""
        return float(self.problem.membrane.spring_constant.mean())

    @cached_property
    def _symbolic(self) -> Symbolic:
        return Symbolic(6, self.problem.membrane.engine)

    def done(self, state: _State) -> Stop | None:
        return Stop.CONVERGED if state.ended else None

    def record(self, state: _State) -> dict[str, object]:
        return figures(self.problem, state.shape, state.note, range(len(state.shape.amplitudes)))


def _blocks(matrix: csc_array) -> Floats:
    """The 3 x 3 blocks (b, 3, 3), by rows, of a symmetric matrix of the membrane's pattern."""
    return csr_array((matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape).tobsr((3, 3)).data


@dataclass(frozen=True)
class IRLS:
    """The method as a value: call it, or hand it to `relax.solve(problem, method=...)`.

    Parameters
    ----------
    first, last : float
        Smoothing of R at the beginning and at the end, as shares of the largest force there is at the start.
    shrink : float
        From one smoothing to the next.
    steps : int
        Largest number of reweightings under one smoothing.
    gain : float
        Relative fall of the smoothed objective for which another one is taken.
    last_steps : int
        Largest number under the last smoothing, where they go on until nothing falls.
    """

    first: float = 1.0
    last: float = 1e-3
    shrink: float = 0.6
    steps: int = 3
    gain: float = 1e-3
    last_steps: int = 200

    def __post_init__(self) -> None:
        if not (0 < self.last <= self.first and 0 < self.shrink < 1 and min(self.steps, self.last_steps) >= 1):
            raise InputError(
                f"IRLS has smoothing from {self.first} to {self.last}, times {self.shrink} after at most {self.steps} steps: "
                "expected 0 < last <= first, shrink between 0 and 1, and a step at least"
            )

    def __call__(self, problem: Problem, start: Start, journal: Journal) -> tuple[Shape, Shape]:
        """The shape after rounding by the dual certificate, and the one before.

        Raises
        ------
        InputError
            The problem asks for what this method cannot treat.
        EquilibriumError
            The membrane does not stand under what was found.
        """
        refuse_constraints(problem, "irls")
        shape = start.shape
        largest = float(max(sizes(shape.amplitudes).max(initial=0.0), np.abs(problem.membrane.tension(shape.positions)).max()))
        steps = Reweighting(problem, self, self.last * largest)
        unrounded = iterate(steps, steps.begin(shape, self.first * largest), STEPS, journal).state.shape
        journal.stage += ", rounding"
        small = sizes(unrounded.amplitudes) <= max(NONE * self.last * largest, problem.penalty.resolution)
        shape = replace(unrounded, amplitudes=np.where(small[:, None], 0.0, unrounded.amplitudes))
        return _rounded(problem, shape, journal), unrounded


def _rounded(problem: Problem, shape: Shape, journal: Journal) -> Shape:
    """Rounding as everywhere, what is missing let in while that pays."""
    keep: Mask = np.zeros(len(shape.amplitudes), dtype=bool)
    best = round_supports(problem, shape, keep, journal)
    for _ in range(ROUNDS):
        if not best.missing.any():
            break
        keep = keep | best.missing
        found = round_supports(problem, seated(problem, best), keep, journal)
        if _objective(problem, found) >= _objective(problem, best):
            break
        best = found
    return best.shape


def _objective(problem: Problem, result: Rounded) -> float:
    return problem.objective(result.shape.positions, result.shape.amplitudes)


irls = IRLS()
