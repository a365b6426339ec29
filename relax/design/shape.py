"""A membrane at rest under support forces, with what is at hand there: a factorisation of K, and the dual.

How it comes to rest under other forces, and what the dual of a shape is (MATHEMATICS.md, "Reduced form").
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.factor import Factor
from relax.membrane.equilibrium import find_equilibrium, with_last_digits

Hopeless = Callable[[Floats], bool]
LIMIT = 40  # steps to a nearby equilibrium, most of them a solve each; one that takes more is not near


@dataclass(frozen=True)
class Dual:
    """A dual lam (n, 3) and the positions (V, 3) that it is exact at: elsewhere where to begin from."""

    positions: Floats
    field: Floats


@dataclass(frozen=True)
class Shape:
    """A membrane at rest under support forces.

    Parameters
    ----------
    positions : (V, 3) metres
    amplitudes : (m, c) newtons
        Of all candidates; zero where nothing stands.
    factor : Factor or None
        Of K at or near the positions, where one is at hand.
    factorizations : int
        Spent so far.
    dual : Dual or None
        Of this shape or of one that a step came from, its level on parts without a fixed vertex left open.
    """

    positions: Floats
    amplitudes: Floats
    factor: Factor | None
    factorizations: int
    dual: Dual | None = None

    def with_factor(self, factor: Factor) -> "Shape":
        """The same shape with a factorisation of its own, counted unless it is the one at hand (linear membranes have one)."""
        if factor is self.factor:
            return self
        return replace(self, factor=factor, factorizations=self.factorizations + 1)


def with_dual(problem: Problem, shape: Shape) -> tuple[Shape, Factor, Floats]:
    """The shape with a factorisation of K at or near it, and the exact dual lam = 2 K^-1 M (x - xhat) there, (n, 3).

    A factorisation from nearby serves as long as iterative refinement reaches the last digits with it; else K is factorised.
    """
    known = shape.dual.field.ravel() if shape.dual is not None else None
    exact = known if shape.dual is not None and shape.dual.positions is shape.positions else None
    factor = shape.factor
    if factor is None or exact is None:
        right = 2 * (problem.metric @ problem.offset(shape.positions).ravel())
        if factor is not None:
            exact = factor.refine(problem.membrane.stiffness(shape.positions), right, known)
        if factor is None or exact is None:
            factor = problem.factor_at(shape.positions)
            shape = shape.with_factor(factor)
            exact = factor.solve(right)
        shape = replace(shape, dual=Dual(shape.positions, exact.reshape(-1, 3)))
    return shape, factor, problem.levelled(exact.reshape(-1, 3), shape.amplitudes)


def rest(problem: Problem, guess: Shape, hopeless: Hopeless | None = None) -> Shape | None:
    """The equilibrium under the guess's forces, from its positions, by chord steps on its factor first; None if none is found.

    None, too, where `hopeless`, asked at each shape on the way, says so.

    Where a part has no fixed vertex its forces are made to add up first, and it comes to lie where E_dist is least.
    """
    amplitudes = problem.balanced(guess.amplitudes)
    if amplitudes is None:
        return None
    applied = problem.supports.forces(amplitudes) + problem.loads
    found = find_equilibrium(problem.membrane, guess.positions, applied, guess.factor, LIMIT, hopeless)
    if not found.found:
        return None
    factor = guess.factor if found.factor is None else problem.floating(found.factor)
    spent = guess.factorizations + found.factorizations
    return Shape(problem.placed(found.positions), amplitudes, factor, spent, guess.dual)


def to_the_last_digits(problem: Problem, shape: Shape) -> Shape:
    """The same shape, its positions at rest to round-off where it has a factorisation nearby."""
    if shape.factor is None or shape.factor.singular:
        return shape
    applied = problem.supports.forces(shape.amplitudes) + problem.loads
    return replace(shape, positions=with_last_digits(problem.membrane, shape.positions, applied, shape.factor))


def displaced(
    problem: Problem, shape: Shape, displacement: Floats, amplitudes: Floats, hopeless: Hopeless | None = None
) -> Shape | None:
    """The shape at rest under other amplitudes (m, c), started a displacement (3n,) from here; None as in `rest`."""
    guess = shape.positions.copy()
    guess[problem.membrane.free] += displacement.reshape(-1, 3)
    return rest(problem, replace(shape, positions=guess, amplitudes=amplitudes), hopeless)


def loaded(problem: Problem, shape: Shape, amplitudes: Floats, hopeless: Hopeless | None = None) -> Shape | None:
    """The shape at rest under other amplitudes (m, c), started where its own factor predicts it; None as in `rest`."""
    assert shape.factor is not None
    shift = shape.factor.solve(problem.supports.forces(amplitudes - shape.amplitudes))
    return displaced(problem, shape, shift, amplitudes, hopeless)


def figures(problem: Problem, shape: Shape, note: str, looked: Iterable[int]) -> dict[str, object]:
    """What the trace keeps of a shape; `looked`: candidates whose columns of K^-1 were made."""
    return {
        "objective": problem.objective(shape.positions, shape.amplitudes),
        "supports": int(problem.standing(shape.amplitudes).sum()),
        "note": note,
        "shape": shape,
        "looked": looked,
    }
