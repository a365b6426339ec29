"""IPOPT through casadi on the smoothed problem with p eliminated, from flat, eps continued (peers.py); then rounding."""

import casadi  # noqa: F401 - where it is not installed, benchopt says so and goes on
from benchmark_utils import Step, Stepwise, rounded
from peers import Ipopt


class Solver(Stepwise):
    """IPOPT through casadi on the smoothed problem with p eliminated, from flat, eps continued; building the model counts."""

    name = "ipopt"

    def skip(self, problem):
        hookean = problem.membrane.springs.name == "hookean" and problem.penalty.name == "power"
        anywhere = problem.scene.candidates[problem.membrane.free].all() and not problem.supports.reach.constrained
        takes = hookean and anywhere and problem.supports.rows.shape[1] == 3
        return not takes, None if takes else "the model holds Hookean springs, the power penalty, any force at any vertex"

    def steps(self, problem):
        model = Ipopt(problem)
        seconds, said, x = model.descend(problem.scene.start)
        answer = Step(model.building + seconds, *model.point(x), said)
        last = rounded(problem, answer)
        yield from (Step(model.building + at, *model.point(way), "IPOPT") for at, way in model.visited)
        yield from (answer, *last)
