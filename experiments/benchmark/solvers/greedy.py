"""Orthogonal matching pursuit on the dual, with drops and swaps."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Orthogonal matching pursuit on the dual, with drops and swaps."""

    name = "greedy"

    def steps(self, problem):
        return steps_of(problem, "greedy")
