"""The search for few supports: at each shape a small model of the whole problem, searched at little cost, then tried in truth.

On a working set, the supports that stand and the peaks of the dual field, the problem is small and dense (model.py), and looking
for few forces there costs nothing beside a factorisation: reweighting while the smoothing shrinks, supports left out that do not
earn their cost. What the model finds best is brought to rest and counts only if the objective falls there.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from relax.arrays import Floats, Ints
from relax.convex.reweighted import GRADUAL
from relax.design.landscape import Landscape
from relax.design.model import Model, empty_model, model_on_supports
from relax.design.problem import Problem
from relax.design.refit import penalty_hessian
from relax.design.shape import Shape, figures
from relax.design.trial import tried
from relax.iterate import Stop
from relax.sparsity.supports import sizes
from relax.sparsity.surrogates import Continuation

DENSE = 0.5  # share of the candidates: more forces than this are no support yet
PEAKS = 24  # of dense forces: candidates of a first model at most
STRONG = 0.2  # share of the largest peak that a peak of the forces must reach to be looked at
NEWCOMERS = 8  # peaks of the dual that enter a model at once
ENTER = 1 / 3  # of the supports that stand: where many do, as many peaks of the dual enter
ROUNDS = 4  # of newcomers to a first model
ROUND_PAYS = 0.01  # relative fall of the model's value for which another round is worth its columns
CLOSE = 6  # mean edge lengths within which two supports may be one
REARRANGED = (
    8  # moves of single supports and close pairs that are looked at closer; where more stand close together the weight fits noise
)
REARRANGED_PAYS = 5e-3  # relative fall that the model must promise for a support moved by itself
PROPOSALS = 2  # the model's best are tried at true equilibrium, no more
GAIN = 1e-4  # relative fall of the objective below which Newton on the support is the better next step
SETTLED = 0.01  # relative fall with the same supports after which Newton on them is the better next step
OPTIMISM = 2.0  # by which a newcomer's dual is raised when one asks whether it could pay: others will make room
FLAT = 1e-9  # of the largest bend: a smaller one is round-off
SHARES = np.geomspace(1e-3, 1.0, 16)  # of the force at which a newcomer alone would gain most


@dataclass(frozen=True)
class State:
    """A shape on the way; its objective is infinite while forces stand almost everywhere."""

    shape: Shape
    objective: float
    note: str = ""
    stop: Stop | None = None
    failure: str = ""  # why nothing was gained though the model promised it
    looked: frozenset[int] = frozenset()  # candidates that were members of a model, so far
    broken: int = 0  # trials of the last step that were broken off


@dataclass(frozen=True)
class Search:
    """Steps from model to model.

    Parameters
    ----------
    problem : Problem
        Its penalty tells small forces from large ones (else there is nothing to reweight).
    continuation : Continuation
        How the smoothing of a model's reweightings shrinks.
    """

    problem: Problem
    continuation: Continuation = GRADUAL

    def begin(self, shape: Shape) -> State:
        """The first state."""
        standing = self.problem.standing(shape.amplitudes)
        dense = np.count_nonzero(standing) > max(PEAKS, DENSE * len(standing))
        return State(shape, np.inf if dense else self.problem.objective(shape.positions, shape.amplitudes))

    def step(self, state: State) -> State:
        """The first of the model's best proposals that pays at true equilibrium."""
        if np.isinf(state.objective):
            shape, model = self._first_model(state.shape)
            few = model.small.pruned(model.small.continued(self.continuation))
            moved = self._tried(replace(state, shape=shape, broken=0), model, [few])
            # a weight so light that forces everywhere pay: few would be worse than what is there, if that stands
            own = self.problem.objective(shape.positions, shape.amplitudes)
            if moved.stop or moved.objective < own or not model.factor.positive_definite:
                return moved
            return replace(state, objective=own, stop=Stop.CONVERGED)
        shape, model, slides = self._model(state.shape)
        small, here = model.small, shape.amplitudes
        starts = [here, self._shifted(here, slides)]
        proposals = [small.pruned(small.continued(self.continuation)), *(small.pruned(start[model.members]) for start in starts)]
        proposals.append(np.zeros_like(proposals[0]))  # nothing at all: each may pay beside the others, and together not
        moved = self._tried(replace(state, shape=shape, broken=0), model, proposals)
        return moved if moved.stop is None else self._rearranged(moved, model, slides)

    def confirms(self, shape: Shape, one_by_one: Ints) -> bool:
        """Whether a stationary shape is a minimum on its support, and the model would leave none of its supports out.

        An answer that was found among symmetric ones only can be neither. `one_by_one`: supports whose absence is tried,
        one of each orbit.
        """
        standing = np.flatnonzero(self.problem.standing(shape.amplitudes))
        if not standing.size:
            return True
        _, model = model_on_supports(self.problem, shape)
        here = shape.amplitudes[model.members]
        hessian = 2 * model.quadratic + penalty_hessian(self.problem, model.members, here)
        bends = np.linalg.eigvalsh(hessian)
        if bends[0] < -FLAT * bends[-1]:
            return False
        fewer = [model.small.pruned(here)]
        for group in one_by_one:
            fewer.append(model.small.settled(np.where((model.members == group)[:, None], 0.0, here)))
        return min(map(model.value, fewer)) > (1 - GAIN) * model.value(here)

    def _rearranged(self, state: State, model: Model, slides: Ints) -> State:
        """Before the search ends: one support at a time moves a step uphill, or two that stand close together become one."""
        here = state.shape.amplitudes
        pairs, halfway = self._close_pairs(state.shape)
        entering = np.setdiff1d(halfway, model.members)
        model = model.enlarged(entering)
        moves = [slides[i : i + 1] for i in range(len(slides))]
        moves += [np.column_stack([pair, [vertex, vertex]]) for pair, vertex in zip(pairs, halfway, strict=True)]
        starts = [self._shifted(here, move)[model.members] for move in moves]
        likely = sorted([model.small.once(start) for start in starts], key=model.value)[:REARRANGED]
        moved = self._tried(state, model, [model.small.pruned(start) for start in likely], REARRANGED_PAYS)
        return moved if moved.stop is None else replace(state, shape=moved.shape, looked=moved.looked, broken=moved.broken)

    def _shifted(self, amplitudes: Floats, moves: Ints) -> Floats:
        """Amplitudes (m, c) with the forces at moves[:, 0] added to those at moves[:, 1]."""
        shifted = amplitudes.copy()
        shifted[moves[:, 0]] = 0.0
        np.add.at(shifted, moves[:, 1], amplitudes[moves[:, 0]])
        return self.problem.supports.reach.project(shifted)

    def _tried(self, state: State, model: Model, proposals: list[Floats], promise: float = GAIN) -> State:
        """The state after the best proposal that pays in truth, or the same at its end; `promise`: what is asked of a model."""
        shape, note = state.shape, f"model of {len(model.members)} candidates"
        failure, looked, broken = "", state.looked.union(model.members), state.broken
        # E_dist + R is never negative: where the model says so it was left behind, the farther the less it is believed
        likely = sorted(proposals, key=lambda proposal: (model.value(proposal) < 0, abs(model.value(proposal))))
        for proposal in likely[:PROPOSALS]:
            if model.value(proposal) >= (1 - promise) * state.objective:
                break
            failure = "nothing that the model proposed lowers the objective in truth"
            enough = (1 - GAIN) * state.objective
            moved, given_up = tried(self.problem, replace(shape, factor=model.factor), model.whole(proposal), enough)
            broken += given_up
            if moved is None:
                continue
            shape = replace(shape, factorizations=moved.factorizations)
            objective = self.problem.objective(moved.positions, moved.amplitudes)
            if objective < enough:
                stop = self._settled(state, moved, objective)
                return State(moved, objective, note, stop, looked=looked, broken=broken)
        stop = Stop.STALLED if failure else Stop.CONVERGED
        end = replace(state, shape=shape, stop=stop, failure=failure, looked=looked, broken=broken)
        return replace(end, note=f"{note} has nothing better")

    def _settled(self, before: State, shape: Shape, objective: float) -> Stop | None:
        """Whether the same supports stand and little was gained, so that the rest is Newton's."""
        same = np.array_equal(self.problem.standing(shape.amplitudes), self.problem.standing(before.shape.amplitudes))
        return Stop.CONVERGED if same and objective > (1 - SETTLED) * before.objective else None

    def _model(self, shape: Shape) -> tuple[Shape, Model, Ints]:
        """The model at a shape under few forces: with those, the peaks that could pay, and a neighbour uphill of each."""
        shape, model = model_on_supports(self.problem, shape)
        standing = model.members
        steep = self.problem.supports.steepness(model.dual)
        uphill = self._land.uphill(steep, standing)
        entering = np.union1d(self._newcomers(model, model.dual), np.setdiff1d(uphill, standing))
        slides = np.column_stack([standing, uphill])[uphill != standing]
        return shape, model.enlarged(entering), slides

    def _first_model(self, shape: Shape) -> tuple[Shape, Model]:
        """The model at a shape under forces almost everywhere: expanded at no forces, with the peaks of forces and dual."""
        problem = self.problem
        factor = shape.factor or problem.factor_at(shape.positions)
        shape = shape.with_factor(factor)
        unbalanced = (problem.membrane.forces(shape.positions) + problem.loads).ravel()
        offset = problem.offset(shape.positions).ravel() + factor.solve(unbalanced)
        pulled = problem.metric @ offset
        dual = problem.supports.duals(factor.solve(2 * pulled).reshape(-1, 3))
        model = empty_model(problem, factor, problem.metric, np.zeros_like(dual), float(offset @ pulled), dual)
        force = sizes(shape.amplitudes)
        peaks = self._land.peaks(force)[:PEAKS]
        peaks = peaks[force[peaks] > STRONG * force.max()]
        model = model.enlarged(np.union1d(peaks, np.flatnonzero(problem.supports.always)))
        value = np.inf
        for _ in range(ROUNDS):
            best = model.small.pruned(model.small.continued(self.continuation))
            if model.value(best) > (1 - ROUND_PAYS) * value:
                break
            value = model.value(best)
            entering = self._newcomers(model, model.dual_at(best), int(np.count_nonzero(sizes(best))))
            if not entering.size:
                break
            model = model.enlarged(entering)
        return shape, model

    def _newcomers(self, model: Model, dual: Floats, standing: int | None = None) -> Ints:
        """Peaks of the dual field outside the model where a force could pay for itself, the steepest first."""
        problem = self.problem
        count = len(model.members) if standing is None else standing
        steep = problem.supports.steepness(dual)
        steep[model.members] = 0.0
        peaks = self._land.peaks(steep)
        peaks = peaks[: max(NEWCOMERS, round(ENTER * count))]
        if not model.members.size:
            return peaks
        # how far a unit force moves the membrane is not known without its column: the members' mean tells the order of it
        pulls = problem.supports.reach.cone(-dual[peaks])
        along = np.square(pulls) / np.square(sizes(pulls)[:, None])
        bend = along @ np.diag(model.small.quadratic).reshape(-1, along.shape[1]).mean(axis=0)
        gain = OPTIMISM * sizes(pulls)
        force = np.minimum(SHARES[:, None] * gain / (2 * bend), problem.supports.reach.largest)
        # a force below the penalty's resolution is none, however little it costs
        priced = np.maximum(force, problem.penalty.resolution)
        cost = problem.strength * problem.supports.weights[peaks] * problem.penalty.value(priced)
        return peaks[(gain * force - bend * force**2 - cost).max(axis=0) > 0]

    @cached_property
    def _land(self) -> Landscape:
        return Landscape(self.problem)

    def _close_pairs(self, shape: Shape) -> tuple[Ints, Ints]:
        """Supports that stand close together and pull the same way (P, 2), and the candidate halfway, by their forces (P,)."""
        problem = self.problem
        group, place, force = problem.candidates_at(shape.positions, shape.amplitudes)
        standing = np.flatnonzero(force.any(axis=1))
        edge = np.linalg.norm(problem.membrane.edge_vectors(shape.positions), axis=1).mean()
        close = KDTree(place[standing].reshape(-1, 3)).query_pairs(CLOSE * edge, output_type="ndarray")
        one, other = standing[close.reshape(-1, 2)].T
        alike = np.einsum("ij,ij->i", force[one], force[other]) > 0
        one, other = one[alike], other[alike]
        share = sizes(force[one]) / (sizes(force[one]) + sizes(force[other]))
        middle = share[:, None] * place[one] + (1 - share[:, None]) * place[other]
        halfway = KDTree(place).query(middle)[1]
        # images of one pair are one move
        moves = np.unique(np.column_stack([np.sort(group[np.column_stack([one, other])]), group[halfway]]), axis=0)
        return moves[:, :2], moves[:, 2]

    def done(self, state: State) -> Stop | None:
        """Whether the model had nothing better, or nothing that held in truth."""
        return state.stop

    def record(self, state: State) -> dict[str, object]:
        """Figures of the state for the trace."""
        return {**figures(self.problem, state.shape, state.note, state.looked), "broken": state.broken}
