"""The judge: every figure of a result from the problem's data, the positions and the forces, for every method alike.

It stands below the algorithms: they may stop on what it says, none can alter it. It trusts no solver: forces, tensions,
stiffness and the duals are computed here again.
"""

from dataclasses import dataclass, fields

import numpy as np

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.factor import Factor
from relax.sparsity.faces import projected_gradient
from relax.sparsity.penalties import steepest
from relax.sparsity.supports import sizes

EQUILIBRIUM = 1e-10
OFF_SUPPORT = 1 + 1e-6
ROUND_OFF = 1e-9  # of a force: how far it may lie outside what a support can do
COLLAPSED = 1e-2  # of the wanted size: a part that is smaller is no roof


@dataclass(frozen=True)
class Certificate:
    """The figures of a result; lengths in metres, forces in newtons, the rest relative.

    `stationarity` and `off_support` are None where the stiffness is singular, so that no dual exists; `off_support` also where
    the penalty jumps at zero, so that no small force ever pays. `warnings` are sentences for a person.
    """

    objective: float
    distance: float
    penalty: float
    rms_distance: float
    supports: int
    equilibrium: float
    stationarity: float | None
    off_support: float | None
    stable: bool
    tension_min: float
    tension_max: float
    slack_share: float
    converged: bool
    warnings: tuple[str, ...] = ()

    def figures(self) -> dict[str, float | int | bool | None]:
        """The figures by name, as result.json holds them."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "warnings"}


def judge(problem: Problem, positions: Floats, forces: Floats, refit: str = "penalised") -> Certificate:
    """Judge positions (V, 3) and support forces (V, 3) of `problem`.

    `refit`: "penalised" measures stationarity of E_dist + R on the support, "debiased" of E_dist alone (R dropped).
    """
    membrane, supports = problem.membrane, problem.supports
    positions, forces = np.asarray(positions, dtype=np.float64), np.asarray(forces, dtype=np.float64)
    nodal = forces[membrane.free]
    amplitudes = supports.amplitudes(nodal)
    distance, sparsity = problem.distance(positions), problem.sparsity(amplitudes)
    tension = membrane.tension(positions)
    length = membrane.edge_state(positions).length
    factor = problem.factor_at(positions)
    equilibrium = _equilibrium(problem, positions, nodal, tension)
    stationarity, off_support = _optimality(problem, positions, amplitudes, factor, refit)
    slack = _slack_share(problem, length)
    unmet = _unmet_constraints(problem, positions, forces)
    stable = factor.positive_definite
    return Certificate(
        objective=distance + sparsity,
        distance=distance,
        penalty=sparsity,
        rms_distance=float(np.sqrt(np.mean(np.sum(problem.offset(positions) ** 2, axis=1)))),
        supports=int(amplitudes.any(axis=1).sum()),
        equilibrium=equilibrium,
        stationarity=stationarity,
        off_support=off_support,
        stable=stable,
        tension_min=float(tension.min()),
        tension_max=float(tension.max()),
        slack_share=slack,
        converged=(
            equilibrium <= EQUILIBRIUM
            and stationarity is not None
            and stationarity <= problem.scene.settings["solver"]["tolerance"]
            and (off_support is None or off_support <= OFF_SUPPORT)
            and stable
            and not unmet
        ),
        warnings=(*_warnings(slack, stable=stable), *_collapsed(problem, positions), *unmet),
    )


def _equilibrium(problem: Problem, positions: Floats, nodal: Floats, tension: Floats) -> float:
    """Largest unbalanced force at a free vertex over the largest of tensions, support forces and loads."""
    unbalanced = problem.membrane.forces(positions) + nodal + problem.loads
    scale = max(np.abs(tension).max(), sizes(nodal).max(), np.linalg.norm(problem.scene.loads, axis=1).max())
    largest = float(sizes(unbalanced).max())
    return largest / float(scale) if scale > 0 else largest


def _optimality(
    problem: Problem, positions: Floats, amplitudes: Floats, factor: Factor, refit: str
) -> tuple[float | None, float | None]:
    """Stationarity over the groups that stand, and off_support over the others (MATHEMATICS.md, "The judge")."""
    if factor.singular:
        return None, None
    supports = problem.supports
    dual = supports.duals(problem.dual(positions, factor))
    size = sizes(amplitudes)
    stands = problem.standing(amplitudes)
    stationarity = _drift(problem, positions, amplitudes)
    if stands.any():
        slope = problem.strength * supports.weights * problem.penalty.slope(size)
        if refit == "debiased":
            slope = 0.0 * slope
        gradient = dual + (slope / np.where(size > 0, size, 1.0))[:, None] * amplitudes
        if problem.resultants is not None:
            multiplier = problem.resultants.spread(problem.resultants.multiplier(gradient, stands))
            dual, gradient = dual + multiplier, gradient + multiplier
        scale, standing = problem.slope_scale(amplitudes), amplitudes[stands]
        left = projected_gradient(supports.reach, standing, gradient[stands], problem.step_lengths(standing, scale))
        stationarity = max(stationarity, float(sizes(left).max()) / scale)
    if not np.isfinite(steepest(problem.penalty)):
        return stationarity, None
    allowed = problem.group_weights(supports.none)
    off_support = float((supports.reach.pull(dual)[~stands] / allowed[~stands]).max(initial=0.0))
    return stationarity, off_support


def _drift(problem: Problem, positions: Floats, amplitudes: Floats) -> float:
    """How E_dist changes as a part without a fixed vertex moves as a whole by the scene's size, over the objective."""
    pull = (2 * (problem.metric @ problem.offset(positions).ravel())).reshape(-1, 3)
    parts = [pull[vertices].sum(axis=0) for vertices in problem.membrane.floating]
    largest = max((float(np.linalg.norm(part)) for part in parts), default=0.0)
    return largest * problem.size / problem.objective(positions, amplitudes) if largest > 0 else 0.0


