"""The convex step as data, and its certificate: what any back-end's answer is worth, computed from the data alone.

    min over d, s   (d + r)^T M (d + r) + sum_g w_g |s_g| + sum_g b_g |s_g|^2     s.t.   K d = h + B s,   s_g in C,   |s_g| <= F

K is the stiffness, h = f + g what is unbalanced without supports, r = x - xhat, B the supports' basis, c amplitudes a group;
C and F are what a support can do, mostly anything, and b is mostly 0 (MATHEMATICS.md, "One convex step"). Nothing here knows
of membranes.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.errors import BackendError, UnheldError
from relax.factor import Factor
from relax.sparsity.reach import ANYTHING, UPWARD, Reach
from relax.sparsity.resultants import Resultants
from relax.sparsity.supports import sizes

ROUND_OFF = 1e-12  # of the largest possible pull: what counts as none where any would void the bound
SINGULAR = 1e-14  # of the largest eigenvalue: directions that the metric does not see
NEARLY = 1 - 1e-3  # of the largest force: an interior point stops short of it; whichever side a group is on, the bound holds
HALVINGS = 60  # of an interval of order one, down to round-off


@dataclass(frozen=True)
class Subproblem:
    """Data of one convex step; vectors are flattened vertex-major.

    Parameters
    ----------
    factor : Factor
        Of the stiffness K (3n, 3n), newtons per metre.
    metric : (3n, 3n) sparse, positive semidefinite
    offset : (3n,) metres
        r.
    load : (3n,) newtons
        h.
    rows : (m, c) int
        Row of K that each amplitude acts on: B has ones there.
    weights : (m,)
        w, 0 or above: at 0 a support is free.
    reach : Reach
        C and F of every group; as many axes as `rows` has columns.
    curvature : (m,) or None
        b, 0 or above: with weights of 0 the step is one of reweighted least squares (IRLS); None: 0 everywhere.
    resultants : Resultants or None
        Where K d = 0 for translations of some parts: what s must add up to there, for K d = h + B s to have a solution. The
        factor then gives one of them, the best for the metric.
    """

    factor: Factor
    metric: csc_array
    offset: Floats
    load: Floats
    rows: Ints
    weights: Floats
    reach: Reach = ANYTHING
    curvature: Floats | None = None
    resultants: Resultants | None = None

    def __post_init__(self) -> None:
        lock_arrays(self)

    @property
    def stiffness(self) -> csc_array:
        return self.factor.matrix

    @property
    def nothing(self) -> Floats:
        """Amplitudes (m, c) of no support."""
        return np.zeros(self.rows.shape)

    @cached_property
    def bends(self) -> Floats:
        """The curvature (m,) as numbers."""
        return np.zeros(len(self.weights)) if self.curvature is None else self.curvature

    @cached_property
    def kept(self) -> Ints:
        """Groups that cost nothing and so always stand, (k,)."""
        return np.flatnonzero((self.weights == 0) & (self.bends == 0))

    @cached_property
    def kept_columns(self) -> "KeptColumns":
        columns = self.factor.inverse_columns(self.rows[self.kept].ravel())
        metric_columns = self.metric @ columns
        squares = columns.T @ metric_columns
        inverse = np.linalg.pinv(2 * squares, rcond=SINGULAR, hermitian=True)
        lengths = np.sqrt(np.maximum(np.diag(squares), 0.0).reshape(len(self.kept), -1).sum(axis=1))
        return KeptColumns(columns, metric_columns, inverse, lengths)

    @property
    def basis(self) -> csc_array:
        """B (3n, cm)."""
        rows = self.rows.ravel()
        return csc_array((np.ones(rows.size), (rows, np.arange(rows.size))), shape=(len(self.offset), rows.size))

    @cached_property
    def unsupported(self) -> Floats:
        """Where the linearised membrane lies without supports, relative to the target: c = r + K^-1 h (3n,)."""
        self._check()
        return self.offset + self.factor.solve(self.load)

    def _check(self) -> None:
        if self.factor.singular:
            raise BackendError(
                "the stiffness is singular at this shape (a mechanism or a slack region), so the displacement cannot be "
                "eliminated: raise the prestress"
            )

    def spread(self, amplitudes: Floats) -> Floats:
        """B s as nodal forces (3n,)."""
        nodal = np.zeros(len(self.offset))
        nodal[self.rows] = amplitudes
        return nodal

    def damped(self, damping: float) -> "Subproblem":
        """The same step with `damping` times the metric norm of the displacement d added (up to a constant)."""
        if damping == 0:
            return self
        return replace(self, metric=self.metric * (1 + damping), offset=self.offset / (1 + damping))

    def scaled(self) -> tuple["Subproblem", float]:
        """The step in units of its own (K and displacements of order one), and newtons per unit of amplitude."""
        spring = float(self.stiffness.diagonal().mean())
        length = float(np.abs(self.offset).max() + np.abs(self.load).max() / spring) or 1.0
        force = spring * length
        inner = Subproblem(
            Factor(csc_array(self.stiffness / spring)),
            self.metric,
            self.offset / length,
            self.load / force,
            self.rows,
            self.weights * (force / length**2),
            replace(self.reach, largest=self.reach.largest / force),
            None if self.curvature is None else self.curvature * (force / length) ** 2,
            None if self.resultants is None else replace(self.resultants, total=self.resultants.total / force),
        )
        return inner, force

    def components(self) -> "Subproblem":
        """The step with the sum of w_g |s_g|_1 in place of the norms: each component is a group of its own, amplitudes (cm, 1).

        Raises
        ------
        BackendError
            A cone or a largest force ties the components of a group to each other.
        """
        width = self.rows.shape[1]
        if width == 1:
            return self
        if self.reach.constrained:
            raise BackendError(
                "a largest lean or force ties the components of a support to each other, so the step cannot be taken component "
                "by component: drop it, or let the supports act along one axis"
            )
        curvature = None if self.curvature is None else np.repeat(self.curvature, width)
        single = Reach((UPWARD,))  # one axis, whichever it is
        return replace(
            self, rows=self.rows.reshape(-1, 1), weights=np.repeat(self.weights, width), reach=single, curvature=curvature
        )


@dataclass(frozen=True)
class KeptColumns:
    """What the groups that cost nothing can do: A = K^-1 B (3n, ck) on them, M A, and the inverse of 2 A^T M A."""

    columns: Floats
    metric_columns: Floats
    inverse: Floats
    lengths: Floats  # |A_g| in M, (k,)

    def largest_pull(self, distance: float) -> Floats:
        """What |lam_g| could be at most at this E_dist, by Cauchy and Schwarz (k,)."""
        return 2 * np.sqrt(max(distance, 0.0)) * self.lengths  # a metric blind to some of it: round-off may go below 0


@dataclass(frozen=True)
class Solution:
    """A point of the step with its certificate.

    Parameters
    ----------
    amplitudes : (m, c) newtons
    displacement : (3n,) metres
        d = K^-1 (h + B s).
    dual : (m, c)
        B^T lam, lam = 2 K^-1 M (d + r): minus it lies in the ball of radius w where nothing stands.
    value, bound : float
        Objective, and a lower bound of the optimum from the dual point nearest at hand.
    ran : str
        The back-ends that made it.
    looked : (k,) int or None
        Groups whose columns of K^-1 were made; None for all.
    """

    amplitudes: Floats
    displacement: Floats
    dual: Floats
    value: float
    bound: float
    ran: str = ""
    looked: Ints | None = None

    def __post_init__(self) -> None:
        lock_arrays(self)

    @property
    def gap(self) -> float:
        """Relative duality gap: how far the value can be from the optimum."""
        return (self.value - self.bound) / abs(self.value) if self.value else 0.0

    @property
    def standing(self) -> Mask:
        """Groups that carry a force (m,)."""
        return np.any(self.amplitudes != 0, axis=1)


def certify(step: Subproblem, amplitudes: Floats, ran: str = "") -> Solution:
    """The certificate of any amplitudes (m, c): value and lower bound from the step's data and one factorisation.

    What no support can do is moved to the nearest that one can. The bound is that of MATHEMATICS.md, "Certificate", at the dual
    point theta lam with the best theta. A group that costs nothing allows no other dual than one that does not pull it: the
    displacement is first moved by those few columns of K^-1 to where it does not.
    """
    amplitudes = _possible(step, amplitudes)
    moved = step.unsupported + step.factor.solve(step.spread(amplitudes))  # d + r
    pulled = step.metric @ moved
    dual = 2 * step.factor.solve(pulled)[step.rows]
    distance = float(moved @ pulled)
    size = sizes(amplitudes)
    value = distance + float(step.weights @ size) + float(step.bends @ size**2)
    displacement, multiplier, worth = moved - step.offset, step.nothing, 0.0
    if step.resultants is not None:  # whose multiplier is free: the one that leaves least pull where the large forces are
        slopes = np.divide(step.weights, size, out=2 * step.bends, where=size > 0)
        of_parts = step.resultants.multiplier(dual + slopes[:, None] * amplitudes, size)
        multiplier, worth = step.resultants.spread(of_parts), float(np.vdot(of_parts, step.resultants.total))
        dual = dual + multiplier
    pull = step.reach.pull(dual)
    if step.kept.size:
        moved, pulled = _relieved(step, moved, pulled, size, multiplier)
        distance = float(moved @ pulled)
        pull = step.reach.pull(2 * step.factor.solve(pulled)[step.rows] + multiplier)
        pull[step.kept] *= pull[step.kept] > ROUND_OFF * step.kept_columns.largest_pull(distance)
    bound = _best_bound(step, float(step.unsupported @ pulled) - worth / 2, distance, pull)
    return Solution(amplitudes, displacement, dual, value, bound, ran)


def _possible(step: Subproblem, amplitudes: Floats) -> Floats:
    """The amplitudes that supports can have, near those that are given.

    Raises
    ------
    UnheldError
        They do not hold a part that must be held.
    """
    amplitudes = step.reach.project(amplitudes)
    if step.resultants is None:
        return amplitudes
    balanced = step.resultants.repaired(amplitudes)
    if balanced is None:
        raise UnheldError("the supports of a convex step leave a part of the membrane without a fixed vertex unheld")
    return balanced


def _relieved(step: Subproblem, moved: Floats, pulled: Floats, size: Floats, multiplier: Floats) -> tuple[Floats, Floats]:
    """The displacement nearest in M at which no kept group is pulled, and M times it; those at their largest force may be pulled.

    Adding A z with 2 A^T M A z = P_C(-lam) takes lam to the nearest dual that does not pull (Moreau), A the kept columns.
    """
    kept = step.kept_columns
    held = size[step.kept] >= NEARLY * step.reach.largest
    for _ in range(2):  # the second removes what round-off left of the first
        away = step.reach.cone(-2 * (kept.columns.T @ pulled).reshape(len(held), -1) - multiplier[step.kept])
        away[held] = 0.0
        change = kept.inverse @ away.ravel()
        moved, pulled = moved + kept.columns @ change, pulled + kept.metric_columns @ change
    return moved, pulled


def _best_bound(step: Subproblem, cross: float, distance: float, pull: Floats) -> float:
    """The largest of 2 theta cross - theta^2 distance - what a force could gain on theta pull, over theta >= 0."""
    if distance <= 0 or cross <= 0:
        return 0.0
    weights, bends, largest = step.weights, step.bends, step.reach.largest
    theta = cross / distance
    outside = theta * pull > weights
    bounded = bends > 0 if np.isinf(largest) else np.ones_like(outside)
    hard = outside & ~bounded
    if hard.any():
        theta = min(theta, float((weights[hard] / pull[hard]).min()))
    soft = outside & bounded
    if not soft.any():
        return theta * (2 * cross - theta * distance)
    weights, bends, pull = weights[soft], bends[soft], pull[soft]

    def force(theta: float) -> tuple[Floats, Floats]:
        """What is left of the pull, and the force that gains most by it."""
        left = np.maximum(theta * pull - weights, 0.0)
        best = np.divide(left, 2 * bends, out=np.where(left > 0, largest, 0.0), where=bends > 0)
        return left, np.minimum(best, largest)

    def falls(theta: float) -> bool:
        return bool(cross - theta * distance < pull @ force(theta)[1] / 2)

    if falls(theta):
        low, high = 0.0, theta
        for _ in range(HALVINGS):
            theta = (low + high) / 2
            low, high = (low, theta) if falls(theta) else (theta, high)
        theta = low  # beyond, round-off would count times the largest force
    left, best = force(theta)
    return theta * (2 * cross - theta * distance) - float(best @ (left - bends * best))
