"""Few groups of a small quadratic: reweighted least squares (IRLS), its smoothing continued to zero, groups dropped by a bound.

    min over s   s^T G s + 2 b^T s + sum_g c_g phi(|s_g|),     G (ck, ck) positive semidefinite, c components a group, k small

Each reweighting replaces phi(|s|) by the parabola in |s| that touches it from above (phi(sqrt u) is concave in u), so it is one
linear system, and the value falls. The problem has many local minima; large smoothing first, when all groups look alike, leads
to good ones (MATHEMATICS.md, "Search").
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri

from relax.arrays import Floats, Ints
from relax.sparsity.penalties import Penalty
from relax.sparsity.supports import sizes

SHRINK = 0.6  # the smoothing from one reweighting to the next
LEAST = 2e-4  # of the largest amplitude: where smoothing ends
GONE = 1e-3  # of the largest amplitude: a group that the reweighting has emptied
RIDGE = 1e-2  # of the mean curvature: what the first amplitudes are damped by, where none are given
STILL = 1e-3  # relative change of every amplitude that a further reweighting is not worth
SETTLING = 8  # reweightings on a support that was chosen; what digits they leave open Newton finds later


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
        c_g, the weight of phi for each group.
    """

    quadratic: Floats
    linear: Floats
    penalty: Penalty
    costs: Floats

    def value(self, amplitudes: Floats) -> float:
        """The problem's value at amplitudes (k, c)."""
        flat = amplitudes.ravel()
        smooth = flat @ (self.quadratic @ flat) + 2 * float(np.vdot(self.linear, amplitudes))
        return float(smooth + self.costs @ self.penalty.value(sizes(amplitudes)))

    def continued(self) -> Floats:
        """Amplitudes (k, c) from the damped least-squares fit, where nothing is few, the smoothing shrinking from its size on."""
        members = np.arange(len(self.costs))
        if not len(members):
            return np.zeros_like(self.linear)
        damping = RIDGE * np.trace(self.quadratic) / len(self.quadratic)
        s = self._fit(members, np.full(len(members), damping))
        largest = float(sizes(s).max(initial=0.0))
        width = largest
        while width > LEAST * largest:
            s = self._fit(members, self._parabola(members, np.hypot(sizes(s), width)))
            size = sizes(s)
            width *= SHRINK
            # a group far below the smoothing is on its way to nothing; early on nothing is decided
            stays = size > GONE * size.max(initial=0.0) * min(1.0, 0.1 * largest / width)
            members, s = members[stays], s[stays]
        return self.settled(self._whole(members, s))

    def once(self, amplitudes: Floats) -> Floats:
        """One reweighting on the groups that stand in amplitudes (k, c): the lowest point of the parabolas that touch there."""
        members = np.flatnonzero(sizes(amplitudes) > 0)
        return self._whole(members, self._fit(members, self._parabola(members, sizes(amplitudes[members]))))

    def settled(self, amplitudes: Floats) -> Floats:
        """The minimum near amplitudes (k, c) on the groups that stand there; groups that come to nothing leave."""
        members = np.flatnonzero(sizes(amplitudes) > 0)
        s = amplitudes[members]
        size = sizes(s)
        for _ in range(SETTLING):
            before = size
            s = self._fit(members, self._parabola(members, before))
            size = sizes(s)
            if (np.abs(size - before) <= STILL * before).all():
                break
            stays = size > max(GONE * size.max(initial=0.0), self.penalty.resolution)
            members, s, size = members[stays], s[stays], size[stays]
        return self._whole(members, s)

    def pruned(self, amplitudes: Floats) -> Floats:
        """Amplitudes (k, c) without the groups that do not earn their cost.

        With all the others free to move, leaving out group g raises the touching parabolas from their minimum v by
        v_g^T ([A^-1]_gg)^-1 v_g, A their matrix, and saves phi(t) - t phi'(t) / 2, what the parabola counts for it at zero:
        where that is more, the value falls for certain.
        """
        s = self.settled(amplitudes)
        while True:
            members = np.flatnonzero(sizes(s) > 0)
            if not len(members):
                return s
            inverse = self._inverse(members, self._parabola(members, sizes(s[members])))
            width = s.shape[1]
            own = inverse.reshape(len(members), width, len(members), width)[np.arange(len(members)), :, np.arange(len(members))]
            lowest = -(inverse @ self.linear[members].ravel()).reshape(-1, width)
            raised = np.einsum("gi,gi->g", lowest, np.linalg.solve(own, lowest[:, :, None])[:, :, 0])
            size = sizes(s[members])
            saved = self.costs[members] * (self.penalty.value(size) - 0.5 * size * self.penalty.slope(size))
            worst = int(np.argmin(raised - saved))
            if raised[worst] >= saved[worst]:
                return s
            s = s.copy()
            s[members[worst]] = 0.0
            s = self.settled(s)

    def _parabola(self, members: Ints, size: Floats) -> Floats:
        """Coefficient of |s_g|^2 in the parabola that touches the penalty at `size`."""
        return self.costs[members] * self.penalty.slope(size) / (2 * size)

    def _index(self, members: Ints) -> Ints:
        width = self.linear.shape[1]
        index: Ints = (width * members[:, None] + np.arange(width)).ravel()
        return index

    def _matrix(self, members: Ints, curvature: Floats) -> Floats:
        index = self._index(members)
        matrix = self.quadratic[np.ix_(index, index)]
        matrix[np.diag_indices_from(matrix)] += np.repeat(curvature, self.linear.shape[1])
        return matrix

    def _fit(self, members: Ints, curvature: Floats) -> Floats:
        """Minimiser (len(members), c) of the quadratic with curvature_g |s_g|^2 added."""
        if not len(members):
            return np.zeros((0, self.linear.shape[1]))
        right = -self.linear[members].ravel()
        _, found, failed = dposv(self._matrix(members, curvature), right)
        if failed:  # columns that are parallel up to round-off
            found = np.linalg.lstsq(self._matrix(members, curvature), right, rcond=1e-14)[0]
        return found.reshape(len(members), -1)

    def _inverse(self, members: Ints, curvature: Floats) -> Floats:
        factor, failed = dpotrf(self._matrix(members, curvature))
        if failed:
            return np.asarray(np.linalg.pinv(self._matrix(members, curvature), rcond=1e-15, hermitian=True), dtype=float)
        upper, _ = dpotri(factor)
        inverse: Floats = np.triu(upper) + np.triu(upper, 1).T
        return inverse

    def _whole(self, members: Ints, s: Floats) -> Floats:
        amplitudes = np.zeros_like(self.linear)
        amplitudes[members] = s
        return amplitudes
