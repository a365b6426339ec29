"""A trial of forces that a model proposes: brought to rest only as far as they may still pay."""

from collections.abc import Sequence

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.design.shape import Shape, loaded

SEEN = 3  # shapes on the way whose spread tells how far their objective is still open


def tried(problem: Problem, shape: Shape, amplitudes: Floats, below: float) -> tuple[Shape | None, bool]:
    """The shape at rest under amplitudes (m, c), started where the shape's own factor predicts it, and whether it was broken off.

    No shape where none is found, and where the objective on the way comes to lie above `below` by more than it still moves.
    """
    seen: list[float] = []

    def hopeless(positions: Floats) -> bool:
        seen.append(problem.objective(problem.placed(positions), amplitudes))
        return lies_above(seen, below)

    moved = loaded(problem, shape, amplitudes, hopeless)
    return moved, moved is None and lies_above(seen, below)


def lies_above(seen: Sequence[float], bound: float) -> bool:
    """Whether the last of some values lies above a bound by more than the last few differ."""
    last = seen[-SEEN:]
    return len(last) == SEEN and last[-1] - (max(last) - min(last)) > bound
