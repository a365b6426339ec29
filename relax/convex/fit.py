"""A convex quadratic over what supports can do, none of which costs anything by itself.

min over s   s^T A s + 2 b^T s,     s_g within reach, A (ck, ck) positive definite
"""

import numpy as np
from scipy.linalg.lapack import dposv

from relax.arrays import Floats
from relax.convex.semismooth import proximal
from relax.iterate import iterate
from relax.sparsity.reach import Reach

LIMIT = 40  # steps; those seen to converge took 3 to 12


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
    free = solve_definite(matrix, -linear.ravel()).reshape(linear.shape)
    inside = reach.project(free)
    if np.allclose(inside, free, rtol=1e-14, atol=0.0):
        return free
    problem = proximal(matrix, linear.ravel(), np.zeros(len(linear)), reach)
    return iterate(problem, problem.state(inside if start is None else reach.project(start)), LIMIT).state.amplitudes
