"""The default: a search of small models, rounding and Newton."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """The default: a search of small models, rounding and Newton."""

    name = "sequential"

    def steps(self, problem):
        return steps_of(problem, "sequential")
