"""The candidates as a landscape: who is beside whom on the mesh, and where a field over them has its peaks."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Ints
from relax.design.problem import Problem


@dataclass(frozen=True)
class Landscape:
    """The graph of a problem's candidates: those beside each other on the mesh."""

    problem: Problem

    @cached_property
    def _graph(self) -> tuple[Ints, Ints]:
        """Row pointer and columns, each candidate its own neighbour."""
        pointer, column = self.problem.membrane.neighbours
        vertices = self.problem.supports.vertices
        index = np.full(self.problem.supports.free, -1)
        index[vertices] = np.arange(len(vertices))
        row = np.repeat(np.arange(len(pointer) - 1), np.diff(pointer))
        keep = (index[row] >= 0) & (index[column] >= 0)
        return np.searchsorted(index[row[keep]], np.arange(len(vertices) + 1)), index[column[keep]]

    def beside(self, group: int) -> Ints:
        """The neighbours of a candidate, itself left out."""
        pointer, column = self._graph
        around = column[pointer[group] : pointer[group + 1]]
        return around[around != group]

    def uphill(self, field: Floats, at: Ints) -> Ints:
        """Of each candidate in `at` and its neighbours the one where `field` (m,) is largest."""
        pointer, column = self._graph
        return np.array([max(column[pointer[i] : pointer[i + 1]], key=field.__getitem__) for i in at], dtype=np.int64)

    def peaks(self, field: Floats) -> Ints:
        """Candidates where `field` (m,) is positive and has a local maximum, the highest first."""
        pointer, column = self._graph
        if not len(field):
            return np.zeros(0, dtype=np.int64)
        found = np.flatnonzero((field > 0) & (field >= np.maximum.reduceat(field[column], pointer[:-1])))
        return found[np.argsort(-field[found], kind="stable")]
