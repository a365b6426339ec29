"""Why an answer is what it is: what each support is worth, where another would pay, and how sure all this is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, lock_arrays
from relax.convex.reweighted import Reweighted
from relax.design.assurance import Assurance, assurance
from relax.design.mast_values import Heard, on_vertices, pull_at, shape_at
from relax.design.model import model_at
from relax.design.optimality import Certificate, judge
from relax.design.problem import Problem
from relax.design.refit import refit
from relax.design.shape import Shape
from relax.errors import EquilibriumError
from relax.factor import Factor
from relax.sparsity.supports import sizes


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
    shape, factor, dual = shape_at(problem, positions, forces)
    without = _taken_out(problem, shape, mode, callback)
    return Explanation(
        _supports(problem, shape, factor, dual, without),
        on_vertices(problem, pull_at(problem, shape, dual)),
        assurance(problem, positions, forces, optimum),
        certificate,
        interrupted=bool(len(without) < np.count_nonzero(shape.amplitudes.any(axis=1))),
    )


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
