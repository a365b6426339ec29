"""Axes of what is asked for: targets, penalties, weights, supports and methods; each from mild to where nothing can hold."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from stress.scenes import TWO, Case, Made, built, decades, grid, hill, planted


def smoothing(side: int) -> Iterator[Case]:
    """Eps, newtons squared."""
    for eps in [*decades(-16, 2, 2), 1e-30, 1e-300]:
        yield eps, lambda eps=eps: planted(side, TWO, 0.01, penalty__smoothing=eps)


def exponent(side: int) -> Iterator[Case]:
    """Alpha."""
    for alpha in (1.0, 0.999, 0.9, 0.7, 0.5, 0.3, 0.2, 0.1, 0.01, 1e-6):
        yield alpha, lambda alpha=alpha: planted(side, TWO, 0.01, penalty__exponent=alpha)


def exponent_and_smoothing(side: int) -> Iterator[Case]:
    """Alpha with the smallest eps."""
    for alpha in (1.0, 0.9, 0.5, 0.3, 0.1, 0.01):
        yield alpha, lambda alpha=alpha: planted(side, TWO, 0.01, penalty__exponent=alpha, penalty__smoothing=1e-16)


def weight(side: int) -> Iterator[Case]:
    """k_sparse, m^2 / N^(1/2)."""
    for value in decades(-10, 3):
        yield value, lambda value=value: planted(side, TWO, 0.01, penalty__weight=value)


def weight_of_lasso(side: int) -> Iterator[Case]:
    """k_sparse of the group lasso, m^2 / N."""
    for value in decades(-10, 2, 2):
        yield value, lambda value=value: planted(side, TWO, 0.01, penalty__weight=value, penalty__name="group-lasso")


def masts_apart(side: int) -> Iterator[Case]:
    """Vertices between two masts that pull alike, and two that pull apart, with noise, metres."""
    step = 1 / (side - 1)
    for sigma in (0.0, 1e-4, 0.01):
        for steps in (1, 2):
            for name, force in (("alike", (0.0, 0.03, 0.25)), ("apart", (0.0, 0.02, -0.2))):
                pair = ((0.25, 0.5, (0.03, 0.0, 0.3)), (0.25 + steps * step, 0.5, force))
                yield f"{steps} {name}, noise {sigma:g}", lambda pair=pair, sigma=sigma: planted(side, pair, sigma)


def spike(side: int) -> Iterator[Case]:
    """Height of one vertex above a flat target, metres, of a membrane 1 m wide."""

    def make(height: float) -> Made:
        mesh, flat = grid(side, side)
        flat[side * (side // 2) + side // 3, 2] = height
        return built(mesh, flat)

    yield from ((height, lambda height=height: make(height)) for height in (1e-12, 1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6))


def outliers(side: int) -> Iterator[Case]:
    """Five vertices of a noisy tent thrown off by so many metres."""

    def make(far: float) -> Made:
        problem, truth = planted(side, TWO, 0.005)
        target, rng = problem.scene.target.copy(), np.random.default_rng(2)
        target[rng.choice(problem.membrane.free, 5, replace=False)] += far * rng.normal(size=(5, 3))
        return problem.replace(scene=replace(problem.scene, target=target)), truth

    yield from ((far, lambda far=far: make(far)) for far in (0.0, 0.01, 0.1, 1.0, 10.0, 1e3, 1e5))


def fold(side: int) -> Iterator[Case]:
    """How far the middle of the target is folded over, metres in plan."""

    def make(over: float) -> Made:
        mesh, flat = grid(side, side)
        target = hill(flat)
        target[:, 0] -= over * np.sin(np.pi * flat[:, 0]) * np.sin(np.pi * flat[:, 1]) * np.sin(3 * np.pi * flat[:, 0])
        return built(mesh, target, membrane__rest="target", membrane__rest_scale=0.5)

    yield from ((over, lambda over=over: make(over)) for over in (0.0, 0.05, 0.1, 0.2, 0.5, 1.0))


def cliff(side: int) -> Iterator[Case]:
    """Height of a step in the target, metres."""

    def make(height: float) -> Made:
        mesh, flat = grid(side, side)
        x, y, _ = flat.T
        flat[:, 2] = height * ((x > 0.5) & (x < 1) & (y > 0) & (y < 1))
        return built(mesh, flat)

    yield from ((height, lambda height=height: make(height)) for height in (0.01, 0.1, 0.5, 1.0, 3.0, 30.0, 1e3))


def noise(side: int) -> Iterator[Case]:
    """Sigma of the noise, metres, of a membrane 1 m wide with a mesh width of 0.125."""
    yield from (
        (sigma, lambda sigma=sigma: planted(side, TWO, sigma)) for sigma in (1e-15, 1e-9, 1e-3, 0.03, 0.1, 0.3, 1.0, 10.0)
    )


def largest_force(side: int) -> Iterator[Case]:
    """max_force, newtons, where two masts of 0.25 and 0.3 would stand; the penalty resolves 1.4e-3."""
    for cap in (1e3, 0.3, 0.1, 0.03, 0.01, 3e-3, 1.5e-3, 1e-3, 1e-4, 1e-6, 1e-9):
        yield cap, lambda cap=cap: planted(side, TWO, 0.01, supports__max_force=cap)


def lean(side: int) -> Iterator[Case]:
    """Largest lean, degrees, where masts lean by about 10."""
    for angle in (90.0, 89.999, 30.0, 5.0, 1.0, 1e-3, 1e-9, 0.0):
        yield angle, lambda angle=angle: planted(side, TWO, 0.01, supports__direction={"lean": angle})


def metric(side: int) -> Iterator[Case]:
    """Metrics that do not see every direction, and weights from heavy to light."""
    for name in ("height", "normal"):
        for value in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6):
            changes = {"target__metric": name, "penalty__weight": value}
            yield f"{name}, {value:g}", lambda changes=changes: planted(side, TWO, 0.005, **changes)


PENALTIES = {
    "log-sum": {"penalty__scale": 0.02},
    "mcp": {"penalty__knee": 0.1},
    "scad": {"penalty__knee": 0.05},
    "count": {},
    "group-lasso": {},
}


def penalties(side: int) -> Iterator[Case]:
    """The other penalties, from heavy weights to light."""
    for name, keys in PENALTIES.items():
        for value in (1.0, 1e-2, 1e-4, 1e-6, 1e-9):
            yield (
                f"{name}, {value:g}",
                lambda name=name, keys=keys, value=value: planted(
                    side, TWO, 0.01, penalty__name=name, penalty__weight=value, **keys
                ),
            )


def methods(side: int) -> Iterator[Case]:
    """The other methods, from heavy weights to light, with the paper's penalty and a kinked one."""
    for method in ("reweighted-l1", "irls", "lagrangian", "greedy"):
        for name, keys in {"power": {}, "log-sum": PENALTIES["log-sum"]}.items():
            for value in (1e-1, 1e-3, 1e-5):
                yield (
                    f"{method}, {name}, {value:g}",
                    lambda method=method, name=name, keys=keys, value=value: planted(
                        side, TWO, 0.01, solver__method=method, penalty__name=name, penalty__weight=value, **keys
                    ),
                )


AXES = (
    smoothing,
    exponent,
    exponent_and_smoothing,
    weight,
    weight_of_lasso,
    masts_apart,
    spike,
    outliers,
    fold,
    cliff,
    noise,
    largest_force,
    lean,
    metric,
    penalties,
    methods,
)
