from dataclasses import dataclass, replace

import naive
import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.factor import available_engines
from relax.membrane.membrane import Membrane
from relax.membrane.springs import SPRINGS, Hookean

few = settings(derandomize=True, max_examples=20, deadline=None)


@dataclass(frozen=True)
class Stiffening:
    """A law with a third derivative, e = k/2 z^2 + k/3 z^3 with z = l - L: what no shipped one has."""

    name: str = "stiffening"

    def energy(self, length, rest, constant):
        return constant * ((length - rest) ** 2 / 2 + (length - rest) ** 3 / 3)

    def tension(self, length, rest, constant):
        return constant * ((length - rest) + (length - rest) ** 2)

    def stiffness(self, length, rest, constant):
        return constant * (1 + 2 * (length - rest))

    def stiffness_slope(self, length, rest, constant):
        return 2 * constant + 0 * length


LAWS = [*SPRINGS.values(), Stiffening()]
every_law = pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)


def bent(law, seed=0):
    """The irregular membrane under `law`, away from its target so that a few edges are slack."""
    scene = zoo.irregular_scene()
    rng = np.random.default_rng(seed)
    x = scene.target + rng.normal(0, 0.06, scene.target.shape)
    return replace(scene.membrane, springs=law), x, rng


def rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def moved(membrane, x, way, t):
    y = x.copy()
    y[membrane.free] += t * way
    return y


def test_the_bent_membrane_is_a_fair_trial():
    membrane, x, _ = bent(Hookean())
    slack = (membrane.tension(x) < 0).mean()
    assert 0 < slack < 0.5


@every_law
def test_naive_twins(law):
    membrane, x, rng = bent(law)
    along = rng.normal(size=(len(membrane.free), 3))
    assert membrane.energy(x) == pytest.approx(naive.energy(membrane, x), rel=1e-13)
    assert np.allclose(membrane.forces(x), naive.forces(membrane, x)[membrane.free], rtol=1e-12, atol=1e-14)
    assert np.allclose(membrane.stiffness(x).toarray(), naive.stiffness(membrane, x), rtol=1e-12, atol=1e-13)
    turn = naive.stiffness_turn(membrane, x, along)
    assert np.allclose(membrane.stiffness_turn(x, along).toarray(), turn, rtol=1e-12, atol=1e-12 * np.abs(turn).max())


@every_law
def test_taylor_slopes(law):
    membrane, x, rng = bent(law)
    way, along = rng.normal(size=(2, len(membrane.free), 3))

    def at(t):
        return moved(membrane, x, way, t)

    h = 1e-4  # no edge passes its rest length on the way
    assert naive.taylor_order(lambda t: membrane.energy(at(t)), -np.vdot(membrane.forces(x), way), h) == pytest.approx(
        2, abs=0.05
    )
    stiff = membrane.stiffness(x) @ way.ravel()
    order = naive.taylor_order(lambda t: membrane.forces(at(t)).ravel(), -stiff, h)
    assert order > 1.95  # inf for the linear law
    turn = membrane.stiffness_turn(x, along) @ way.ravel()
    order = naive.taylor_order(lambda t: membrane.stiffness(at(t)) @ along.ravel(), turn, h)
    assert order > 1.95


@every_law
def test_matrices_are_symmetric_with_one_pattern_a_mesh(law):
    membrane, x, rng = bent(law)
    along = rng.normal(size=(len(membrane.free), 3))
    first = membrane.stiffness(x)
    for matrix in (first, membrane.taut_stiffness(x), membrane.stiffness_turn(x, along), membrane.stiffness(1.3 * x)):
        assert matrix.format == "csc"
        assert np.allclose(matrix.toarray(), matrix.toarray().T, rtol=0, atol=1e-13 * abs(matrix).max())
        assert np.array_equal(matrix.indices, first.indices) and np.array_equal(matrix.indptr, first.indptr)


@every_law
def test_definite_where_all_edges_are_taut(law):
    scene = zoo.irregular_scene()
    membrane = replace(scene.membrane, springs=law)
    assert membrane.tension(scene.target).min() > 0
    assert np.linalg.eigvalsh(membrane.stiffness(scene.target).toarray())[0] > 0
    taut = membrane.taut_stiffness(scene.target).toarray()
    assert np.allclose(taut, membrane.stiffness(scene.target).toarray(), rtol=0, atol=1e-14)


@every_law
def test_the_taut_part_never_pushes(law):
    membrane, x, _ = bent(law)
    for shape in (x, 0.6 * x):  # at 0.6 most edges push
        values = np.linalg.eigvalsh(membrane.taut_stiffness(shape).toarray())
        assert values[0] > -1e-12 * values[-1]


