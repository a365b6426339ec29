"""Iterative rounding (section 3.2 of the paper): refit on the supports, drop those that are none, until the support repeats.

What is none is decided by the penalty, not by a guess: a force below its resolution is one that the smoothing made. What is
missing is decided by the dual certificate: a candidate whose dual is steeper than R allows goes back to the convex steps.
"""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, Mask
from relax.design.problem import Problem
from relax.design.refit import Progress, Shape, refit, stationary_dual
from relax.sparsity.supports import sizes

LIMIT = 50
SEAT = 1e-3  # of the largest force: where Newton on R starts with a support that is missing
STATIONARY = 1e-3  # of a shape whose dual is believed
SLACK = 1 + 1e-7  # round-off of a dual; the judge allows 1e-6


@dataclass(frozen=True)
class Rounded:
    """A refitted shape with its dual (m, 3), which groups were dropped on the way (m,), and which are missing (m,)."""

    shape: Shape
    dual: Floats
    dropped: Mask
    missing: Mask  # without a support, though their dual is steeper than R allows anywhere


def round_supports(problem: Problem, shape: Shape, keep: Mask, progress: Progress) -> Rounded:
    """Refit, drop and refit again until the support repeats; groups in `keep` (m,) are never dropped for their size."""
    before = problem.standing(shape.amplitudes)
    for _ in range(LIMIT):
        shape = refit(problem, shape, "penalised", progress)
        standing = problem.standing(shape.amplitudes)
        small = standing & (sizes(shape.amplitudes) <= problem.penalty.resolution) & ~keep
        if not small.any():
            break
        shape = replace(shape, amplitudes=np.where(small[:, None], 0.0, shape.amplitudes))
    shape, field, residual = stationary_dual(problem, shape)
    dual = problem.supports.duals(field)
    stands = problem.standing(shape.amplitudes)
    allowed = problem.group_weights(np.zeros_like(shape.amplitudes))
    # the dual of a shape that Newton left far from stationary says nothing
    missing = ~stands & (sizes(dual) > allowed * SLACK) if residual <= STATIONARY else np.zeros_like(stands)
    return Rounded(shape, dual, before & ~stands, missing)


def seated(problem: Problem, result: Rounded) -> Shape:
    """The rounded shape with a first small force at each missing group, along which the value falls."""
    shape, dual = result.shape, result.dual[result.missing]
    seat = SEAT * float(sizes(shape.amplitudes).max(initial=0.0)) or problem.penalty.resolution
    amplitudes = shape.amplitudes.copy()
    amplitudes[result.missing] = -seat * dual / sizes(dual)[:, None]
    return replace(shape, amplitudes=amplitudes)
