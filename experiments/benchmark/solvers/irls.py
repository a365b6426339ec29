"""Reweighted least squares on every candidate at once."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Reweighted least squares on every candidate at once."""

    name = "irls"

    def steps(self, problem):
        return steps_of(problem, "irls")
