"""Where a run may start, which decides the minimum it finds (MATHEMATICS.md, "Starts")."""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.design.shape import Shape, rest
from relax.errors import EquilibriumError, InputError
from relax.membrane.formers import form_find
from relax.sparsity.penalties import is_convex, steepest
from relax.sparsity.supports import sizes

PLANTED = 0.1  # share of the candidates: where fewer carry a force at the target, the target is itself a tensile surface
ROUND_OFF = 1e-9  # of the largest force: what a planted target, stored with fewer digits perhaps, carries everywhere else
NOTHING = 1e-12  # of the largest tension: a force that is the round-off of balance
REACHED = 1e-16  # of the scene's size squared: a rested shape this near is the target
# of the mean stiffness: the springs that draw the membrane to a target, the next where it would not stand
PULLS = (0.125, 0.016, 0.002)
TILT = 0.05  # by which noise may tilt what these springs average it over; where it is more they are weaker
HEAVY = (0.5, 0.005, 0.1)  # first weights, as shares of the largest useful one; none wins on every scene


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
        It finds no rest, or does not stand there; the message says why.
    """
    if problem.membrane.floating:
        vertex = int(problem.membrane.free[problem.membrane.floating[0][0]])
        raise EquilibriumError(
            f"the membrane without supports: the part that holds vertex {vertex} has no fixed vertex, so it shrinks until no "
            "edge pulls, and nothing can be measured or begun there: begin at forces that hold it (start), fix a vertex, or hand "
            "weights to relax.path"
        )
    found = form_find(problem.membrane, problem.scene.start, problem.loads)
    if not found.found:
        raise EquilibriumError(f"the membrane without supports: {found.stop.value}")
    factor = problem.factor_at(found.positions)
    if not factor.positive_definite:
        raise EquilibriumError(
            "the membrane without supports does not stand by itself (no prestress, or a slack part): lower membrane.rest_scale"
        )
    return Shape(found.positions, problem.supports.none, found.factor, found.factorizations).with_factor(factor)


def largest_weight(problem: Problem, shape: Shape) -> float:
    """The smallest weight at which no support passes the dual test: max |P_C(-lam_g)| / c_g at the unsupported `shape`."""
    factor, supports = shape.factor or problem.factor_at(shape.positions), problem.supports
    return float(supports.steepness(supports.duals(problem.dual(shape.positions, factor))).max(initial=0.0))


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
    slope = steepest(problem.penalty)
    if not np.isfinite(slope):
        raise InputError(
            f'penalty.weight_fraction: the penalty "{problem.penalty.name}" jumps at zero, so no weight is the largest useful '
            "one: give penalty.weight"
        )
    if problem.membrane.floating:
        raise InputError(
            "penalty.weight_fraction: a part of the membrane has no fixed vertex and does not stand without supports, so no "
            "weight is the largest useful one: give penalty.weight"
        )
    bare = unsupported(problem)
    if _reached(problem, bare):
        raise InputError(
            "penalty.weight_fraction: the membrane without supports already lies on the target, so no weight is useful: give "
            "penalty.weight, or another target"
        )
    largest = largest_weight(problem, bare)
    if largest == 0:
        raise InputError(
            "penalty.weight_fraction: no support that could be left out would bring the membrane nearer to the target "
            "(supports.direction, supports.candidates, supports.always), so no weight is useful: give penalty.weight, or allow "
            "other supports"
        )
    return problem.replace(weight=fraction * largest / slope)


def at_target(problem: Problem) -> Shape | None:
    """The target under the forces that its own springs ask for, x = xhat, p = -f(xhat) - g, or as near as candidates allow."""
    target = problem.scene.target
    wanted = -problem.membrane.forces(target) - problem.loads
    amplitudes = problem.supports.nearest(wanted)
    level = NOTHING * max(float(sizes(wanted).max()), float(np.abs(problem.membrane.tension(target)).max()))
    amplitudes[sizes(amplitudes) <= level] = 0.0
    return rest(problem, Shape(target, amplitudes, problem.factor_at(target), 1))


def pulled(problem: Problem) -> Shape | None:
    """The membrane drawn to the target by a weak spring at each vertex: the target denoised, under the forces that hold it there.

    One Newton step from the flat start, (K + t M) d = f + g - t M (x - xhat). Noise is averaged over some neighbours, while the
    forces p = -f - g keep sharp peaks where the target needs a support. None where the membrane would not stand so.

    Springs that are a share t of the stiffness average over some 1 / t vertices: what is left of noise sigma, sigma sqrt(t),
    tilts a line across these, of h / sqrt(t) at edges h, by t sigma / h. Where the target is rough, t is smaller.
    """
    membrane, start = problem.membrane, problem.scene.start
    forces = membrane.forces(start) + problem.loads
    # alike in all directions: a metric that lets a vertex slide says nothing of where it should start
    pull = np.einsum("vii->v", problem.scene.metric[membrane.free])
    pull *= float(membrane.stiffness(start).diagonal().mean()) / (pull.mean() or 1.0)
    offset = pull[:, None] * problem.offset(start)
    rough = problem.roughness * PULLS[0]
    gentle = min(1.0, TILT / rough) if rough > 0 else 1.0
    for share in gentle * np.array(PULLS):
        tied = membrane.tied_factor_at(start, share * pull[:, None, None] * np.eye(3))
        if not tied.positive_definite:
            continue
        positions = start.copy()
        positions[membrane.free] += tied.solve(forces - share * offset)
        factor = problem.factor_at(positions)
        if factor.positive_definite:
            amplitudes = problem.supports.nearest(-membrane.forces(positions) - problem.loads)
            return rest(problem, Shape(positions, amplitudes, factor, 2))
    return None


def given(problem: Problem, positions: Floats, forces: Floats) -> Shape | None:
    """The shape of another result: its forces where this scene has candidates, brought to rest."""
    free = problem.membrane.free
    placed = problem.scene.clean_target.copy()
    placed[free] = positions[free]
    amplitudes = problem.supports.nearest(np.asarray(forces[free], dtype=np.float64))
    return rest(problem, Shape(placed, amplitudes, problem.factor_at(placed), 1))


def is_planted(problem: Problem, shape: Shape) -> bool:
    """Whether few supports hold the target as it is, so that nothing needs to be searched for elsewhere."""
    size = sizes(shape.amplitudes)
    counted = np.count_nonzero(size > ROUND_OFF * size.max(initial=0.0))
    return bool(counted <= max(1, PLANTED * len(size))) and _reached(problem, shape)


def choose_starts(problem: Problem, start: tuple[Floats, Floats] | None, skipped: list[str]) -> list[Start]:
    """The starts that the scene asks for; what a run need not look at is said in `skipped`.

    `start`: positions and forces (V, 3) of another result, from which alone to start.

    Raises
    ------
    EquilibriumError, InputError
        A start that was asked for is not to be had.
    """
    choice = problem.scene.settings["solver"]["start"]
    if start is not None:
        return [Start("given", _found(problem, given(problem, *start), "under the forces of that result"))]
    if choice not in ("auto", "target", "heavy"):
        raise InputError(f"solver.start is {choice!r}: hand the positions and forces of that result to solve(start=...)")
    if choice == "heavy":
        if problem.membrane.floating:
            raise InputError(
                'solver.start "heavy" begins without supports, and a part of the membrane has no fixed vertex, so without them '
                'it is nowhere at rest: start from "auto" or "target", or fix a vertex'
            )
        return heavy_starts(problem)
    if choice == "target":
        return [Start("target", _found(problem, at_target(problem), "near the target"))]
    return _automatic(problem, skipped)


def _automatic(problem: Problem, skipped: list[str]) -> list[Start]:
    """The target where few supports hold it, else the target denoised, else what stands."""
    shape = at_target(problem)
    if shape is not None and is_planted(problem, shape):
        skipped.append("a search for other starts: few supports hold the target as it is")
        return [Start("target", shape)]
    if is_convex(problem.penalty) and not problem.membrane.floating:
        skipped.append("other first weights: the penalty's own never change")
        return [Start("unsupported", unsupported(problem))]
    drawn = pulled(problem) if len(problem.supports.vertices) else None
    if drawn is not None:
        return [Start("pulled", drawn)]
    try:
        return heavy_starts(problem)
    except EquilibriumError as error:
        if shape is None and problem.membrane.floating:
            raise EquilibriumError(
                "solver.start: the candidates near the target hold no part without a fixed vertex at rest: widen "
                "supports.candidates, fix a vertex, or begin at positions and forces that balance"
            ) from error
        if shape is None:
            raise
        skipped.append("heavy starts: the membrane does not stand without supports")
        return [Start("target", shape)]


def _found(problem: Problem, shape: Shape | None, where: str) -> Shape:
    if shape is None:
        elsewhere = "auto" if problem.membrane.floating else "auto or heavy"
        raise EquilibriumError(f"solver.start: the membrane finds no rest {where}; start elsewhere ({elsewhere})")
    return shape


def _reached(problem: Problem, shape: Shape) -> bool:
    """Whether the shape is the target, up to round-off of the scene's size."""
    return problem.distance(shape.positions) <= REACHED * float(problem.metric.diagonal().sum()) * problem.size**2


def heavy_starts(problem: Problem) -> list[Start]:
    """Few masts first: the unsupported membrane with first weights at several shares of the largest useful one."""
    shape = unsupported(problem)
    if _reached(problem, shape) or not len(problem.supports.vertices):
        return [Start("unsupported", shape)]
    top = largest_weight(problem, shape)
    starts = [Start(f"heavy {share:g}", replace(shape, factorizations=0), share * top) for share in HEAVY]
    return [replace(starts[0], shape=shape), *starts[1:]]  # what the unsupported membrane took is counted once
