"""Few groups of a small quadratic: reweighted least squares (IRLS), its smoothing continued to zero, groups dropped by a bound.

    min over s   s^T G s + 2 b^T s + sum_g c_g phi(|s_g|),     G (ck, ck) positive semidefinite, c components a group, k small

each s_g within what a support can do, where that is not anything.

Each reweighting replaces phi(|s|) by the parabola in |s| that touches it from above (sparsity/surrogates.py), so it is one linear
system, and the value falls. The problem has many local minima; large smoothing first, when all groups look alike, leads to good
ones (MATHEMATICS.md, "Search").
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from relax.arrays import Floats, Ints, Mask
from relax.convex.fit import fit_within, solve_definite
from relax.sparsity.penalties import Penalty
from relax.sparsity.reach import ANYTHING, Reach
from relax.sparsity.resultants import Resultants
from relax.sparsity.supports import sizes
from relax.sparsity.surrogates import REWEIGHTED_L2, Continuation

GONE = 1e-3  # of the largest amplitude: a group that the reweighting has emptied
RIDGE = 1e-2  # of the mean curvature: what the first amplitudes are damped by, where none are given
DECIDED = 1 / 6  # of the largest amplitude: while the smoothing is wider, less than that share of it still counts as something
UNDECIDED = 0.05  # of the largest amplitude: while the smoothing is wider, a support that its reach holds at zero may come back
ALONE = 1e-9  # of the largest: a group that cannot move while the others keep the balance moves this little, by round-off
ROUND_OFF = 1e-12  # of the mean curvature: what a matrix that is singular up to round-off is lifted by
STILL = 1e-3  # relative change of every amplitude that a further reweighting is not worth
SETTLING = 8  # reweightings on a support that was chosen; what digits they leave open Newton finds later

GRADUAL = Continuation()


@dataclass(frozen=True)
class Reweighted:
    """The small problem.

    Parameters
    ----------
    quadratic : (ck, ck)
        G, square metres per square newton.
    linear : (k, c)
        b.
    penalty : Penalty
    costs : (k,)
        c_g, the weight of phi for each group; one with 0 stands whatever comes.
    reach : Reach
        Of every group.
    resultants : Resultants or None
        What the groups of parts without a fixed vertex must add up to.
    """

    quadratic: Floats
    linear: Floats
    penalty: Penalty
    costs: Floats
    reach: Reach = ANYTHING
    resultants: Resultants | None = None

    def value(self, amplitudes: Floats) -> float:
        """The problem's value at amplitudes (k, c); infinite where they do not add up."""
        if self.resultants is not None and not self.resultants.met(amplitudes):
            return np.inf
        flat = amplitudes.ravel()
        smooth = flat @ (self.quadratic @ flat) + 2 * float(np.vdot(self.linear, amplitudes))
        return float(smooth + self.costs @ self.penalty.value(sizes(amplitudes)))

    def continued(self, continuation: Continuation = GRADUAL) -> Floats:
        """Amplitudes (k, c) from the damped least-squares fit, where nothing is few, the smoothing shrinking from its size on."""
        members = np.arange(len(self.costs))
        if not len(members):
            return np.zeros_like(self.linear)
        damping = RIDGE * np.trace(self.quadratic) / len(self.quadratic)
        s = self._fit(members, np.full(len(members), damping))
        largest = float(sizes(s).max(initial=0.0))
        if largest == 0:
            return self._whole(members, s)
        for width in continuation.smoothings(largest):
            s = self._fit(members, self._parabola(members, sizes(s), width), s)
            size = sizes(s)
            # a group far below the smoothing is on its way to nothing; early on nothing is decided
            stays = self._stays(members, size > GONE * size.max(initial=0.0) * min(1.0, DECIDED * largest / width))
            if self.reach.constrained and width > UNDECIDED * largest:
                continue
            members, s = members[stays], s[stays]
        return self.settled(self._whole(members, s))

    def once(self, amplitudes: Floats) -> Floats:
        """One reweighting on the groups that stand in amplitudes (k, c): the lowest point of the parabolas that touch there."""
        members, s = self._standing(amplitudes)
        return self._whole(members, self._fit(members, self._parabola(members, sizes(s)), s))

    def settled(self, amplitudes: Floats) -> Floats:
        """The minimum near amplitudes (k, c) on the groups that stand there; groups that come to nothing leave."""
        members, s = self._standing(amplitudes)
        size = sizes(s)
        for _ in range(SETTLING):
            before = size
            s = self._fit(members, self._parabola(members, before), s)
            size = sizes(s)
            if (np.abs(size - before) <= STILL * before).all():
                break
            stays = self._stays(members, size > max(GONE * size.max(initial=0.0), self.penalty.resolution))
            members, s, size = members[stays], s[stays], size[stays]
        else:  # the last ones to leave took their share of the balance with them
            if self.resultants is not None:
                s = self._fit(members, self._parabola(members, size), s)
        return self._whole(members, s)

    def pruned(self, amplitudes: Floats) -> Floats:
        """Amplitudes (k, c) without the groups that do not earn their cost.

        With all the others free to move, leaving out group g raises the touching parabolas from their minimum v by
        v_g^T ([A^-1]_gg)^-1 v_g, A their matrix, and saves phi(t) - t phi'(t) / 2, what the parabola counts for it at zero:
        where that is more, the value falls for certain. Where their reach holds the others back it may not: then it is looked at.
        """
        s = self.settled(amplitudes)
        while True:
            members, standing = self._standing(s)
            priced = np.flatnonzero(self.costs[members] > 0)
            if not priced.size:
                return s
            inverse = self._inverse(members, self._parabola(members, sizes(s[members])))
            width = s.shape[1]
            if self.resultants is not None:
                lowest = self.resultants.of(members).fitted_by(inverse, self.linear[members])
                inverse = self.resultants.of(members).constrained(inverse)
            else:
                lowest = standing if self.reach.constrained else -(inverse @ self.linear[members].ravel()).reshape(-1, width)
            lowest = lowest[priced]
            own = inverse.reshape(len(members), width, len(members), width)[priced, :, priced]
            raised = _raised(own, lowest)
            size = sizes(standing[priced])
            saved = self.costs[members[priced]] * self.penalty.value(size) - self._parabola(members[priced], size) * size**2
            worst = int(np.argmin(raised - saved))
            if raised[worst] >= saved[worst]:
                return s
            fewer = s.copy()
            fewer[members[priced[worst]]] = 0.0
            fewer = self.settled(fewer)
            if self.reach.constrained and self.value(fewer) >= self.value(s):
                return s
            s = fewer

    def _standing(self, amplitudes: Floats) -> tuple[Ints, Floats]:
        """Groups that carry a force or have no price, and their amplitudes."""
        members = np.flatnonzero(self._stays(np.arange(len(self.costs)), sizes(amplitudes) > 0))
        return members, amplitudes[members]

    def _stays(self, members: Ints, chosen: Mask) -> Mask:
        stays: Mask = chosen | (self.costs[members] == 0)
        return stays

    def _parabola(self, members: Ints, size: Floats, smoothing: float = 0.0) -> Floats:
        """Coefficient of |s_g|^2 in the parabola that touches the smoothed penalty at `size`."""
        return self.costs[members] * REWEIGHTED_L2.coefficient(self.penalty, size, smoothing)

    def _index(self, members: Ints) -> Ints:
        width = self.linear.shape[1]
        index: Ints = (width * members[:, None] + np.arange(width)).ravel()
        return index

    def _matrix(self, members: Ints, curvature: Floats) -> Floats:
        if len(members) == len(self.costs):
            matrix = self.quadratic.copy()
        else:
            index = self._index(members)
            matrix = self.quadratic.take(index, axis=0).take(index, axis=1)
        np.einsum("ii->i", matrix)[:] += np.repeat(curvature, self.linear.shape[1])  # a view of the diagonal
        return matrix

    def _fit(self, members: Ints, curvature: Floats, start: Floats | None = None) -> Floats:
        """Minimiser (len(members), c) of the quadratic with curvature_g |s_g|^2 added; `start`: near it, perhaps."""
        matrix, linear = self._matrix(members, curvature), self.linear[members]
        if self.reach.constrained:
            return fit_within(self.reach, matrix, linear, start)
        if self.resultants is not None:
            conditions = self.resultants.of(members)
            both = solve_definite(matrix, np.column_stack([-linear.ravel(), conditions.matrix.T]))
            return conditions.fitted(both[:, 0].reshape(linear.shape), both[:, 1:])
        return solve_definite(matrix, -linear.ravel()).reshape(linear.shape)

    def _inverse(self, members: Ints, curvature: Floats) -> Floats:
        matrix = self._matrix(members, curvature)
        factor, failed = dpotrf(matrix)
        if failed:  # columns that are parallel up to round-off, under a penalty that no longer bends
            matrix[np.diag_indices_from(matrix)] += ROUND_OFF * max(np.trace(matrix) / len(matrix), np.finfo(float).tiny)
            factor, failed = dpotrf(matrix)
        if failed:
            return np.eye(len(matrix)) / np.diag(matrix)
        upper, _ = dpotri(factor)
        inverse: Floats = np.triu(upper) + np.triu(upper, 1).T
        return inverse

    def _whole(self, members: Ints, s: Floats) -> Floats:
        amplitudes = np.zeros_like(self.linear)
        amplitudes[members] = s
        return amplitudes


def _raised(own: Floats, lowest: Floats) -> Floats:
    """v_g^T B_g^-1 v_g of blocks B (k, c, c) and vectors v (k, c); infinite where a group cannot be moved by itself."""
    least = np.linalg.eigvalsh(own)[:, 0]
    moves = least > ALONE * np.abs(own).max(initial=0.0)
    raised = np.full(len(own), np.inf)
    raised[moves] = np.einsum("gi,gi->g", lowest[moves], np.linalg.solve(own[moves], lowest[moves][:, :, None])[:, :, 0])
    return raised
