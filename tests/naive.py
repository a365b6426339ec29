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


def prox(value, size, step):
    """The least of (t - size)^2 / 2 + step value(t) over t >= 0 and where it is: a fine grid, then finer ones around its hollows.

    `value` maps an array to an array. The constant size^2 / 2 is left out; the smaller t of equals.
    """

    def total(t):
        return t * (t / 2 - size) + step * value(t)

    grid = np.unique(
        np.concatenate(
            [np.linspace(0, size, 2001), size * np.geomspace(1e-14, 1, 2001), size - size * np.geomspace(1e-14, 1, 1001)]
        )
    )
    height = total(grid)
    walled = np.concatenate([[np.inf], height, [np.inf]])
    hollows = np.flatnonzero((height <= walled[:-2]) & (height <= walled[2:]))
    best = (float(height[0]), 0.0)
    for hollow in hollows[np.argsort(height[hollows], kind="stable")[:4]]:
        low, high = grid[max(hollow - 1, 0)], grid[min(hollow + 1, len(grid) - 1)]
        for _ in range(12):
            fine = np.linspace(low, high, 41)
            lowest = int(np.argmin(total(fine)))
            best = min(best, (float(total(fine)[lowest]), float(fine[lowest])))
            low, high = fine[max(lowest - 1, 0)], fine[min(lowest + 1, 40)]
    return best


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

    def forward(point):
        moved = point - pace * 2 * (quadratic @ point.ravel() + linear).reshape(-1, 3)
        size = np.linalg.norm(moved, axis=1)
        return moved * np.maximum(0, 1 - pace * weights / np.maximum(size, 1e-300))[:, None]

    def ended(turn, s, _point, _after):
        return turn % 250 == 249 and violation(quadratic, linear, weights, s) < 1e-13

    return accelerated(forward, np.zeros((len(weights), 3)), ended, rounds)


def accelerated(forward, s, ended, rounds):
    """A fixed point of `forward` from s: Nesterov's momentum, which starts again when it swings back."""
    point, t = s, 1.0
    for turn in range(rounds):
        after = forward(point)
        if ended(turn, s, point, after):
            break
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


def dynamic_relaxation(membrane, x, applied, steps, margin):
    """`steps` explicit steps of leap-frog with kinetic damping, vertex by vertex, for Hookean springs: masses never change."""
    free = membrane.free
    mass = np.zeros(len(x))
    for (a, b), k in zip(membrane.edges, membrane.spring_constant, strict=True):
        mass[a] += margin / 2 * k
        mass[b] += margin / 2 * k
    x, velocity, energies = x.copy(), np.zeros_like(x), [0.0, 0.0]
    standing = True
    for _ in range(steps):
        force = forces(membrane, x)
        force[free] += applied
        after = velocity.copy()
        for i in free:
            after[i] += force[i] / mass[i] * (0.5 if standing else 1.0)
        energy = sum(0.5 * mass[i] * after[i] @ after[i] for i in free)
        if energy < energies[-1]:
            a, b, c = energies[-2], energies[-1], energy
            top = (a - c) / (2 * (a - 2 * b + c))  # of the parabola through (-1, a), (0, b), (1, c)
            x[free] -= (0.5 - top) * velocity[free]  # b is the energy half a step ago
            velocity, energies, standing = np.zeros_like(x), [0.0, 0.0], True
            continue
        x[free] += after[free]
        velocity, standing = after, False
        energies.append(energy)
    return x


def chain_shape(count, span, rest, stiffness, weight):
    """Nodes (count + 2, 2) of a chain of equal springs hung between two points of one height, `weight` at each inner node.

    The horizontal pull H is the same everywhere, the vertical one of edge j is that of the nodes on the way to the middle.
    """
    lift = weight * (count / 2 - np.arange(count + 1))  # vertical pull of each edge at its left end, upwards on the support

    def edges(pull):
        tension = np.hypot(pull, lift)
        length = rest + tension / stiffness
        return np.column_stack([length * pull / tension, -length * lift / tension])

    low, high = 1e-12, stiffness * span
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if edges(middle)[:, 0].sum() < span else (low, middle)
    return np.vstack([[0.0, 0.0], np.cumsum(edges(low), axis=0)])


def nearest_in_cone(v, tangent):
    """The nearest vector that leans at most by the angle whose tangent is given, by angles; None: v itself."""
    if tangent is None:
        return v
    across, up = np.linalg.norm(v[:-1]), v[-1]
    lean, largest = np.arctan2(across, up), np.arctan(tangent)
    if lean <= largest:
        return v
    if lean >= largest + np.pi / 2 or (len(v) == 1 and up <= 0):
        return np.zeros_like(v)
    side = np.append(v[:-1] / across * np.sin(largest), np.cos(largest))
    return (v @ side) * side


def nearest(v, reach):
    """The nearest force that a support can carry."""
    inner = nearest_in_cone(v, reach.tangent)
    size = np.linalg.norm(inner)
    return inner if size <= reach.largest else inner * (reach.largest / size)


def step_value(step, s):
    """The value of a convex step at amplitudes, group by group."""
    quadratic, linear, constant = reduced(step)
    cost = sum(w * np.linalg.norm(one) + b * one @ one for w, b, one in zip(step.weights, step.bends, s, strict=True))
    flat = s.ravel()
    return float(constant + flat @ quadratic @ flat + 2 * linear @ flat + cost)


def step_optimum(step, rounds=20_000):
    """The optimum of a convex step by proximal gradient, accelerated, starting again when it swings back."""
    quadratic, linear, _ = reduced(step)
    quadratic = quadratic + np.diag(np.repeat(step.bends, step.rows.shape[1]))
    pace = 1 / (2 * np.linalg.eigvalsh(quadratic)[-1])

    def forward(point):
        moved = point - pace * 2 * (quadratic @ point.ravel() + linear).reshape(point.shape)
        after = np.zeros_like(point)
        for g, v in enumerate(moved):
            inner = nearest_in_cone(v, step.reach.tangent)
            size = np.linalg.norm(inner)
            if size > pace * step.weights[g]:
                after[g] = inner / size * min(size - pace * step.weights[g], step.reach.largest)
        return after

    def ended(turn, _s, point, after):
        return turn % 50 == 0 and np.abs(after - point).max() < 1e-16 * np.abs(after).max()

    return accelerated(forward, np.zeros(step.rows.shape), ended, rounds)


def step_violation(step, s):
    """How far s is from stationary in a convex step, |s - P(s - gradient)| a group, relative to the largest gradient at none.

    P as the nearest force is not the prox: the norm's own slope is taken along s, and where s is 0 the pull is compared with w.
    """
    quadratic, linear, _ = reduced(step)
    gradient = 2 * (quadratic @ s.ravel() + linear).reshape(s.shape)
    largest, worst = 2 * np.abs(linear).max(), 0.0
    for lam, w, b, force in zip(gradient, step.weights, step.bends, s, strict=True):
        size = np.linalg.norm(force)
        if size == 0:
            worst = max(worst, (np.linalg.norm(nearest_in_cone(-lam, step.reach.tangent)) - w) / largest)
            continue
        slope = lam + w * force / size + 2 * b * force
        pace = size / largest  # the step of a projected gradient, of the size of the force
        worst = max(worst, np.linalg.norm(force - nearest(force - pace * slope, step.reach)) / size)
    return worst
