"""The judge's figures of a membrane and its support forces: what every solver of this benchmark is compared by."""

import numpy as np
from benchmark_utils import as_it_stands
from benchopt import BaseObjective
from benchopt.stopping_criterion import NoCriterion

import relax
from relax.design.optimality import OFF_SUPPORT


class Objective(BaseObjective):
    """min over x, p   |x - xhat|^2 + R(p)   s.t.   f(x) + g + p = 0: the wanted shape xhat under few supports p.

    A solver gets `problem` (relax.Problem) and gives `positions` and support `forces`, both (V, 3); it never evaluates itself. A
    point is judged as it would stand: forces up to the penalty's resolution, which its smoothing made, are left out, and the
    membrane is brought to rest under the others. So no point is low because it is not in equilibrium. `equilibrium` is of the
    point as it was handed in, all else of the point as it stands; nan where it finds no rest. `violation` is what it misses the
    first-order conditions by: stationarity on the supports, or how far the steepest candidate without one is above its price.
    """

    name = "Few supports"
    min_benchopt_version = "1.10"
    sampling_strategy = "callback"
    stopping_criterion = NoCriterion(strategy="callback")  # a run ends where its method does
    test_dataset_name = "net"

    def set_data(self, problem):
        self.problem = problem

    def get_objective(self):
        return {"problem": self.problem}

    def get_one_result(self):
        start = self.problem.scene.start
        return {"positions": start, "forces": np.zeros_like(start)}

    def evaluate_result(self, positions, forces, said=""):
        row = dict.fromkeys(("value", "violation", "stationarity", "off_support", "equilibrium", "supports"), np.nan)
        row |= {"converged": False, "vertices": self.problem.scene.mesh.vertices, "said": said}
        if positions is None:
            return row
        row["equilibrium"] = relax.judge(self.problem, positions, forces).equilibrium
        stands = as_it_stands(self.problem, positions, forces)
        if stands is None:
            return row
        judged = relax.judge(self.problem, *stands)
        row |= {"value": judged.objective, "supports": judged.supports, "converged": judged.converged}
        if judged.stationarity is None:
            return row
        row |= {"stationarity": judged.stationarity, "violation": judged.stationarity}
        if judged.off_support is not None:
            row["off_support"] = judged.off_support
            if judged.off_support > OFF_SUPPORT:  # what the judge takes for none is none here
                row["violation"] = max(judged.stationarity, judged.off_support - 1)
        return row
