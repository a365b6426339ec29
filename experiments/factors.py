"""Factorising the stiffness: which engine, what is saved by analysing a mesh once, and what it takes in memory.

Question: how long does each engine take for the first factorisation of K, analysis and all, for the next one with the same
pattern, for one solve and for a block of 60 columns of the inverse; how much memory, and how full is the factor?

    python experiments/factors.py               some minutes
    python experiments/factors.py --size small  some seconds

K of a taut square membrane raised in the middle, each engine in a process of its own, processor seconds on one thread, medians
of three (`first` once); `memory` is what the first factorisation adds to the process, `fill` the entries of the factor.
Engines that are not installed are left out; `pip install -e '.[rslab,pardiso]' cvxopt cholespy` brings all of them.

Finding: at 90,000 vertices (266,412 unknowns)

| engine | first, s | again, s | 60 columns, s | memory, MB | fill, 1e6 |
|---|---|---|---|---|---|
| superlu | 2.4 | 1.9 | 1.2 | 515 | 21 |
| superlu, minimum degree | 2.2 | 2.0 | 1.8 | 511 | 21 |
| rslab | 2.4 | 0.49 | 0.40 | 364 | 19 |
| pardiso | 2.5 | 0.65 | 0.51 | 377 | 23 |
| cholmod (cvxopt) | 1.4 | 0.71 | 3.5 | 374 | |
| cholmod (cholespy) | 5.4 | 4.5 | 1.4 | 370 | |

- rslab (MIT, a wheel of 3 MB for every platform) comes first: four times faster than SuperLU from the second factorisation on,
  three times in blocks of columns, with the inertia, and one analysis for any number of factorisations that live at the same
  time.
- PARDISO is nearly as fast. py-mkl-pardiso brings it in a wheel of 18 MB with a refactorisation of its own; pypardiso installs
  the whole MKL, 0.9 GB, for the same. Handles share no analysis, so a factorisation that lives beside another is analysed again;
  a handle that is free is used again.
- Nested dissection by METIS takes a third off SuperLU's blocks of columns and up to a seventh off its factorisations from
  10,000 vertices on, beside minimum degree, both on the vertices; a single solve costs a fifth more. It weighs 0.3 MB and has
  no wheel for Windows, where minimum degree serves.
- CHOLMOD is no faster: in cvxopt its licence is GPL-3 and its blocks of columns are slow; cholespy (and its fork sksparse-
  minimal) analyses each time and is slower than SuperLU; neither tells the inertia. qdldl takes five times as long as SuperLU
  at 40,000 vertices.
- MUMPS has no wheel that works: python-mumps 0.0.2 was built for NumPy 1, later ones need the system's headers, as scikit-
  sparse.
- A block of 16 columns or more costs SuperLU 0.3 of as many single solves, and larger ones gain nothing; the memory order of
  the block makes 4 % there, a third with rslab. Neither can be told that a right-hand side has one entry.
- 500 x 500 vertices (744,012 unknowns): 2.3 GB with SuperLU (3.6 with a second factorisation beside it), 1.6 with rslab (3.0).
  1000 x 1000 (2,988,012): 88 s and 9.6 GB with SuperLU, 42 s and 6.5 GB with rslab. To show the signs of the pivots SciPy
  copies L and U for good, half as much memory again; a proof from the taut edges (`Membrane.factor_at`) spares that.
- An indefinite K: SuperLU without pivoting and with refinement takes a fourth of partial pivoting's time and fill.
- Force densities at 40,000 vertices, one scalar factorisation for x, y and z: 0.4 of the time of the whole matrix with
  SuperLU, 0.2 with rslab; 60 columns at 20 vertices a seventeenth and a sixth.
"""

import importlib.util
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rows import in_own_processes, measured, peak_gigabytes
from scipy.sparse import coo_array, csc_array, tril
from threadpoolctl import threadpool_limits

import relax
from relax.factor import available_engines
from relax.factor.superlu import SuperLUAnalysis, minimum_degree
from relax.membrane.membrane import Membrane
from relax.membrane.mesh import grid_mesh

SIDES = {"small": (21, 50), "full": (50, 100, 200, 300)}
ROUNDS = 3


