"""skglm's block coordinate descent on the explicit design matrix K^-1 B, where the whole problem is a group lasso."""

import numpy as np
from benchmark_utils import fresh
from benchopt import BaseSolver
from benchopt.stopping_criterion import StoppingCriterion
from scipy.sparse import eye_array
from skglm.datafits.group import QuadraticGroup
from skglm.penalties import WeightedGroupL2
from skglm.solvers import GroupBCD

from ablation import Kind, planted  # isort: skip  # found by what benchmark_utils puts on the path

GIGABYTE = 2**30  # of design matrix, at most
DIGITS = 12
PASSES = 50  # of working sets and of coordinates in each: a run that needs more gets no nearer in any time worth waiting for


class Digits(StoppingCriterion):
    """A run for each digit."""

    def check_convergence(self, objective_list):
        return len(objective_list) > DIGITS, len(objective_list) / (DIGITS + 1)


class Solver(BaseSolver):
    """GroupBCD on |c + K^-1 B s|^2 + sum of w_g |s_g|; the matrix is part of its time. Run anew for each tolerance."""

    name = "skglm"
    sampling_strategy = "tolerance"
    stopping_criterion = Digits(strategy="tolerance")

    def skip(self, problem):
        convex = problem.membrane.linear and problem.penalty.name == "group-lasso" and not problem.supports.reach.constrained
        plain = abs(problem.metric - eye_array(problem.metric.shape[0])).max() == 0
        fits = 8 * problem.metric.shape[0] * problem.supports.rows.size <= GIGABYTE
        takes = convex and plain and fits and not problem.supports.always.any()
        return not takes, None if takes else "no group lasso with an explicit design matrix that fits in memory"

    def set_objective(self, problem):
        self.problem = problem

    def warm_up(self):
        problem = self.problem
        self.problem = planted(Kind(springs="force-density", lasso=3.0), 8)
        self.run(1.0)
        self.problem = problem

    def get_next(self, stop_val):
        """A digit more; the first is one digit."""
        return min(stop_val, 1.0) / 10

    def run(self, tolerance):
        problem = fresh(self.problem)
        start, supports = problem.scene.start, problem.supports
        factor = problem.factor_at(start)
        groups = np.arange(len(supports.vertices))
        design = np.asfortranarray(problem.columns(factor, groups))
        unbalanced = (problem.membrane.forces(start) + problem.loads).ravel()
        bare = problem.offset(start).ravel() + factor.solve(unbalanced)
        samples, width = len(bare), supports.rows.shape[1]
        # half a square over the number of samples: everything else by the same number
        weights = problem.strength * supports.weights / (2 * samples)
        pointers = np.arange(0, design.shape[1] + 1, width, dtype=np.int32)
        indices = np.arange(design.shape[1], dtype=np.int32)
        solver = GroupBCD(max_iter=PASSES, max_epochs=PASSES, tol=min(tolerance, 1.0) * weights.max())
        found, *_ = solver.solve(
            design, -bare, QuadraticGroup(pointers, indices), WeightedGroupL2(1.0, weights, pointers, indices)
        )
        self.positions = problem.scene.target.copy()
        self.positions[problem.membrane.free] += (bare + design @ found).reshape(-1, 3)
        self.forces = problem.all_forces(found.reshape(-1, width))

    def get_result(self):
        return {"positions": self.positions, "forces": self.forces}
