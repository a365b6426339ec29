"""Newton steps of supports within their reach: on the smooth piece of it where their forces lie, its curvature counted.

At a minimum s = P(s - tau g), g the gradient. A Newton step on this equation, written in the eigenvectors T and eigenvalues D of
the slope of P (group by group), is an ordinary Newton step along T,

    [T^T H T + (1/D - 1) / tau] y = -(D^-1 T^T F) / tau - T^T H n,     F = s - P(s - tau g),

beside the step n = -(F off T) onto the piece; (1/D - 1) / tau is how the piece bends. Where nothing binds it is H y = -g.
"""

from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats
from relax.sparsity.reach import Reach

FLAT = 1e-12  # eigenvalues of the slope of P below this are zero


@dataclass(frozen=True)
class Face:
    """The piece of the reach at amplitudes (k, c) under a gradient: the problem of a Newton step on it.

    Parameters
    ----------
    basis : (ck, r) or None
        T, orthonormal; None where nothing binds: the identity.
    bend : (r,)
        (1/D - 1) / tau.
    slope : (r,)
        (D^-1 T^T F) / tau: the gradient along T.
    onto : (ck,)
        n.
    """

    basis: Floats | None
    bend: Floats
    slope: Floats
    onto: Floats

    def hessian(self, whole: Floats) -> Floats:
        """The matrix of the step, (r, r), from H (ck, ck)."""
        return whole if self.basis is None else self.basis.T @ whole @ self.basis + np.diag(self.bend)

    def gradient(self, whole: Floats) -> Floats:
        """Minus the right-hand side (r,), from H (ck, ck)."""
        return self.slope if self.basis is None else self.slope + self.basis.T @ (whole @ self.onto)

    def step(self, along: Floats) -> Floats:
        """The whole step (ck,) from y (r,)."""
        return along if self.basis is None else self.basis @ along + self.onto


def projected_gradient(reach: Reach, amplitudes: Floats, gradient: Floats, tau: Floats) -> Floats:
    """(s - P(s - tau g)) / tau of each group (k, c): zero where no step within reach descends; g itself where nothing binds.

    `amplitudes` and `gradient` are (k, c), `tau` (k,) the steps' lengths, positive.
    """
    if not reach.constrained:
        return gradient
    return (amplitudes - reach.project(amplitudes - tau[:, None] * gradient)) / tau[:, None]


def face_at(reach: Reach, amplitudes: Floats, gradient: Floats, tau: Floats) -> Face:
    """The piece on which amplitudes (k, c) lie once the gradient (k, c) has pushed them against what binds; tau (k,)."""
    count, width = amplitudes.shape
    if not reach.constrained:
        return Face(None, np.zeros(count * width), gradient.ravel(), np.zeros(count * width))
    pushed = amplitudes - tau[:, None] * gradient
    missing = amplitudes - reach.project(pushed)
    values, vectors = np.linalg.eigh(reach.slope(pushed))
    group, which = np.nonzero(values > FLAT)
    pieces = np.zeros((count, width, len(group)))
    pieces[group, :, np.arange(len(group))] = vectors[group, :, which]
    basis = pieces.reshape(count * width, -1)
    share, length = values[group, which], tau[group]
    along = basis.T @ missing.ravel()
    onto = basis @ along - missing.ravel()
    return Face(basis, (1 / share - 1) / length, along / (share * length), onto)