class Cholmod:
    """CHOLMOD as cvxopt ships it (GPL-3), for comparison: definite matrices only."""

    def __init__(self, pattern: csc_array, _block: int) -> None:
        from cvxopt import cholmod

        self.symbolic = cholmod.symbolic(self.lower(pattern))

    def lower(self, matrix: csc_array) -> object:
        from cvxopt import spmatrix

        part = tril(matrix, format="coo")
        return spmatrix(part.data, part.row, part.col)

    def factorise(self, matrix: csc_array, _pivot_bound: float) -> "Cholmod":
        from cvxopt import cholmod

        cholmod.numeric(self.lower(matrix), self.symbolic)
        return self

    definite, fill = True, 0

    def solve(self, right: np.ndarray) -> np.ndarray:
        from cvxopt import cholmod, matrix

        answer = matrix(right)
        cholmod.solve(self.symbolic, answer)
        return np.array(answer).reshape(right.shape)


class Cholespy:
    """CHOLMOD without its supernodes as cholespy ships it (BSD), for comparison: definite matrices only, analysed each time."""

    definite, fill = True, 0

    def __init__(self, _pattern: csc_array, _block: int) -> None:
        self.solver = None

    def factorise(self, matrix: csc_array, _pivot_bound: float) -> "Cholespy":
        from cholespy import CholeskySolverD, MatrixType

        part = coo_array(matrix)
        self.solver = CholeskySolverD(matrix.shape[0], part.row, part.col, part.data, MatrixType.COO)
        return self

    def solve(self, right: np.ndarray) -> np.ndarray:
        answer = np.zeros(right.shape)
        self.solver.solve(np.ascontiguousarray(right), answer)
        return answer


# name: engine, and the package that it needs
CANDIDATES = {
    "superlu": ("superlu", "scipy"),
    "superlu, minimum degree": (partial(SuperLUAnalysis, ordering=minimum_degree), "scipy"),
    "rslab": ("rslab", "rslab"),
    "pardiso": ("pardiso", "pymklpardiso"),
    "cholmod (cvxopt)": (Cholmod, "cvxopt"),
    "cholmod (cholespy)": (Cholespy, "cholespy"),
}


def raised_square(side: int) -> tuple[Membrane, np.ndarray]:
    """A taut membrane over a unit square of `side` x `side` vertices, and a shape of it that is not flat."""
    mesh = grid_mesh(side, side, "alternating")
    row, column = np.divmod(np.arange(side * side), side)
    flat = np.column_stack([column, row, 0 * row]) / (side - 1)
    settings = relax.load_scene(Path(__file__).parent.parent / "data" / "tent.toml").settings
    shape = flat + np.outer(0.3 * np.sin(np.pi * flat[:, 0]) * np.sin(np.pi * flat[:, 1]), [0, 0, 1])
    return relax.build_scene(settings, mesh, flat, flat).membrane, shape


def median_seconds(work: Callable[[], object], rounds: int) -> float:
    """Median processor time of `work`: other programs do not count."""
    seconds = []
    for _ in range(rounds):
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    return statistics.median(seconds)


def measure(side: int, name: str) -> dict[str, object]:
    """One row: an engine on a mesh."""
    membrane, shape = raised_square(side)
    membrane = replace(membrane, engine=CANDIDATES[name][0])
    first = membrane.factor_at(shape)
    before = peak_gigabytes()
    row: dict[str, object] = {"vertices": side**2, "engine": name}
    with threadpool_limits(1, "blas"):
        row["first, s"] = median_seconds(lambda: first.positive_definite, 1)
        row["memory, MB"] = round(1024 * (peak_gigabytes() - before))
        # the first one stays alive; one more is not counted, for which an engine may make a second analysis
        again = [membrane.factor_at(shape) for _ in range(ROUNDS + 1)]
        _ = again.pop().positive_definite
        row["again, s"] = median_seconds(lambda: again.pop().positive_definite, ROUNDS)
        right = np.cos(np.arange(float(first.matrix.shape[0])))
        row["one solve, s"] = median_seconds(lambda: first.solve(right), ROUNDS)
        chosen = np.random.default_rng(0).choice(first.matrix.shape[0], 60, replace=False)
        row["60 columns, s"] = median_seconds(lambda: first.inverse_columns(chosen), ROUNDS)
        row["fill, 1e6"] = first.fill / 1e6 or "?"
        row["residual"] = float(abs(first.matrix @ first.solve(right) - right).max())
    return row


def table(size: str) -> list[dict[str, object]]:
    """Rows of the engines that are installed, each measured in a process of its own."""
    missing = [name for name, (_, package) in CANDIDATES.items() if not importlib.util.find_spec(package)]
    print(f"auto is {available_engines()[0]}; not installed and left out: {', '.join(missing) or 'none'}", file=sys.stderr)
    work = [(side, name) for side in SIDES[size] for name in CANDIDATES if name not in missing]
    return list(in_own_processes(measure, work))


def main() -> int:
    """Measure and print."""
    measured(__doc__, SIDES, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
