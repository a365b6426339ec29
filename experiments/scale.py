"""Growth: how time and memory of an inverse run rise with the mesh.

Question: what do a forward and an inverse run take from 2,500 vertices to a quarter of a million, and a million?

    python experiments/scale.py               nine minutes
    python experiments/scale.py --size small  some seconds
    python experiments/scale.py --size huge   1000 x 1000 vertices, once, with the fastest engine installed

Five planted masts without noise (price.py), for the engine that needs nothing installed and the fastest that is. Each row runs
in a process of its own. `exponent` is the slope of log time over log vertices from the row before of the same engine,
`overall` from the first one.

Finding: from 2,500 to 250,000 vertices the time of an inverse run grows with the power 1.1 of the vertices with rslab and 1.25
with SuperLU (1.2 and 1.4 over the last step). 500 x 500 vertices, 750,000 unknowns, take 17 s and 3.3 GB with rslab, 35 s and
4.6 GB with SuperLU, 1.2 and 0.8 forward runs; 1000 x 1000 vertices, three million unknowns, took 84 s and 13.7 GB with rslab,
0.9 forward runs.
"""

import sys
from dataclasses import replace
from math import log

from price import planted
from rows import in_own_processes, measured, peak_gigabytes

import relax
from relax.factor import available_engines

SIDES = {"small": (15, 30), "full": (50, 100, 200, 500), "huge": (1000,)}
ONCE = 250  # vertices a side from which on a run is timed once


def measure(side: int, engine: str) -> dict[str, object]:
    """One row."""
    problem, forces = planted(side, 5, 0.0)
    problem = problem.replace(scene=replace(problem.scene, engine=engine))
    rounds = 1 if side >= ONCE else 5
    relax.form(problem, 0 * forces)  # what is analysed once a mesh
    designs = [relax.solve(problem) for _ in range(rounds)]
    forward = sorted(relax.form(problem, forces).seconds for _ in range(rounds))
    inverse = sorted(design.seconds for design in designs)
    said = designs[-1].certificate
    return {
        "vertices": side**2,
        "engine": engine,
        "forward, s": forward[rounds // 2],
        "inverse, s": inverse[rounds // 2],
        "inverse / forward": inverse[rounds // 2] / forward[rounds // 2],
        "supports": said.supports,
        "objective": said.objective,
        "stationarity": said.stationarity,
        "converged": said.converged,
        "peak, GB": peak_gigabytes(),
    }


def all_rows(size: str) -> list[dict[str, object]]:
    """The rows of each engine, with the growth of their inverse time."""
    engines = [available_engines()[0]] if size == "huge" else list(dict.fromkeys(["superlu", available_engines()[0]]))
    rows = in_own_processes(measure, [(side, engine) for engine in engines for side in SIDES[size]])
    grown = []
    for row in rows:
        same = [one for one in grown if one["engine"] == row["engine"]]
        slopes = [_slope(one, row) for one in (same[-1], same[0])] if same else ["", ""]
        grown.append({**row, "exponent": slopes[0], "overall": slopes[1]})
    return grown


def _slope(one: dict[str, object], other: dict[str, object]) -> float:
    return log(other["inverse, s"] / one["inverse, s"]) / log(other["vertices"] / one["vertices"])


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__, SIDES, all_rows)
    return 0 if all(row["converged"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