def _slack_share(problem: Problem, length: Floats) -> float:
    """Share of edges shorter than their rest length; a force density is never slack."""
    if problem.membrane.springs.name == "force-density":
        return float(np.mean(problem.membrane.spring_constant < 0))
    return float(np.mean(length < problem.membrane.rest_length))


def _unmet_constraints(problem: Problem, positions: Floats, forces: Floats) -> list[str]:
    """A sentence on each thing that the scene asks for and the result does not keep."""
    scene, supports = problem.scene, problem.supports
    said = []
    if forces[~scene.candidates].any() or not np.array_equal(positions[scene.fixed], scene.start[scene.fixed]):
        said.append("a support stands where the scene allows none, or a fixed vertex is not in its place")
    amplitudes = supports.amplitudes(forces[problem.membrane.free])
    beyond = problem.all_forces(supports.reach.project(amplitudes)) - forces
    bad = np.flatnonzero(sizes(beyond) > ROUND_OFF * sizes(forces))
    bad = bad[scene.candidates[bad]]
    if bad.size:
        said.append(
            f"the support at vertex {bad[0]} acts in a direction or with a force that the scene's supports.direction and "
            "supports.max_force do not allow"
        )
    return said


def _collapsed(problem: Problem, positions: Floats) -> list[str]:
    """On parts without a fixed vertex that supports no longer hold open: stationary they may be, wanted they are not."""
    said = []
    for part in problem.membrane.floating:
        vertices = problem.membrane.free[part]
        size, wanted = (np.ptp(shape[vertices], axis=0).max() for shape in (positions, problem.scene.target))
        if size < COLLAPSED * wanted:
            said.append(
                f"the part of the membrane that holds vertex {vertices[0]} has shrunk from {wanted:.3g} m to {size:.3g} m: its "
                "supports hardly pull; lower penalty.weight"
            )
    return said


def _warnings(slack: float, *, stable: bool) -> list[str]:
    said = []
    if slack > 0:
        said.append(
            f"{slack:.1%} of the edges are slack, shorter than their rest length: a fabric cannot push, so this shape is none; "
            "raise the prestress (lower membrane.rest_scale) or ask for a gentler target"
        )
    if not stable:
        said.append("the shape does not stand: its stiffness is not positive definite, the membrane would leave it")
    return said
