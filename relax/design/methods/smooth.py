"""What methods that differentiate R everywhere ask of a problem: a penalty flat at zero, and supports without constraints."""

from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.errors import InputError
from relax.sparsity.penalties import Penalty, steepest


@dataclass(frozen=True)
class Smoothed:
    """psi(t) = phi(h) - phi(width), h = sqrt(t^2 + width^2): a penalty phi smoothed as the paper does it (section 3.1).

    Parameters
    ----------
    penalty : Penalty
    width : float
        Newtons; 0: phi itself, which must then be flat at zero.
    """

    penalty: Penalty
    width: float

    def value(self, size: Floats) -> Floats:
        """psi(t)."""
        return self.penalty.value(np.hypot(size, self.width)) - self.penalty.value(np.full(1, self.width))

    def across(self, size: Floats) -> Floats:
        """psi'(t) / t, the curvature across the force and twice the parabola's that touches psi from above; its limit at 0."""
        height = np.hypot(size, self.width)
        safe = np.where(height > 0, height, 1.0)
        return np.where(height > 0, self.penalty.slope(height) / safe, self.penalty.curvature(height))

    def along(self, size: Floats) -> Floats:
        """psi''(t)."""
        height = np.hypot(size, self.width)
        share = np.square(size / np.where(height > 0, height, 1.0))
        return share * self.penalty.curvature(height) + (1 - share) * self.across(size)


def refuse_floating(problem: Problem, method: str) -> None:
    """Raise InputError where a part has no fixed vertex, for a method that knows no condition on what forces add up to."""
    if problem.membrane.floating:
        raise InputError(
            f'solver.method "{method}" cannot treat a part of the membrane without a fixed vertex, whose support forces must '
            'balance: use the method "sequential" or "reweighted-l1", or fix a vertex'
        )


def refuse_constraints(problem: Problem, method: str) -> None:
    """Raise InputError where a problem asks for what a method without constraints on supports cannot give.

    Raises
    ------
    InputError
        Supports that lean or push only so far or always stand, or a penalty without a slope.
    """
    supports = problem.supports
    refuse_floating(problem, method)
    lacks = ""
    if supports.reach.constrained:
        lacks = "supports whose direction or force is bounded (supports.direction, supports.max_force)"
    elif supports.always.any():
        lacks = "supports that always stand (supports.always)"
    if not lacks and not 0 < steepest(problem.penalty) < np.inf:
        lacks = f"the penalty {problem.penalty.name!r}, which has no finite slope to go down (penalty.name)"
    if lacks:
        raise InputError(f'solver.method "{method}" cannot treat {lacks}: use the method "sequential"')


def steepest_slope(problem: Problem) -> float:
    """The largest slope of R anywhere, metres squared per newton: what a multiplier of equilibrium comes up to at most."""
    return problem.strength * float(problem.supports.weights.max(initial=0.0)) * steepest(problem.penalty)
