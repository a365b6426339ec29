"""A membrane that falls apart is the sum of its parts, whatever the order of vertices, penalty, start or interrupt."""

import json
from dataclasses import replace

import numpy as np
import pytest
import zoo
from naive_judge import differences, naive_figures, result_arrays

import relax.membrane.scene
from relax.cli import run
from relax.design.optimality import judge
from relax.design.parts import PartJournal, assembled, split
from relax.design.problem import Problem
from relax.design.shape import Shape
from relax.design.solve import solve
from relax.errors import BackendError, EquilibriumError
from relax.files import load_result, write_result
from relax.iterate import Stop
from relax.membrane.mesh import Mesh

BY_VERTEX = ("target", "clean_target", "start", "loads", "fixed", "candidates", "metric", "support_weight")
LASSO = {"penalty__name": "group-lasso"}
KINDS = {
    "planted": ({}, {"penalty__weight": 1e-3}),
    "noisy": ({"sigma": 0.01}, {"penalty__weight": 1e-2}),
    "debiased": ({"sigma": 0.01}, {"penalty__weight": 1e-2, "rounding__refit": "debiased"}),
    "group lasso": ({"sigma": 0.01}, {"penalty__weight": 5e-2, **LASSO}),
    "force density": ({"sigma": 0.01}, {"penalty__weight": 1e-2, "membrane__springs": "force-density"}),
    "from the target": ({"sigma": 0.01}, {"penalty__weight": 1e-2, "solver__start": "target"}),
    "heavy": ({"sigma": 0.01}, {"penalty__weight": 1e-2, "solver__start": "heavy"}),
    "clarabel": ({"sigma": 0.01}, {"penalty__weight": 1e-2, "solver__backend": "clarabel"}),
}


def together(*scenes, seed=0):
    """One scene of several that do not touch, its vertices shuffled, and the new number of each vertex."""
    first = np.cumsum([0, *(scene.mesh.vertices for scene in scenes)])
    order = np.random.default_rng(seed).permutation(first[-1])
    number = np.argsort(order)
    edges = np.sort(number[np.vstack([scene.mesh.edges + at for scene, at in zip(scenes, first, strict=False)])], axis=1)
    ranked = np.lexsort(edges.T[::-1])
    faces = np.vstack(
        [np.where(scene.mesh.faces < 0, -1, scene.mesh.faces + at) for scene, at in zip(scenes, first, strict=False)]
    )
    mesh = Mesh(int(first[-1]), np.where(faces < 0, -1, number[faces]), edges[ranked])

    def joined(name):
        return np.concatenate([getattr(scene, name) for scene in scenes])

    arrays = {name: joined(name)[order] for name in BY_VERTEX} | {
        name: joined(name)[ranked] for name in ("rest_length", "spring_constant")
    }
    return replace(scenes[0], mesh=mesh, **arrays), number


def tents(sigma=None, **changes):
    """Two planted scenes of different size."""
    return zoo.planted(9, zoo.TWO_MASTS, sigma, 1, **changes).scene, zoo.planted(8, zoo.ONE_MAST, sigma, **changes).scene


@pytest.mark.parametrize("kind", KINDS)
def test_two_tents_side_by_side_are_the_two_tents(kind):
    planting, changes = KINDS[kind]
    alone = tents(**planting, **changes)
    whole, number = together(*alone)
    design, singles = solve(Problem(whole)), [solve(Problem(scene)) for scene in alone]
    forces, positions = (np.concatenate([getattr(single, name) for single in singles]) for name in ("forces", "positions"))
    np.testing.assert_allclose(design.forces[number], forces, rtol=0, atol=1e-10)
    np.testing.assert_allclose(design.positions[number], positions, rtol=0, atol=1e-10)
    assert design.certificate == judge(design.problem, design.positions, design.forces, design.settings["rounding"]["refit"])
    assert design.certificate.converged and design.stop == Stop.CONVERGED.value
    assert design.certificate.objective == pytest.approx(sum(single.certificate.objective for single in singles), rel=1e-10)
    assert design.factorizations == sum(single.factorizations for single in singles)
    assert design.iterations + 1 == sum(single.iterations + 1 for single in singles) == len(design.trace.objective)
    assert "one problem of 85 free vertices: 2 parts solved apart" in design.skipped
    assert all(note.startswith(("part 1 of 2, start", "part 2 of 2, start", "part")) for note in design.trace.notes)


def test_the_trace_shows_the_whole_membrane_at_rest_and_ends_at_the_result():
    whole, _ = together(*tents(0.01, penalty__weight=1e-2, solver__start="heavy"))
    seen = []
    design = solve(Problem(whole), callback=seen.append)
    trace = design.trace
    assert [record["step"] for record in seen] == list(range(design.iterations + 1))
    for step, record in enumerate(seen):
        said = judge(design.problem, trace.positions[step], trace.forces[step])
        assert said.objective == pytest.approx(record["objective"], rel=1e-12) == trace.objective[step]
        assert said.equilibrium <= 1e-10 and said.supports == record["supports"]
        assert said.stationarity == record["stationarity"]
    same = (trace.positions == design.positions).all(axis=(1, 2)) & (trace.forces == design.forces).all(axis=(1, 2))
    assert same.any()
    raw = judge(design.problem, trace.unrounded_positions, trace.unrounded_forces)
    assert raw.equilibrium <= 1e-10 and design.certificate.objective <= raw.objective * (1 + 1e-12)


