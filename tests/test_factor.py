import gc
import pickle
import weakref
from dataclasses import replace

import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array, kron

from relax.errors import EquilibriumError, InputError
from relax.factor import Factor, ScalarFactor, Symbolic, available_engines, superlu
from relax.factor.symbolic import ENGINES, find_engine

few = settings(derandomize=True, max_examples=100, deadline=None)
seeds = st.integers(0, 100_000)
every_engine = pytest.mark.parametrize("engine", list(ENGINES))


@pytest.fixture(autouse=True)
def installed(request):
    engine = getattr(request.node, "callspec", None) and request.node.callspec.params.get("engine")
    if engine and engine not in available_engines():
        pytest.skip(f"{ENGINES[engine][0]} is not installed: pip install 'relax-tensile[{engine}]'")


def spectrum(seed, values):
    """A dense symmetric matrix with these eigenvalues."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(values), len(values))))[0]
    matrix = q @ np.diag(values) @ q.T
    return (matrix + matrix.T) / 2


def sparse_symmetric(seed, definite):
    """A random sparse matrix, well conditioned, and its dense twin."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 13))
    dense = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.3)
    dense = dense + dense.T + np.diag(rng.uniform(*((5, 9) if definite else (-1, 1)), n))
    values = np.linalg.eigvalsh(dense)
    return dense if np.abs(values).min() > 1e-3 * np.abs(values).max() else spectrum(seed, np.where(np.arange(n) % 3, 1.0, -1.0))


def factorised(dense, engine, **more):
    return Factor(csc_array(dense), Symbolic(engine=engine), **more)


# verdicts


@every_engine
@few
@given(seed=seeds, definite=st.booleans())
def test_the_verdict_is_that_of_the_eigenvalues(engine, seed, definite):
    dense = sparse_symmetric(seed, definite)
    factor = factorised(dense, engine)
    assert factor.positive_definite == (np.linalg.eigvalsh(dense)[0] > 0)
    assert not factor.singular


@every_engine
@few
@given(seed=seeds)
def test_the_verdict_does_not_depend_on_units(engine, seed):
    dense = sparse_symmetric(seed, definite=True)
    unit = 10 ** np.random.default_rng(seed).uniform(-8, 8, len(dense))
    factor = factorised(unit[:, None] * dense * unit, engine)
    assert factor.positive_definite == (np.linalg.eigvalsh(dense)[0] > 0)
    right = np.random.default_rng(seed).normal(size=len(dense))
    if factor.positive_definite:
        assert np.allclose(unit * factor.solve(right * unit), np.linalg.solve(dense, right), atol=1e-9)


def test_pivots_are_read_beside_their_own_diagonal_entries():
    """Eight unknowns of sizes a thousandfold apart, in an order that SuperLU permutes once more by its elimination tree."""
    unit = 10.0 ** np.array([0, 3, 0, 3, 0, 3, 0, 3])
    dense = np.diag([1e-12, 1, 1, 1, 1, 1, 1, 1]) + 0.1 * (np.eye(8, k=4) + np.eye(8, k=-4)) * np.outer([0, 1] * 4, [0, 1] * 4)
    numeric = superlu.SuperLUAnalysis(csc_array(dense), 1).factorise(csc_array(unit[:, None] * dense * unit), 0.0)
    diagonal = numeric.factor.U.diagonal()[numeric.factor.perm_c] / numeric.diagonal
    assert numeric.definite and diagonal.max() == 1.0 and diagonal.min() == pytest.approx(0.99)


@every_engine
@pytest.mark.parametrize("smallest", [1e-8, -1e-8, -1.0])
def test_one_eigenvalue_decides(engine, smallest):
    factor = factorised(spectrum(1, [smallest, 1.0, 2.0, 3.0, 50.0]), engine)
    assert factor.positive_definite == (smallest > 0)
    assert not factor.singular


@every_engine
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_a_negative_pivot_anywhere_is_seen(engine, order):
    dense = np.array([[2.0, 1, 0], [1, 2, 3], [0, 3, 2]])[np.ix_(order, order)]  # positive diagonal, indefinite
    assert np.linalg.eigvalsh(dense)[0] < 0
    assert not factorised(dense, engine).positive_definite


