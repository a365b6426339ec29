"""Cone steps with reweighted norms by the working set, and rounding alone."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Cone steps with reweighted norms by the working set, and rounding alone."""

    name = "reweighted-l1"

    def steps(self, problem):
        return steps_of(problem, "reweighted-l1")
