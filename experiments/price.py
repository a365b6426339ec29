"""The price of inverse design: a whole inverse run beside one forward form-finding of the same membrane.

Question: with one to five planted masts, without and with noise, what does the run from target to judged supports cost, in
units of one forward form-finding from flat under the planted forces, as the mesh grows?

    python experiments/price.py               about a quarter of an hour
    python experiments/price.py --size small  some seconds

Square membranes of fabric with a fixed edge, prestressed by rest_scale 0.7; weights grow with the number of vertices, so that the
penalty keeps its share of the objective. Forward and inverse take turns in one process with the same factorisation; reading and
writing are left out; medians. `exact` says whether the supports found are the planted vertices. `peak, GB` is of the whole
process so far. Exit status 1 if a run does not converge.

Finding: without noise the inverse run costs 0.8 to 1.4 forward runs from 2,500 to 90,000 vertices and finds every planted mast,
with one factorisation where the forward run needs three. With noise of 2 % of the height it finds them as well, but at the
price of 18 to 46 forward runs: two starts, each with some convex steps in which a hundred candidates are looked at.
"""

import resource
import statistics
import sys
from pathlib import Path

import numpy as np
from rows import measured

import relax

MASTS = {
    1: [(0.40, 0.35, (0.02, 0.0, 0.3))],
    5: [
        (0.30, 0.30, (0.02, 0.0, 0.3)),
        (0.70, 0.30, (0.0, 0.05, -0.2)),
        (0.50, 0.70, (0.05, 0.0, 0.3)),
        (0.25, 0.75, (0.0, -0.05, 0.2)),
        (0.80, 0.75, (0.03, 0.0, -0.25)),
    ],
}
SIDES = {"small": (21,), "full": (50, 100, 200, 300)}
NOISY_UP_TO = {"small": 21, "full": 100}  # vertices a side
ROUNDS = {"small": 1, "full": 5}
NOISE = 0.005  # metres: about 2 % of the height of a mast


def planted(side: int, masts: int, sigma: float) -> tuple[relax.Problem, np.ndarray]:
    """A membrane brought to rest under known forces, as the target, and those forces (V, 3)."""
    mesh = relax.grid_mesh(side, side, "alternating")
    row, column = np.divmod(np.arange(side * side), side)
    flat = np.column_stack([column, row, 0 * row]) / (side - 1)
    settings = relax.load_scene(Path(__file__).parent.parent / "data" / "tent.toml").settings
    forces = np.zeros_like(flat)
    for x, y, force in MASTS[masts]:
        forces[round(y * (side - 1)) * side + round(x * (side - 1))] = force
    shape = relax.form(relax.Problem(relax.build_scene(settings, mesh, flat, flat)), forces).positions
    noise = {"sigma": sigma, "seed": 0} if sigma else None
    noisy = {**settings, "target": {**settings["target"], "noise": noise}}
    weight = (0.02 if sigma else 0.001) * (side / 21) ** 2
    return relax.Problem(relax.build_scene(noisy, mesh, shape, flat), weight=weight), forces


def measure(side: int, masts: int, sigma: float, rounds: int) -> dict[str, object]:
    """One row."""
    problem, forces = planted(side, masts, sigma)
    relax.form(problem, forces)  # once before the clock: the elimination order is computed once a mesh
    forward, designs = [], []
    for _ in range(rounds):
        forward.append(relax.form(problem, forces).seconds)
        designs.append(relax.solve(problem))
    said = designs[-1].certificate
    inverse = statistics.median(design.seconds for design in designs)
    return {
        "vertices": side**2,
        "masts": masts,
        "noise, m": sigma,
        "forward, s": statistics.median(forward),
        "inverse, s": inverse,
        "inverse / forward": inverse / statistics.median(forward),
        "supports": said.supports,
        "exact": bool(np.array_equal(designs[-1].forces.any(axis=1), forces.any(axis=1))),
        "objective": said.objective,
        "stationarity": said.stationarity,
        "converged": said.converged,
        "peak, GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def all_rows(size: str) -> list[dict[str, object]]:
    """Every row of one size, the noisy ones last."""
    cases = [(side, 0.0) for side in SIDES[size]]
    cases += [(side, NOISE) for side in SIDES[size] if side <= NOISY_UP_TO[size]]
    return [measure(side, masts, sigma, ROUNDS[size]) for side, sigma in cases for masts in MASTS]


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__, SIDES, all_rows)
    return 0 if all(row["converged"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
