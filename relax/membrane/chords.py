"""Chord steps: Newton's by a stiffness factorised elsewhere, accelerated, and when a new factorisation would be cheaper.

Each step x -> x + K^-1 (f(x) + p) costs a solve. Anderson's mixing takes, of the affine combinations of the last few, the one
whose step would be the smallest (Walker and Ni, SIAM J. Numer. Anal. 49, 2011), which makes light of a stiffness that has
changed around a few supports only, where plain chord steps diverge.
"""

from dataclasses import dataclass, field

import numpy as np

from relax.arrays import Floats
from relax.factor import Factor

AIM = 1e-13  # relative residual: what double precision reaches on meshes of 1e5 vertices
ROUGH = 2e-5  # residual above which a new factorisation would not serve the dual of the shape that it leads to
DEPTH = 5  # steps that are remembered
FACTORISATION = 8.0  # what a factorisation costs, in steps
SLOWEST = 1 / 3  # fall of the logarithm of the residual a step: a Newton step far from rest brings as much for its price
TRUSTED = 2  # steps before a residual that has not fallen as fast is believed
SAME = 1e-10  # of the largest: a direction that the others span


@dataclass(frozen=True)
class Chords:
    """A factorisation with what is remembered of the steps that it has served for.

    Parameters
    ----------
    factor : Factor
        Of a stiffness nearby.
    residuals : tuple of floats
        Relative, of every point so far.
    last : (n, 3) and (n, 3) metres
        The newest point, and the step there without acceleration.
    changes, moves : tuples of (n, 3) metres
        By how much these steps, and where they lead to, differ from one point to the next; the last `DEPTH`.
    products : (k, k)
        Of the changes with each other.
    """

    factor: Factor
    residuals: tuple[float, ...] = ()
    last: tuple[Floats, Floats] | None = None
    changes: tuple[Floats, ...] = ()
    moves: tuple[Floats, ...] = ()
    products: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def pay(self, residual: float) -> bool:
        """Whether another step is cheaper than to factorise now, by how fast the residual came down to `residual`.

        Newton's residual is about the square of the one before, so l = -log of it says what it takes after a factorisation: the
        logarithm of the aim over l. A step that raises l may pay for itself there, or the end is nearer as it is. While the
        residual is above `ROUGH` they go on in any case, for the factorisation shall serve the dual of the shape at rest too.
        """
        if not self.residuals or residual <= AIM:
            return True
        seen = self.residuals[-3:]
        if len(self.residuals) < TRUSTED and residual > np.exp(-SLOWEST) * seen[0]:
            return True
        pace = np.log(seen[0] / residual) / len(seen)
        if pace < SLOWEST:
            return False
        near, end = -np.log(residual), -np.log(AIM)
        return bool(residual > ROUGH or pace * end > near * abs(near) or (end - near) / pace <= FACTORISATION + end / near)

    def step(self, point: Floats, unbalanced: Floats, residual: float) -> tuple["Chords", Floats]:
        """These with a step from a point (n, 3) more, and that step, accelerated."""
        plain = self.factor.solve(unbalanced)
        changes, moves, products = self.changes[1 - DEPTH :], self.moves[1 - DEPTH :], self.products[1 - DEPTH :, 1 - DEPTH :]
        if self.last is not None:
            before, step = self.last
            change = plain - step
            changes, moves = (*changes, change), (*moves, change + point - before)
            row = _products(changes, change)
            products = np.block([[products, row[:-1, None]], [row]])
        accelerated = plain.copy()
        for share, move in zip(_shares(products, _products(changes, plain)), moves, strict=True):
            accelerated -= share * move
        residuals = (*self.residuals, residual)
        return Chords(self.factor, residuals, (point, plain), changes, moves, products), accelerated


def _products(vectors: tuple[Floats, ...], other: Floats) -> Floats:
    return np.array([float(each.ravel() @ other.ravel()) for each in vectors])


def _shares(products: Floats, inner: Floats) -> Floats:
    """Least-squares shares (k,) of changes by their products with each other (k, k) and with what they shall make up (k,)."""
    size = np.sqrt(np.diag(products))
    size[size == 0] = 1.0
    scaled, right = products / np.outer(size, size), inner / size
    if not (np.isfinite(scaled).all() and np.isfinite(right).all()):
        return np.zeros_like(size)
    shares: Floats = np.linalg.lstsq(scaled, right, rcond=SAME)[0] / size
    return shares