@every_engine
def test_a_pivot_that_vanishes_on_the_way_is_no_positive_one(engine):
    dense = np.array([[1.0, 2, 1], [2, 1, 1], [1, 1, 1]])  # rows are swapped, and then all pivots are positive
    assert np.linalg.eigvalsh(dense)[0] == pytest.approx(-1)
    factor = factorised(dense, engine)
    assert not factor.positive_definite
    assert np.allclose(factor.solve(np.ones(3)), np.linalg.solve(dense, np.ones(3)))


@every_engine
def test_an_empty_diagonal_is_no_matter_for_an_indefinite_matrix(engine):
    factor = factorised([[0.0, 2], [2, 0]], engine)
    assert not factor.positive_definite
    assert not factor.singular
    assert np.allclose(factor.solve(np.array([2.0, 4.0])), [2, 1])


SINGULAR = {
    "zero": np.zeros((2, 2)),
    "empty": csc_array((3, 3)),
    "slack": np.diag([1.0, 0, 1]),
    "rank one": np.ones((3, 3)),
    "indefinite": np.diag([1.0, 0, -1]),
    "free spring": np.array([[1.0, -1], [-1, 1]]),
    "not a number": np.diag([1.0, np.nan]),
    "infinite": np.diag([1.0, np.inf]),
}


@every_engine
@pytest.mark.parametrize("matrix", SINGULAR.values(), ids=SINGULAR.keys())
def test_exactly_singular(engine, matrix):
    factor = factorised(matrix, engine)
    assert factor.singular
    assert not factor.positive_definite


@every_engine
@few
@given(seed=seeds)
def test_singular_up_to_round_off(engine, seed):
    rank = 1 + seed % 7
    dense = spectrum(seed, np.concatenate([[0.0], np.random.default_rng(seed).uniform(0.5, 2, rank)]))
    factor = factorised(dense, engine)
    assert factor.singular
    assert not factor.positive_definite


@every_engine
@pytest.mark.parametrize("left", [1e-2, 1e-6, 1e-9, 1e-15, 0.0, -1e-15, -1e-9, -1e-6, -1e-2])
def test_a_chain_that_hardly_hangs_on_its_anchor(engine, left):
    """The smallest eigenvalue of 20 springs in a row goes with the anchor: its sign is told down to round-off."""
    chain = np.diag(np.r_[1.0, np.full(18, 2.0), 1.0]) - np.eye(20, k=1) - np.eye(20, k=-1)
    chain[0, 0] += left
    factor = factorised(chain, engine)
    assert factor.positive_definite == (left > 1e-12)
    assert factor.singular == (abs(left) < 1e-12)


@every_engine
@pytest.mark.parametrize("seed", range(8))
def test_a_membrane_that_nothing_holds_is_singular_by_its_translations_alone(engine, seed):
    scene = zoo.irregular_scene(seed=seed)
    loose = type(scene.membrane)(
        scene.mesh.edges, scene.rest_length, scene.spring_constant, scene.membrane.springs, np.zeros(25, dtype=bool), engine
    )
    bare, held = factorised(loose.stiffness(scene.target), engine), loose.factor_at(scene.target)
    assert bare.singular and not bare.positive_definite
    assert held.positive_definite and not held.singular  # one vertex held: every edge is taut
    rest = replace(loose, rest_length=np.linalg.norm(loose.edge_vectors(scene.target), axis=1)).factor_at(scene.target)
    assert not rest.positive_definite  # unstressed it can be turned, and bent along its edges


def test_a_proof_spares_the_trial_and_the_look_at_the_pivots():
    class Untried:
        definite = True

        def solve(self, right):
            raise AssertionError("a trial solve")

        def factorise(self, matrix, pivot_bound):
            return self

    symbolic = Symbolic(engine=lambda pattern, block: Untried())
    assert Factor(csc_array(np.eye(3)), symbolic, 1e-3).positive_definite
    with pytest.raises(AssertionError, match="a trial solve"):
        _ = Factor(csc_array(np.eye(3)), symbolic).positive_definite
    assert superlu._Diagonal(None, np.arange(3), np.ones(3), 1e-3).definite  # without a factor whose D could be read


