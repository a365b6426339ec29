"""Orthogonal matching pursuit on the dual field: supports one at a time, then dropped and moved, as long as the objective falls.

The dual says for every candidate at once what a first small force there would gain, so the support to add is looked for at its
peaks (Pati, Rezaiifar and Krishnaprasad 1993, with |P_C(-lam_g)| / c_g in place of a correlation; drops and swaps after Zhang
2011 and Hazimeh and Mazumder 2020). After each move all forces are refitted by Newton (MATHEMATICS.md, "Other methods").
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Ints, Mask
from relax.design.landscape import Landscape
from relax.design.methods.smooth import refuse_floating
from relax.design.model import Model, model_on_supports
from relax.design.problem import Problem
from relax.design.rounding import Rounded, round_supports, seated
from relax.design.search import Search
from relax.design.shape import Shape, figures, loaded
from relax.design.starts import Start, unsupported
from relax.design.trace import Journal
from relax.errors import EquilibriumError
from relax.iterate import Stop, iterate

LIMIT = 2000  # moves; a run that takes more has a weight so light that supports fit noise
LOOK = 8  # peaks of the dual that the model compares before one is added
NEAR = 3  # neighbours that a support may move to, those uphill in the dual: a support a step off its place feels the place
TRIES = 3  # of the model's best that are brought to rest: it is exact for linear membranes, and near enough for most others
LIKELY = 12  # moves of a support that are looked at closer, by their touching parabolas
GAIN = 1e-9  # relative fall that counts: far above the round-off of an objective, below anything that matters
EVERY = ("add", "drop", "swap")


@dataclass(frozen=True)
class Move:
    """A proposal: the forces (m, c) that the model expects after it, the objective that it expects, and what to call it."""

    amplitudes: Floats
    expected: float
    note: str


@dataclass(frozen=True)
class State:
    """A refitted shape, its objective and how it came about."""

    rounded: Rounded
    objective: float
    note: str
    looked: frozenset[int] = frozenset()
    stop: Stop | None = None

    @property
    def shape(self) -> Shape:
        """The membrane at rest under refitted forces."""
        return self.rounded.shape


@dataclass(frozen=True)
class Greedy:
    """Moves of single supports, each of which lowers the objective at true equilibrium.

    Parameters
    ----------
    problem : Problem
    moves : tuple of "add", "drop", "swap"
        In the order of preference; the next kind is looked at where no move of those before pays.
    look : int
        Peaks of the dual among which the model chooses what to add; 1 is plain matching pursuit.
    """

    problem: Problem
    moves: tuple[str, ...] = EVERY
    look: int = LOOK

    @cached_property
    def _landscape(self) -> Landscape:
        return Landscape(self.problem)

    def begin(self, shape: Shape) -> State:
        """The first state: `shape` with supports that always stand brought to bear, refitted."""
        absent = self.problem.supports.always & ~shape.amplitudes.any(axis=1)
        if absent.any():
            shape, model = model_on_supports(self.problem, shape)
            standing = np.flatnonzero(self.problem.standing(shape.amplitudes))
            start = self._seeded(model, shape.amplitudes, model.dual, standing[absent[standing]])
            settled = model.whole(model.small.settled(start[model.members]))
            shape = loaded(self.problem, replace(shape, factor=model.factor), settled) or shape
        rounded = self._refitted(shape, np.zeros(len(absent), dtype=bool))
        return State(rounded, self._objective(rounded.shape), "where it begins")

    def step(self, state: State) -> State:
        """The first move that pays in truth, of the model's best of each kind; the end where none does."""
        shape, model = model_on_supports(self.problem, state.shape)
        dual = model.dual
        looked, spent = state.looked, shape.factorizations
        kinds = {"add": self._additions, "drop": self._omissions, "swap": self._exchanges}
        for kind in self.moves:
            model, moves = kinds[kind](model, shape, dual)
            looked = looked.union(model.members.tolist())
            likely = sorted(moves, key=lambda move: move.expected)[:TRIES]
            for move in likely:
                if move.expected >= (1 - GAIN) * state.objective:
                    break
                moved = self._tried(replace(shape, factorizations=spent), model, move)
                spent = moved.shape.factorizations if moved else spent
                if moved and moved.objective < (1 - GAIN) * state.objective:
                    return replace(moved, looked=looked)
        rounded = replace(state.rounded, shape=replace(shape, factorizations=spent))
        end = replace(state, rounded=rounded, looked=looked, stop=Stop.CONVERGED)
        return self._infinitesimal(end) if state.rounded.missing.any() and "add" in self.moves else end

    def _additions(self, model: Model, shape: Shape, dual: Floats) -> tuple[Model, list[Move]]:
        """One more support at a peak of the dual."""
        peaks = self._peaks(shape, dual)
        model = model.enlarged(np.setdiff1d(peaks, model.members))
        starts = [self._seeded(model, shape.amplitudes, dual, peaks[i : i + 1]) for i in range(len(peaks))]
        notes = [f"add vertex {self._vertex(g)}" for g in peaks]
        return model, [self._settled(model, start, note) for start, note in zip(starts, notes, strict=True)]

    def _omissions(self, model: Model, shape: Shape, dual: Floats) -> tuple[Model, list[Move]]:
        """One support less."""
        return model, [
            self._settled(model, _without(shape.amplitudes, g), f"drop vertex {self._vertex(g)}") for g in self._movable(shape)
        ]

    def _exchanges(self, model: Model, shape: Shape, dual: Floats) -> tuple[Model, list[Move]]:
        """One support moved: with its force to a neighbour, or given up for a peak of the dual."""
        here, peaks = shape.amplitudes, self._peaks(shape, dual)
        standing = self.problem.standing(here)
        steep = self.problem.supports.steepness(dual)
        around = {}
        for g in self._movable(shape):
            near = [h for h in self._landscape.beside(g) if not standing[h]]
            around[g] = sorted(near, key=steep.__getitem__)[-NEAR:]
        everywhere = np.array(sorted({h for near in around.values() for h in near} | set(peaks.tolist())), dtype=np.int64)
        model = model.enlarged(np.setdiff1d(everywhere, model.members))
        found = []
        for g, start, h in self._exchanged(model, here, dual, around, peaks):
            once = model.small.once(start[model.members])
            found.append((model.value(once), g, h, start))
        likely = sorted(found, key=lambda each: each[0])[:LIKELY]
        return model, [
            self._settled(model, start, f"move vertex {self._vertex(g)} to {self._vertex(h)}") for _, g, h, start in likely
        ]

    def _exchanged(
        self, model: Model, here: Floats, dual: Floats, around: dict[int, list[int]], peaks: Ints
    ) -> Iterator[tuple[int, Floats, int]]:
        """Forces (m, c) to start from, with the candidates that a support leaves and goes to."""
        for g, near in around.items():
            for h in near:
                start = _without(here, g)
                start[h] = here[g]
                yield g, start, h
            for h in peaks:
                yield g, self._seeded(model, _without(here, g), dual, np.array([h])), int(h)

    def _settled(self, model: Model, start: Floats, note: str) -> Move:
        forces = model.small.settled(start[model.members])
        return Move(model.whole(forces), model.value(forces), note)

    def _tried(self, shape: Shape, model: Model, move: Move) -> State | None:
        """The move at true equilibrium, refitted; None if the membrane finds no rest."""
        moved = loaded(self.problem, replace(shape, factor=model.factor), move.amplitudes)
        if moved is None:
            return None
        try:
            rounded = self._refitted(moved, np.zeros(len(move.amplitudes), dtype=bool))
        except EquilibriumError:
            return None
        return State(rounded, self._objective(rounded.shape), move.note)

    def _infinitesimal(self, state: State) -> State:
        """A candidate whose dual is steeper than R allows gains by a small force, whatever the model expects of a large one."""
        rounded, spent = state.rounded, state.shape.factorizations
        steep = self.problem.supports.steepness(rounded.dual) * rounded.missing
        one = replace(rounded, missing=np.arange(len(steep)) == int(np.argmax(steep)))
        try:
            tried = self._refitted(seated(self.problem, one), one.missing)
        except EquilibriumError:
            return state
        objective = self._objective(tried.shape)
        if objective < (1 - GAIN) * state.objective:
            note = f"add vertex {self._vertex(int(np.argmax(steep)))}, as its dual asks for"
            return State(tried, objective, note, state.looked)
        shape = replace(state.shape, factorizations=max(spent, tried.shape.factorizations))
        return replace(state, rounded=replace(rounded, shape=shape), stop=Stop.STALLED)

    def _refitted(self, shape: Shape, keep: Mask) -> Rounded:
        return round_supports(self.problem, shape, keep, lambda _: None)

    def _seeded(self, model: Model, amplitudes: Floats, dual: Floats, groups: Ints) -> Floats:
        """Forces (m, c) with a first one at each of `groups`, members of the model: the best there while nothing else moves."""
        seeded = amplitudes.copy()
        pull = self.problem.supports.reach.cone(-dual[groups])
        width = dual.shape[1]
        for g, force in zip(groups, pull, strict=True):
            at = width * int(np.flatnonzero(model.members == g)[0]) + np.arange(width)
            bend = float(force @ model.small.quadratic[np.ix_(at, at)] @ force)
            seeded[g] = force * (float(force @ force) / (2 * bend) if bend > 0 else 0.0)
        return self.problem.supports.reach.project(seeded)

    def _peaks(self, shape: Shape, dual: Floats) -> Ints:
        steep = self.problem.supports.steepness(dual)
        steep[self.problem.standing(shape.amplitudes)] = 0.0
        return self._landscape.peaks(steep)[: self.look]

    def _movable(self, shape: Shape) -> list[int]:
        """Supports that stand by choice."""
        standing = self.problem.standing(shape.amplitudes) & ~self.problem.supports.always
        return [int(g) for g in np.flatnonzero(standing)]

    def _vertex(self, group: int) -> int:
        return int(self.problem.membrane.free[self.problem.supports.vertices[group]])

    def _objective(self, shape: Shape) -> float:
        return self.problem.objective(shape.positions, shape.amplitudes)

    def done(self, state: State) -> Stop | None:
        """Whether no move pays."""
        return state.stop

    def record(self, state: State) -> dict[str, object]:
        """Figures of the state for the trace."""
        return figures(self.problem, state.shape, state.note, state.looked)


def greedy(problem: Problem, start: Start, journal: Journal) -> tuple[Shape, Shape]:
    """Supports one at a time from none, or from `start` where the membrane does not stand by itself; every shape is rounded.

    Raises
    ------
    InputError
        A part of the membrane has no fixed vertex.
    EquilibriumError
        The membrane finds no rest where it begins.
    """
    refuse_floating(problem, "greedy")
    method = Greedy(problem)
    run = iterate(method, method.begin(_first(problem, start.shape)), LIMIT, journal)
    return run.state.shape, run.state.shape


def _first(problem: Problem, shape: Shape) -> Shape:
    """The membrane without supports; where it does not stand, `shape`, thinned by one step of the search if supports crowd it."""
    try:
        bare = unsupported(problem)
    except EquilibriumError:
        search = Search(problem)
        state = search.begin(shape)
        return shape if np.isfinite(state.objective) else search.step(state).shape
    return replace(bare, factorizations=bare.factorizations + shape.factorizations)


def _without(amplitudes: Floats, group: int) -> Floats:
    fewer = amplitudes.copy()
    fewer[group] = 0.0
    return fewer