def test_a_row_of_fixed_vertices_cuts_a_membrane_in_two():
    n = 9
    y, x = np.divmod(np.arange(n * n), n)
    fixed = np.flatnonzero((x == 0) | (x == n - 1) | (y == 0) | (y == n - 1) | (x == 4))
    scene = zoo.grid_scene(n, zoo.bumps, penalty__weight=1e-2, supports__fixed=fixed.tolist())
    problem = Problem(scene)
    left, right = split(problem)
    # what is fixed passes nothing on, and belongs to both
    shared = np.intersect1d(left.vertices, right.vertices)
    assert np.isin(np.flatnonzero((x == 4) & (y > 0) & (y < n - 1)), shared).all() and (x[shared] == 4).all()
    design = solve(problem)
    assert design.certificate.converged
    for part in (left, right):
        single = solve(part.problem)
        np.testing.assert_allclose(design.forces[part.vertices], single.forces, atol=1e-10)
        np.testing.assert_array_equal(part.problem.scene.target, scene.target[part.vertices])
        inner = part.problem.membrane
        place = np.flatnonzero(np.isin(scene.membrane.free, part.vertices[inner.free]))
        np.testing.assert_array_equal(inner.forces(single.positions), scene.membrane.forces(design.positions)[place])


def test_one_connected_membrane_is_no_case_and_looked_at_once(monkeypatch):
    scene = zoo.planted(9, zoo.TWO_MASTS).scene
    assert split(Problem(scene)) == ()
    monkeypatch.setattr("relax.membrane.membrane.connected_components", None)  # a second look would fail
    design = solve(Problem(scene))
    assert not any("part" in words for words in (*design.trace.notes, *design.skipped))


def test_parts_that_share_a_bundle_come_to_the_same(monkeypatch):
    scenes = [zoo.planted(n, sigma=0.01, penalty__weight=1e-2).scene for n in (6, 7, 8)]
    whole, _ = together(*scenes)
    apart = solve(Problem(whole))
    monkeypatch.setattr(relax.membrane.scene, "MOST_PARTS", 2)
    bundled = solve(Problem(replace(whole)))
    assert len(split(bundled.problem)) == 2 and len(split(apart.problem)) == 3
    assert "one problem of 77 free vertices: 3 parts solved apart, as 2 problems" in bundled.skipped
    np.testing.assert_allclose(bundled.forces, apart.forces, atol=1e-9)


def test_a_given_start_is_split_too():
    whole, _ = together(*tents(0.01, penalty__weight=1e-2, solver__start="elsewhere"))
    first = solve(Problem(replace(whole, settings=tents(0.01, penalty__weight=1e-2)[0].settings)))
    again = solve(Problem(whole), start=(first.positions, first.forces))
    assert again.iterations < first.iterations and all("start given" in note for note in again.trace.notes)
    np.testing.assert_allclose(again.forces, first.forces, atol=1e-9)


def test_a_fraction_is_one_of_the_whole_and_all_parts_have_one_weight():
    weights = {"penalty__weight": None, "penalty__weight_fraction": 0.05, **LASSO}
    alone = tents(0.01, **weights)
    design = solve(Problem(together(*alone)[0]))
    assert design.certificate.converged
    separate = [solve(Problem(scene)).problem.strength for scene in alone]
    assert design.problem.strength == pytest.approx(max(separate), rel=1e-9)


@pytest.mark.parametrize("springs", ["hookean", "force-density"])
@pytest.mark.parametrize("start", ["auto", "heavy", "target"])
@pytest.mark.parametrize("penalty", [{}, LASSO])
def test_a_part_without_candidates_and_one_at_rest_need_nothing(springs, start, penalty):
    changes = {"penalty__weight": 1e-2, "solver__start": start, "membrane__springs": springs, **penalty}
    one = zoo.planted(7, sigma=0.01, **changes).scene
    bare = zoo.grid_scene(6, zoo.hill, **changes)
    bare = replace(bare, candidates=np.zeros_like(bare.candidates))
    flat = zoo.grid_scene(5, None, **changes)
    whole, number = together(one, bare, flat)
    design, single = solve(Problem(whole)), solve(Problem(one))
    assert design.certificate.converged == single.certificate.converged
    np.testing.assert_allclose(design.forces[number][:49], single.forces, atol=1e-10)
    assert not design.forces[number][49:].any()
    np.testing.assert_allclose(design.positions[number][49:, 2], 0, atol=1e-10)