@every_engine
def test_a_proof_that_the_engine_cannot_follow_is_none(engine):
    assert not factorised(np.array([[1.0, 1], [1, 1]]), engine, pivot_bound=1e-3).positive_definite


# solutions


@every_engine
@few
@given(seed=seeds)
def test_solutions_solve_in_each_shape_and_memory_order(engine, seed):
    dense = sparse_symmetric(seed, definite=False)
    factor, n = factorised(dense, engine), len(dense)
    right = np.random.default_rng(seed).normal(size=(n, 4))
    answer = np.linalg.solve(dense, right)
    for way in (right, np.asfortranarray(right)):
        assert np.allclose(factor.solve(way), answer, atol=1e-9)
    assert np.allclose(factor.solve(right[:, 0]), answer[:, 0], atol=1e-9)
    if n % 3 == 0 and n != 3:  # (3, 3) is three columns
        points = right[:, 0].reshape(-1, 3)
        assert np.array_equal(factor.solve(points), factor.solve(right[:, 0]).reshape(-1, 3))


@every_engine
@few
@given(seed=seeds, definite=st.booleans())
def test_columns_of_the_inverse(engine, seed, definite):
    dense = sparse_symmetric(seed, definite)
    rows = np.random.default_rng(seed).integers(0, len(dense), 5)  # some twice
    assert np.allclose(factorised(dense, engine).inverse_columns(rows), np.linalg.inv(dense)[:, rows], atol=1e-9)
    assert factorised(dense, engine).inverse_columns(rows[:0]).shape == (len(dense), 0)


@every_engine
def test_engines_agree_on_a_membrane(engine):
    scene = zoo.irregular_scene()
    right = np.random.default_rng(0).normal(size=(len(scene.membrane.free), 3))
    for shape, definite in ((scene.target, True), (0.5 * scene.target, False)):
        stiffness = scene.membrane.stiffness(shape)
        twin, factor = np.linalg.solve(stiffness.toarray(), right.ravel()), Factor(stiffness, Symbolic(3, engine))
        assert factor.positive_definite == (np.linalg.eigvalsh(stiffness.toarray())[0] > 0) == definite
        assert np.linalg.norm(factor.solve(right).ravel() - twin) < 1e-12 * np.linalg.norm(twin)
        assert factor.fill >= np.count_nonzero(np.tril(stiffness.toarray()))


@few
@given(seeds)
def test_without_pivots_the_answer_is_as_good_or_not_taken(seed):
    dense = sparse_symmetric(seed, definite=False)
    dense[0, 0] = dense[-1, -1] = 1e-9  # a pivot without reason to be large: L grows a billionfold
    right, factor = np.random.default_rng(seed).normal(size=len(dense)), factorised(dense, "superlu")
    if not factor.singular:
        answer = factor.solve(right)
        assert np.linalg.norm(dense @ answer - right) < 1e-13 * (
            np.linalg.norm(dense) * np.linalg.norm(answer) + np.linalg.norm(right)
        )


@every_engine
@few
@given(seed=seeds, definite=st.booleans())
def test_refinement_solves_a_matrix_nearby_and_says_when_it_is_too_far(engine, seed, definite):
    dense = sparse_symmetric(seed, definite)
    rng = np.random.default_rng(seed)
    right, factor = rng.normal(size=len(dense)), factorised(dense, engine)
    near = dense + 5e-4 * np.abs(np.linalg.eigvalsh(dense)).min() * spectrum(seed, rng.uniform(-1, 1, len(dense)))
    assert np.allclose(factor.refine(csc_array(near), right), np.linalg.solve(near, right), rtol=1e-9, atol=1e-11)
    assert factor.refine(csc_array(3 * dense), right) is None
    begun, answer, solves = [], np.linalg.solve(near, right), []
    for start in (None, answer * (1 + 1e-9), np.zeros_like(right)):
        solves.clear()
        counted = Factor(factor.matrix, factor.symbolic)
        counted.solve = lambda given, own=counted: (solves.append(1), Factor.solve(own, given))[1]
        assert np.allclose(counted.refine(csc_array(near), right, start), answer, rtol=1e-9, atol=1e-11)
        begun.append(len(solves))
    assert begun[1] < begun[0] == begun[2]  # what is known already costs no solve


