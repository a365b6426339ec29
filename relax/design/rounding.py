"""Iterative rounding (section 3.2 of the paper): refit on the supports, drop those that are none, until the support repeats.

What is none is decided by the penalty, not by a guess: a force below its resolution is one that the smoothing made. What is
missing is decided by the dual certificate: a candidate whose dual is steeper than R allows goes back to the convex steps.
"""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, Mask
from relax.design.problem import Problem
from relax.design.refit import Progress, refit, stationary_dual
from relax.design.shape import Shape
from relax.sparsity.supports import sizes

LIMIT = 50
SEATS = 16  # groups that are missing get a first force at once; hundreds would raise the value before Newton lowers it
SEAT = 1e-3  # of the largest force: where Newton on R starts with a support that is missing
STATIONARY = 1e-3  # of a shape whose dual is believed
SLACK = 1 + 1e-7  # round-off of a dual; the judge allows 1e-6


@dataclass(frozen=True)
class Rounded:
    """A refitted shape with its dual (m, c), which groups were dropped on the way (m,), and which are missing (m,)."""

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
        small = standing & (sizes(shape.amplitudes) <= problem.penalty.resolution) & ~keep & ~problem.supports.always
        if not small.any():
            break
        shape = replace(shape, amplitudes=np.where(small[:, None], 0.0, shape.amplitudes))
    shape, field, residual = stationary_dual(problem, shape)
    dual = problem.supports.duals(field)
    stands = problem.standing(shape.amplitudes)
    allowed = problem.group_weights(problem.supports.none)
    # the dual of a shape that Newton left far from stationary says nothing
    missing = ~stands & (problem.supports.reach.pull(dual) > allowed * SLACK) if residual <= STATIONARY else np.zeros_like(stands)
    return Rounded(shape, dual, before & ~stands, missing)


def seated(problem: Problem, result: Rounded, seats: int = SEATS) -> Shape:
    """The rounded shape with a first small force at the groups that are missed most; the value falls along each by itself."""
    shape, supports = result.shape, problem.supports
    missing = np.flatnonzero(result.missing)
    most = missing[np.argsort(-supports.steepness(result.dual)[missing])][:seats]
    pulls = supports.reach.cone(-result.dual[most])
    seat = SEAT * float(sizes(shape.amplitudes).max(initial=0.0)) or problem.penalty.resolution
    amplitudes = shape.amplitudes.copy()
    amplitudes[most] = seat * pulls / sizes(pulls)[:, None]
    return replace(shape, amplitudes=amplitudes)


def gently_seated(problem: Problem, result: Rounded) -> Shape:
    """The same with first forces that are no larger than E_dist wants them, all of them together as far as one alone.

    On a soft part of the membrane a share of the largest force goes far beyond that, and Newton takes the support away again.
    """
    shape, supports = seated(problem, result), problem.supports
    new = np.flatnonzero(result.missing & shape.amplitudes.any(axis=1))
    size = sizes(shape.amplitudes[new])
    along = shape.amplitudes[new] / size[:, None]
    pull = sizes(supports.reach.cone(-result.dual[new]))
    columns = problem.columns(shape.factor or problem.factor_at(shape.positions), new).reshape(-1, *along.shape)
    moved = np.einsum("ngc,gc->ng", columns, along)
    bend = np.einsum("ng,ng->g", moved, problem.metric @ moved)
    best = pull / (2 * np.maximum(bend, np.finfo(float).tiny)) / len(new)
    amplitudes = shape.amplitudes.copy()
    amplitudes[new] = np.minimum(size, best)[:, None] * along
    return replace(shape, amplitudes=amplitudes)
