"""The problem of a linear membrane as a dense quadratic in the forces of all candidates, and how large they can be.

E_dist(s) = s^T G s + 2 b^T s + e,     G = C^T M C,  C = K^-1 B,     exactly, for force densities.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from relax.arrays import Floats
from relax.convex.reweighted import Reweighted
from relax.design.problem import Problem
from relax.errors import InputError
from relax.sparsity.reach import ANYTHING, Reach
from relax.sparsity.supports import sizes

DEPENDENT = 1e-11  # smallest eigenvalue of G over the largest, below which its inverse is round-off
BELOW = 1 - 1e-9  # of the split that leaves Q singular: so that Q keeps no negative eigenvalue by round-off


@dataclass(frozen=True)
class Quadratic:
    """E_dist of a linear membrane in the amplitudes of all candidates.

    Parameters
    ----------
    gram : (cm, cm)
        G, square metres per square newton.
    linear : (m, c)
        b.
    constant : float
        e: E_dist without supports, square metres.
    costs : (m,)
        k_sparse c_g; 0 for a support that stands whatever comes.
    reach : Reach
        What each support can do.
    """

    gram: Floats
    linear: Floats
    constant: float
    costs: Floats
    reach: Reach = ANYTHING

    def distance(self, amplitudes: Floats) -> float:
        """E_dist at amplitudes (m, c)."""
        flat = amplitudes.ravel()
        return float(flat @ (self.gram @ flat) + 2 * np.vdot(self.linear, amplitudes)) + self.constant

    @cached_property
    def inverse(self) -> Floats:
        """G^-1 (cm, cm)."""
        return np.asarray(cho_solve(cho_factor(self.gram), np.eye(len(self.gram))), dtype=float)

    @cached_property
    def fitted(self) -> Floats:
        """The least-squares forces (m, c), where no support costs anything."""
        return -(self.inverse @ self.linear.ravel()).reshape(self.linear.shape)

    @cached_property
    def least(self) -> float:
        """E_dist there."""
        return max(self.distance(self.fitted), 0.0)

    @cached_property
    def levers(self) -> Floats:
        """Largest eigenvalue of each group's block of G^-1 (m,): how far |s_g|^2 gets for a unit of E_dist."""
        return np.asarray(np.linalg.eigvalsh(self._blocks(self.inverse))[:, -1], dtype=float)

    @cached_property
    def bends(self) -> Floats:
        """Largest eigenvalue of each group's block of G (m,): how E_dist bends along a force, halved."""
        return np.asarray(np.linalg.eigvalsh(self._blocks(self.gram))[:, -1], dtype=float)

    def _blocks(self, matrix: Floats) -> Floats:
        count, width = self.linear.shape
        index = np.arange(count)
        return matrix.reshape(count, width, count, width)[index, :, index, :]

    @cached_property
    def split(self) -> Floats:
        """D (m,): what each group bears by itself, as large as G - diag(D) stays positive semidefinite, in G^-1's proportions."""
        root = np.repeat(1 / np.sqrt(self.levers), self.linear.shape[1])
        top = np.linalg.eigvalsh(root[:, None] * self.inverse * root)[-1]
        split: Floats = BELOW / (top * self.levers)
        return split

    def caps(self, value: float) -> Floats:
        """A size (m,) that no force exceeds where E_dist + R <= value.

        There E_dist - least = |s - fitted|_G^2 is at most value - least, an ellipsoid on which the largest |s_g| is at most
        |fitted_g| + ((value - least) lever_g)^(1/2).
        """
        left = max(value - self.least, 0.0)
        return np.minimum(sizes(self.fitted) + np.sqrt(left * self.levers), self.reach.largest)


def quadratic_of(problem: Problem) -> Quadratic:
    """The dense problem of a linear membrane.

    Raises
    ------
    InputError
        Two sets of forces move the membrane alike, so that no force is bounded.
    """
    positions = problem.scene.start
    factor = problem.factor_at(positions)
    columns = problem.columns(factor, np.arange(len(problem.supports.vertices)))
    unbalanced = (problem.membrane.forces(positions) + problem.loads).ravel()
    bare = problem.offset(positions).ravel() + factor.solve(unbalanced)
    gram = columns.T @ (problem.metric @ columns)
    gram = 0.5 * (gram + gram.T)
    values = np.linalg.eigvalsh(gram)
    if values[0] <= DEPENDENT * values[-1]:
        raise InputError(
            "the exact method found forces that do not change E_dist, so that nothing bounds them: ask for supports.direction "
            'that the target measures ("vertical" for heights), or fewer supports.candidates'
        )
    linear = (columns.T @ (problem.metric @ bare)).reshape(-1, problem.supports.width)
    costs = problem.strength * problem.supports.weights
    return Quadratic(gram, linear, float(bare @ (problem.metric @ bare)), costs, problem.supports.reach)


def small_problem(problem: Problem, quadratic: Quadratic) -> Reweighted:
    """The same problem for the search of few forces."""
    return Reweighted(quadratic.gram, quadratic.linear, problem.penalty, quadratic.costs)
