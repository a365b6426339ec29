import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array, csr_array

from relax.errors import EquilibriumError
from relax.factor import Factor, block_order

few = settings(derandomize=True, max_examples=100, deadline=None)
seeds = st.integers(0, 100_000)


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


@few
@given(seeds, st.booleans())
def test_the_verdict_is_that_of_the_eigenvalues(seed, definite):
    dense = sparse_symmetric(seed, definite)
    factor = Factor(csc_array(dense))
    assert factor.positive_definite == (np.linalg.eigvalsh(dense)[0] > 0)
    assert not factor.singular


@few
@given(seeds)
def test_solutions_solve_in_each_shape(seed):
    dense = sparse_symmetric(seed, definite=False)
    factor, n = Factor(csc_array(dense)), len(dense)
    right = np.random.default_rng(seed).normal(size=(n, 4))
    answer = np.linalg.solve(dense, right)
    assert np.allclose(factor.solve(right), answer, atol=1e-9)
    assert np.allclose(factor.solve(right[:, 0]), answer[:, 0], atol=1e-9)
    if n % 3 == 0 and n != 3:  # (3, 3) is three columns
        points = right[:, 0].reshape(-1, 3)
        assert np.array_equal(factor.solve(points), factor.solve(right[:, 0]).reshape(-1, 3))


@few
@given(seeds, st.booleans())
def test_an_elimination_order_changes_nothing(seed, definite):
    dense = sparse_symmetric(seed, definite)
    rng = np.random.default_rng(seed)
    plain, ordered = Factor(csc_array(dense)), Factor(csc_array(dense), rng.permutation(len(dense)))
    assert ordered.positive_definite == plain.positive_definite
    assert ordered.singular == plain.singular
    right = rng.normal(size=(len(dense), 4))
    assert np.allclose(ordered.solve(right), plain.solve(right), atol=1e-9)
    assert np.allclose(ordered.solve(right[:, 0]), plain.solve(right[:, 0]), atol=1e-9)
    if len(dense) % 3 == 0 and len(dense) != 3:
        points = right[:, 0].reshape(-1, 3)
        assert np.allclose(ordered.solve(points), plain.solve(points), atol=1e-9)


@pytest.mark.parametrize("block", [1, 3])
def test_the_order_of_a_graph_keeps_the_unknowns_of_a_vertex_together(block):
    rng = np.random.default_rng(0)
    graph = csr_array(rng.random((9, 9)) < 0.3)
    order = block_order(csr_array((graph + graph.T).astype(float)), block).reshape(-1, block)
    assert sorted(order[:, 0] // block) == list(range(9))
    assert np.array_equal(order, block * (order[:, :1] // block) + np.arange(block))


@few
@given(seeds)
def test_the_verdict_with_an_order_does_not_depend_on_units(seed):
    dense = sparse_symmetric(seed, definite=True)
    rng = np.random.default_rng(seed)
    unit = 10 ** rng.uniform(-8, 8, len(dense))
    factor = Factor(csc_array(unit[:, None] * dense * unit), rng.permutation(len(dense)))
    assert factor.positive_definite == (np.linalg.eigvalsh(dense)[0] > 0)


@pytest.mark.parametrize("smallest", [1e-8, -1e-8, -1.0])
def test_one_eigenvalue_decides(smallest):
    factor = Factor(csc_array(spectrum(1, [smallest, 1.0, 2.0, 3.0, 50.0])))
    assert factor.positive_definite == (smallest > 0)
    assert not factor.singular


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_a_negative_pivot_anywhere_is_seen(order):
    dense = np.array([[2.0, 1, 0], [1, 2, 3], [0, 3, 2]])[np.ix_(order, order)]  # positive diagonal, indefinite
    assert np.linalg.eigvalsh(dense)[0] < 0
    assert not Factor(csc_array(dense)).positive_definite


def test_a_pivot_that_vanishes_on_the_way_is_no_positive_one():
    dense = np.array([[1.0, 2, 1], [2, 1, 1], [1, 1, 1]])  # rows are swapped, and then all pivots are positive
    assert np.linalg.eigvalsh(dense)[0] == pytest.approx(-1)
    factor = Factor(csc_array(dense))
    assert not factor.positive_definite
    assert np.allclose(factor.solve(np.ones(3)), np.linalg.solve(dense, np.ones(3)))


@few
@given(seeds)
def test_the_verdict_does_not_depend_on_units(seed):
    dense = sparse_symmetric(seed, definite=True)
    unit = 10 ** np.random.default_rng(seed).uniform(-8, 8, len(dense))
    factor = Factor(csc_array(unit[:, None] * dense * unit))
    assert factor.positive_definite == (np.linalg.eigvalsh(dense)[0] > 0)


def test_an_empty_diagonal_is_no_matter_for_an_indefinite_matrix():
    factor = Factor(csc_array(np.array([[0.0, 2], [2, 0]])))
    assert not factor.positive_definite
    assert not factor.singular
    assert np.allclose(factor.solve(np.array([2.0, 4.0])), [2, 1])


@pytest.mark.parametrize(
    "dense",
    [np.zeros((2, 2)), np.diag([1.0, 0, 1]), np.ones((3, 3)), np.diag([1.0, 0, -1]), np.array([[1.0, -1], [-1, 1]])],
    ids=["zero", "slack", "rank one", "indefinite", "free spring"],
)
def test_exactly_singular(dense):
    factor = Factor(csc_array(dense))
    assert factor.singular
    assert not factor.positive_definite


@few
@given(seeds)
def test_singular_up_to_round_off(seed):
    rank = 1 + seed % 7
    dense = spectrum(seed, np.concatenate([[0.0], np.random.default_rng(seed).uniform(0.5, 2, rank)]))
    factor = Factor(csc_array(dense))
    assert factor.singular
    assert not factor.positive_definite


@pytest.mark.parametrize("seed", range(8))
def test_a_membrane_that_nothing_holds_is_singular(seed):
    scene = zoo.irregular_scene(seed=seed)
    loose = type(scene.membrane)(
        scene.mesh.edges, scene.rest_length, scene.spring_constant, scene.membrane.springs, np.zeros(25, dtype=bool)
    )
    for factor in (Factor(loose.stiffness(scene.target)), loose.factor_at(scene.target)):
        assert factor.singular
        assert not factor.positive_definite


@few
@given(seeds, st.booleans())
def test_refinement_solves_a_matrix_nearby_and_says_when_it_is_too_far(seed, definite):
    dense = sparse_symmetric(seed, definite)
    rng = np.random.default_rng(seed)
    right, factor = rng.normal(size=len(dense)), Factor(csc_array(dense))
    near = dense + 1e-2 * np.abs(np.linalg.eigvalsh(dense)).min() * spectrum(seed, rng.uniform(-1, 1, len(dense)))
    assert np.allclose(factor.refine(csc_array(near), right), np.linalg.solve(near, right), rtol=1e-9, atol=1e-11)
    assert factor.refine(csc_array(3 * dense), right) is None


def test_a_singular_matrix_refines_nothing():
    assert Factor(csc_array(np.zeros((2, 2)))).refine(csc_array(np.eye(2)), np.ones(2)) is None


def test_no_answer_is_a_sentence():
    with pytest.raises(EquilibriumError, match="the stiffness is singular"):
        Factor(csc_array((3, 3))).solve(np.ones(3))
