"""The convex step on few groups, solved to the last digit: Newton on the groups that stand, zeros by their certificate.

    min over s   s^T G s + 2 b^T s + sum_g w_g |s_g|     s.t.   s_g in C,   |s_g| <= F,        G (ck, ck) positive semidefinite

Here is what serves where a support can do anything and none is free of cost; the rest is in semismooth.py.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csc_array, csr_array, eye_array

from relax.arrays import Floats
from relax.convex.semismooth import ACCURACY, SAME, proximal
from relax.errors import BackendError
from relax.iterate import Stop, iterate
from relax.sparsity.reach import ANYTHING, Reach

ENOUGH = 1e-9  # where round-off ends on neighbouring candidates, whose columns are nearly parallel
WARM = 12  # Newton steps that a good start needs at most; more means a hard step
LIMIT = 60


@dataclass(frozen=True)
class _State:
    amplitudes: Floats  # (k, c)
    gradient: Floats  # (k, c) of the quadratic
    value: float
    residual: float
    stuck: bool = False


@dataclass(frozen=True)
class _Restricted:
    quadratic: Floats
    linear: Floats
    weights: Floats

    def state(self, amplitudes: Floats) -> _State:
        flat = amplitudes.ravel()
        product = self.quadratic @ flat
        gradient = 2 * (product + self.linear).reshape(amplitudes.shape)
        size = np.linalg.norm(amplitudes, axis=1)
        value = float(flat @ product + 2 * self.linear @ flat + self.weights @ size)
        stands = size > 0
        residual = np.linalg.norm(gradient, axis=1) - self.weights  # of the zeros: how far outside the ball
        direction = amplitudes[stands] / size[stands, None]
        residual[stands] = np.linalg.norm(gradient[stands] + self.weights[stands, None] * direction, axis=1)
        return _State(amplitudes, gradient, value, float((residual / self.weights).max(initial=0.0)))

    def step(self, state: _State) -> _State:
        size = np.linalg.norm(state.amplitudes, axis=1)
        stands = np.flatnonzero(size > 0)
        moved = self._newton(state, stands) if stands.size else None
        if moved is None or moved.residual > 0.1 * state.residual:
            raised = self._raise(moved or state)
            moved = raised if raised is not None else moved
        return moved if moved is not None else replace(state, stuck=True)

    def _newton(self, state: _State, stands: np.ndarray) -> _State | None:
        """A Newton step on the standing groups; those that it would turn round are set to zero where that pays."""
        s = state.amplitudes[stands]
        size = np.linalg.norm(s, axis=1)
        unit = s / size[:, None]
        width = s.shape[1]
        index = (width * stands[:, None] + np.arange(width)).ravel()
        hessian = 2 * self.quadratic[np.ix_(index, index)]
        curved = (self.weights[stands] / size)[:, None, None] * (np.eye(width) - unit[:, :, None] * unit[:, None, :])
        for group, block in enumerate(curved):
            own = slice(width * group, width * group + width)
            hessian[own, own] += block
        slope = state.gradient[stands] + self.weights[stands, None] * unit
        hessian[np.diag_indices_from(hessian)] *= 1 + 1e-14
        try:
            delta = -cho_solve(cho_factor(hessian), slope.ravel()).reshape(-1, width)
        except LinAlgError:
            delta = -np.linalg.lstsq(hessian, slope.ravel(), rcond=1e-14)[0].reshape(-1, width)
        descent = float(np.vdot(slope, delta))
        turned = np.einsum("ij,ij->i", unit, s + delta) <= 0
        length = 1.0
        for _ in range(30):
            for cut in (True, False) if turned.any() else (False,):
                trial = state.amplitudes.copy()
                trial[stands] += length * delta
                if cut:
                    trial[stands[turned]] = 0.0
                moved = self.state(trial)
                better = moved.value < state.value + 1e-4 * length * descent * (not cut)
                if better or (moved.residual < 0.5 * state.residual and moved.value <= state.value + 1e-14 * abs(state.value)):
                    return moved
            length *= 0.5
        return None

    def _raise(self, state: _State) -> _State | None:
        """Let the zeros whose gradient leaves the ball stand, each by a step that its own curvature allows."""
        size = np.linalg.norm(state.gradient, axis=1)
        enter = ~state.amplitudes.any(axis=1) & (size > self.weights * (1 + ACCURACY))
        if not enter.any():
            return None
        diagonal = np.diag(self.quadratic).reshape(len(enter), -1).sum(axis=1)[enter]  # trace bounds the largest eigenvalue
        away = state.gradient[enter] / size[enter, None]
        raised = -away * ((size[enter] - self.weights[enter]) / (2 * diagonal))[:, None]
        length = 1.0
        for _ in range(40):
            trial = state.amplitudes.copy()
            trial[enter] = length * raised
            moved = self.state(trial)
            if moved.value < state.value:
                return moved
            length *= 0.5
        return None

    def done(self, state: _State) -> Stop | None:
        if state.residual <= ACCURACY:
            return Stop.CONVERGED
        return Stop.STALLED if state.stuck else None

    def record(self, state: _State) -> dict[str, float]:
        return {"residual": state.residual}


def solve_restricted(quadratic: Floats, linear: Floats, weights: Floats, start: Floats, reach: Reach = ANYTHING) -> Floats:
    """Amplitudes (k, c) of the restricted step from `start` (k, c), exact zeros included.

    Newton alone where the start is near; else a small dense cone program says which groups stand and Newton finishes on
    those. What is not certified (by `certify`, on the whole step) goes back to the caller's loop.
    """
    free = not reach.constrained and bool((weights > 0).all())
    problem: Any = _Restricted(quadratic, linear, weights) if free else proximal(quadratic, linear, weights, reach)
    near = problem.state(reach.project(start))
    near = iterate(problem, near, WARM).state if start.any() else near
    if near.residual <= ENOUGH:
        return near.amplitudes
    rough = problem.state(reach.project(_small_cone_program(quadratic, linear, weights, near.amplitudes, reach)))
    stands = reach.pull(rough.gradient) >= (1 - 1e-4) * weights
    fine = iterate(problem, problem.state(np.where(stands[:, None], rough.amplitudes, 0.0)), LIMIT).state
    least = min(near.value, rough.value, fine.value)
    level = least + SAME * abs(least)
    return min((state for state in (near, rough, fine) if state.value <= level), key=lambda state: state.residual).amplitudes


def _small_cone_program(quadratic: Floats, linear: Floats, weights: Floats, otherwise: Floats, reach: Reach) -> Floats:
    """The restricted step by Clarabel, in units of its own; `otherwise` where that gives nothing."""
    from relax.convex.cone import ConeProgram, clarabel_settings  # what finds its start near need not load it

    count = len(quadratic)
    unit = float(np.trace(quadratic)) / count
    size = float(np.abs(linear).max()) / unit  # amplitudes of order one
    inner = replace(reach, largest=reach.largest / size)
    upper = csc_array(np.triu(quadratic / unit))
    program = ConeProgram(
        upper, linear / (unit * size), csr_array(eye_array(count)), np.zeros(count), weights / (unit * size), inner
    )
    try:
        return size * program.solve(clarabel_settings(1e-11)).reshape(otherwise.shape)
    except BackendError:
        return otherwise
