"""Cone steps by cvxpy, then the moves of the search."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Cone steps by cvxpy, then the moves of the search."""

    name = "cone, cvxpy"

    def steps(self, problem):
        return steps_of(problem, backend="cvxpy")
