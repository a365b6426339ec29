"""Factorising the stiffness: where the time goes, and what an elimination order known beforehand saves.

Question: how long does one factorisation of K take, with the order sought on the 3n unknowns each time, and with the order of the
n vertices that is computed once a mesh?

    python experiments/factors.py               about a minute
    python experiments/factors.py --size small  a few seconds

K of a taut square membrane raised in the middle, SciPy's SuperLU on the diagonal, one BLAS thread, medians. `order` is paid
once a mesh; `pivots` reads the signs that say whether K is positive definite; `24 solves` is one block of right-hand sides.

Finding: the known order takes a tenth off each factorisation at 10,000 vertices and a fifth at 40,000, where it costs a third of
one: it pays from the second factorisation on. A block of 24 solves costs two fifths of a factorisation.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rows import measured
from threadpoolctl import threadpool_limits

import relax
from relax.factor import Factor
from relax.membrane.membrane import Membrane
from relax.membrane.mesh import grid_mesh

SIDES = {"small": (21, 50), "full": (50, 100, 200)}
ROUNDS = {"small": 3, "full": 5}


def raised_square(side: int) -> tuple[Membrane, np.ndarray]:
    """A taut membrane over a unit square of `side` x `side` vertices, and a shape of it that is not flat."""
    mesh = grid_mesh(side, side, "alternating")
    row, column = np.divmod(np.arange(side * side), side)
    flat = np.column_stack([column, row, 0 * row]) / (side - 1)
    settings = relax.load_scene(Path(__file__).parent.parent / "data" / "tent.toml").settings
    shape = flat + np.outer(0.3 * np.sin(np.pi * flat[:, 0]) * np.sin(np.pi * flat[:, 1]), [0, 0, 1])
    return relax.build_scene(settings, mesh, flat, flat).membrane, shape


def median_seconds(work: Callable[[], object], rounds: int) -> float:
    """Median time of `work`."""
    seconds = []
    for _ in range(rounds):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds)


def measure(side: int, rounds: int) -> list[dict[str, object]]:
    """One row an order."""
    membrane, shape = raised_square(side)
    stiffness = membrane.stiffness(shape)
    begin = time.perf_counter()
    known = membrane.factor_at(shape).order
    order_seconds = time.perf_counter() - begin
    rows = []
    for name, order in (("sought each time", None), ("of the vertices", known)):
        factor = Factor(stiffness, order)
        right = np.cos(np.arange(24 * stiffness.shape[0])).reshape(-1, 24)
        row = {"vertices": side**2, "order": name, "paid once, s": 0.0 if order is None else order_seconds}
        row["factor and pivots, s"] = median_seconds(lambda order=order: Factor(stiffness, order).positive_definite, rounds)
        row["24 solves, s"] = median_seconds(lambda factor=factor, right=right: factor.solve(right), rounds)
        rows.append(row)
    return rows


def main() -> int:
    """Measure and print."""
    with threadpool_limits(1, "blas"):
        measured(__doc__, SIDES, lambda size: [row for side in SIDES[size] for row in measure(side, ROUNDS[size])])
    return 0


if __name__ == "__main__":
    sys.exit(main())
