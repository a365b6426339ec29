"""The convex step as data, and its certificate: what any back-end's answer is worth, computed from the data alone.

    min over d, s   (d + r)^T M (d + r) + sum_g w_g |s_g|     s.t.   K d = h + B s,   s_g in C,   |s_g| <= F

K is the stiffness, h = f + g what is unbalanced without supports, r = x - xhat, B the supports' basis, c amplitudes a group;
C and F are what a support can do, mostly anything (MATHEMATICS.md, "One convex step"). Nothing here knows of membranes.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from relax.arrays import Floats, Ints, Mask, lock_arrays
from relax.errors import BackendError
from relax.factor import Factor
from relax.sparsity.reach import ANYTHING, Reach


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
        C and F of every group; its axes are those of `rows`.
    """

    factor: Factor
    metric: csc_array
    offset: Floats
    load: Floats
    rows: Ints
    weights: Floats
    reach: Reach = ANYTHING

    def __post_init__(self) -> None:
        lock_arrays(self)

    @property
    def stiffness(self) -> csc_array:
        return self.factor.matrix

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
        )
        return inner, force


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

    The bound is c^T K lam - (K lam)^T M^+ (K lam) / 4 at lam scaled into the ball (MATHEMATICS.md), where K lam = 2 M (d + r).
    """
    moved = step.unsupported + step.factor.solve(step.spread(amplitudes))  # d + r
    pulled = step.metric @ moved
    dual = 2 * step.factor.solve(pulled)[step.rows]
    distance = float(moved @ pulled)
    value = distance + float(step.weights @ np.linalg.norm(amplitudes, axis=1))
    size = np.linalg.norm(dual, axis=1)
    outside = size > step.weights
    shrink = float((step.weights[outside] / size[outside]).min()) if outside.any() else 1.0
    cross = float(step.unsupported @ pulled)
    shrink = min(shrink, max(cross / distance, 0.0)) if distance > 0 else shrink
    bound = 2 * shrink * cross - shrink**2 * distance
    return Solution(amplitudes, moved - step.offset, dual, value, bound, ran)
