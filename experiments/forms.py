"""Three ways to the same shape: Newton, dynamic relaxation and multi-step force density, side by side.

Question: which family of form-finding brings a membrane to rest, at what cost, and from how bad a start?

    python experiments/forms.py               two minutes
    python experiments/forms.py --size small  some seconds

The scenes of data/ under the supports that relax finds, from flat; five planted masts (price.py) as the mesh grows and as the
prestress falls (`rest` is rest length over flat length); and starts and membranes that are no friend of Newton's: slack, without
prestress, 20 m off, folded at random, 20 x 20 vertices. `iterations` are Newton and chord steps, explicit steps, and linear
solves, with those of all that `ran`: where Newton is lost, dynamic relaxation takes over. `apart` is the largest distance from
where Newton came to rest, in metres: slack and pushing membranes rest in more than one shape.

Finding: where every edge pulls, the three end at one shape, to 3e-10 of its size. Newton takes 11 to 16 steps, two to four of
them with a factorisation, the others chord steps; force density is as fast (0.7 to 2.3 times as long), 20 linear solves with
30 % of strain, 40 with 10 %, 90 with 2 %, whatever the mesh; dynamic relaxation takes 3 to 5 times as long, 400 to 2,300
explicit steps, and hardly more from 20 m off or folded. Where edges go slack the order turns: on 100 x 100 vertices with 2 %
of strain and five masts Newton needs 98 steps and 6 times as long as either. Newton alone is lost on slack membranes without
load (3 of 4 cases), where dynamic relaxation takes over; force density is too slow there once. Slack springs that push rest in
several shapes, so there the methods end apart.
"""

import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from price import planted
from rows import measured
from threadpoolctl import threadpool_limits

import relax
from relax.membrane.formers import FORMERS
from relax.membrane.membrane import Membrane
from relax.membrane.springs import SPRINGS

DATA = Path(__file__).parent.parent / "data"
SCENES = {"small": ("tent",), "full": ("tent", "five-masts", "tent-noisy", "bumps", "pavilion", "terrain")}
SIDES = {"small": (15,), "full": (50, 100)}
REST = {"small": (0.9,), "full": (0.7, 0.9, 0.98)}
HARD = {"small": 10, "full": 20}  # vertices a side
ROUNDS = {"small": 1, "full": 3}
WEIGHT = 1e-3  # newtons at each vertex, a hundredth of what a prestress of ten per cent holds up

Case = tuple[str, Membrane, np.ndarray, np.ndarray]


def cases(size: str) -> Iterator[Case]:
    """Name, membrane, start (V, 3) and applied forces (n, 3) of each."""
    for name in SCENES[size]:
        problem = relax.Problem(relax.load_scene(DATA / f"{name}.toml"))
        applied = relax.solve(problem).forces[problem.membrane.free] + problem.loads
        yield name, problem.membrane, problem.scene.start, applied
    for side in SIDES[size]:
        for rest in REST[size]:
            yield f"planted, rest {rest}", *cut(side, rest)
    yield from hard(HARD[size])


def cut(side: int, rest: float, springs: str = "hookean") -> tuple[Membrane, np.ndarray, np.ndarray]:
    """Five masts on a membrane cut to `rest` times the flat lengths."""
    problem, forces = planted(side, 5, 0.0)
    flat, membrane = problem.scene.start, problem.membrane
    length = np.linalg.norm(membrane.edge_vectors(flat), axis=1)
    return replace(membrane, rest_length=rest * length, springs=SPRINGS[springs]), flat, forces[membrane.free]


def hard(side: int) -> Iterator[Case]:
    """What a method for bad starts is there for."""
    rng = np.random.default_rng(0)
    for springs in ("hookean", "tension-only"):
        taut, flat, forces = cut(side, 0.9, springs)
        free, none = taut.free, 0 * forces
        hanging = none - [0, 0, WEIGHT]
        folded, far = flat.copy(), flat.copy()
        folded[free] = rng.uniform(0, 1, none.shape)
        far[free] += [0, 0, 20]
        exact, slack = (replace(taut, rest_length=scale / 0.9 * taut.rest_length) for scale in (1.0, 1.3))
        yield f"{springs}: folded start", taut, folded, forces
        yield f"{springs}: start 20 m off", taut, far, forces
        yield f"{springs}: no prestress, hung", exact, flat, hanging
        yield f"{springs}: slack, hung", slack, flat, hanging
        yield f"{springs}: slack, hung, folded start", slack, folded, hanging
        yield f"{springs}: slack, no load, folded start", slack, folded, none
        yield f"{springs}: slack, no load, 20 m off", slack, far, none


def rows_of_case(case: Case, rounds: int) -> list[dict[str, object]]:
    """A row for each method."""
    name, membrane, start, applied = case
    rows: list[dict[str, object]] = []
    reference = None
    for method, former in FORMERS.items():
        seconds = []
        for _ in range(rounds):
            begin = time.perf_counter()
            found = former(membrane, start, applied)
            seconds.append(time.perf_counter() - begin)
        reference = found.positions if reference is None else reference
        rows.append(
            {
                "case": name,
                "vertices": len(membrane.fixed),
                "method": method,
                "seconds": statistics.median(seconds),
                "iterations": found.iterations,
                "factorizations": found.factorizations,
                "residual": found.residual,
                "found": found.found,
                "apart, m": float(np.linalg.norm(found.positions - reference, axis=1).max()),
                "ran": " + ".join(found.ran),
                "stop": found.stop.value,
            }
        )
    return rows


def all_rows(size: str) -> list[dict[str, object]]:
    """Every method on every case."""
    with threadpool_limits(1, "blas"):
        return [row for case in cases(size) for row in rows_of_case(case, ROUNDS[size])]


def main() -> int:
    """Measure and print; 1 if a case is left without a shape by relax's default."""
    rows = measured(__doc__, SCENES, all_rows)
    return 0 if all(row["found"] for row in rows if row["method"] == "newton") else 1


if __name__ == "__main__":
    sys.exit(main())
