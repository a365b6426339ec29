"""A convex quadratic over what supports can do: projected Newton steps on the pieces of their reach.

min over s   s^T A s + 2 b^T s,     s_g within reach, A (ck, ck) positive definite
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from relax.arrays import Floats
from relax.iterate import Stop, iterate
from relax.sparsity.faces import face_at
from relax.sparsity.reach import Reach

LIMIT = 40  # steps; those seen to converge took 3 to 12
ACCURACY = 1e-10  # of the largest amplitude: a step that no longer moves


@dataclass(frozen=True)
class _State:
    amplitudes: Floats  # (k, c)
    value: float
    moved: float = np.inf  # the largest change by the last step, relative


@dataclass(frozen=True)
class _Fit:
    reach: Reach
    matrix: Floats
    linear: Floats
    tau: Floats  # (k,) lengths of gradient steps that do not overshoot by themselves

    def state(self, amplitudes: Floats) -> _State:
        flat = amplitudes.ravel()
        return _State(amplitudes, float(flat @ (self.matrix @ flat) + 2 * np.vdot(self.linear, amplitudes)))

    def step(self, state: _State) -> _State:
        """A Newton step on the present piece, projected and shortened while the value rises; else a gradient step."""
        s = state.amplitudes
        gradient = 2 * ((self.matrix @ s.ravel()).reshape(s.shape) + self.linear)
        face = face_at(self.reach, s, gradient, self.tau)
        whole = 2 * self.matrix
        along = solve_definite(face.hessian(whole), -face.gradient(whole))
        delta = face.step(along).reshape(s.shape)
        trials = [s + length * delta for length in (1.0, 0.5, 0.1)]
        # A is at most its diagonal blocks times their number, so this one always descends
        trials.append(s - (self.tau / len(s))[:, None] * gradient)
        for trial in trials:
            moved = self.state(self.reach.project(trial))
            change = np.abs(moved.amplitudes - s).max(initial=0.0) / (np.abs(moved.amplitudes).max(initial=0.0) or 1.0)
            if moved.value < state.value or change <= ACCURACY:
                return _State(moved.amplitudes, min(moved.value, state.value), float(change))
        return _State(s, state.value, 0.0)

    def done(self, state: _State) -> Stop | None:
        return Stop.CONVERGED if state.moved <= ACCURACY else None

    def record(self, state: _State) -> dict[str, float]:
        return {"value": state.value}


def solve_definite(matrix: Floats, right: Floats) -> Floats:
    """A^-1 right, A positive definite, or the least-squares answer where its columns are parallel up to round-off."""
    if not len(right):
        return right
    _, found, failed = dposv(matrix, right)
    if failed:
        found = np.linalg.lstsq(matrix, right, rcond=1e-14)[0]
    answer: Floats = found
    return answer


def fit_within(reach: Reach, matrix: Floats, linear: Floats, start: Floats | None) -> Floats:
    """The minimiser (k, c) within `reach`, from `start` (k, c) or from the projection of the free minimiser.

    What the last digits are worth is for the caller to judge: steps end where none lowers the value.
    """
    count, width = linear.shape
    free = solve_definite(matrix, -linear.ravel()).reshape(linear.shape)
    inside = reach.project(free)
    if np.allclose(inside, free, rtol=1e-14, atol=0.0):
        return free
    blocks = np.trace(matrix.reshape(count, width, count, width).diagonal(axis1=0, axis2=2))
    problem = _Fit(reach, matrix, linear, 1 / (2 * np.maximum(blocks, np.finfo(float).tiny)))
    return iterate(problem, problem.state(inside if start is None else reach.project(start)), LIMIT).state.amplitudes
