"""What a mast elsewhere would be worth: the pull of every vertex, and what the best force there promises."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats, Ints, lock_arrays
from relax.design.problem import Problem
from relax.design.shape import Shape, with_dual
from relax.errors import InputError
from relax.factor import Factor
from relax.sparsity.supports import sizes

Heard = Callable[[Mapping[str, int]], None]
BLOCK = 64  # candidates whose columns of K^-1 are held at once
TRIALS = np.geomspace(1e-4, 1.0, 40)  # of the force at which a mast without a price would gain most
REFINEMENTS = 40  # golden-section steps between two trials: to 1e-8 of the force
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class MastValues:
    """What a new mast at each vertex promises, to second order in its force with R as it is; nan where that was not asked for.

    Parameters
    ----------
    fit : (V,)
        The largest fall of E_dist, its price not counted: |P_C(-lam_g)|^2 / (4 q_g), less where the largest force is less.
    gain : (V,)
        The largest fall of the objective; 0 where no force pays.
    force : (V,) newtons
        At which the gain is largest.
    """

    fit: Floats
    gain: Floats
    force: Floats

    def __post_init__(self) -> None:
        lock_arrays(self)


def mast_values(
    problem: Problem,
    positions: Floats,
    forces: Floats,
    vertices: Sequence[int] | None = None,
    callback: Heard | None = None,
) -> MastValues:
    """What a new mast at each vertex promises, all other forces as they are.

        max over 0 <= t <= F of  |P_C(-lam_g)| t - q_g t^2 - R_g(t)

    along P_C(-lam_g), with q_g the own curvature of E_dist there. nan where none may stand, where one stands already, and at
    vertices that are not asked for.

    Parameters
    ----------
    problem : Problem
    positions, forces : (V, 3)
    vertices : indices, optional
        Default: all candidates. Each costs a solve with K per free component of a force.
    callback : function, optional
        Called with `done` and `total`, candidates, from time to time.

    Raises
    ------
    InputError
        A vertex where no support may stand, or a part without a fixed vertex, where no force can be added by itself.

    Notes
    -----
    Exact on linear membranes. Others stiffen as they are lifted, a flat one most of all: there large forces do less than this
    says.
    """
    refuse_floating(problem)
    shape, factor, dual = shape_at(problem, positions, forces)
    supports, place = problem.supports, problem.membrane.free[problem.supports.vertices]
    asked = np.arange(len(place)) if vertices is None else _groups_at(place, vertices)
    asked = asked[~problem.standing(shape.amplitudes)[asked]]
    push = supports.reach.cone(-supports.duals(dual))
    size = sizes(push)
    found = np.full((3, len(place)), np.nan)
    found[:, asked] = 0.0
    asked = asked[size[asked] > 0]
    curvature = problem.curvature(shape.positions, dual)
    for first in range(0, len(asked), BLOCK):
        groups = asked[first : first + BLOCK]
        along = push[groups] / size[groups, None]
        columns = problem.columns(factor, groups).reshape(-1, len(groups), supports.width)
        moved = np.einsum("ngc,gc->ng", columns, along)
        bend = np.einsum("ng,ng->g", moved, curvature @ moved)
        # where the model bends down it bends up as much
        found[:, groups] = _best_force(problem, groups, size[groups], np.maximum(np.abs(bend), np.finfo(float).tiny))
        if callback is not None:
            callback({"done": min(first + BLOCK, len(asked)), "total": len(asked)})
    return MastValues(*(on_vertices(problem, values) for values in found))


def _groups_at(place: Ints, vertices: Sequence[int]) -> Ints:
    """The groups at some vertices, of those at `place` (m,)."""
    groups = np.searchsorted(place, vertices)
    wrong = [int(v) for v, g in zip(vertices, groups, strict=True) if g >= len(place) or place[g] != v]
    if wrong:
        raise InputError(f"vertex {wrong[0]}: no support may stand there (supports.candidates); ask for others")
    return np.unique(groups)


def refuse_floating(problem: Problem) -> None:
    """Raise InputError where a part has no fixed vertex: a force by itself cannot stand there."""
    if problem.membrane.floating:
        raise InputError(
            "the gain of one new mast means nothing where a part of the membrane has no fixed vertex: the others would have to "
            "balance it; leave --gains out, and read the pull"
        )


def _best_force(problem: Problem, groups: Ints, push: Floats, bend: Floats) -> tuple[Floats, Floats, Floats]:
    """The largest fall of E_dist of each group (k,), that of the objective, and the force of the latter."""
    cost = problem.strength * problem.supports.weights[groups]

    def gained(force: Floats) -> Floats:
        # a force below the penalty's resolution is none, however little it costs
        priced = np.where(force > 0, np.maximum(force, problem.penalty.resolution), 0.0)
        gain: Floats = push * force - bend * force**2 - cost * problem.penalty.value(priced)
        return gain

    free = np.minimum(push / (2 * bend), problem.supports.reach.largest)
    trials = TRIALS[:, None] * free
    best = np.argmax([gained(trial) for trial in trials], axis=0)
    index = np.arange(len(groups))
    low, high = trials[np.maximum(best - 1, 0), index], trials[np.minimum(best + 1, len(trials) - 1), index]
    for _ in range(REFINEMENTS):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        rises = gained(left) < gained(right)
        low, high = np.where(rises, left, low), np.where(rises, high, right)
    force = 0.5 * (low + high)
    gain = gained(force)
    return push * free - bend * free**2, np.maximum(gain, 0.0), np.where(gain > 0, force, 0.0)


def shape_at(problem: Problem, positions: Floats, forces: Floats) -> tuple[Shape, Factor, Floats]:
    """The shape with a factorisation of its own, and its dual (n, 3)."""
    amplitudes = problem.supports.amplitudes(forces[problem.membrane.free])
    shape, factor, dual = with_dual(problem, Shape(positions, amplitudes, None, 0))
    share = 0.0 if problem.scene.settings["rounding"]["refit"] == "debiased" else 1.0
    return shape, factor, problem.levelled(dual, amplitudes, share)


def pull(problem: Problem, positions: Floats, forces: Floats) -> Floats:
    """`Explanation.pull` alone (V,), for one solve with K; arguments and what raises as of `explain`."""
    shape, _, dual = shape_at(problem, positions, forces)
    return on_vertices(problem, pull_at(problem, shape, dual))


def pull_at(problem: Problem, shape: Shape, dual: Floats) -> Floats:
    """|P_C(-lam_g)| over the steepest slope of R (m,); infinite where a support is free."""
    allowed = problem.group_weights(np.zeros_like(shape.amplitudes))
    push = problem.supports.reach.pull(problem.supports.duals(dual))
    return np.divide(push, allowed, out=np.full_like(push, np.inf), where=allowed > 0)


def on_vertices(problem: Problem, values: Floats) -> Floats:
    """Values of the candidates (m,) on all vertices (V,), nan elsewhere."""
    field = np.full(len(problem.scene.target), np.nan)
    field[problem.membrane.free[problem.supports.vertices]] = values
    return field
