"""The last solve on a support: Newton with the exact Hessian on E_dist + R, or on E_dist alone (debiased).

Where K is invertible, positions are a function of the support forces through equilibrium, so on a support of k groups only
c k numbers are unknown (MATHEMATICS.md, "Reduced form"). What a support can do is kept on the way (sparsity/faces.py).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, Ints
from relax.design.problem import Problem
from relax.design.shape import Shape, displaced, figures, rest, to_the_last_digits, with_dual
from relax.errors import EquilibriumError
from relax.factor import Factor
from relax.iterate import Record, Stop, iterate
from relax.sparsity.faces import face_at, projected_gradient
from relax.sparsity.supports import sizes

Progress = Callable[[Record], None]
NEAR = 1e-4  # stationarity from which the next Newton step may be the last
AIM = 1e-12  # stationarity at which Newton stops at once
LIMIT = 60
HALVINGS = 12  # a step that must be shorter than 1/4000 of Newton's leads nowhere
NOISE = 1e-13  # of the value: round-off
VISIBLE = 1e3  # times the noise: a fall that can be seen
IDLE = 1e-6  # relative decrease of the value that counts as a gain, if the step was not shorter than this share of Newton's:
SHORT = 0.1
FAST = 0.01  # a step that shrinks the gradient at least this much needs no new curvature
PATIENCE = (
    10  # steps in a row without a gain: the way ends at a shape that would not stand; off a saddle falls of 1e-10 quadruple
)


@dataclass(frozen=True)
class _Bend:
    """How E_dist bends in the members' forces, (ck, ck), and the columns of K^-1 (3n, ck): where they move the membrane."""

    columns: Floats
    hessian: Floats


@dataclass(frozen=True)
class _State:
    shape: Shape
    factor: Factor  # of K at the shape or so near that the dual could be refined to the last digits
    members: Ints
    value: float
    dual: Floats  # (n, 3)
    gradient: Floats  # (k, c) on the members
    scale: float  # sigma
    residual: float
    fresh: bool  # the factorisation was made at this very shape
    bend: _Bend | None = None  # of an earlier shape, while it serves
    idle: int = 0  # steps in a row that gained next to nothing
    best: float = np.inf  # the smallest residual so far
    stuck: bool = False
    kept: bool = False  # the step here went by columns and curvature of an earlier shape


