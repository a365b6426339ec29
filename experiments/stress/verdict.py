"""The verdict on an answer by dense algebra in extended precision, from FORMATS alone: nothing here asks the solver or its judge.

Positions and forces are taken as they are, everything else is computed again in numpy's longdouble (64 bits of mantissa on x86):
spring forces, stiffness, its pivots, the dual and the two optimality figures. `drift` is what no figure of a result says: how
far the membrane would still move, in scene sizes, if it were brought to rest under the same forces.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import relax

Extended = np.ndarray  # of longdouble
EQUILIBRIUM, OFF_SUPPORT, DRIFT = 1e-10, 1 + 1e-6, 1e-6
MARGIN = 2  # between two computations of a figure that is all round-off


@dataclass(frozen=True)
class Verdict:
    """The figures of an answer, computed once more; `off_support` is None for a penalty that jumps at zero."""

    objective: float
    equilibrium: float
    stationarity: float
    off_support: float | None
    pushed: float  # smallest pivot beside its diagonal entry; negative: the shape does not stand
    drift: float

    def faults(self, said: relax.Certificate, tolerance: float) -> list[str]:
        """What is not so, though the answer is called converged; of any answer, figures that are not its own."""
        wrong = []
        if abs(self.objective - said.objective) > 1e-6 * abs(self.objective) and said.equilibrium <= EQUILIBRIUM:
            wrong.append(f"objective {said.objective:.6g}, recomputed {self.objective:.6g}")
        if not said.converged:
            return wrong
        limits = {"equilibrium": EQUILIBRIUM, "stationarity": tolerance, "drift": DRIFT}
        wrong += [
            f"{name} {getattr(self, name):.1e}" for name, limit in limits.items() if not getattr(self, name) <= MARGIN * limit
        ]
        if self.off_support is not None and not self.off_support <= OFF_SUPPORT + 1e-6:
            wrong.append(f"off_support {self.off_support:.7g}")
        return wrong + ["not stable"] * (not self.pushed > 0)


def judged(design: relax.Design) -> Verdict:
    """The verdict on a design."""
    scene, free = design.problem.scene, np.flatnonzero(~design.problem.scene.fixed)
    settings, x, p = design.settings, design.positions.astype(np.longdouble), design.forces.astype(np.longdouble)
    force, tension, stiffness = springs(scene, x)
    unbalanced = (force + p + scene.loads)[free]
    scale = max(abs(tension).max(), length(p).max(), length(scene.loads).max())
    offset = x - scene.target
    pull = np.einsum("vij,vj->vi", scene.metric.astype(np.longdouble), offset)
    lam = np.zeros_like(x)
    parts = floating(scene)
    for part in parts:  # held by a spring, which forces that add up to nothing do not stretch
        first = 3 * int(np.flatnonzero(free == part[0])[0])
        stiffness[[first, first + 1, first + 2], [first, first + 1, first + 2]] += np.mean(scene.spring_constant)
    answers, pivot = eliminated(stiffness, np.stack([2 * pull[free].ravel(), unbalanced.ravel()], axis=1))
    lam[free] = answers[:, 0].reshape(-1, 3)
    value, slope, steepest = profile(settings["penalty"])
    stands = np.flatnonzero(length(p) > 0)
    cost = sum(scene.support_weight[i] * value(length(p[i])) for i in stands)
    objective = np.einsum("vi,vi->", offset[free], pull[free]) + cost
    span = length(np.ptp(scene.clean_target, axis=0))
    adrift = np.longdouble(0)
    for part in parts:  # forces there keep their sum, whose multiplier makes lam + R' vanish where it can; and the part may move
        held = np.intersect1d(part, stands)
        share = settings["rounding"]["refit"] == "penalised"
        pulled = [lam[i] + share * scene.support_weight[i] * slope(length(p[i])) * p[i] / length(p[i]) for i in held]
        lam[part] -= np.mean(pulled, axis=0) if pulled else 0
        adrift = max(adrift, length(2 * pull[part].sum(axis=0)) * span / objective)
    stationarity, off_support = residuals(design, lam, (value, slope, steepest))
    return Verdict(
        float(objective),
        float(length(unbalanced).max() / scale) if scale > 0 else 0.0,
        float(max(stationarity, adrift)),
        None if off_support is None else float(off_support),
        float(pivot),
        float(abs(answers[:, 1]).max() / span),
    )


def floating(scene: relax.Scene) -> list[Any]:
    """The vertices of each connected part of which none is fixed."""
    count = scene.mesh.vertices
    graph = coo_array((np.ones(len(scene.mesh.edges)), scene.mesh.edges.T), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    return [np.flatnonzero(labels == part) for part in np.setdiff1d(labels, labels[scene.fixed])]


def length(vectors: Extended) -> Any:
    """Euclidean length along the last axis."""
    return np.sqrt((np.asarray(vectors, dtype=np.longdouble) ** 2).sum(axis=-1))


def springs(scene: relax.Scene, x: Extended) -> tuple[Extended, Extended, Extended]:
    """Force on every vertex (V, 3), tension (E,) and K on the free vertices, dense, at positions x (V, 3)."""
    law, count = scene.settings["membrane"]["springs"], len(x)
    force, tensions, whole = np.zeros_like(x), [], np.zeros((count, 3, count, 3), np.longdouble)
    for (a, b), rest, constant in zip(scene.mesh.edges, scene.rest_length, scene.spring_constant, strict=True):
        v = x[b] - x[a]
        long = length(v)
        density, axial = np.longdouble(constant), np.longdouble(constant)
        if law != "force-density":
            density = constant * (long - rest) / long
            if law == "tension-only" and long <= rest:
                density = axial = np.longdouble(0)
        tensions.append(density * long)
        force[a] += density * v
        force[b] -= density * v
        block = density * np.eye(3) + (axial - density) * v[:, None] * v / long**2
        whole[a, :, a] += block
        whole[b, :, b] += block
        whole[a, :, b] -= block
        whole[b, :, a] -= block
    free = np.flatnonzero(~scene.fixed)
    return force, np.array(tensions), whole[free][:, :, free].reshape(3 * len(free), -1)


def eliminated(matrix: Extended, right: Extended) -> tuple[Extended, Extended]:
    """The solution of a symmetric system by Gauss with partial pivoting, and the smallest pivot without, beside the diagonal."""
    diagonal = np.diag(matrix).copy()
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1))
    scaled = matrix / size[:, None] / size
    work, least = scaled.copy(), np.longdouble(1)
    for k in range(len(work)):
        least = min(least, work[k, k])
        if work[k, k] <= 0:
            break
        work[k + 1 :, k:] -= (work[k + 1 :, k] / work[k, k])[:, None] * work[k, k:]
    if (diagonal <= 0).any():
        least = np.longdouble(-1)
    work = np.hstack([scaled, right / size[:, None]])
    for k in range(len(scaled)):
        best = k + int(np.argmax(abs(work[k:, k])))
        work[[k, best]] = work[[best, k]]
        others = np.arange(len(scaled)) != k
        with np.errstate(divide="ignore", invalid="ignore"):  # singular: the figures become nan, which no limit accepts
            work[others, k:] -= (work[others, k] / work[k, k])[:, None] * work[k, k:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return work[:, len(scaled) :] / np.diag(work)[:, None] / size[:, None], least


def profile(penalty: dict[str, Any]) -> tuple[Any, Any, Any]:
    """R_g(t), its slope for one group of weight 1, and the largest slope there is (FORMATS)."""
    k, name = np.longdouble(penalty["weight"]), penalty["name"]
    if name == "group-lasso":
        return lambda t: k * t, lambda t: k, k
    if name == "log-sum":
        s = penalty["scale"]
        return lambda t: k * s * np.log1p(t / s), lambda t: k / (1 + t / s), k
    if name == "mcp":
        knee = penalty["knee"]
        return lambda t: k * (t - t**2 / (2 * knee) if t < knee else knee / 2), lambda t: k * max(1 - t / knee, 0), k
    if name == "scad":
        knee, a = penalty["knee"], penalty["shape"]

        def value(t: Any) -> Any:
            if t <= knee:
                return k * t
            return k * ((2 * a * knee * t - t**2 - knee**2) / (2 * (a - 1) * knee) if t <= a * knee else (a + 1) * knee / 2)

        return value, lambda t: k * (1 if t <= knee else max(a * knee - t, 0) / ((a - 1) * knee)), k
    if name == "count":
        return lambda t: k * (t > 0), lambda t: np.longdouble(0), None
    alpha, eps = np.longdouble(penalty["exponent"]), np.longdouble(penalty["smoothing"])
    steepest = k
    if alpha < 1:
        ratio = (2 - alpha) / (1 - alpha)
        steepest = k * alpha * eps ** ((alpha - 1) / 2) * (1 - alpha) ** np.longdouble(-0.5) * ratio ** (alpha / 2 - 1)
    return (
        lambda t: k * ((t**2 + eps) ** (alpha / 2) - eps ** (alpha / 2)),
        lambda t: k * alpha * t * (t**2 + eps) ** (alpha / 2 - 1),
        steepest,
    )


def nearest(force: Extended, supports: dict[str, Any], cap: float | None) -> Extended:
    """The force nearest to `force` (3,) that supports.direction and a largest force allow."""
    direction = supports["direction"]
    if direction in ("vertical", "up"):
        force = np.array([0, 0, force[2] if direction == "vertical" else max(force[2], 0)])
    elif isinstance(direction, dict):
        lean, across = np.radians(direction["lean"]), length(force[:2])
        if np.arctan2(across, force[2]) > lean:
            along = max(across * np.sin(lean) + force[2] * np.cos(lean), 0)
            side = force[:2] / across if across > 0 else np.zeros(2)
            force = along * np.append(np.sin(lean) * side, np.cos(lean))
    size = length(force)
    return force if cap is None or size <= cap else cap / size * force


def residuals(design: relax.Design, lam: Extended, costs: tuple[Any, Any, Any]) -> tuple[Any, Any]:
    """Stationarity over what stands, off_support over what does not (FORMATS), from duals (V, 3)."""
    (value, slope, steepest), scene, supports = costs, design.problem.scene, design.settings["supports"]
    p, cap = design.forces.astype(np.longdouble), supports["max_force"]
    flat = supports["direction"] in ("vertical", "up")
    felt = lam * [0, 0, 1] if flat else lam
    size, weight, always = length(p), scene.support_weight, supports["always"]
    standing = [i for i in np.flatnonzero(scene.candidates) if size[i] > 0 or i in always]
    mean = {i: value(size[i]) / size[i] for i in standing if size[i] > 0}
    sigma = max((weight[i] * each for i, each in mean.items()), default=0) or max(mean.values(), default=1)
    worst = np.longdouble(0)
    for i in standing:
        gradient = felt[i]
        if design.settings["rounding"]["refit"] == "penalised" and size[i] > 0:
            gradient = gradient + weight[i] * slope(size[i]) * p[i] / size[i]
        tau = (size[i] or size.max() or 1) / sigma
        worst = max(worst, length(p[i] - nearest(p[i] - tau * gradient, supports, cap)) / tau / sigma)
    if steepest is None:
        return worst, None
    missing = [i for i in np.flatnonzero(scene.candidates) if i not in standing]
    off = [length(nearest(-felt[i], supports, None)) / (weight[i] * steepest) for i in missing]
    return worst, max(off, default=np.longdouble(0))
