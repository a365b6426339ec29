"""Where a run may start, which decides the minimum it finds (MATH, "Starts")."""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.design.refit import Shape, rest
from relax.errors import EquilibriumError
from relax.factor import Factor
from relax.membrane.equilibrium import find_equilibrium
from relax.sparsity.supports import sizes

PLANTED = 0.1  # share of the candidates: where fewer carry a force at the target, the target is itself a tensile surface
HEAVY = (0.5, 0.1)  # first weights, as shares of the largest useful one; neither wins on every scene


@dataclass(frozen=True)
class Start:
    """A shape to start from; `weight` is a first group-lasso weight k, or None to use the penalty's own at once."""

    name: str
    shape: Shape
    weight: float | None = None


def unsupported(problem: Problem) -> Shape:
    """The membrane at rest without supports, found from the flat start.

    Raises
    ------
    EquilibriumError
        It finds no rest; the message says why.
    """
    found = find_equilibrium(problem.membrane, problem.scene.start, problem.loads)
    if not found.found:
        raise EquilibriumError(f"the membrane without supports: {found.stop.value}")
    factor = Factor(problem.membrane.stiffness(found.positions))
    if factor.singular:
        raise EquilibriumError(
            "the membrane without supports has a singular stiffness (no prestress, or a slack part): lower membrane.rest_scale"
        )
    return Shape(found.positions, np.zeros_like(problem.supports.rows, dtype=float), factor, found.factorizations + 1)


def largest_weight(problem: Problem, shape: Shape) -> float:
    """The smallest weight at which no support passes the dual test: max |lam_g| / c_g at the unsupported `shape`."""
    dual = problem.supports.amplitudes(problem.dual(shape.positions, shape.factor))
    return float((sizes(dual) / problem.supports.weights).max())


def resolve_weight(problem: Problem) -> Problem:
    """The problem with its weight as a number, where the scene gives it as a fraction of the largest useful one.

    Raises
    ------
    EquilibriumError
        The membrane without supports, at which that is measured, finds no rest.
    """
    fraction = problem.scene.settings["penalty"].get("weight_fraction")
    if problem.weight is not None or fraction is None:
        return problem
    steepest = float(problem.penalty.weight(np.zeros(1))[0])
    return problem.replace(weight=fraction * largest_weight(problem, unsupported(problem)) / steepest)


def at_target(problem: Problem) -> Shape | None:
    """The target under the forces that its own springs ask for, x = xhat, p = -f(xhat) - g, or as near as candidates allow."""
    target = problem.scene.target
    wanted = -problem.membrane.forces(target) - problem.loads
    shape = Shape(target, problem.supports.amplitudes(wanted), Factor(problem.membrane.stiffness(target)), 0)
    return rest(problem, shape)


def given(problem: Problem, positions: Floats, forces: Floats) -> Shape | None:
    """The shape of another result: its forces where this scene has candidates, brought to rest."""
    free = problem.membrane.free
    placed = problem.scene.clean_target.copy()
    placed[free] = positions[free]
    amplitudes = problem.supports.amplitudes(forces[free])
    return rest(problem, Shape(placed, amplitudes, Factor(problem.membrane.stiffness(placed)), 0))


def is_planted(problem: Problem, shape: Shape) -> bool:
    """Whether few supports hold the target as it is, so that nothing needs to be searched for elsewhere."""
    counted = np.count_nonzero(sizes(shape.amplitudes) > problem.penalty.resolution)
    return problem.penalty.resolution > 0 and counted <= PLANTED * len(shape.amplitudes)


def heavy_starts(problem: Problem) -> list[Start]:
    """Few masts first: the unsupported membrane with first weights at several shares of the largest useful one."""
    shape = unsupported(problem)
    top = largest_weight(problem, shape)
    return [Start(f"heavy {share:g}", replace(shape), share * top) for share in HEAVY]
