"""The paper's own augmented Lagrangian; that it is brought to rest after each step is in its time."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """The paper's own augmented Lagrangian; that it is brought to rest after each step is in its time."""

    name = "lagrangian"

    def steps(self, problem):
        return steps_of(problem, "lagrangian")
