"""Axes of the membrane: units, stiffness, prestress, meshes, loads and precision; each from mild to where nothing can hold."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from stress.scenes import TWO, Case, Made, built, decades, grid, hill, hilly, planted

import relax


def unit_system(side: int, metre: float, newton: float) -> Made:
    """The noisy tent with a metre written as `metre` and a newton as `newton`; weight and eps moved along."""
    problem, forces = planted(side, sigma=0.01)
    scene = problem.scene
    told = {section: dict(keys) for section, keys in scene.settings.items() if section != "title"}
    told["penalty"] |= {"weight": 0.01 * metre**2 / newton**0.5, "smoothing": 1e-6 * newton**2}
    moved = {name: metre * getattr(scene, name) for name in ("target", "clean_target", "start", "rest_length")}
    constants = scene.spring_constant * (newton / metre)
    told = {"title": "units", **told}
    return relax.Problem(replace(scene, **moved, spring_constant=constants, loads=newton * scene.loads, settings=told)), (
        newton * forces
    )


def lengths(side: int) -> Iterator[Case]:
    """Unit of length, eps and weight moved along."""
    yield from ((unit, lambda unit=unit: unit_system(side, unit, 1.0)) for unit in decades(-6, 6, 2))


def forces(side: int) -> Iterator[Case]:
    """Unit of force, eps and weight moved along."""
    yield from ((unit, lambda unit=unit: unit_system(side, 1.0, unit)) for unit in decades(-6, 6, 2))


def both_units(side: int) -> Iterator[Case]:
    """Both, against each other."""
    yield from ((unit, lambda unit=unit: unit_system(side, unit, 1 / unit)) for unit in decades(-6, 6, 3))


def one_stiff_edge(side: int) -> Iterator[Case]:
    """The spring constant of one inner edge, times."""

    def make(ratio: float) -> Made:
        problem, _ = built(*hilly(side), penalty__weight=0.02)
        factor = np.ones(len(problem.scene.mesh.edges))
        factor[len(factor) // 2] = ratio
        return with_springs((problem, None), factor)

    yield from ((ratio, lambda ratio=ratio: make(ratio)) for ratio in decades(-8, 8, 2))


def half_stiff(side: int) -> Iterator[Case]:
    """The spring constants of one half of the membrane, times."""

    def make(ratio: float) -> Made:
        mesh, flat = grid(side, side)
        middle = flat[mesh.edges].mean(axis=1)
        return with_springs(built(mesh, hill(flat), penalty__weight=0.02), np.where(middle[:, 0] > 0.5, ratio, 1.0))

    yield from ((ratio, lambda ratio=ratio: make(ratio)) for ratio in decades(-8, 8, 2))


def mixed_stiffness(side: int) -> Iterator[Case]:
    """Spring constants spread over so many decades, edge by edge."""

    def make(spread: int) -> Made:
        mesh, flat = grid(side, side)
        factor = 10.0 ** np.random.default_rng(1).uniform(-spread / 2, spread / 2, len(mesh.edges))
        return with_springs(built(mesh, hill(flat), penalty__weight=0.02), factor)

    yield from ((spread, lambda spread=spread: make(spread)) for spread in (0, 1, 2, 4, 6, 8, 12, 16))


def with_springs(made: Made, stiffness: np.ndarray) -> Made:
    """The same shape with springs scaled edge by edge: the forces that hold it are others, and stand everywhere."""
    problem = made[0]
    return problem.replace(scene=replace(problem.scene, spring_constant=problem.scene.spring_constant * stiffness)), None


def cable(side: int) -> Iterator[Case]:
    """EA of a cable across the membrane, newtons."""

    def make(stiffness: float) -> Made:
        path = list(range(side * (side // 2), side * (side // 2 + 1)))
        mesh, flat = grid(side, side)
        along = {"path": path, "stiffness": stiffness, "rest_scale": 0.9}
        return built(mesh, hill(flat), membrane__cables=[along], penalty__weight=0.02)

    yield from ((stiffness, lambda stiffness=stiffness: make(stiffness)) for stiffness in decades(-8, 8, 2))


def rest_scales() -> list[float]:
    """From strong prestress to slack."""
    return [1e-4, 0.1, 0.5, 0.9, 0.99, 0.999, 0.999999, 1.0, 1.001, 1.01, 1.05, 1.1, 1.3, 2.0]


def prestress(side: int) -> Iterator[Case]:
    """rest_scale, Hookean."""
    for scale in rest_scales():
        yield scale, lambda scale=scale: built(*hilly(side), membrane__rest_scale=scale)


def prestress_of_fabric(side: int) -> Iterator[Case]:
    """rest_scale, tension-only springs."""
    for scale in rest_scales():
        yield (
            scale,
            lambda scale=scale: built(*hilly(side), membrane__rest_scale=scale, membrane__springs="tension-only"),
        )


def target_prestress(side: int) -> Iterator[Case]:
    """rest_scale, rest lengths measured on the target itself."""
    for scale in rest_scales()[:-4]:
        yield scale, lambda scale=scale: built(*hilly(side), membrane__rest_scale=scale, membrane__rest="target")


def aspect(side: int) -> Iterator[Case]:
    """Length over width of every triangle."""

    def make(ratio: float) -> Made:
        mesh, flat = grid(side, side)
        return built(mesh, hill(flat) * [1.0, 1 / ratio, min(1.0, 10 / ratio)], penalty__weight=1e-3 / ratio)

    yield from ((ratio, lambda ratio=ratio: make(ratio)) for ratio in (1.0, 10.0, 100.0, 1e3, 1e4, 1e6))


def slivers(side: int) -> Iterator[Case]:
    """Length over width of one column of triangles in an even mesh."""

    def make(ratio: float) -> Made:
        mesh, flat = grid(side, side)
        x = flat[:, 0]
        flat[:, 0] = np.where(x == 0.5, 0.5 + (1 / ratio - 1) / (side - 1), x)
        return built(mesh, hill(flat), penalty__weight=0.02)

    yield from ((ratio, lambda ratio=ratio: make(ratio)) for ratio in decades(0, 12, 2))


def near_coincident(side: int) -> Iterator[Case]:
    """Distance of two neighbours over the mesh width."""

    def make(share: float) -> Made:
        mesh, flat = grid(side, side)
        middle = side * (side // 2) + side // 2
        flat[middle] = flat[middle - 1] + share * (flat[middle] - flat[middle - 1])
        return built(mesh, hill(flat), penalty__weight=0.02)

    yield from ((share, lambda share=share: make(share)) for share in (1.0, 0.1, 1e-2, 1e-4, 1e-6, 1e-8, 1e-12, 1e-15, 0.0))


def one_free(side: int) -> Iterator[Case]:
    """One free vertex held by four spokes of 1 m, lifted by so many metres."""

    def make(height: float) -> Made:
        target = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, height]])
        mesh = relax.mesh_from_faces(5, np.array([[0, 1, 4, -1], [1, 2, 4, -1], [2, 3, 4, -1], [3, 0, 4, -1]]))
        return built(mesh, target, penalty__weight=1e-3 * height**1.5, penalty__smoothing=1e-6 * min(height**2, 1.0))

    yield from ((height, lambda height=height: make(height)) for height in (1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6))


def strip(side: int) -> Iterator[Case]:
    """Vertices along a strip one free vertex wide."""

    def make(count: int) -> Made:
        mesh, flat = grid(3, count)
        flat[:, 2] = 0.05 * (flat[:, 1] == flat[count, 1]) * np.sin(np.pi * flat[:, 0]) ** 2
        flat[[count, 2 * count - 1], 2] = 0.0
        return built(mesh, flat, penalty__weight=1e-4)

    yield from ((count, lambda count=count: make(count)) for count in (3, 5, 9, 17, 41))


def components(side: int) -> Iterator[Case]:
    """Membranes beside each other that share nothing, each noisy in its own way."""

    def make(count: int) -> Made:
        mesh, flat = grid(5, 5)
        faces = [np.where(mesh.faces >= 0, mesh.faces + 25 * each, -1) for each in range(count)]
        target = np.concatenate([hill(flat, 0.2) + 1.5 * each * np.eye(3)[0] for each in range(count)])
        noise = {"sigma": 0.01, "seed": 0}
        return built(relax.mesh_from_faces(25 * count, np.concatenate(faces)), target, target__noise=noise)

    yield from ((count, lambda count=count: make(count)) for count in (1, 2, 3, 8, 16))


def held_vertices(side: int) -> Iterator[Case]:
    """Which vertices are fixed, of the hill."""
    for fixed in ("boundary", "corners", [0, side - 1, side * side - 1], [0, side * side - 1], [0], "none"):
        yield str(fixed), lambda fixed=fixed: built(*hilly(side), supports__fixed=fixed)


def load_down(side: int) -> Iterator[Case]:
    """Load on a weakly prestressed dome, newtons per square metre, down: from carried to turned over."""
    for load in (0.0, -0.001, -0.01, -0.03, -0.1, -0.3, -1.0, -10.0, -1e3, -1e6):
        yield (
            load,
            lambda load=load: built(
                *hilly(side, 0.2),
                membrane__rest="target",
                membrane__rest_scale=0.98,
                membrane__loads=[0.0, 0.0, load],
                penalty__weight=1e-3,
            ),
        )


def load_across(side: int) -> Iterator[Case]:
    """Load in the plane, newtons per square metre: it presses one side of the membrane together until it buckles."""
    for load in (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1e4):
        yield load, lambda load=load: built(*hilly(side, 0.1), membrane__loads=[load, 0.0, 0.0])


def single_precision(side: int) -> Iterator[Case]:
    """Arrays of single precision: the target rounded to it, the target's array of that type, every array of that type."""

    def rounded(sigma: float) -> Made:
        problem, truth = planted(side, TWO, sigma)
        target = problem.scene.target.astype(np.float32).astype(float)
        return problem.replace(scene=replace(problem.scene, target=target)), truth

    def handed(sigma: float) -> Made:
        mesh, flat = grid(side, side)
        return built(mesh, hill(flat).astype(np.float32), target__noise={"sigma": sigma, "seed": 0})

    def whole(sigma: float) -> Made:
        problem, truth = planted(side, TWO, sigma)
        names = ("target", "clean_target", "start", "rest_length", "spring_constant", "loads", "metric", "support_weight")
        arrays = {name: getattr(problem.scene, name).astype(np.float32) for name in names}
        return problem.replace(scene=replace(problem.scene, **arrays)), truth

    for name, make in (("rounded target", rounded), ("target of float32", handed), ("scene of float32", whole)):
        for sigma in (0.0, 0.01):
            yield f"{name}, noise {sigma:g}", lambda make=make, sigma=sigma: make(sigma)


def far_away(side: int) -> Iterator[Case]:
    """Distance of the scene from the origin, metres, of a membrane 1 m wide."""

    def make(far: float) -> Made:
        mesh, target = hilly(side)
        return built(mesh, target + far * np.eye(3)[0])

    for far in (0.0, 1.0, 1e2, 1e3, 1e4, 1.4e4, 1e6):
        yield far, lambda far=far: make(far)


AXES = (
    lengths,
    forces,
    both_units,
    one_stiff_edge,
    half_stiff,
    mixed_stiffness,
    cable,
    prestress,
    prestress_of_fabric,
    target_prestress,
    aspect,
    slivers,
    near_coincident,
    one_free,
    strip,
    components,
    held_vertices,
    load_down,
    load_across,
    single_precision,
    far_away,
)
