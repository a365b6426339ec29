"""Symmetry found, the membrane of representatives against the whole one, and answers with and without it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zoo

from relax.design import race
from relax.design.problem import Problem
from relax.design.search import Search
from relax.design.shape import Shape
from relax.design.solve import solve
from relax.design.symmetric import symmetric_problem
from relax.files.scenes import load_scene
from relax.membrane.equilibrium import find_equilibrium
from relax.membrane.mesh import mesh_from_faces
from relax.membrane.orbits import orbit_membrane
from relax.membrane.scene import build_scene
from relax.membrane.symmetry import find_symmetry

DATA = Path(__file__).parent.parent / "data"
CENTRE = 0.5
AXIS = [((0.0, 0.0), (0.0, 0.0, 0.3))]  # plan position from the centre, force
MIRRORS = [((x, y), (0.1 * x, 0.1 * y, 0.2)) for x, y in ((0.25, 0), (0, 0.25), (-0.25, 0), (0, -0.25))]
GENERIC = [
    ((s * a, t * b), (0.2 * s * a, 0.2 * t * b, -0.1))
    for a, b in ((3 / 8, 1 / 8), (1 / 8, 3 / 8))
    for s in (1, -1)
    for t in (1, -1)
]
TENTS = {"axis": AXIS, "mirrors": MIRRORS, "axis, mirrors and sectors": AXIS + MIRRORS + GENERIC}


def tent(masts, sigma=0.0, n=17, **changes):
    """A planted tent that has the symmetry of the square, its noise made symmetric too; returns the planted forces (V, 3)."""
    planted = zoo.planted(n, [((CENTRE + u, CENTRE + v), force) for (u, v), force in masts], **changes)
    scene = planted.scene
    if sigma:
        symmetry = find_symmetry(scene)
        noise = np.random.default_rng(0).normal(scale=sigma * np.sqrt(symmetry.order), size=scene.target.shape)
        noise[scene.fixed] = 0
        scene = replace(scene, target=scene.target + symmetry.whole(symmetry.mean(noise)))
    return scene, planted.forces


def loaded(n=8):
    return zoo.grid_scene(n, zoo.hill, "both", membrane__loads=[0.0, 0.0, -0.1], membrane__rest_scale=0.8)


def lopsided(x, y):
    """One mirror, x."""
    return zoo.hill(x, y) * (1 + 0.3 * x)


def pinwheel():
    """A square whose target is turned more the nearer to the centre: rotations without mirrors."""
    scene = zoo.grid_scene(9, zoo.hill, "both", membrane__rest_scale=0.8)
    plan = scene.target[:, :2] - CENTRE
    angle = 3 * scene.target[:, 2]
    c, s = np.cos(angle), np.sin(angle)
    turned = np.column_stack([c * plan[:, 0] - s * plan[:, 1], s * plan[:, 0] + c * plan[:, 1]]) + CENTRE
    return replace(scene, target=np.column_stack([turned, scene.target[:, 2]]))


SCENES = {
    "pavilion": (lambda: load_scene(DATA / "pavilion.toml"), "6 rotations and 6 mirrors", 12),
    "odd grid": (lambda: zoo.grid_scene(7, zoo.hill), "4 rotations and 4 mirrors", 8),
    "even grid, diagonals from corner to corner": (lambda: zoo.grid_scene(8, zoo.hill), "2 rotations and 2 mirrors", 4),
    "crossed diagonals, load": (loaded, "4 rotations and 4 mirrors", 8),
    "lopsided": (lambda: zoo.grid_scene(9, lopsided, "both", membrane__rest_scale=0.8), "1 mirror", 2),
    "load that leans": (lambda: zoo.grid_scene(7, zoo.hill, membrane__loads=[0.1, 0.0, -0.1]), "1 mirror", 2),
    "pinwheel": (pinwheel, "4 rotations", 4),
    "tent, noise": (lambda: tent(TENTS["axis, mirrors and sectors"], 0.01)[0], "4 rotations and 4 mirrors", 8),
}


@pytest.fixture(scope="module", params=SCENES)
def case(request):
    make, said, order = SCENES[request.param]
    return make(), said, order


# --- detection ---


def test_the_group_is_what_one_sees(case):
    scene, said, order = case
    found = find_symmetry(scene)
    assert str(found) == said and found.order == order


def test_every_map_takes_the_scene_to_itself(case):
    scene, *_ = case
    found = find_symmetry(scene)
    size = np.ptp(scene.target)
    edges = {frozenset(edge): spring for edge, spring in zip(scene.mesh.edges.tolist(), scene.spring_constant, strict=True)}
    assert np.array_equal(found.turns[0], np.eye(3)) and np.array_equal(found.images[0], np.arange(scene.mesh.vertices))
    assert len({image.tobytes() for image in found.images}) == found.order
    for turn, image in zip(found.turns, found.images, strict=True):
        for points in (scene.target, scene.start):
            moved = (points - found.axis) @ turn.T + found.axis
            np.testing.assert_allclose(points[image], moved, rtol=0, atol=1e-9 * size)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(turn[2], [0, 0, 1])
        for edge, spring in list(edges.items())[::7]:
            assert edges[frozenset(image[list(edge)].tolist())] == pytest.approx(spring, rel=1e-9)


def test_orbits_shares_and_fields(case):
    scene, *_ = case
    found = find_symmetry(scene)
    for vertex, (orbit, element) in enumerate(zip(found.orbit, found.element, strict=True)):
        assert found.images[element, found.representatives[orbit]] == vertex
    assert not found.element[found.representatives].any()
    np.testing.assert_allclose(np.bincount(found.orbit) / found.order, found.share, rtol=1e-15)
    field = np.random.default_rng(0).normal(size=scene.target.shape)
    whole = found.whole(found.mean(field))
    naive = np.mean([field[image] @ turn for turn, image in zip(found.turns, found.images, strict=True)], axis=0)
    np.testing.assert_allclose(whole, naive, atol=1e-14)
    np.testing.assert_allclose(found.invariant @ found.invariant, found.invariant, atol=1e-15)
    np.testing.assert_allclose(np.einsum("rij,rj->ri", found.invariant, found.mean(field)), found.mean(field), atol=1e-14)


def one(array, index, change):
    changed = array.copy()
    changed[index] += change
    return changed


VERTEX = 3 * 9 + 2  # of a 9 x 9 grid: off every mirror
BREAKS = {
    "spring constant": lambda s: {"spring_constant": one(s.spring_constant, 20, 1e-3)},
    "rest length": lambda s: {"rest_length": one(s.rest_length, 20, 1e-4)},
    "candidate": lambda s: {"candidates": s.candidates & (np.arange(81) != VERTEX)},
    "load": lambda s: {"loads": one(s.loads, (VERTEX, 2), 0.01)},
    "target vertex": lambda s: {"target": one(s.target, (VERTEX, 0), 1e-4)},
    "start vertex": lambda s: {"start": one(s.start, (VERTEX, 2), 1e-4)},
    "metric": lambda s: {"metric": one(s.metric, (VERTEX, 0, 0), 0.1)},
    "support weight": lambda s: {"support_weight": one(s.support_weight, VERTEX, 0.1)},
}


@pytest.mark.parametrize("broken", BREAKS)
def test_one_number_that_differs_leaves_no_symmetry(broken):
    scene = zoo.grid_scene(9, zoo.hill, membrane__loads=[0.0, 0.0, -0.1])
    assert find_symmetry(scene).order == 8
    assert find_symmetry(replace(scene, **BREAKS[broken](scene))) is None


def test_a_mirror_that_leaves_all_but_springs_alone_is_none():
    # alternating diagonals on an odd number of quads: a quarter turn takes diagonals to places where none runs
    assert find_symmetry(zoo.grid_scene(6, zoo.hill)).order == 4 < find_symmetry(zoo.grid_scene(6, zoo.hill, "both")).order


@pytest.mark.parametrize("name", ["bumps", "five-masts", "tent", "tent-noisy", "terrain"])
def test_scenes_without_symmetry(name):
    assert find_symmetry(load_scene(DATA / f"{name}.toml")) is None


def test_symmetry_does_not_depend_on_units_or_place():
    scene = zoo.grid_scene(9, zoo.hill)
    for scale in (1e-3, 1e3):
        moved = {key: getattr(scene, key) * scale + scale * np.array([3.0, -7.0, 0.5]) for key in ("target", "start")}
        assert find_symmetry(replace(scene, **moved)).order == 8


def test_a_scene_that_is_turned_keeps_its_symmetry():
    scene = zoo.grid_scene(9, zoo.hill)
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert find_symmetry(replace(scene, target=scene.target @ turn.T, start=scene.start @ turn.T)).order == 8


def polygon(sides):
    """A cone over a polygon: two rings and a top."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, 1 - r)]) for r in (1.0, 0.5)]
    here, there = np.arange(sides), np.roll(np.arange(sides), -1)
    quads = np.column_stack([here, there, sides + there, sides + here])
    tops = np.column_stack([sides + here, sides + there, np.full(sides, 2 * sides), np.full(sides, -1)])
    mesh = mesh_from_faces(2 * sides + 1, np.vstack([quads, tops]))
    return build_scene(zoo.settings(), mesh, np.vstack([*rings, [[0.0, 0.0, 1.0]]]), None)