def test_a_singular_matrix_refines_nothing():
    assert Factor(csc_array(np.zeros((2, 2)))).refine(csc_array(np.eye(2)), np.ones(2)) is None


@every_engine
def test_no_answer_is_a_sentence(engine):
    with pytest.raises(EquilibriumError, match="the stiffness is singular"):
        factorised(csc_array((3, 3)), engine).solve(np.ones(3))


# what is shared


@every_engine
def test_one_analysis_serves_matrices_that_live_at_the_same_time(engine):
    scene, symbolic = zoo.irregular_scene(), Symbolic(3, engine)
    rng, right = np.random.default_rng(0), None
    living = []
    for step in range(6):
        matrix = scene.membrane.stiffness(scene.target + 0.01 * step * rng.normal(size=scene.target.shape))
        right = rng.normal(size=matrix.shape[0])
        living.append((Factor(matrix, symbolic), np.linalg.solve(matrix.toarray(), right), right))
        assert living[-1][0].positive_definite
        for factor, answer, load in living[step // 2 :]:
            assert np.allclose(factor.solve(load), answer, rtol=1e-10, atol=0)
        if step % 2:
            living[step // 2] = living[-1]  # one is dropped, and what held it may be used again


@every_engine
def test_another_pattern_is_refused(engine):
    symbolic = Symbolic(engine=engine)
    assert Factor(csc_array(np.eye(3)), symbolic).positive_definite
    with pytest.raises(ValueError, match="another sparsity pattern"):
        Factor(csc_array(np.ones((3, 3))), symbolic).solve(np.ones(3))


@every_engine
def test_a_factor_is_freed_with_its_last_reader_and_travels_without_its_factorisation(engine):
    factor = factorised(np.diag([1.0, 2]), engine)
    assert np.allclose(factor.solve(np.ones(2)), [1, 0.5])
    copy = pickle.loads(pickle.dumps(factor))
    assert np.array_equal(copy.solve(np.ones(2)), factor.solve(np.ones(2)))
    gone = weakref.ref(factor._numeric)
    del factor
    gc.collect()
    assert gone() is None


def test_pardiso_handles_are_used_again():
    pytest.importorskip("pymklpardiso", reason="pip install 'relax-tensile[pardiso]'")
    symbolic = Symbolic(engine="pardiso")
    one, other = (Factor(csc_array(np.diag([1.0, size])), symbolic) for size in (2, 3))
    assert one.positive_definite and other.positive_definite
    handles = {one._numeric.handle, other._numeric.handle}
    assert len(handles) == 2 and symbolic._analysis.spare == []
    del one, other
    assert len(symbolic._analysis.spare) == 1 and set(symbolic._analysis.spare) < handles
    again = Factor(csc_array(np.diag([1.0, 4])), symbolic)
    assert np.allclose(again.solve(np.ones(2)), [1, 0.25]) and again._numeric.handle in handles


# which engine


def test_the_engine_that_is_always_there():
    assert available_engines()[-1] == "superlu"
    assert find_engine("auto") is find_engine(available_engines()[0])


def test_an_engine_of_your_own_is_handed_in():
    asked = []

    def engine(pattern, block):
        asked.append((pattern.shape, block))
        return superlu.SuperLUAnalysis(pattern, block)

    assert Factor(csc_array(np.eye(6)), Symbolic(3, engine)).positive_definite
    assert asked == [((6, 6), 3)]


def test_engines_that_are_not_there_are_a_sentence(monkeypatch):
    with pytest.raises(InputError, match="engine 'umfpack' is unknown: expected auto, rslab"):
        Symbolic(engine="umfpack")
    monkeypatch.setattr("relax.factor.symbolic.find_spec", lambda package: package == "scipy")
    with pytest.raises(
        InputError, match=r"engine 'pardiso' is not installed \(found: superlu\): pip install 'relax-tensile\[pardiso"
    ):
        Symbolic(engine="pardiso")
    assert find_engine("auto") is superlu.SuperLUAnalysis


# the elimination order


@pytest.mark.parametrize("ordering", [superlu.minimum_degree, superlu.nested_dissection])
@pytest.mark.parametrize("block", [1, 3])
def test_the_order_of_a_mesh_keeps_the_unknowns_of_a_vertex_together_and_fills_little(ordering, block):
    if ordering is superlu.nested_dissection and superlu.pymetis is None:
        pytest.skip("pymetis has no wheel for this platform")
    side = 12
    path = np.eye(side, k=1) + np.eye(side, k=-1)
    grid = np.kron(path, np.eye(side)) + np.kron(np.eye(side), path)
    matrix = csc_array(kron(csc_array(5 * np.eye(side**2) - grid), np.ones((block, block)) + np.eye(block)))
    analysis = superlu.SuperLUAnalysis(matrix, block, ordering)
    order = analysis.order.reshape(-1, block)
    assert sorted(order[:, 0] // block) == list(range(side**2))
    assert np.array_equal(order, block * (order[:, :1] // block) + np.arange(block))
    rows = superlu.SuperLUAnalysis(matrix, block, lambda graph: np.arange(graph.shape[0]))
    assert analysis.factorise(matrix, 0.0).fill < 0.7 * rows.factorise(matrix, 0.0).fill


@few
@given(seeds, st.booleans())
def test_an_elimination_order_changes_nothing(seed, definite):
    dense = sparse_symmetric(seed, definite)
    rng = np.random.default_rng(seed)
    shuffled = Symbolic(
        engine=lambda pattern, block: superlu.SuperLUAnalysis(pattern, block, lambda graph: rng.permutation(len(dense)))
    )
    plain, ordered = factorised(dense, "superlu"), Factor(csc_array(dense), shuffled)
    assert ordered.positive_definite == plain.positive_definite
    assert ordered.singular == plain.singular
    right = rng.normal(size=(len(dense), 4))
    assert np.allclose(ordered.solve(right), plain.solve(right), atol=1e-9)


# three directions by one


@few
@given(seeds, st.booleans())
def test_a_scalar_factor_is_that_of_the_three_directions(seed, definite):
    scalar = sparse_symmetric(seed, definite)
    dense, rng = np.kron(scalar, np.eye(3)), np.random.default_rng(seed)
    factor, twin = ScalarFactor(csc_array(dense), Factor(csc_array(scalar))), Factor(csc_array(dense))
    assert (factor.positive_definite, factor.singular) == (twin.positive_definite, twin.singular)
    right, rows = rng.normal(size=(len(dense), 4)), rng.integers(0, len(dense), 7)
    for way in (right, np.asfortranarray(right), right[:, 0], right[:, 0].reshape(-1, 3)):
        if way.shape != (3, 3):
            assert np.allclose(
                factor.solve(way), np.linalg.solve(dense, way.reshape(len(dense), -1)).reshape(way.shape), atol=1e-9
            )
    assert np.allclose(factor.inverse_columns(rows), np.linalg.inv(dense)[:, rows], atol=1e-9)
    assert np.allclose(factor.refine(factor.matrix, right[:, 0]), np.linalg.solve(dense, right[:, 0]), atol=1e-9)
    assert np.array_equal(pickle.loads(pickle.dumps(factor)).solve(right), factor.solve(right))


def test_a_scalar_factor_solves_once_a_vertex():
    asked = []

    class Counted(Factor):
        def solve(self, right):
            asked.append(right.shape)
            return super().solve(right)

    factor = ScalarFactor(csc_array(2 * np.eye(12)), Counted(csc_array(2 * np.eye(4))))
    assert np.array_equal(factor.inverse_columns(np.array([3, 4, 5, 9, 4])), np.eye(12)[:, [3, 4, 5, 9, 4]] / 2)
    assert asked == [(4, 2)]


def test_a_singular_scalar_is_three_times_singular():
    factor = ScalarFactor(csc_array((6, 6)), Factor(csc_array((2, 2))))
    assert factor.singular and not factor.positive_definite and factor.fill == 0
    with pytest.raises(EquilibriumError, match="the stiffness is singular"):
        factor.solve(np.ones(6))
