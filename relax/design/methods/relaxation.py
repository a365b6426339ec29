"""Lower bounds of the problem of a linear membrane: a cut from every point, and Newton for the best of them.

With E_dist = s^T G s + 2 b^T s + e and G = Q + diag(D), both positive semidefinite, every point z gives (MATHEMATICS.md, "Other
methods")

    E_dist + R >= e - z^T Q z + sum_g min over t of [D_g t^2 + R_g(t) - |lam_g| t],     lam = -2 (Q z + b),

in which the minima are over t alone: one number for each segment in which |s_g| may lie (the perspective of the quadratic's
own share D, and the conjugate of the penalty).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Mask
from relax.design.methods.pieces import Pieces, pieces_of
from relax.design.methods.quadratic import Quadratic
from relax.design.problem import Problem
from relax.sparsity.reach import Reach
from relax.sparsity.supports import sizes

ROUGH = (1e-2, 1e-3)  # smoothings of the minimum over segments, as shares of the value to beat: at a node that is to be cut off
FINE = (1e-2, 1e-3, 1e-4, 1e-5)  # and where every digit counts
EXACT = 1e-9  # of the penalty: round-off
NEWTON = 12  # steps at each: those seen to converge took 2 to 6
HALVINGS = 12
STILL = 0.01  # of the smoothing: a gain of the bound that is not worth another step


@dataclass(frozen=True)
class Cut:
    """A lower bound of the objective that is linear in the choice of segments: constant + sum over groups of values_gj."""

    constant: float
    values: Floats  # (m, J)

    def bound(self, allowed: Mask) -> float:
        """The bound over every choice of allowed segments (m, J)."""
        return self.constant + float(np.where(allowed, self.values, np.inf).min(axis=1).sum())


@dataclass(frozen=True)
class Relaxation:
    """Lower bounds of E_dist + R over all points whose value is at most `value`.

    Parameters
    ----------
    quadratic : Quadratic
    pieces : Pieces
        Of the penalty, up to the largest of `caps`.
    caps : (m,) newtons
        Sizes that no force of such a point exceeds.
    exact : bool
        Whether the pieces are the penalty itself.
    """

    quadratic: Quadratic
    pieces: Pieces
    caps: Floats
    exact: bool

    @cached_property
    def chosen(self) -> Mask:
        """Groups (m,) that stand by choice; the others cost nothing and lie in no segment."""
        return self.quadratic.costs > 0

    @cached_property
    def everywhere(self) -> Mask:
        """Segments (m, J) that a group can reach at all."""
        return (self.pieces.low <= self.caps[:, None]) & self.chosen[:, None] | (~self.chosen[:, None] & self._origin)

    @property
    def _origin(self) -> Mask:
        return np.arange(len(self.pieces)) == 0

    @cached_property
    def _rest(self) -> Floats:
        """Q = G - diag(D)."""
        return self.quadratic.gram - np.diag(np.repeat(self.quadratic.split, self.quadratic.linear.shape[1]))

    def _lowest(self, pull: Floats) -> tuple[Floats, Floats, Floats]:
        """Value, size and its rate in each segment (m, J); a group that stands whatever comes is free, and told by the first."""
        quadratic = self.quadratic
        value, size, rate = self.pieces.lowest(pull, quadratic.split, quadratic.costs, self.caps)
        if not self.chosen.all():
            always = ~self.chosen
            wanted = pull / (2 * quadratic.split)
            free = np.minimum(wanted, self.caps)
            value[always, 0] = (free * (quadratic.split * free - pull))[always]
            size[always, 0], rate[always, 0] = free[always], ((free == wanted) / (2 * quadratic.split))[always]
        return value, size, rate

    def _pull(self, turned: Floats) -> Floats:
        """P_C(lam_g) (m, c) with lam = -2 (Q z + b), `turned` = Q z: no force in the cone C gains more than along it."""
        return self.quadratic.reach.cone(-2 * (turned + self.quadratic.linear))

    def forces(self, allowed: Mask, point: Floats) -> Floats:
        """The forces (m, c) within reach that attain the minima of the cut at a point: at the best cut, the relaxation's own."""
        pull = self._pull((self._rest @ point.ravel()).reshape(point.shape))
        length = sizes(pull)
        value, size, _ = self._lowest(length)
        best = np.where(allowed, value, np.inf).argmin(axis=1)
        wanted = size[np.arange(len(best)), best] / np.maximum(length, np.finfo(float).tiny)
        return self.quadratic.reach.project(wanted[:, None] * pull)

    def cut(self, point: Floats) -> Cut:
        """The cut at any point (m, c)."""
        turned = (self._rest @ point.ravel()).reshape(point.shape)
        values, _, _ = self._lowest(sizes(self._pull(turned)))
        return Cut(self.quadratic.constant - float(np.vdot(point, turned)), values)

    def tightest(self, allowed: Mask, start: Floats, unit: float, smoothings: tuple[float, ...] = FINE) -> tuple[Cut, Floats]:
        """The best cut over the allowed segments that Newton from `start` finds, and its point (m, c).

        The bound is concave in the point, with kinks where two segments are equally low: so their minimum is smoothed,
        -T log sum exp(-value / T), T falling through `smoothings`, shares of `unit`, the value to beat. A cut is exact anywhere.
        """
        point = at = start
        best = self.cut(start)
        reached = best.bound(allowed)
        for share in smoothings:
            point = self._climbed(allowed, point, share * unit)
            cut = self.cut(point)
            bound = cut.bound(allowed)
            if bound > reached:
                best, at, reached = cut, point, bound
        return best, at

    def _climbed(self, allowed: Mask, point: Floats, smoothing: float) -> Floats:
        """Newton with a line search on the smoothed bound."""
        value, step, gain = self._newton(allowed, point, smoothing)
        for _ in range(NEWTON):
            if gain <= STILL * smoothing:
                break
            share = 1.0
            for _ in range(HALVINGS):
                moved = point + share * step
                after, next_step, next_gain = self._newton(allowed, moved, smoothing)
                if after >= value + 0.1 * share * gain:
                    break
                share *= 0.4
            else:
                break
            point, value, step, gain = moved, after, next_step, next_gain
        return point

    def _newton(self, allowed: Mask, point: Floats, smoothing: float) -> tuple[float, Floats, float]:
        """The smoothed bound at a point, Newton's step there (m, c), and what it promises."""
        quadratic = self.quadratic
        turned = (self._rest @ point.ravel()).reshape(point.shape)
        along_dual = self._pull(turned)
        pull = sizes(along_dual)
        value, size, rate = self._lowest(pull)
        value = np.where(allowed, value, np.inf)
        least = value.min(axis=1, keepdims=True)
        share = np.exp((least - value) / smoothing)
        total = share.sum(axis=1, keepdims=True)
        share /= total
        mean = (share * size).sum(axis=1)
        spread = (share * np.square(size - mean[:, None])).sum(axis=1)
        bound = quadratic.constant - float(np.vdot(point, turned)) + float((least - smoothing * np.log(total)).sum())
        # the forces that attain the minimum, mean * unit, and how they turn with the dual
        length = np.maximum(pull, np.finfo(float).tiny)
        unit = along_dual / length[:, None]
        along, across = (share * rate).sum(axis=1) + spread / smoothing, mean / length
        rows = self._rest.reshape(*point.shape, -1)
        if quadratic.reach.tangent is not None:
            # a cone only: the largest force is a cap on the sizes
            rows = Reach(quadratic.reach.axes, quadratic.reach.tangent).slope(-2 * (turned + quadratic.linear)) @ rows
        turn = across[:, None, None] * rows
        turn += ((along - across)[:, None] * unit)[:, :, None] * np.einsum("gi,gij->gj", unit, rows)[:, None, :]
        missed = mean[:, None] * unit - point
        matrix = 2 * turn.reshape(point.size, -1)
        matrix[np.diag_indices_from(matrix)] += 1.0
        step = np.linalg.solve(matrix, missed.ravel()).reshape(point.shape)
        return bound, step, float(2 * missed.ravel() @ (self._rest @ step.ravel()))


def relaxation_of(problem: Problem, quadratic: Quadratic, value: float) -> Relaxation:
    """The relaxation for points at least as good as `value`."""
    caps = quadratic.caps(value)
    chosen = quadratic.costs > 0
    caps = np.where(chosen, np.minimum(caps, _affordable(problem, quadratic, value)), caps)
    bend = float((2 * quadratic.bends[chosen] / quadratic.costs[chosen]).max(initial=0.0))
    pieces = pieces_of(problem.penalty, float(caps[chosen].max(initial=1.0)), bend, quadratic.reach.largest)
    return Relaxation(quadratic, pieces, caps, pieces.missed(problem.penalty) <= EXACT)


def _affordable(problem: Problem, quadratic: Quadratic, value: float) -> Floats:
    """Sizes (m,) beyond which a support alone costs more than value - least, for phi never falls."""
    left = max(value - quadratic.least, 0.0)
    caps = quadratic.caps(value)
    low, high = np.zeros_like(caps), caps.copy()
    fits = quadratic.costs * problem.penalty.value(high) <= left
    for _ in range(60):
        middle = 0.5 * (low + high)
        over = quadratic.costs * problem.penalty.value(middle) > left
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return np.where(fits, caps, high)
