"""Cone steps by OSQP, quadratic programs where supports act along one axis, then the moves of the search."""

from benchmark_utils import Stepwise, steps_of


class Solver(Stepwise):
    """Cone steps by OSQP, quadratic programs where supports act along one axis, then the moves of the search."""

    name = "cone, osqp"

    def skip(self, problem):
        cones = problem.supports.rows.shape[1] > 1
        return cones, "OSQP takes no second-order cones: supports along one axis only" if cones else None

    def steps(self, problem):
        return steps_of(problem, backend="osqp")