def test_what_is_wrong_with_one_part_names_it():
    one = zoo.planted(7, sigma=0.01, solver__start="heavy").scene
    loose = zoo.grid_scene(5, zoo.hill, membrane__springs="tension-only", membrane__loads=[0, 0, -1.0], solver__start="heavy")
    loose = replace(loose, rest_length=50.0 * loose.rest_length, spring_constant=1e-9 * loose.spring_constant)
    whole, number = together(one, loose)
    first = number[49:][~loose.fixed].min()
    with pytest.raises(EquilibriumError, match=f"^the part of the membrane that holds vertex {first}: the membrane without"):
        solve(Problem(whole))


def test_why_one_part_did_not_converge_is_said(monkeypatch):
    monkeypatch.setattr("relax.design.methods.sequential.ROUNDS", 1)  # Newton would find by itself what the steps do not

    def nothing(step, start):
        raise BackendError("the solver has gone away")

    one = zoo.planted(9, sigma=0.03, solver__start="heavy", penalty__weight=0.001).scene
    design = solve(Problem(together(one, one)[0]), backend=nothing)
    assert not design.certificate.converged
    assert design.stop.endswith("; part 1: the solver has gone away; part 2: the solver has gone away")
    assert any("then the solver has gone away" in note for note in design.trace.notes)


# --- interrupts ---


def interrupted_at(problem, step):
    def stop(record):
        if record["step"] == step:
            raise KeyboardInterrupt

    design = solve(problem, callback=stop)
    assert design.interrupted and design.stop == Stop.INTERRUPTED.value and design.iterations == step
    assert judge(design.problem, design.positions, design.forces, design.settings["rounding"]["refit"]) == design.certificate
    assert design.certificate.equilibrium <= 1e-10
    return design


def test_an_interrupt_in_the_second_part_keeps_the_first_and_the_best_of_the_second():
    problem = Problem(together(*tents(0.01, penalty__weight=1e-2))[0])
    part, _ = split(problem)
    first = solve(part.problem)
    second = first.iterations + 1  # the step at which the second part begins
    for step in (second, second + 2):
        design = interrupted_at(problem, step)
        np.testing.assert_allclose(design.forces[part.vertices], first.forces, atol=1e-10)
        assert design.certificate.objective == pytest.approx(design.trace.objective.min(), rel=1e-12)
    early = interrupted_at(problem, 1)
    assert early.certificate.objective == pytest.approx(early.trace.objective.min(), rel=1e-12)


def test_an_interrupt_before_the_second_part_took_a_step_keeps_the_first(monkeypatch):
    problem = Problem(together(*tents(0.01, penalty__weight=1e-2))[0])
    part, _ = split(problem)
    keep = PartJournal.__call__

    def stop_at_second(journal, record):
        if journal.index:
            raise KeyboardInterrupt
        keep(journal, record)

    monkeypatch.setattr(PartJournal, "__call__", stop_at_second)
    design = solve(problem)
    assert design.interrupted and design.certificate.equilibrium <= 1e-10
    np.testing.assert_allclose(design.forces[part.vertices], solve(part.problem).forces, atol=1e-10)


def test_an_interrupt_before_any_step_is_not_swallowed(monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(PartJournal, "__call__", stop)
    with pytest.raises(KeyboardInterrupt):
        solve(Problem(together(*tents())[0]))


# --- files ---


def test_the_result_folder_of_a_membrane_in_parts_is_checked_like_any_other(tmp_path, capfd):
    design = solve(Problem(together(*tents(0.01, penalty__weight=1e-2))[0]))
    write_result(tmp_path / "result", design)
    assert run(["check", str(tmp_path / "result")]) == 0
    assert "every figure agrees; converged" in capfd.readouterr().out
    said = json.loads((tmp_path / "result" / "result.json").read_text())
    assert (
        differences(said, naive_figures(result_arrays(design.problem.scene, design.positions, design.forces), said["settings"]))
        == []
    )
    assert said["skipped"] == list(design.skipped)
    stored = load_result(tmp_path / "result")
    assert len(split(Problem(stored.scene))) == 2
    with np.load(tmp_path / "result" / "trace.npz", allow_pickle=False) as trace:
        assert trace["positions"].shape == (said["iterations"] + 1, *design.positions.shape)


def test_parts_put_together_are_the_whole():
    whole, _ = together(*tents())
    problem, rng = Problem(whole), np.random.default_rng(2)
    positions = whole.start.copy()
    positions[~whole.fixed] += rng.normal(size=(int((~whole.fixed).sum()), 3))
    amplitudes = rng.normal(size=(len(problem.supports.vertices), 3))
    parts = split(problem)
    shapes = [Shape(positions[part.vertices], amplitudes[part.candidates], None, 2) for part in parts]
    back = assembled(problem, parts, shapes)
    np.testing.assert_array_equal(back.positions, positions)
    np.testing.assert_array_equal(back.amplitudes, amplitudes)
    assert back.factorizations == 4
    for part in parts:
        np.testing.assert_array_equal(
            part.problem.all_forces(amplitudes[part.candidates]), problem.all_forces(amplitudes)[part.vertices]
        )
