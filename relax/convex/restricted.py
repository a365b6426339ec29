"""The convex step on few groups, solved to the last digit: Newton on the groups that stand, zeros by their certificate.

min over s   s^T G s + 2 b^T s + sum_g w_g |s_g|,     G (3k, 3k) positive semidefinite, k small
"""

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import block_diag, coo_array, csc_array, csc_matrix

from relax.arrays import Floats
from relax.iterate import Stop, iterate

ACCURACY = 1e-12  # gradient relative to the weights
ENOUGH = 1e-9  # where round-off ends on neighbouring candidates, whose columns are nearly parallel
SAME = 1e-13  # relative difference of values that is round-off
WARM = 12  # Newton steps that a good start needs at most; more means a hard step
LIMIT = 60


@dataclass(frozen=True)
class _State:
    amplitudes: Floats  # (k, 3)
    gradient: Floats  # (k, 3) of the quadratic
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
        gradient = 2 * (product + self.linear).reshape(-1, 3)
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
        index = (3 * stands[:, None] + np.arange(3)).ravel()
        hessian = 2 * self.quadratic[np.ix_(index, index)]
        curved = (self.weights[stands] / size)[:, None, None] * (np.eye(3) - unit[:, :, None] * unit[:, None, :])
        for group, block in enumerate(curved):
            hessian[3 * group : 3 * group + 3, 3 * group : 3 * group + 3] += block
        slope = state.gradient[stands] + self.weights[stands, None] * unit
        hessian[np.diag_indices_from(hessian)] *= 1 + 1e-14
        try:
            delta = -cho_solve(cho_factor(hessian), slope.ravel()).reshape(-1, 3)
        except LinAlgError:
            delta = -np.linalg.lstsq(hessian, slope.ravel(), rcond=1e-14)[0].reshape(-1, 3)
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
        diagonal = np.diag(self.quadratic).reshape(-1, 3).sum(axis=1)[enter]  # trace bounds the largest eigenvalue
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


def solve_restricted(quadratic: Floats, linear: Floats, weights: Floats, start: Floats) -> Floats:
    """Amplitudes (k, 3) of the restricted step from `start` (k, 3), exact zeros included.

    Newton alone where the start is near; else a small dense cone program says which groups stand and Newton finishes on
    those. What is not certified (by `certify`, on the whole step) goes back to the caller's loop.
    """
    problem = _Restricted(quadratic, linear, weights)
    near = iterate(problem, problem.state(start), WARM).state if start.any() else problem.state(start)
    if near.residual <= ENOUGH:
        return near.amplitudes
    rough = problem.state(_small_cone_program(quadratic, linear, weights))
    stands = np.linalg.norm(rough.gradient, axis=1) >= (1 - 1e-4) * weights
    fine = iterate(problem, problem.state(np.where(stands[:, None], rough.amplitudes, 0.0)), LIMIT).state
    least = min(near.value, rough.value, fine.value)
    level = least + SAME * abs(least)
    return min((state for state in (near, rough, fine) if state.value <= level), key=lambda state: state.residual).amplitudes


def _small_cone_program(quadratic: Floats, linear: Floats, weights: Floats) -> Floats:
    """The restricted step by Clarabel: s and one bound t_g >= |s_g| a group."""
    groups = len(weights)
    unit = float(np.trace(quadratic)) / len(quadratic)
    size = float(np.abs(linear).max()) / unit  # amplitudes of order one
    program = block_diag([csc_array(np.triu(2 * quadratic / unit)), csc_array((groups, groups))], format="csc")
    row = 4 * np.arange(groups)
    inside = (row[:, None] + np.arange(1, 4)).ravel()
    place = coo_array(
        (-np.ones(4 * groups), (np.concatenate([inside, row]), np.arange(4 * groups))), shape=(4 * groups, 4 * groups)
    )
    linear = np.concatenate([2 * linear / (unit * size), weights / (unit * size)])
    cones = [clarabel.SecondOrderConeT(4)] * groups
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    result = clarabel.DefaultSolver(csc_matrix(program), linear, csc_matrix(place), np.zeros(4 * groups), cones, settings).solve()
    return size * np.asarray(result.x)[: 3 * groups].reshape(-1, 3)
