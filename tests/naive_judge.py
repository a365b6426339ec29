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
    if penalty["name"] == "log-sum":
        s = penalty["scale"]
        return lambda t: k * s * np.log1p(t / s), lambda t: k / (1 + t / s), k
    if penalty["name"] == "mcp":
        knee = penalty["knee"]
        return (
            lambda t: k * (t - t**2 / (2 * knee) if t < knee else knee / 2),
            lambda t: k * (1 - t / knee if t < knee else 0.0),
            k,
        )
    if penalty["name"] == "scad":
        knee, a = penalty["knee"], penalty["shape"]
        return lambda t: k * scad(t, knee, a), lambda t: k * scad_slope(t, knee, a), k
    if penalty["name"] == "count":
        return lambda t: k * float(t > 0), lambda t: 0.0, np.inf
    alpha, eps = penalty["exponent"], penalty["smoothing"]
    steepest = k
    if alpha < 1:
        steepest = k * alpha * eps ** ((alpha - 1) / 2) * (1 - alpha) ** -0.5 * ((2 - alpha) / (1 - alpha)) ** (alpha / 2 - 1)
    return (
        lambda t: k * ((t**2 + eps) ** (alpha / 2) - eps ** (alpha / 2)),
        lambda t: k * alpha * t * (t**2 + eps) ** (alpha / 2 - 1),
        steepest,
    )


def scad(t, knee, a):
    """Fan and Li's equation over lambda = knee, piece by piece."""
    if t <= knee:
        return t
    if t <= a * knee:
        return (2 * a * knee * t - t**2 - knee**2) / (2 * (a - 1) * knee)
    return (a + 1) * knee / 2


def scad_slope(t, knee, a):
    if t <= knee:
        return 1.0
    return max(a * knee - t, 0.0) / ((a - 1) * knee)


def nearest(force, supports):
    """The force nearest to `force` (3,) that supports.direction and supports.max_force allow, by angles from the vertical."""
    direction, cap = supports["direction"], supports["max_force"]
    if direction != "any":
        across, up = np.linalg.norm(force[:2]), force[2]
        if isinstance(direction, dict) and direction["lean"] > 0:
            lean, angle = np.radians(direction["lean"]), np.arctan2(across, up)
            if angle > lean:
                along = max(0.0, across * np.sin(lean) + up * np.cos(lean))
                side = force[:2] / across if across > 0 else np.zeros(2)
                force = along * np.append(np.sin(lean) * side, np.cos(lean))
        else:
            force = np.array([0.0, 0.0, up if direction == "vertical" else max(up, 0.0)])
    size = np.linalg.norm(force)
    return force if cap is None or size <= cap else cap / size * force


def felt(dual, supports):
    """What a support feels of a dual (3,): its part along the directions that are free."""
    direction = supports["direction"]
    sideways = direction == "any" or (isinstance(direction, dict) and direction["lean"] > 0)
    return dual if sideways else dual * [0.0, 0.0, 1.0]


def residuals(arrays, settings, lam):
    """Stationarity over what stands, and off_support over what does not, from duals (V, 3)."""
    p, weight, supports = arrays["forces"], arrays["support_weight"], settings["supports"]
    cost, slope, steepest = profile(settings["penalty"])
    size = np.linalg.norm(p, axis=1)
    candidates = np.flatnonzero(arrays["candidates"])
    standing = [i for i in candidates if size[i] > 0 or i in supports["always"]]
    ratios = [cost(size[i]) / size[i] for i in standing if size[i] > 0]
    sigma = max([weight[i] * cost(size[i]) / size[i] for i in standing if size[i] > 0], default=0.0) or max(ratios, default=1.0)
    stationarity = 0.0
    for i in standing:
        gradient = felt(lam[i], supports)
        if settings["rounding"]["refit"] == "penalised" and size[i] > 0:
            gradient = gradient + weight[i] * slope(size[i]) * p[i] / size[i]
        # a support that always stands, at no force, steps as far as the largest would
        tau = (size[i] or size[standing].max() or 1.0) / sigma
        stationarity = max(stationarity, np.linalg.norm(p[i] - nearest(p[i] - tau * gradient, supports)) / tau / sigma)
    anysize = supports | {"max_force": None}
    missing = [i for i in candidates if i not in standing]
    off = [np.linalg.norm(nearest(-felt(lam[i], supports), anysize)) / (weight[i] * steepest) for i in missing]
    return stationarity, max(off, default=0.0) if np.isfinite(steepest) else None


