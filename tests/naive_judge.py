"""The judge once more, with dense matrices and plain loops, straight from FORMATS: what every figure of a result should be."""

import numpy as np

ARRAYS = (
    *("target", "clean_target", "start", "loads", "rest_length", "spring_constant", "fixed", "candidates", "metric"),
    "support_weight",
)


def result_arrays(scene, positions, forces):
    """The content of result.npz."""
    arrays = {name: getattr(scene, name) for name in ARRAYS}
    return arrays | {"faces": scene.mesh.faces, "edges": scene.mesh.edges, "positions": positions, "forces": forces}


def spring(law, length, rest, constant):
    """Force density and axial stiffness of one edge (MATH's table)."""
    if law == "force-density":
        return constant, constant
    if law == "tension-only" and length < rest:
        return 0.0, 0.0
    return constant * (1 - rest / length), constant


def dense_stiffness(arrays, law):
    """Unbalanced internal forces (V, 3), tensions (E,), and K on the free vertices as a full matrix."""
    x = arrays["positions"]
    f, tension, whole = np.zeros_like(x), [], np.zeros((3 * len(x), 3 * len(x)))
    for (a, b), rest, constant in zip(arrays["edges"], arrays["rest_length"], arrays["spring_constant"], strict=True):
        v = x[b] - x[a]
        length = np.linalg.norm(v)
        density, axial = spring(law, length, rest, constant)
        tension.append(density * length)
        f[a] += density * v
        f[b] -= density * v
        block = density * np.eye(3) + (axial - density) * np.outer(v, v) / length**2
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            whole[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] += sign * block
    free = np.flatnonzero(~arrays["fixed"])
    keep = (3 * free[:, None] + np.arange(3)).ravel()
    return f, np.array(tension), whole[np.ix_(keep, keep)]


def profile(penalty):
    """R_g(t) and its slope for one group of weight 1, and the largest slope there is; FORMATS's formulas."""
    k = penalty["weight"]
    if penalty["name"] == "group-lasso":
        return lambda t: k * t, lambda t: k, k
    alpha, eps = penalty["exponent"], penalty["smoothing"]
    steepest = k
    if alpha < 1:
        steepest = k * alpha * eps ** ((alpha - 1) / 2) * (1 - alpha) ** -0.5 * ((2 - alpha) / (1 - alpha)) ** (alpha / 2 - 1)
    return (
        lambda t: k * ((t**2 + eps) ** (alpha / 2) - eps ** (alpha / 2)),
        lambda t: k * alpha * t * (t**2 + eps) ** (alpha / 2 - 1),
        steepest,
    )


def naive_figures(arrays, settings):
    """Every figure of result.json but the counters."""
    law = settings["membrane"]["springs"]
    x, p, free = arrays["positions"], arrays["forces"], np.flatnonzero(~arrays["fixed"])
    f, tension, stiffness = dense_stiffness(arrays, law)
    size = np.linalg.norm(p, axis=1)
    y = x - arrays["target"]
    cost, slope, steepest = profile(settings["penalty"])
    candidates = np.flatnonzero(arrays["candidates"])
    standing = [i for i in candidates if size[i] > 0]
    distance = sum(y[i] @ arrays["metric"][i] @ y[i] for i in free)
    penalty = sum(arrays["support_weight"][i] * cost(size[i]) for i in standing)
    scale = max(np.abs(tension).max(), size.max(), np.linalg.norm(arrays["loads"], axis=1).max())
    pull = np.concatenate([2 * arrays["metric"][i] @ y[i] for i in free])
    lam = np.zeros_like(x)
    lam[free] = np.linalg.solve(stiffness, pull).reshape(-1, 3)
    stationarity = 0.0
    if standing:
        sigma = max(arrays["support_weight"][i] * cost(size[i]) / size[i] for i in standing)
        for i in standing:
            gradient = lam[i].copy()
            if settings["rounding"]["refit"] == "penalised":
                gradient += arrays["support_weight"][i] * slope(size[i]) * p[i] / size[i]
            tau = size[i] / sigma
            stationarity = max(stationarity, np.linalg.norm(p[i] - (p[i] - tau * gradient)) / tau / sigma)
    off = [np.linalg.norm(lam[i]) / (arrays["support_weight"][i] * steepest) for i in candidates if size[i] == 0]
    length = np.linalg.norm(x[arrays["edges"][:, 1]] - x[arrays["edges"][:, 0]], axis=1)
    slack = arrays["spring_constant"] < 0 if law == "force-density" else length < arrays["rest_length"]
    figures = {
        "objective": distance + penalty,
        "distance": distance,
        "penalty": penalty,
        "rms_distance": np.sqrt(np.mean(np.sum(y[free] ** 2, axis=1))),
        "supports": len(standing),
        "equilibrium": np.linalg.norm((f + p + arrays["loads"])[free], axis=1).max() / scale,
        "stationarity": stationarity,
        "off_support": max(off, default=0.0),
        "stable": positive_definite(stiffness),
        "tension_min": tension.min(),
        "tension_max": tension.max(),
        "slack_share": slack.mean(),
    }
    met = not p[~arrays["candidates"]].any()
    figures["converged"] = bool(
        figures["equilibrium"] <= 1e-10
        and figures["stationarity"] <= settings["solver"]["tolerance"]
        and figures["off_support"] <= 1 + 1e-6
        and figures["stable"]
        and met
    )
    return figures


def positive_definite(matrix):
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def differences(said, mine, tolerance=1e-6):
    """Names of the figures that differ by more than `tolerance`, relative; residuals may differ by their round-off."""
    slight = {"equilibrium": 1e-12, "stationarity": 1e-10, "off_support": 1e-9, "tension_min": 1e-9 * abs(mine["tension_max"])}
    wrong = []
    for name, value in mine.items():
        if isinstance(value, bool | int):
            same = said[name] == value
        else:
            same = said[name] is not None and abs(said[name] - value) <= tolerance * abs(value) + slight.get(name, 1e-15)
        if not same:
            wrong.append(f"{name} is said to be {said[name]}, recomputed {value}")
    return wrong