@dataclass(frozen=True)
class _Refit:
    problem: Problem
    share: float  # 1: E_dist + R, 0: E_dist alone

    def state(self, shape: Shape, before: float = np.inf) -> _State:
        """Value and gradient at a shape that a step came to from one with the residual `before`."""
        problem, nearby = self.problem, shape.factor
        if before <= NEAR:  # the last gradients are those of a membrane at rest: what is unbalanced moves x - xhat, small itself
            shape = to_the_last_digits(problem, shape)
        shape, factor, dual = with_dual(problem, shape)
        members = np.flatnonzero(problem.standing(shape.amplitudes))
        standing = shape.amplitudes[members]
        size = sizes(standing)
        slope = self._strength(members) * problem.penalty.slope(size)
        gradient = problem.supports.duals(dual)[members] + (slope / np.where(size > 0, size, 1.0))[:, None] * standing
        if problem.resultants is not None:  # with R dropped the multiplier is another
            keeping = problem.resultants.of(members)
            gradient = gradient + keeping.spread(keeping.multiplier(gradient, np.ones(len(members))))
        scale = problem.slope_scale(shape.amplitudes)
        left = projected_gradient(problem.supports.reach, standing, gradient, problem.step_lengths(standing, scale))
        residual = float(sizes(left).max(initial=0.0)) / scale
        value = self._value(shape.positions, shape.amplitudes)
        return _State(shape, factor, members, value, dual, gradient, scale, residual, factor is not nearby)

    def _strength(self, members: Ints) -> Floats:
        return self.share * self.problem.strength * self.problem.supports.weights[members]

    def _value(self, positions: Floats, amplitudes: Floats) -> float:
        return self.problem.distance(positions) + self.share * self.problem.sparsity(amplitudes)

    def step(self, state: _State) -> _State:
        """A Newton step; one that gains nothing by a curvature from elsewhere is tried again with one made here."""
        moved = self._newton(state, state.bend or self._bend(state))
        kept = state.bend is not None
        if (kept or not state.fresh) and (moved.idle > state.idle or moved.stuck):
            here = replace(self.state(replace(state.shape, factor=None)), idle=state.idle, best=state.best)
            moved, kept = self._newton(here, self._bend(here)), False
        return replace(moved, kept=kept)

    def _bend(self, state: _State) -> _Bend:
        columns = self.problem.columns(state.factor, state.members)
        curvature = self.problem.curvature(state.shape.positions, state.dual)
        return _Bend(columns, 2 * (columns.T @ (curvature @ columns)))

    def _newton(self, state: _State, bend: _Bend) -> _State:
        amplitudes = state.shape.amplitudes[state.members]
        whole = bend.hessian + self.share * penalty_hessian(self.problem, state.members, amplitudes)
        # steps of curvature's own length tell what binds; the judge's, as long as the force, would press small forces to nothing
        tau = 1 / np.maximum(np.abs(np.diag(whole)).reshape(amplitudes.shape).sum(axis=1), np.finfo(float).tiny)
        face = face_at(self.problem.supports.reach, amplitudes, state.gradient, tau)
        hessian, kept = face.hessian(whole), None
        if self.problem.resultants is not None:
            kept = self.problem.resultants.of(state.members).directions
            hessian = kept.T @ hessian @ kept
        values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
        vectors = vectors if kept is None else kept @ vectors
        # R bends downwards along each force and the membrane's own curvature may too: reflect, so that the step descends
        size = np.maximum(np.abs(values), 1e-13 * np.abs(values).max(initial=0.0))
        slopes = vectors.T @ face.gradient(whole)
        steps = -slopes / size
        if values.size and values[0] < 0 and slopes @ slopes < VISIBLE * NOISE * abs(state.value) * size[0]:
            # at a saddle the slope is lost in round-off: go down its steepest bend far enough for the value to show it
            steps[0] += np.copysign(np.sqrt(2 * VISIBLE * NOISE * abs(state.value) / size[0]), -slopes[0])
        delta = face.step(vectors @ steps)
        moved = self._search(state, delta.reshape(amplitudes.shape), bend)
        if not (moved.stuck and self.problem.supports.reach.constrained):
            return moved
        # a projected Newton step may climb where several bind; a projected gradient step of this length descends
        return self._search(state, -(tau / len(tau))[:, None] * state.gradient, bend)

    def _search(self, state: _State, delta: Floats, bend: _Bend) -> _State:
        """Backtrack at true equilibrium that stands; supports that the step turns round leave where that lowers the value."""
        members, shape, supports = state.members, state.shape, self.problem.supports
        s = shape.amplitudes[members]
        turned = (np.einsum("ij,ij->i", s, s + delta) <= 0) & ~supports.always[members]
        noise = NOISE * abs(state.value)
        length = 1.0
        for _ in range(HALVINGS):
            for leave in [True, False] if turned.any() and self.share else [False]:
                trial = supports.reach.project(s + length * delta)
                descent = min(0.0, float(np.vdot(state.gradient, trial - s)))
                if leave:
                    trial[turned] = 0.0
                amplitudes = shape.amplitudes.copy()
                amplitudes[members] = trial
                moved = displaced(self.problem, shape, bend.columns @ (trial - s).ravel(), amplitudes)
                if moved is None:
                    continue
                value = self._value(moved.positions, moved.amplitudes)
                falls = value <= state.value + (0.0 if leave else 1e-4 * descent)
                if falls or value <= state.value + noise:
                    near = self.state(moved, state.residual)
                    stands = near.factor.positive_definite or not state.factor.positive_definite
                    if stands and (falls or near.residual < 0.5 * state.residual):
                        falling = length >= SHORT and state.value - value > IDLE * abs(state.value)
                        best = min(state.best, state.residual)
                        gained = falling or near.residual < 0.5 * best
                        serves = near.residual <= FAST * state.residual and len(near.members) == len(members)
                        return replace(near, bend=bend if serves else None, idle=0 if gained else state.idle + 1, best=best)
            length *= 0.5
        return replace(state, stuck=True)

    def done(self, state: _State) -> Stop | None:
        if not state.members.size or state.residual <= AIM:
            return Stop.CONVERGED
        return Stop.STALLED if state.stuck or state.idle >= PATIENCE else None

    def record(self, state: _State) -> dict[str, object]:
        note = "Newton on the support"
        return {**figures(self.problem, state.shape, note, state.members), "residual": state.residual, "kept": state.kept}


def penalty_hessian(problem: Problem, members: Ints, amplitudes: Floats) -> Floats:
    """R's Hessian (ck, ck) at the members' amplitudes (k, c): phi'' u u^T + phi'/t (I - u u^T) a group."""
    count, width = amplitudes.shape
    size = sizes(amplitudes)
    length = np.where(size > 0, size, 1.0)  # at no force stand only those without a price
    unit = amplitudes / length[:, None]
    strength = problem.strength * problem.supports.weights[members]
    across = strength * problem.penalty.slope(size) / length
    along = strength * problem.penalty.curvature(size)
    blocks = across[:, None, None] * np.eye(width) + (along - across)[:, None, None] * unit[:, :, None] * unit[:, None, :]
    whole = np.zeros((count, width, count, width))
    index = np.arange(count)
    whole[index, :, index, :] = blocks
    return whole.reshape(width * count, -1)


def stationary_dual(problem: Problem, shape: Shape) -> tuple[Shape, Floats, float]:
    """The shape, its dual (n, 3), and how far it is from stationary for E_dist + R on its support (relative, as the judge)."""
    state = _Refit(problem, 1.0).state(shape)
    return state.shape, state.dual, state.residual


def refit(problem: Problem, shape: Shape, mode: str = "penalised", progress: Progress | None = None) -> Shape:
    """Newton on the forces that stand in `shape`, to stationarity; a support that the way down brings to zero leaves.

    `mode`: "penalised" minimises E_dist + R, "debiased" E_dist alone.

    Raises
    ------
    EquilibriumError
        The membrane finds no rest under these forces, or has no dual there.
    """
    method = _Refit(problem, 1.0 if mode == "penalised" else 0.0)
    # a first force may be larger than any that is allowed
    rested = rest(problem, replace(shape, amplitudes=problem.supports.reach.project(shape.amplitudes)))
    if rested is None:
        advice = "lower penalty.weight or raise the prestress" if problem.membrane.floating else "raise the prestress"
        raise EquilibriumError(f"the membrane finds no rest under the supports that were kept: {advice}")
    begin = method.state(rested)
    if begin.residual <= NEAR:
        begin = method.state(begin.shape, begin.residual)
    return iterate(method, begin, LIMIT, progress).state.shape
