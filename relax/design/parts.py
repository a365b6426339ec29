"""A membrane that falls apart: parts that share no free vertex are problems of their own, and their designs together the whole's.

Support forces, positions and candidates of one part do not enter the equations of another, and both terms of the objective are
sums over vertices. So the parts are solved one after the other; what a run shows on the way is always the whole membrane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats, Ints
from relax.design.problem import Problem
from relax.design.shape import Shape, figures
from relax.design.trace import Journal, Tally
from relax.iterate import Record


@dataclass(frozen=True)
class Part:
    """One of the problems that another falls into.

    Parameters
    ----------
    problem : Problem
    vertices : (v,) int
        Its vertices in the whole: the free ones of the part and the fixed ones beside them.
    candidates : (k,) int
        Its candidates among the m of the whole.
    """

    problem: Problem
    vertices: Ints
    candidates: Ints

    def start(self, whole: tuple[Floats, Floats] | None) -> tuple[Floats, Floats] | None:
        """Positions and forces (v, 3) of the part, out of those (V, 3) of the whole, where a start is given."""
        return None if whole is None else (whole[0][self.vertices], whole[1][self.vertices])


def split(problem: Problem) -> tuple[Part, ...]:
    """The problems that this one falls into, with its penalty and its weight; none where it is one problem."""
    parts = []
    place = np.cumsum(problem.scene.candidates) - 1
    for cut in problem.scene.parts:
        standing = cut.vertices[cut.scene.candidates]
        parts.append(Part(problem.replace(scene=cut.scene), cut.vertices, place[standing]))
    return tuple(parts)


def assembled(problem: Problem, parts: Sequence[Part], shapes: Sequence[Shape]) -> Shape:
    """The whole membrane with each part in its shape."""
    positions = problem.scene.start.copy()
    amplitudes = problem.supports.none.copy()
    for part, shape in zip(parts, shapes, strict=True):
        free = part.problem.membrane.free
        positions[part.vertices[free]] = shape.positions[free]
        amplitudes[part.candidates] = shape.amplitudes
    return Shape(positions, amplitudes, None, sum(shape.factorizations for shape in shapes))


def counted(problem: Problem, parts: Sequence[Part], tallies: Sequence[Tally]) -> Tally:
    """The counts of all parts that were reached, as those of the whole."""
    looked = np.zeros(len(problem.supports.vertices), dtype=bool)
    for part, tally in zip(parts, tallies, strict=False):
        looked[part.candidates] = tally.looked
    sums = (sum(getattr(tally, name) for tally in tallies) for name in ("reused", "compared", "kept", "broken", "patterns"))
    return Tally(looked, *sums)


class PartJournal(Journal):
    """The journal of one part, which tells that of the whole what each step makes of the whole membrane.

    Parameters
    ----------
    whole : Journal
    parts : all parts
    shapes : the shape that each of them has by now
    index : int
        Which of them this is.
    """

    def __init__(self, whole: Journal, parts: Sequence[Part], shapes: Sequence[Shape], index: int) -> None:
        super().__init__(parts[index].problem, None)
        self.whole, self.parts, self.others, self.index = whole, parts, list(shapes), index

    def __call__(self, record: Record) -> None:
        """Keep a record, and the whole membrane with it."""
        known = len(self.shapes)
        super().__call__(record)
        if len(self.shapes) == known:
            return
        self.others[self.index] = self.shapes[-1]
        shape = assembled(self.whole.problem, self.parts, self.others)
        self.whole.stage = f"part {self.index + 1} of {len(self.parts)}, {self.stage}"
        self.whole(figures(self.whole.problem, shape, record["note"], ()))

    def remark(self, words: str) -> None:
        """Add words to the last note, here and in the whole."""
        super().remark(words)
        self.whole.remark(words)