@every_law
def test_factors_are_those_of_the_stiffness(law):
    membrane, x, rng = bent(law)
    right = rng.normal(size=(len(membrane.free), 3))
    assert np.array_equal(membrane.factor_at(x).matrix.toarray(), membrane.stiffness(x).toarray())
    for factor in (membrane.factor_at(x), membrane.lifted_factor_at(0.6 * x)):
        assert np.allclose(factor.matrix @ factor.solve(right).ravel(), right.ravel(), atol=1e-8)
    assert membrane.lifted_factor_at(0.6 * x).positive_definite
    lift = membrane.lifted_factor_at(x).matrix - membrane.taut_stiffness(x)
    assert np.allclose(lift.toarray(), 1e-4 * membrane.spring_constant.mean() * np.eye(right.size))


def pivots(matrix):
    """D of K = L D L^T, without any pivoting."""
    rest, values = matrix.copy(), []
    while len(rest):
        values.append(rest[0, 0])
        rest = rest[1:, 1:] - np.outer(rest[1:, 0], rest[0, 1:]) / rest[0, 0]
    return np.array(values)


@every_law
@few
@given(seed=st.integers(0, 1000))
def test_the_proof_of_definiteness_bounds_every_pivot(law, seed):
    scene, rng = zoo.irregular_scene(), np.random.default_rng(seed)
    fixed = rng.random(len(scene.membrane.fixed)) < 0.1
    fixed[rng.integers(len(fixed))] = True
    constant = scene.membrane.spring_constant * 10 ** rng.uniform(-4, 4, len(scene.membrane.edges))
    membrane = replace(scene.membrane, springs=law, fixed=fixed, spring_constant=constant)
    whole = membrane.factor_at(scene.target)
    for factor in (getattr(whole, "scalar", whole), membrane.lifted_factor_at(0.6 * scene.target)):
        dense = factor.matrix.toarray()
        order = rng.permutation(len(dense))
        assert factor.pivot_bound > 0
        assert (pivots(dense[np.ix_(order, order)]) / dense.diagonal()[order]).min() >= 0.99 * factor.pivot_bound
        assert factor.positive_definite


def test_no_proof_where_an_edge_pushes():
    membrane, x, _ = bent(Hookean())
    assert membrane.factor_at(x).pivot_bound == 0  # a few edges push, which may or may not matter


def test_a_floating_part_is_factorised_with_one_vertex_held():
    scene = zoo.irregular_scene()
    loose = replace(scene.membrane, fixed=np.zeros_like(scene.membrane.fixed))
    assert [part.tolist() for part in loose.floating] == [list(range(25))] and scene.membrane.floating == ()
    factor, lifted = loose.factor_at(scene.target), loose.lifted_factor_at(scene.target)
    for one in (factor, lifted):
        dense = one.matrix.toarray()
        pivots = np.diag(np.linalg.cholesky(dense)) ** 2 / np.diag(dense)
        assert 0 < one.pivot_bound <= pivots.min() and one.positive_definite
    assert np.allclose(factor.matrix - loose.grounding @ np.eye(75), naive.stiffness(loose, scene.target), atol=1e-12)
    forces = np.random.default_rng(0).normal(size=(25, 3))
    forces -= forces.mean(axis=0)
    moved = factor.solve(forces)
    assert np.allclose(naive.stiffness(loose, scene.target) @ moved.ravel(), forces.ravel(), atol=1e-11)
    assert np.allclose(moved[0], 0, atol=1e-12)  # the spring that holds it is not stretched


@pytest.mark.parametrize("engine", available_engines())
def test_one_analysis_a_mesh_in_the_engine_that_was_chosen(engine):
    scene = zoo.irregular_scene()
    membrane, right = replace(scene.membrane, engine=engine), np.ones((len(scene.membrane.free), 3))
    factors = [membrane.factor_at(scale * scene.target) for scale in (1.0, 1.1, 0.6)]
    factors.append(membrane.lifted_factor_at(0.6 * scene.target))
    for factor in factors:
        assert factor.symbolic is factors[0].symbolic and factor.symbolic.engine == engine
        assert np.allclose(factor.matrix @ factor.solve(right).ravel(), right.ravel(), atol=1e-8)


def test_force_densities_are_factorised_once_and_as_scalars():
    membrane, x, rng = bent(SPRINGS["force-density"])
    factor = membrane.factor_at(x)
    assert membrane.linear and factor.matrix is membrane.stiffness(x)
    assert membrane.factor_at(2 * x) is factor and factor.scalar.matrix.shape == (len(membrane.free),) * 2
    right, rows = rng.normal(size=factor.matrix.shape[0]), rng.integers(0, factor.matrix.shape[0], 9)
    dense = naive.stiffness(membrane, x)
    assert np.allclose(factor.solve(right), np.linalg.solve(dense, right), atol=1e-11)
    assert np.allclose(factor.inverse_columns(rows), np.linalg.inv(dense)[:, rows], atol=1e-11)
    assert not replace(membrane, springs=Hookean()).linear


