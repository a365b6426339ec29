"""The convex step on few groups that cannot do everything: semismooth Newton on the fixed point of a proximal gradient step.

    min over s   s^T G s + 2 b^T s + sum_g w_g |s_g|     s.t.   s_g in C,   |s_g| <= F,        G (ck, ck) positive semidefinite

At a minimum F(s) = s - P(s - t gradient) is zero, P the prox of norm, cone and cap together, which has a formula (`Reach.prox`).
With D the derivative of P, Newton's (I - D + 2 t D G) delta = -F becomes symmetric and definite in the directions that D sees,
delta = D^(1/2) y, while the others go to where P puts them. A proximal step follows each Newton step: it makes zeros, edges and
caps exact, and where Newton is cut back to nothing it alone lowers the value (Patrinos, Stella and Bemporad,
"Forward-backward truncated Newton methods for convex composite optimization", 2014).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from relax.arrays import Floats
from relax.iterate import Stop
from relax.sparsity.reach import Reach
from relax.sparsity.supports import sizes

ACCURACY = 1e-12  # gradient relative to the weights
SAME = 1e-13  # relative difference of values that is round-off
HALVINGS = 30
UNSEEN = 1e-9  # eigenvalue of D below which a direction goes where P puts it
POWER = 8  # iterations that know the largest eigenvalue to some per cent, which is all that a step length needs


@dataclass(frozen=True)
class ProximalState:
    """Amplitudes, and how far they are from the fixed point."""

    amplitudes: Floats  # (k, c)
    gradient: Floats  # (k, c) of the quadratic
    value: float
    miss: Floats  # F (k, c)
    residual: float
    stuck: bool = False


@dataclass(frozen=True)
class Proximal:
    """The problem as an algorithm of `iterate`, made by `proximal`."""

    quadratic: Floats
    linear: Floats
    weights: Floats
    reach: Reach
    pace: float  # t: a step of the gradient that lowers the value
    scale: Floats  # (k,) what a gradient is compared with

    def state(self, amplitudes: Floats) -> ProximalState:
        gradient, smooth = self._slope(amplitudes)
        miss = amplitudes - self._forward(amplitudes, gradient)
        value = smooth + float(self.weights @ sizes(amplitudes))
        return ProximalState(amplitudes, gradient, value, miss, float((sizes(miss) / (self.pace * self.scale)).max(initial=0.0)))

    def _slope(self, amplitudes: Floats) -> tuple[Floats, float]:
        """Gradient and value of the quadratic."""
        flat = amplitudes.ravel()
        product = self.quadratic @ flat
        return 2 * (product + self.linear).reshape(amplitudes.shape), float(flat @ (product + 2 * self.linear))

    def _forward(self, amplitudes: Floats, gradient: Floats) -> Floats:
        """The proximal gradient step from amplitudes."""
        return self.reach.prox(amplitudes - self.pace * gradient, self.pace * self.weights)

    def step(self, state: ProximalState) -> ProximalState:
        """A Newton step and a proximal one, the first as long as the value falls, or the residual where it no longer can."""
        delta = self._newton(state)
        promised = float(np.vdot(state.miss, state.miss)) / self.pace
        noise = SAME * abs(state.value)
        for length in [*0.5 ** np.arange(HALVINGS), 0.0]:
            trial = state.amplitudes + length * delta
            moved = self.state(self._forward(trial, self._slope(trial)[0]))
            if moved.value < state.value - 1e-4 * promised:
                return moved
            if moved.residual < 0.5 * state.residual and moved.value <= state.value + noise:
                return moved
        return replace(state, stuck=True)

    def _newton(self, state: ProximalState) -> Floats:
        count, width = state.amplitudes.shape
        turn = self.reach.slope(state.amplitudes - self.pace * state.gradient, self.pace * self.weights)
        share, axes = np.linalg.eigh(turn)
        miss = np.einsum("gij,gi->gj", axes, state.miss)
        delta = -np.einsum("gij,gj->gi", axes, np.where(share > UNSEEN, 0.0, miss))
        members = np.flatnonzero(share[:, -1] > UNSEEN)  # ascending: the last is the largest
        if not members.size:
            return delta
        share = share[members].ravel()
        seen = np.flatnonzero(share > UNSEEN)
        share = share[seen]
        roots = axes[members]  # from here on along the axes of D
        blocks = roots.transpose(0, 2, 1) @ self.quadratic.reshape(count, width, count, width)[members][:, :, members].reshape(
            len(members), width, -1
        )
        whole = np.einsum("xhb,hbj->xhj", blocks.reshape(-1, len(members), width), roots).reshape(len(members) * width, -1)
        root = np.sqrt(share)
        matrix = 2 * self.pace * root[:, None] * whole[np.ix_(seen, seen)] * root
        matrix[np.diag_indices_from(matrix)] += 1 - share + 1e-15  # round-off: G itself may be singular
        pulled = np.einsum("gij,gi->gj", roots, (self.quadratic @ delta.ravel()).reshape(-1, width)[members]).ravel()[seen]
        right = -2 * self.pace * root * pulled - miss[members].ravel()[seen] / root
        found = np.zeros(len(members) * width)
        try:
            found[seen] = root * cho_solve(cho_factor(matrix), right)
        except LinAlgError:
            found[seen] = root * np.linalg.lstsq(matrix, right, rcond=1e-14)[0]
        delta[members] += np.einsum("gij,gj->gi", roots, found.reshape(-1, width))
        return delta

    def done(self, state: ProximalState) -> Stop | None:
        if state.residual <= ACCURACY:
            return Stop.CONVERGED
        return Stop.STALLED if state.stuck else None

    def record(self, state: ProximalState) -> dict[str, float]:
        return {"residual": state.residual}


def proximal(quadratic: Floats, linear: Floats, weights: Floats, reach: Reach) -> Proximal:
    """The problem with its step length, and what each gradient is compared with: the weight, or all that pulls without one."""
    vector, bend = np.ones(len(quadratic)), 0.0
    for _ in range(POWER):
        vector = quadratic @ vector
        bend = float(np.linalg.norm(vector))
        vector = vector / (bend or 1.0)
    bend = max(bend, float(np.diag(quadratic).max(initial=0.0)))
    most = max(float(weights.max(initial=0.0)), 2 * float(np.abs(linear).max(initial=0.0))) or 1.0
    return Proximal(quadratic, linear, weights, reach, 1 / (2 * bend) if bend else 1.0, np.where(weights > 0, weights, most))
