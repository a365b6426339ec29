"""What a design says it skipped is true, has its count, and is not said where it did not happen."""

import re
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
import zoo

from relax.design.problem import Problem
from relax.design.rounding import round_supports
from relax.design.solve import solve
from relax.factor import Factor, ScalarFactor
from relax.factor.symbolic import find_engine
from relax.membrane.chords import Chords
from relax.membrane.membrane import Membrane

LINEAR = {"membrane__springs": "force-density"}


def skipped(scene, words, **options):
    """The sentence with `words` in it, None where there is none."""
    found = [sentence for sentence in solve(Problem(scene), **options).skipped if words in sentence]
    assert len(found) <= 1
    return found[0] if found else None


def noisy(**changes):
    return zoo.planted(9, zoo.TWO_MASTS, 0.01, penalty__weight=5e-3, **changes).scene


@pytest.mark.parametrize("options", [{}, LINEAR, {"solver__backend": "working-set"}, {"penalty__name": "group-lasso"}])
def test_the_candidates_never_looked_at_are_those_whose_columns_were_not_made(options, monkeypatch):
    made = set()

    def noting(columns):
        def noted(factor, rows):
            if factor.matrix.shape[0] == 3 * 49:  # not the scalar factorisation within
                made.update((rows // 3).tolist())
            return columns(factor, rows)

        return noted

    for kind in (Factor, ScalarFactor):
        monkeypatch.setattr(kind, "inverse_columns", noting(kind.inverse_columns))
    said = skipped(noisy(**options), "never looked at")
    left = 49 - len(made)
    assert made and said == (f"columns of K^-1 for {left} of 49 candidates: they were never looked at" if left else None)


def test_a_cone_program_looks_at_everybody():
    assert skipped(noisy(solver__backend="clarabel"), "never looked at") is None


def test_fixed_vertices_are_no_unknowns():
    assert skipped(noisy(), "fixed") == "96 unknowns: those of the 32 fixed vertices are eliminated"


def test_a_linear_membrane_has_one_factorisation_and_no_other_has():
    assert "x, y and z share a scalar one" in skipped(noisy(**LINEAR), "factorisations of K but one")
    assert skipped(noisy(), "factorisations of K but one") is None
    assert skipped(noisy(**LINEAR), "sparsity pattern") is None


def test_the_pattern_is_analysed_once_for_the_factorisations_that_the_design_counts():
    made, scene = [], noisy()
    with patch("relax.factor.symbolic.find_engine", lambda name: lambda *given: made.append(given) or find_engine(name)(*given)):
        design = solve(Problem(scene))
    assert len(made) == 1
    assert f"the analysis of the sparsity pattern: once a mesh, for {design.factorizations} factorisations" in design.skipped
    assert design.factorizations > 1


def test_reused_factorisations_are_counted_from_the_steps():
    design = solve(Problem(noisy()))
    (said,) = (sentence for sentence in design.skipped if sentence.startswith("a factorisation in"))
    reused, compared = (int(word) for word in said.split() if word.isdigit())
    assert 0 < reused <= compared == design.iterations
    with (
        patch.object(Chords, "pay", lambda *_: False),
        patch.object(Factor, "refine", lambda *_: None),
    ):
        assert skipped(noisy(), "a factorisation in") is None


def test_columns_are_said_to_be_kept_only_where_they_are():
    assert "of the Newton steps" in skipped(zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-4).scene, "columns and curvature")
    with patch("relax.design.refit.FAST", 0.0):
        assert skipped(zoo.planted(9, zoo.TWO_MASTS, penalty__weight=1e-4).scene, "columns and curvature") is None


def test_trials_are_said_to_be_broken_off_only_where_they_are():
    broken = zoo.grid_scene(13, zoo.bumps, penalty__weight=1e-2)
    assert re.fullmatch(r"the rest of (one trial|\d+ trials): broken off, .*", skipped(broken, "broken off"))
    with patch("relax.design.trial.lies_above", lambda *_: False):
        assert skipped(broken, "broken off") is None


def test_pivots_are_proven_only_where_every_edge_is_taut():
    assert skipped(noisy(), "proven") is not None
    with patch.object(Membrane, "_pivot_bound", lambda *_: 0.0):
        assert skipped(noisy(), "proven") is None


def test_a_second_round_is_skipped_only_where_nothing_is_missing():
    assert skipped(noisy(), "a second round") == "a second round of steps: nothing was pruned, no candidate is missing"
    rounds = []

    def missing_once(problem, shape, keep, progress):
        result = round_supports(problem, shape, keep, progress)
        rounds.append(result)
        if len(rounds) > 1:
            return result
        missing = np.zeros_like(result.missing)
        missing[0] = True
        return replace(result, missing=missing)

    with patch("relax.design.methods.sequential.round_supports", missing_once):
        assert skipped(noisy(), "a second round") is None
    assert len(rounds) > 1


def test_cvxpy_is_not_imported_unless_asked_for():
    assert skipped(noisy(), "cvxpy") is not None
    assert skipped(noisy(solver__backend="cvxpy"), "cvxpy") is None


def test_vertical_supports_spare_two_columns_of_three():
    scene = zoo.planted(9, sigma=0.01, supports__direction="up").scene
    skipped = solve(Problem(scene)).skipped
    said = next(sentence for sentence in skipped if "each candidate needs one, not three" in sentence)
    looked = len(Problem(scene).supports.vertices) - int(
        next(sentence for sentence in skipped if "never looked at" in sentence).split()[4].replace(",", "")
    )
    assert int(said.split()[0]) == 2 * looked
    assert not any("not three" in sentence for sentence in solve(Problem(zoo.planted(9, sigma=0.01).scene)).skipped)
