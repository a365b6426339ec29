"""Dense twins written as loops, straight from MATHEMATICS.md: slow, plain, and what the sparse code must agree with."""

import numpy as np


def taylor_order(function, derivative, h=1e-3):
    """Order of |F(t) - F(0) - t F'(0)| in t, from halving h: 2 where `derivative` is right and F bends, inf where it is straight.

    `function` maps a number to an array or a number; `derivative` is its derivative at 0.
    """
    start = np.asarray(function(0.0), dtype=float)
    rest = [np.linalg.norm(np.asarray(function(t)) - start - t * np.asarray(derivative)) for t in (h, h / 2)]
    if rest[0] <= 1e-13 * max(1.0, np.linalg.norm(start)):
        return np.inf
    return float(np.log2(rest[0] / rest[1]))


def _edges(membrane, x):
    """a, b, direction u, length, rest length and the law at each edge, one at a time."""
    for (a, b), rest, k in zip(membrane.edges, membrane.rest_length, membrane.spring_constant, strict=True):
        v = x[b] - x[a]
        length = np.sqrt(v @ v)
        laws = (membrane.springs.energy, membrane.springs.tension, membrane.springs.stiffness, membrane.springs.stiffness_slope)
        yield a, b, v / length, length, [float(law(np.array([length]), np.array([rest]), np.array([k]))[0]) for law in laws]


def energy(membrane, x):
    return sum(law[0] for *_, law in _edges(membrane, x))


def forces(membrane, x):
    """f on all vertices (V, 3): each edge pulls its ends together."""
    f = np.zeros_like(x)
    for a, b, u, _, law in _edges(membrane, x):
        f[a] += law[1] * u
        f[b] -= law[1] * u
    return f


def stiffness(membrane, x):
    """K on the free vertices (3n, 3n): q I + (e'' - q) u u^T an edge."""
    blocks = [
        (a, b, law[1] / length * np.eye(3) + (law[2] - law[1] / length) * np.outer(u, u))
        for a, b, u, length, law in _edges(membrane, x)
    ]
    return _summed(membrane, blocks)


def stiffness_turn(membrane, x, along):
    """T: directional derivative of each edge's block along w, term by term."""
    whole = np.zeros_like(x)
    whole[membrane.free] = along
    blocks = []
    for a, b, u, length, law in _edges(membrane, x):
        w = whole[b] - whole[a]
        rate = (law[2] - law[1] / length) / length
        block = rate * ((u @ w) * (np.eye(3) - 3 * np.outer(u, u)) + np.outer(w, u) + np.outer(u, w))
        blocks.append((a, b, block + law[3] * (u @ w) * np.outer(u, u)))
    return _summed(membrane, blocks)


def _summed(membrane, blocks):
    count = len(membrane.fixed)
    whole = np.zeros((count, 3, count, 3))
    for a, b, block in blocks:
        whole[a, :, a] += block
        whole[b, :, b] += block
        whole[a, :, b] -= block
        whole[b, :, a] -= block
    free = membrane.free
    return whole[free][:, :, free].reshape(3 * len(free), 3 * len(free))


def force_density_shape(membrane, x, applied):
    """Where a force-density net rests: one dense solve with the graph Laplacian."""
    laplacian = np.zeros((len(x), len(x)))
    for (a, b), q in zip(membrane.edges, membrane.spring_constant, strict=True):
        laplacian[a, a] += q
        laplacian[b, b] += q
        laplacian[a, b] -= q
        laplacian[b, a] -= q
    free, held = membrane.free, np.flatnonzero(membrane.fixed)
    shape = x.copy()
    shape[free] = np.linalg.solve(laplacian[np.ix_(free, free)], applied - laplacian[np.ix_(free, held)] @ x[held])
    return shape


def triangle_area(a, b, c):
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a))


def triangle_edge_areas(x, triangles):
    """{(a, b): area of the triangles beside the edge}."""
    total = {}
    for i, j, k in triangles:
        for a, b in ((i, j), (j, k), (k, i)):
            key = (int(min(a, b)), int(max(a, b)))
            total[key] = total.get(key, 0.0) + triangle_area(x[i], x[j], x[k])
    return total


def reduced(step):
    """G, b and c of a convex step with the displacement eliminated: |c + K^-1 B s|^2_M = s G s + 2 b s + c M c."""
    columns = np.linalg.inv(step.stiffness.toarray())[:, step.rows.ravel()]
    metric = step.metric.toarray()
    unsupported = step.offset + np.linalg.solve(step.stiffness.toarray(), step.load)
    return columns.T @ metric @ columns, columns.T @ metric @ unsupported, float(unsupported @ metric @ unsupported)


def group_value(quadratic, linear, weights, s):
    flat = s.ravel()
    return float(flat @ quadratic @ flat + 2 * linear @ flat + weights @ np.linalg.norm(s, axis=1))


def group_lasso(quadratic, linear, weights, rounds=20_000):
    """Minimiser of s G s + 2 b s + sum w |s_g| by proximal gradient, accelerated, starting again when it swings back."""
    pace = 1 / (2 * np.linalg.eigvalsh(quadratic)[-1])
    s = point = np.zeros((len(weights), 3))
    t = 1.0
    for turn in range(rounds):
        if turn % 250 == 249 and violation(quadratic, linear, weights, s) < 1e-13:
            break
        moved = point - pace * 2 * (quadratic @ point.ravel() + linear).reshape(-1, 3)
        size = np.linalg.norm(moved, axis=1)
        after = moved * np.maximum(0, 1 - pace * weights / np.maximum(size, 1e-300))[:, None]
        if np.vdot(point - after, after - s) > 0:
            t, point = 1.0, s
            continue
        swing = (1 + np.sqrt(1 + 4 * t * t)) / 2
        point, s, t = after + (t - 1) / swing * (after - s), after, swing
    return s


def violation(quadratic, linear, weights, s):
    """How far s is from the optimality conditions of the group lasso, relative to the weights."""
    worst = 0.0
    gradient = 2 * (quadratic @ s.ravel() + linear).reshape(-1, 3)
    for lam, w, force in zip(gradient, weights, s, strict=True):
        size = np.linalg.norm(force)
        miss = np.linalg.norm(lam + w * force / size) if size > 0 else max(np.linalg.norm(lam) - w, 0.0)
        worst = max(worst, miss / w)
    return worst
