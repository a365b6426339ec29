"""Why an answer is what it is: what each support is worth, what a mast elsewhere would be worth, and how sure all this is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, Ints, lock_arrays
from relax.convex.reweighted import Reweighted
from relax.design.assurance import Assurance, assurance
from relax.design.model import model_at
from relax.design.optimality import Certificate, judge
from relax.design.problem import Problem
from relax.design.refit import Shape, refit, with_dual
from relax.errors import EquilibriumError, InputError
from relax.factor import Factor
from relax.sparsity.supports import sizes

Heard = Callable[[Mapping[str, int]], None]
BLOCK = 64  # candidates whose columns of K^-1 are held at once
TRIALS = np.geomspace(1e-4, 1.0, 40)  # of the force at which a mast without a price would gain most
REFINEMENTS = 40  # golden-section steps between two trials: to 1e-8 of the force
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class SupportValue:
    """What one support is worth; newtons, and the objective's unit, square metres (of E_dist).

    Parameters
    ----------
    vertex : int
    force : float
        |p_g|.
    dual, slope : float
        -lam_g along the force, and R_g'(|p_g|): what a little more force gains and costs. Equal where the answer is stationary.
    price : float
        R_g.
    share : float
        Of the sum of all losses of the fit, what this support's removal loses.
    loss_distance, loss_objective : float or None
        What E_dist, and the objective, rise to without it, the others refitted, less what they are; None where the membrane
        then finds no rest.
    estimate : float
        The same rise of the objective by the second-order model, before anything is solved again; nan where the others alone
        cannot hold a part without a fixed vertex.
    """

    vertex: int
    force: float
    dual: float
    slope: float
    price: float
    share: float | None
    loss_distance: float | None
    loss_objective: float | None
    estimate: float


@dataclass(frozen=True)
class Explanation:
    """What can be said of one answer.

    Parameters
    ----------
    supports : SupportValue of each, ascending by vertex
    pull : (V,)
        |P_C(-lam)| over the steepest slope of R: above 1 a small support would pay there at once; nan where none may stand.
    assurance : Assurance
    certificate : Certificate
    interrupted : bool
        Whether Ctrl-C, or `StopRun` from the callback, came before all supports were looked at: those that were are there,
        without their shares.
    """

    supports: tuple[SupportValue, ...]
    pull: Floats
    assurance: Assurance
    certificate: Certificate
    interrupted: bool = False

    def __post_init__(self) -> None:
        lock_arrays(self)


def explain(
    problem: Problem, positions: Floats, forces: Floats, optimum: float | None = None, callback: Heard | None = None
) -> Explanation:
    """What each support of an answer is worth, what a mast elsewhere would be, and how good the answer is known to be.

    Parameters
    ----------
    problem : Problem
    positions, forces : (V, 3) metres, newtons
        Of a membrane at rest, as `solve` gives them.
    optimum : float, optional
        The least objective there is, where somebody knows it.
    callback : function, optional
        Called with `done` and `total` after each support that was taken out.

    Raises
    ------
    EquilibriumError
        The stiffness is singular at this shape, so that no dual exists.

    Notes
    -----
    The removal of a support is true: it is taken out, the others are refitted by Newton as the scene's last refit does, and
    the new rest is compared. With many supports that costs a Newton solve each.
    """
    mode = str(problem.scene.settings["rounding"]["refit"])
    certificate = judge(problem, positions, forces, mode)
    if certificate.stationarity is None:
        raise EquilibriumError(
            "the stiffness is singular at this shape, so there is no dual to explain it by: raise the prestress"
        )
    shape, factor, dual = _at(problem, positions, forces)
    without = _taken_out(problem, shape, mode, callback)
    return Explanation(
        _supports(problem, shape, factor, dual, without),
        _on_vertices(problem, _pull(problem, shape, dual)),
        assurance(problem, positions, forces, optimum),
        certificate,
        interrupted=bool(len(without) < np.count_nonzero(shape.amplitudes.any(axis=1))),
    )


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
    shape, factor, dual = _at(problem, positions, forces)
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
    return MastValues(*(_on_vertices(problem, values) for values in found))


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


def _at(problem: Problem, positions: Floats, forces: Floats) -> tuple[Shape, Factor, Floats]:
    """The shape with a factorisation of its own, and its dual (n, 3)."""
    amplitudes = problem.supports.amplitudes(forces[problem.membrane.free])
    shape, factor, dual = with_dual(problem, Shape(positions, amplitudes, None, 0))
    share = 0.0 if problem.scene.settings["rounding"]["refit"] == "debiased" else 1.0
    return shape, factor, problem.levelled(dual, amplitudes, share)


def pull(problem: Problem, positions: Floats, forces: Floats) -> Floats:
    """`Explanation.pull` alone (V,), for one solve with K; arguments and what raises as of `explain`."""
    shape, _, dual = _at(problem, positions, forces)
    return _on_vertices(problem, _pull(problem, shape, dual))


def _pull(problem: Problem, shape: Shape, dual: Floats) -> Floats:
    """|P_C(-lam_g)| over the steepest slope of R (m,); infinite where a support is free."""
    allowed = problem.group_weights(np.zeros_like(shape.amplitudes))
    push = problem.supports.reach.pull(problem.supports.duals(dual))
    return np.divide(push, allowed, out=np.full_like(push, np.inf), where=allowed > 0)


def _on_vertices(problem: Problem, values: Floats) -> Floats:
    """Values of the candidates (m,) on all vertices (V,), nan elsewhere."""
    field = np.full(len(problem.scene.target), np.nan)
    field[problem.membrane.free[problem.supports.vertices]] = values
    return field


def _taken_out(problem: Problem, shape: Shape, mode: str, callback: Heard | None) -> list[Shape | None]:
    """The shape without each group that carries a force, as many as there is time for."""
    groups = np.flatnonzero(shape.amplitudes.any(axis=1))
    found: list[Shape | None] = []
    try:
        for group in groups:
            found.append(_without(problem, shape, int(group), mode))
            if callback is not None:
                callback({"done": len(found), "total": len(groups)})
    except KeyboardInterrupt:
        if not found:
            raise
    return found


def _supports(
    problem: Problem, shape: Shape, factor: Factor, dual: Floats, without: Sequence[Shape | None]
) -> tuple[SupportValue, ...]:
    """A record for each group that carries a force and was taken out."""
    share = 0.0 if problem.scene.settings["rounding"]["refit"] == "debiased" else 1.0
    groups = np.flatnonzero(shape.amplitudes.any(axis=1))
    here, costs = shape.amplitudes[groups], problem.group_costs(sizes(shape.amplitudes))
    model = model_at(problem, shape, factor, dual).enlarged(groups)
    distance, felt = model.distance, model.dual
    size = sizes(here)
    slopes = share * problem.strength * problem.supports.weights[groups] * problem.penalty.slope(size)
    along = -np.einsum("gc,gc->g", felt[groups], here) / size
    lost = [None if rest is None else problem.distance(rest.positions) - distance for rest in without]
    # shares of a sum: none where a loss is not known, or has no end
    known = [value for value in lost if value is not None]
    whole = sum(value for value in known if value > 0) if len(known) == len(groups) else 0.0
    before = problem.objective(shape.positions, shape.amplitudes)
    found = []
    for index, group in enumerate(groups[: len(without)]):
        left = _settled_without(model.small, here, index, share)
        rest, loss = without[index], lost[index]
        estimate = float(model.value(left) - model.value(here))
        found.append(
            SupportValue(
                vertex=int(problem.membrane.free[problem.supports.vertices[group]]),
                force=float(size[index]),
                dual=float(along[index]),
                slope=float(slopes[index]),
                price=float(costs[group]),
                share=None if loss is None or not whole else max(loss, 0.0) / whole,
                loss_distance=loss,
                loss_objective=None if rest is None else problem.objective(rest.positions, rest.amplitudes) - before,
                estimate=estimate if np.isfinite(estimate) else float("nan"),
            )
        )
    return tuple(found)


def _settled_without(model: Reweighted, start: Floats, index: int, share: float) -> Floats:
    """Forces (k, c) at the model's minimum near `start` with none on group `index`: one without a price would come back."""
    others = np.delete(np.arange(len(start)), index)
    within = (start.shape[1] * others[:, None] + np.arange(start.shape[1])).ravel()
    fewer = replace(
        model,
        quadratic=model.quadratic[np.ix_(within, within)],
        linear=model.linear[others],
        resultants=None if model.resultants is None else model.resultants.of(others),
        costs=share * model.costs[others],  # as the refit does: none where R is dropped
    )
    left = np.zeros_like(start)
    left[others] = fewer.settled(start[others])
    return left


def _without(problem: Problem, shape: Shape, group: int, mode: str) -> Shape | None:
    """The shape at rest without one support, the others refitted; None where it finds no rest."""
    amplitudes = shape.amplitudes.copy()
    amplitudes[group] = 0.0
    if problem.supports.always[group]:  # with a price it stays away
        weight = problem.scene.support_weight.copy()
        weight[problem.membrane.free[problem.supports.vertices[group]]] = 1.0
        problem = problem.replace(scene=replace(problem.scene, support_weight=weight))
    try:
        return refit(problem, replace(shape, amplitudes=amplitudes), mode)
    except EquilibriumError:
        return None
