"""Cone steps by the working set, then the moves of the search."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Cone steps by the working set, then the moves of the search."""

    name = "cone, working-set"

    def steps(self, problem):
        return steps_of(problem, backend="working-set")