@pytest.mark.parametrize(("sides", "rotations"), [(3, 3), (5, 5), (32, 32), (40, 20)])
def test_polygons_and_the_largest_order(sides, rotations):
    scene = polygon(sides)
    assert str(find_symmetry(scene)) == f"{rotations} rotations and {rotations} mirrors"
    design = solve(Problem(scene, weight=0.01))
    assert design.certificate.converged and uses_symmetry(design)


# --- the membrane of representatives ---


def symmetric_shape(scene, found, amount=0.01, seed=1):
    """Positions of representatives near the target, and of the whole."""
    rng = np.random.default_rng(seed)
    off = found.mean(rng.normal(size=scene.target.shape)) * amount * np.ptp(scene.target)
    off[scene.fixed[found.representatives]] = 0
    positions = found.mean(scene.target - found.axis) + off
    return positions, found.whole(positions) + found.axis


def on_orbits(found, membrane, nodal):
    """Generalised forces (n, 3) of the representatives for forces on the whole's free vertices."""
    whole = np.zeros((len(membrane.fixed), 3))
    whole[membrane.free] = nodal
    return (found.mean(whole) * found.share[:, None])[~membrane.fixed[found.representatives]]


def test_energy_forces_and_stiffness_are_the_wholes(case):
    scene, *_ = case
    found = find_symmetry(scene)
    membrane, orbits = scene.membrane, orbit_membrane(scene.membrane, found)
    x, whole = symmetric_shape(scene, found)
    assert found.order * orbits.energy(x) == pytest.approx(membrane.energy(whole), rel=1e-12)
    forces = membrane.forces(whole)
    size = np.abs(forces).max()
    np.testing.assert_allclose(orbits.forces(x), on_orbits(found, membrane, forces), atol=1e-12 * size)
    field, everywhere = symmetric_shape(scene, found, 1.0, 2)
    field, everywhere = field[orbits.free], (everywhere - found.axis)[membrane.free]
    for mine, its in (
        (orbits.stiffness(x), membrane.stiffness(whole)),
        (orbits.stiffness_turn(x, field), membrane.stiffness_turn(whole, everywhere)),
    ):
        assert abs(mine - mine.T).max() <= 1e-14 * abs(mine).max()
        product = (its @ everywhere.ravel()).reshape(-1, 3)
        size = np.abs(product).max()
        projected = np.einsum("vij,vj->vi", orbits.invariant[orbits.free], (mine @ field.ravel()).reshape(-1, 3))
        np.testing.assert_allclose(projected, on_orbits(found, membrane, product), atol=1e-12 * size)


