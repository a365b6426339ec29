"""Which formulation ends lowest in the paper's objective, on each scene of data/, under one judge? Every one, side by side.

    python experiments/formulations.py                  every scene, some minutes
    python experiments/formulations.py --size small     the two tents

What `relax compare` prints, scene by scene: every penalty with the default method, every method and every back-end with the
paper's penalty, all from the same start. Each answer is pruned and refitted under the paper's R by one rule before it is judged;
other penalties get the weight at which a typical force costs the same. `above` is the objective over the lowest on that scene,
less one. Ends with status 1 if an answer of the default is more than 1e-6 above the best, or an answer has not converged.

Finding: the default ends lowest on all eight scenes, and every answer converges. On the five planted scenes, with or without
noise, all formulations end at the same supports. On bumps, pavilion and terrain nothing but greedy, log-sum and MCP comes
within 0.6 %; reweighted l1 by itself ends up to 6 % higher, with the search's moves after it 0.07 %; IRLS 4 %, the augmented
Lagrangian and the group lasso 17 %, count 25 % (its weight says nothing of how large a force is).
"""

import sys
from pathlib import Path

from rows import measured

import relax

DATA = Path(__file__).parent.parent / "data"
SCENES = {
    "small": ("tent", "tent-noisy"),
    "full": ("tent", "five-masts", "scalloped", "sail", "tent-noisy", "bumps", "pavilion", "terrain"),
}
ENOUGH = 1e-6


def table(scene: str) -> list[dict[str, object]]:
    """A row for each run on one scene."""
    problem = relax.Problem(relax.load_scene(DATA / f"{scene}.toml"))
    return [
        {
            "scene": scene,
            "penalty": row.penalty,
            "method": row.method,
            "back-end": row.backend,
            "supports": row.supports,
            "objective": row.objective,
            "above": row.over_best,
            "rms distance, m": row.rms_distance,
            "total force, N": row.total_force,
            "stationarity": row.stationarity,
            "off support": row.off_support,
            "converged": row.converged,
            "seconds": row.seconds,
            "stop": row.stop,
        }
        for row in relax.ranked(relax.compare(problem))
    ]


def main() -> int:
    """Compare and print."""
    rows = measured(__doc__ or "", SCENES, lambda size: [row for scene in SCENES[size] for row in table(scene)])
    first = {row["scene"]: row["above"] for row in reversed(rows)}  # the default's is the first of its scene
    late = [scene for scene, above in first.items() if not isinstance(above, float) or above > ENOUGH]
    open_ends = [row for row in rows if row["converged"] is False]
    return 1 if late or open_ends else 0


if __name__ == "__main__":
    sys.exit(main())
