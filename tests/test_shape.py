"""A shape and its dual: exact where it is, a start for the next one nearby, and not mistaken for that of another shape."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
import zoo

from relax.design.problem import Problem
from relax.design.shape import Shape, loaded, with_dual
from relax.design.trial import lies_above
from relax.factor import Factor


def noisy(**changes):
    planted = zoo.planted(9, zoo.TWO_MASTS, 0.01, **changes)
    problem = Problem(planted.scene)
    amplitudes = problem.supports.amplitudes(planted.forces[problem.membrane.free])
    return problem, Shape(planted.positions, amplitudes, problem.factor_at(planted.positions), 0)


def solves_of(task):
    """What a task returns, and the number of solves that it took."""
    count, solve = [], Factor.solve
    with patch.object(Factor, "solve", lambda *given: (count.append(1), solve(*given))[1]):
        return task(), len(count)


@pytest.mark.parametrize("springs", ["hookean", "force-density"])
def test_the_dual_of_a_shape_is_found_once_and_that_of_its_neighbour_from_there(springs):
    problem, shape = noisy(membrane__springs=springs)
    (known, _, dual), first = solves_of(lambda: with_dual(problem, shape))
    (again, _, same), none = solves_of(lambda: with_dual(problem, known))
    assert first > 0 == none and again is known and np.array_equal(dual, same)
    moved = loaded(problem, known, 1.0001 * known.amplitudes)
    assert moved.dual is known.dual  # of the shape before: where to begin from, no more
    (_, _, near), few = solves_of(lambda: with_dual(problem, moved))
    (_, _, fresh), whole = solves_of(lambda: with_dual(problem, replace(moved, factor=None, dual=None)))
    (_, _, far), more = solves_of(lambda: with_dual(problem, replace(moved, dual=None)))
    assert few <= more and whole >= 1
    for other in (near, far):
        np.testing.assert_allclose(other, fresh, atol=1e-12 * np.abs(fresh).max())
    assert np.abs(near - dual).max() > 1e-6 * np.abs(dual).max()


def test_another_array_of_positions_is_another_shape():
    problem, shape = noisy()
    known = with_dual(problem, shape)[0]
    shifted = known.positions.copy()
    shifted[problem.membrane.free] += 1e-3
    dual = with_dual(problem, replace(known, positions=shifted))[2]
    right = 2 * (problem.metric @ problem.offset(shifted).ravel())
    wanted = np.linalg.solve(problem.membrane.stiffness(shifted).toarray(), right).reshape(-1, 3)
    np.testing.assert_allclose(dual, wanted, atol=1e-11 * np.abs(wanted).max())


def test_values_lie_above_a_bound_by_more_than_they_still_move():
    assert not lies_above([9.0, 9.0], 1.0)  # two tell nothing yet
    assert lies_above([9.0, 5.0, 5.1, 5.2], 4.9)
    assert not lies_above([9.0, 5.0, 5.1, 5.2], 5.0)
    assert not lies_above([9.0, 7.0, 5.0], 4.0)