def floating_parts(arrays):
    """The vertices of each connected part that has no fixed one, by spreading labels along edges."""
    label = np.arange(len(arrays["fixed"]))
    for _ in label:
        for a, b in arrays["edges"]:
            label[a] = label[b] = min(label[a], label[b])
    return [np.flatnonzero(label == one) for one in np.unique(label) if not arrays["fixed"][label == one].any()]


def translations(arrays, free):
    """Columns that move one such part along one axis, on the free vertices."""
    columns = []
    for part in floating_parts(arrays):
        for axis in range(3):
            move = np.zeros((len(arrays["fixed"]), 3))
            move[part, axis] = 1.0
            columns.append(move[free].ravel())
    return np.array(columns).reshape(-1, 3 * len(free)).T


def with_multipliers(arrays, settings, lam):
    """Duals (V, 3) with one vector added a floating part, so that the mean over its supports of lam + dR vanishes."""
    p, lam = arrays["forces"], lam.copy()
    slope = profile(settings["penalty"])[1]
    for part in floating_parts(arrays):
        total, count = np.zeros(3), 0
        for i in part:
            size = np.linalg.norm(p[i])
            if size == 0 and i not in settings["supports"]["always"]:
                continue
            count += 1
            total += lam[i]
            if settings["rounding"]["refit"] == "penalised" and size > 0:
                total += arrays["support_weight"][i] * slope(size) * p[i] / size
        lam[part] -= total / max(count, 1)
    return lam


def naive_figures(arrays, settings):
    """Every figure of result.json but the counters."""
    law = settings["membrane"]["springs"]
    x, p, free = arrays["positions"], arrays["forces"], np.flatnonzero(~arrays["fixed"])
    f, tension, stiffness = dense_stiffness(arrays, law)
    size = np.linalg.norm(p, axis=1)
    y = x - arrays["target"]
    cost = profile(settings["penalty"])[0]
    standing = [i for i in np.flatnonzero(arrays["candidates"]) if size[i] > 0]
    distance = sum(y[i] @ arrays["metric"][i] @ y[i] for i in free)
    penalty = sum(arrays["support_weight"][i] * cost(size[i]) for i in standing)
    scale = max(np.abs(tension).max(), size.max(), np.linalg.norm(arrays["loads"], axis=1).max())
    pull = np.concatenate([2 * arrays["metric"][i] @ y[i] for i in free])
    lam = np.zeros_like(x)
    moves = translations(arrays, free)
    # a stiffness of one of its own along each translation: what the dual is there is the multiplier's to say
    whole = stiffness + moves @ moves.T
    lam[free] = np.linalg.solve(whole, pull).reshape(-1, 3)
    stationarity, off_support = residuals(arrays, settings, with_multipliers(arrays, settings, lam))
    drift = [np.linalg.norm(pull @ moves[:, 3 * part : 3 * part + 3]) for part in range(moves.shape[1] // 3)]
    size_of_scene = np.linalg.norm(np.ptp(arrays["clean_target"], axis=0))
    stationarity = max([stationarity, *(one * size_of_scene / (distance + penalty) for one in drift)])
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
        "off_support": off_support,
        "stable": positive_definite(whole),
        "tension_min": tension.min(),
        "tension_max": tension.max(),
        "slack_share": slack.mean(),
    }
    allowed = [np.linalg.norm(nearest(p[i], settings["supports"]) - p[i]) <= 1e-9 * size[i] for i in standing]
    held = (x[arrays["fixed"]] == arrays["start"][arrays["fixed"]]).all()
    met = not p[~arrays["candidates"]].any() and all(allowed) and held
    figures["converged"] = bool(
        figures["equilibrium"] <= 1e-10
        and figures["stationarity"] <= settings["solver"]["tolerance"]
        and (figures["off_support"] is None or figures["off_support"] <= 1 + 1e-6)
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
        if value is None or isinstance(value, bool | int):
            same = said[name] == value
        else:
            same = said[name] is not None and abs(said[name] - value) <= tolerance * abs(value) + slight.get(name, 1e-15)
        if not same:
            wrong.append(f"{name} is said to be {said[name]}, recomputed {value}")
    return wrong
