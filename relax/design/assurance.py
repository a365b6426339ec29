"""How good an answer is known to be: by a duality gap, a known optimum, or as a stationary point."""

from dataclasses import dataclass

import numpy as np

from relax.arrays import Floats
from relax.convex.subproblem import certify
from relax.design.optimality import judge
from relax.design.problem import Problem

NORM = np.array([1e-6, 1.0, 1e6])  # newtons at which a penalty must be the norm itself for a duality gap to be of E_dist + R


@dataclass(frozen=True)
class Assurance:
    """How good an answer is known to be.

    `kind` is "duality gap", "known optimum", "stationarity" or "none"; `gap` bounds (objective - optimum) / objective where
    one is known; `sentence` is for a person.
    """

    kind: str
    gap: float | None
    sentence: str


def assurance(problem: Problem, positions: Floats, forces: Floats, optimum: float | None = None) -> Assurance:
    """How good an answer is known to be; `optimum`: the least objective there is, where somebody knows it."""
    said = judge(problem, positions, forces, str(problem.scene.settings["rounding"]["refit"]))
    if optimum is not None:
        gap = (said.objective - optimum) / said.objective if said.objective else 0.0
        return Assurance("known optimum", gap, f"the objective is {gap:.2g} of itself above the known optimum {optimum:.8g}")
    size = problem.penalty.value(NORM)
    if problem.membrane.linear and np.allclose(size, NORM, rtol=1e-12, atol=0) and said.stationarity is not None:
        amplitudes = problem.supports.amplitudes(forces[problem.membrane.free])
        step = problem.linearised(positions, problem.factor_at(positions), problem.group_weights(amplitudes))
        gap = certify(step, amplitudes).gap
        return Assurance(
            "duality gap",
            gap,
            f"the problem is convex, its duality gap {gap:.2g}: no answer is lower by more than that share",
        )
    if not said.converged:
        return Assurance("none", None, "the judge does not accept it as a stationary point, so nothing is known of it")
    # a penalty that is steep without bound at 0 lets no small support pay, so the judge does not ask
    others = "" if said.off_support is None else f" (off support {said.off_support:.2g})"
    return Assurance(
        "stationarity",
        None,
        f"a stationary point (stationarity {said.stationarity:.2g}) where no small new support would pay{others}; "
        "the problem is not convex, and another point may be lower",
    )
