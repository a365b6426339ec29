"""Cone steps by Clarabel, then the moves of the search."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Cone steps by Clarabel, then the moves of the search."""

    name = "cone, clarabel"

    def steps(self, problem):
        return steps_of(problem, backend="clarabel")
