"""What the recovery study plants is what it says, and what it counts is right by hand."""

from dataclasses import replace

import numpy as np
import pytest
import recovered
import recovery

import relax

CASE = {"seed": 7, "edges": 10, "masts": 3, "spacing": 3, "noise": 0.02}
RUN = {"penalty": "power", "exponent": 0.5, "method": "sequential", "level": 500.0}


@pytest.fixture(scope="module")
def planted():
    return recovered.plant(**CASE)


def test_masts_stand_as_far_apart_as_asked_and_off_the_edge():
    for seed in range(20):
        for masts, spacing in ((2, 1), (3, 3), (6, 2)):
            vertices = np.array(recovered.places(np.random.default_rng(seed), 14, masts, spacing))
            assert len(set(vertices)) == masts
            assert spacing <= recovered.nearest(vertices, 14) < spacing + 1
            assert all(recovered.MARGIN <= each <= 14 - recovered.MARGIN for each in (*(vertices // 15), *(vertices % 15)))
    crowd = np.array(recovered.places(np.random.default_rng(0), 10, 8, 6))
    assert len(set(crowd)) == 8 and 1 <= recovered.nearest(crowd, 10) < 6


def test_the_clean_target_is_at_rest_under_the_planted_forces_and_the_noise_is_as_asked(planted):
    scene = planted.scene
    left = relax.judge(relax.Problem(scene, weight=1.0), scene.clean_target, planted.forces)
    assert left.equilibrium < 1e-12 and left.stable and len(planted.vertices) == 3
    heights = scene.clean_target[planted.vertices, 2]
    assert planted.sigma == pytest.approx(0.02 * heights.mean())
    moved = (scene.target - scene.clean_target)[~scene.fixed]
    assert moved.std() == pytest.approx(planted.sigma, rel=0.15)  # 243 numbers: a standard error of 5 %
    size = np.linalg.norm(planted.forces[planted.vertices], axis=1)
    assert (size >= 0.2).all() and (size <= 0.4).all()
    assert np.degrees(np.arccos(planted.forces[planted.vertices, 2] / size)).max() <= 15


def test_a_typical_mast_costs_the_level_times_the_variance_under_every_penalty(planted, monkeypatch):
    seen = []
    solve = relax.solve
    monkeypatch.setattr(relax, "solve", lambda problem, **asked: seen.append(problem) or solve(problem, **asked), raising=False)
    typical = np.array([np.median(np.linalg.norm(planted.forces[planted.vertices], axis=1))])
    for penalty, exponent in recovery.PENALTIES:
        row = recovered.measure({**CASE, **RUN, "penalty": penalty, "exponent": exponent})
        assert set(row) == set(recovered.COLUMNS) and row["converged"]
        problem = seen.pop()
        cost = problem.strength * problem.penalty.value(typical)[0]
        assert cost == pytest.approx(500 * planted.sigma**2)


def test_agreement_by_hand(planted):
    true = planted.vertices
    forces = np.zeros_like(planted.forces)
    assert recovered.agreement(planted, forces)["precision"] is None and recovered.force_error(planted, forces) is None
    forces[true[0]] = 1.1 * planted.forces[true[0]]
    forces[true[1] + 1] = forces[true[1] - 1] = [0, 0, 0.1]  # both within an edge of one mast: one of them counts
    found = recovered.agreement(planted, forces)
    assert (found["supports"], found["hits"], found["near"]) == (3, 1, 2)
    assert (found["precision"], found["recall"]) == (pytest.approx(1 / 3), pytest.approx(1 / 3))
    assert found["near_precision"] == pytest.approx(2 / 3) == found["near_recall"]
    assert recovered.force_error(planted, forces) == pytest.approx(0.1)


def test_debiasing_without_noise_gives_the_planted_forces():
    row = recovered.measure({**CASE, **RUN, "noise": 0.0, "level": 10000.0})
    assert row["hits"] == row["supports"] == 3
    assert row["debiased_error"] < 1e-8 and row["force_error"] > 1e-4
    assert row["debiased_clean"] < 1e-9 * row["height"]


def test_every_factor_takes_its_levels_equally_often():
    scenes = recovery.design()
    assert len(scenes) >= 200
    for name, levels in {
        "noise": recovery.NOISE,
        "masts": recovery.MASTS,
        "spacing": recovery.SPACING,
        "edges": recovery.EDGES,
    }.items():
        counts = [sum(scene[name] == level for scene in scenes) for level in levels]
        assert max(counts) - min(counts) <= 1
    cases = recovery.all_cases("full")
    assert {(case["penalty"], case["exponent"], case["seed"]) for case in cases} >= {
        (*penalty, scene["seed"]) for penalty in recovery.PENALTIES for scene in scenes
    }


def run(cost, hits, supports, misfit):
    found = {"hits": hits, "supports": supports, "rms": misfit, "expected": 1.0}
    return recovery.Run(0, ("power", 0.5, "sequential"), cost, {"masts": 4}, found)


def test_the_weight_is_the_heaviest_that_the_noise_explains():
    light, middle, heavy = run(3, 4, 9, 0.9), run(10, 4, 4, 1.05), run(30, 2, 2, 1.4)
    assert recovery.by_discrepancy([light, middle, heavy]) is middle and middle.exact
    assert recovery.by_discrepancy([replace(light, found={**light.found, "rms": 2.0}), heavy]).cost == 3
    assert recovery.by_truth([light, middle, heavy]) is middle
    assert heavy.f1 == pytest.approx(2 * 1 * 0.5 / 1.5)  # precision 1, recall 1/2


def test_intervals():
    # Newcombe 1998, table I: 81 of 263 gives .2553 to .3662 by Wilson's method
    assert recovery.wilson(81, 263) == (pytest.approx(0.2553, abs=5e-5), pytest.approx(0.3662, abs=5e-5))
    low, high = recovery.bootstrap([0.0, 1.0] * 200)
    assert low == pytest.approx(0.5 - 1.96 * 0.025, abs=0.005) and high == pytest.approx(0.5 + 1.96 * 0.025, abs=0.005)
    assert recovery.bootstrap([0.25] * 30) == (0.25, 0.25)