@pytest.mark.parametrize("seed", range(10))
def test_force_densities_of_mixed_sign_are_seen(seed):
    membrane, x, rng = bent(SPRINGS["force-density"])
    mixed = replace(membrane, spring_constant=membrane.spring_constant * rng.choice([1, -0.3 - 0.1 * seed], len(membrane.edges)))
    values = np.linalg.eigvalsh(naive.stiffness(mixed, x))
    factor = mixed.factor_at(x)
    assert factor.positive_definite == (values[0] > 0) and not factor.singular
    assert mixed.lifted_factor_at(x).positive_definite
    none = replace(membrane, spring_constant=0 * membrane.spring_constant).factor_at(x)
    assert none.singular and not none.positive_definite


def test_tension_has_a_sign_and_force_density_is_tension_over_length():
    line = zoo.line()
    assert np.allclose(line.membrane.tension(line.start), [0.5, 1.8])
    assert np.allclose(line.membrane.forces(line.start), [[1.3, 0, 0]])
    squeezed = line.start * [0.3, 1, 1]
    assert np.allclose(line.membrane.tension(squeezed), [-0.2, -0.3])
    state = line.membrane.edge_state(line.start * 2)
    assert np.allclose(state.density, [1.5 / 2, 4.8 / 2])
    assert np.allclose(state.direction, [[1, 0, 0]] * 2)


@pytest.mark.parametrize("constant", [1.0, 100.0])
@every_law
def test_an_edge_of_no_length_pulls_nowhere(law, constant):
    line = zoo.line(law)
    membrane = replace(line.membrane, spring_constant=np.array([constant, constant]))
    x = np.array([[0.0, 0, 0], [0, 0, 0], [2, 0, 0]])
    other = law.tension(np.array([2.0]), np.array([0.4]), np.array([constant]))
    assert np.allclose(membrane.forces(x), [[other[0], 0, 0]])
    matrix = membrane.stiffness(x).toarray()
    assert np.isfinite(matrix).all() and np.abs(matrix).max() <= 10 * constant
    if law.name == "force-density":
        assert np.allclose(matrix, 2 * constant * np.eye(3))


@few
@given(st.integers(0, 10_000))
def test_rigid_motion_changes_no_energy_and_turns_forces_and_stiffness_along(seed):
    membrane, x, rng = bent(LAWS[seed % len(LAWS)], seed)
    turn = rotation(seed)
    y = x @ turn.T + rng.normal(size=3)
    assert membrane.energy(y) == pytest.approx(membrane.energy(x), rel=1e-12)
    assert np.allclose(membrane.forces(y), membrane.forces(x) @ turn.T, atol=1e-12)
    whole = np.kron(np.eye(len(membrane.free)), turn)
    assert np.allclose(membrane.stiffness(y).toarray(), whole @ membrane.stiffness(x).toarray() @ whole.T, atol=1e-11)


@few
@given(st.integers(0, 10_000))
def test_renumbering_vertices_and_edges_renumbers_forces_and_stiffness(seed):
    membrane, x, rng = bent(LAWS[seed % len(LAWS)], seed)
    place, order = rng.permutation(len(x)), rng.permutation(len(membrane.edges))
    flip = rng.random(len(order)) < 0.5
    edges = place[membrane.edges][order]
    edges[flip] = edges[flip, ::-1]
    y, fixed = np.empty_like(x), np.empty_like(membrane.fixed)
    y[place], fixed[place] = x, membrane.fixed
    other = Membrane(edges, membrane.rest_length[order], membrane.spring_constant[order], membrane.springs, fixed)
    new = np.searchsorted(other.free, place[membrane.free])
    assert np.allclose(other.forces(y)[new], membrane.forces(x), atol=1e-13)
    rows = (3 * new[:, None] + np.arange(3)).ravel()
    assert np.allclose(other.stiffness(y).toarray()[np.ix_(rows, rows)], membrane.stiffness(x).toarray(), atol=1e-12)


@every_law
def test_internal_forces_and_their_moments_cancel(law):
    membrane, x, _ = bent(law)
    loose = replace(membrane, fixed=np.zeros(len(x), dtype=bool))
    f = loose.forces(x)
    assert np.allclose(f.sum(axis=0), 0, atol=1e-13)
    assert np.allclose(np.cross(x, f).sum(axis=0), 0, atol=1e-13)
    # all vertices moved alike: no stiffness resists a translation
    assert np.allclose(loose.stiffness(x) @ np.tile(np.eye(3), (len(x), 1)), 0, atol=1e-12)


def test_a_membrane_does_not_change_under_a_reader():
    with pytest.raises(ValueError, match="read-only"):
        zoo.line().membrane.rest_length[0] = 3