def test_factors_and_columns_are_the_wholes(case):
    scene, *_ = case
    whole_problem = Problem(scene, weight=1.0)
    problem = symmetric_problem(whole_problem)
    found = problem.symmetry
    rest = find_equilibrium(problem.membrane, problem.scene.start, problem.loads)
    assert rest.found
    x = rest.positions
    whole = found.whole(x) + found.axis
    mine, its = problem.factor_at(x), whole_problem.factor_at(whole)
    assert mine.positive_definite and its.positive_definite
    assert mine.matrix.shape[0] < 2.5 * its.matrix.shape[0] / found.order + 30
    groups = np.arange(len(problem.supports.vertices))
    columns = problem.columns(mine, groups)
    supports = whole_problem.supports
    for group in groups[:: max(1, len(groups) // 8)]:
        for part in range(3):
            unit = np.zeros((len(groups), 3))
            unit[group, part] = 1
            nodal = supports.forces(problem.whole(shape_of(problem, x, unit)).amplitudes)
            moved = np.zeros_like(scene.target)
            moved[whole_problem.membrane.free] = its.solve(nodal)
            own = np.zeros_like(x)
            own[problem.membrane.free] = columns[:, 3 * group + part].reshape(-1, 3)
            np.testing.assert_allclose(own, found.mean(moved), atol=1e-11 * np.abs(columns).max())


def shape_of(problem, positions, amplitudes):
    """A shape whose amplitudes are within what the symmetry allows."""
    allowed = np.einsum("gij,gj->gi", problem.supports.invariant, amplitudes)
    return Shape(positions, allowed, None, 0)


def test_values_and_duals_are_the_wholes(case):
    scene, *_ = case
    whole_problem = Problem(scene, weight=0.3)
    problem = symmetric_problem(whole_problem)
    found = problem.symmetry
    x, _ = symmetric_shape(scene, found)
    amplitudes = np.random.default_rng(3).normal(size=problem.supports.rows.shape)
    shape = shape_of(problem, x, amplitudes)
    whole = problem.whole(shape)
    value = whole_problem.objective(whole.positions, whole.amplitudes)
    assert found.order * problem.objective(x, shape.amplitudes) == pytest.approx(value, rel=1e-10)
    field, everywhere = symmetric_shape(scene, found, 1.0, 2)
    everywhere = (everywhere - found.axis)[whole_problem.membrane.free]
    felt = np.vdot(whole_problem.supports.duals(everywhere), whole.amplitudes)
    mine = problem.supports.duals(field[problem.membrane.free])
    assert found.order * np.vdot(mine, shape.amplitudes) == pytest.approx(felt, rel=1e-10, abs=1e-10 * np.abs(mine).sum())
    forces = problem.supports.forces(shape.amplitudes)
    np.testing.assert_allclose(
        forces, on_orbits(found, scene.membrane, whole_problem.supports.forces(whole.amplitudes)), atol=1e-12
    )
    np.testing.assert_allclose(problem.supports.amplitudes(forces), shape.amplitudes, atol=1e-12)
    group, place, force = problem.candidates_at(x, shape.amplitudes)
    np.testing.assert_allclose(place + found.axis, whole.positions[scene.candidates], atol=1e-12 * np.ptp(scene.target))
    np.testing.assert_array_equal(force, whole.amplitudes)
    assert np.array_equal(np.unique(group), np.arange(len(amplitudes)))


# --- answers ---


def without(problem, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(race, "symmetric_problem", lambda _: None)
        return solve(problem)


def assert_same(design, other):
    assert design.certificate.converged and other.certificate.converged
    assert design.certificate.objective == pytest.approx(other.certificate.objective, rel=1e-8)
    assert np.array_equal(design.forces.any(axis=1), other.forces.any(axis=1))
    np.testing.assert_allclose(design.forces, other.forces, atol=1e-6 * np.abs(other.forces).max())


def uses_symmetry(design):
    return any("parts of the membrane" in sentence for sentence in design.skipped)


@pytest.mark.parametrize("sigma", [0.0, 0.005])
@pytest.mark.parametrize("masts", TENTS)
def test_planted_tents_have_the_same_answer(masts, sigma, monkeypatch):
    scene, forces = tent(TENTS[masts], sigma, penalty__weight=1e-2 if sigma else 1e-4)
    problem = Problem(scene)
    design = solve(problem)
    assert_same(design, without(problem, monkeypatch))
    assert uses_symmetry(design) and np.array_equal(design.forces.any(axis=1), forces.any(axis=1))
    # the trace is the whole membrane's
    assert design.trace.positions.shape[1:] == scene.target.shape
    assert design.trace.objective[-1] == pytest.approx(design.certificate.objective, rel=1e-6)


def test_pavilion_ends_no_higher_than_without(monkeypatch):
    """Nothing few holds its target as it is: another way down may end elsewhere."""
    problem = Problem(load_scene(DATA / "pavilion.toml"))
    design = solve(problem)
    assert design.certificate.converged
    assert design.certificate.objective <= (1 + 1e-8) * without(problem, monkeypatch).certificate.objective
    parts = "11 of 12 parts of the membrane: it has 6 rotations and 6 mirrors"
    assert f"{parts}, and the search of the whole found nothing better" in design.skipped


@pytest.mark.parametrize("step", [1, 4])
def test_an_interrupted_run_shows_the_whole_membrane(step):
    def interrupt(record):
        if record["step"] == step:
            raise KeyboardInterrupt

    design = solve(Problem(load_scene(DATA / "pavilion.toml")), callback=interrupt)
    assert design.interrupted and design.certificate.equilibrium < 1e-10
    assert design.certificate.objective == pytest.approx(min(design.trace.objective), rel=1e-9)


def test_debiased_forces_are_the_planted_ones():
    scene, forces = tent(TENTS["axis, mirrors and sectors"], penalty__weight=1e-4, rounding__refit="debiased")
    design = solve(Problem(scene))
    assert uses_symmetry(design) and design.certificate.converged
    np.testing.assert_allclose(design.forces, forces, atol=1e-9)


def test_millimetres_change_nothing():
    scene, _ = tent(TENTS["mirrors"], 0.005, penalty__weight=1e-2)
    long = {key: 1e3 * getattr(scene, key) for key in ("target", "clean_target", "start", "rest_length")}
    other = replace(scene, **long, spring_constant=1e-3 * scene.spring_constant)
    one_design, other_design = solve(Problem(scene)), solve(Problem(other, weight=1e6 * Problem(scene).weight))
    assert uses_symmetry(other_design)
    assert other_design.certificate.objective == pytest.approx(1e6 * one_design.certificate.objective, rel=1e-9)


def test_a_symmetry_that_is_only_almost_there_is_made_good_by_the_whole():
    scene, forces = tent(TENTS["mirrors"], penalty__weight=1e-4)
    off = np.random.default_rng(0).uniform(-2e-8, 2e-8, scene.target.shape)
    design = solve(Problem(replace(scene, target=scene.target + np.where(scene.fixed[:, None], 0, off))))
    assert find_symmetry(design.problem.scene).order == 8
    assert design.certificate.converged and np.array_equal(design.forces.any(axis=1), forces.any(axis=1))


def two_seats():
    """A hill that one of two seats beside its top can hold as well as both: cheaper by one, and not symmetric."""
    scene = zoo.grid_scene(9, zoo.hill, "both", membrane__rest_scale=0.8, penalty__weight=0.3)
    seats = np.zeros_like(scene.candidates)
    seats[[4 * 9 + 3, 4 * 9 + 5]] = True
    return replace(scene, candidates=seats)


def test_an_answer_that_is_not_symmetric_is_found_by_the_whole(monkeypatch):
    problem = Problem(two_seats())
    assert find_symmetry(problem.scene).order == 4
    design = solve(problem)
    assert design.certificate.converged and design.certificate.supports == 1
    assert design.certificate.objective == pytest.approx(without(problem, monkeypatch).certificate.objective, rel=1e-8)
    assert any("the search of the whole went on from there" in sentence for sentence in design.skipped)


@pytest.mark.parametrize(("weight", "confirmed"), [(0.1, True), (0.3, False), (0.8, False)])
def test_supports_that_do_not_earn_their_cost_are_not_confirmed(weight, confirmed, monkeypatch):
    problem = Problem(two_seats(), weight=weight)  # at 0.8 the symmetric answer is a saddle too
    reduced = symmetric_problem(problem)
    with monkeypatch.context() as patch:
        patch.setattr(race, "symmetric_problem", lambda _: None)
        both = solve(reduced)
    shape = reduced.whole(Shape(both.positions, reduced.supports.amplitudes(both.forces[reduced.membrane.free]), None, 0))
    assert np.count_nonzero(problem.standing(shape.amplitudes)) == 2
    assert Search(problem).confirms(shape, reduced.one_of_each(np.arange(2))) == confirmed


def test_what_cannot_use_a_symmetry_does_not():
    for changes in ({"membrane__springs": "force-density"}, {"penalty__name": "group-lasso"}, {"solver__start": "heavy"}):
        scene = build_scene(zoo.settings(penalty__weight=1e-2, **changes), *zoo.grid(9)[:1], lifted(9), None)
        assert not uses_symmetry(solve(Problem(scene)))


def lifted(n):
    _, target = zoo.grid(n)
    target[:, 2] = zoo.hill(*target.T[:2])
    return target


@pytest.mark.parametrize("n", [7, 9, 13])
def test_the_noise_of_a_target_is_that_of_the_whole(n):
    problem = Problem(zoo.grid_scene(n, lambda x, y: 5 * zoo.hill(x, y)))
    assert symmetric_problem(problem).roughness == problem.roughness
