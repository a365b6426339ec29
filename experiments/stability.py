"""Stability: every axis of a scene to its breaking point.

Question: where does each thing that a scene can ask for break, and what happens there?

    python experiments/stability.py               every axis to its end, 9 x 9 vertices, three minutes (five on a busy machine)
    python experiments/stability.py --size small  two values an axis, 5 x 5 vertices, some ten seconds

An axis (experiments/stress/membranes.py, wishes.py) leads from a mild value to where nothing can hold: units, ratios of
stiffness, prestress, triangles, targets, noise, loads, eps, alpha, weights, supports, methods, single precision. Each case runs
in a process of its own with limited time. Its answer is judged by stress/verdict.py, dense algebra in extended precision that
asks neither the solver nor the judge; `equilibrium` to `drift` are its figures: `smallest pivot` of the stiffness beside its
diagonal entry, `drift` how far the membrane would still move to rest, in scene sizes. Outcomes: solved; solved with warning;
not converged, says so; refused (the sentence). `WRONG` is an answer that is called converged and is not, or whose objective is
another; `CRASH` any error that is no sentence of relax's, or a warning of numpy's; `HANG` more than SECONDS of the processor.
One of these three: exit status 1. What happens on each axis, in short, goes to the error stream.

Finding: no answer in 343 cases is called converged that is not, none crashes or hangs; 297 are solved. Units of length and
force over twelve decades against each other change nothing; nor do eps down to 1e-300, alpha down to 1e-6, aspect 1e6, masts
one vertex apart, folds, cliffs, outliers of a thousand scene sizes, any lean or largest force, float32, other methods. What ends
unconverged, and says so: spring constants of 1e6 on one edge or over more than four decades edge by edge, neighbours nearer
than 1e-6 of the mesh width (a nearly inextensible edge that turns takes Newton more steps than it has); weights below 1e-8 (1e-6
for the group lasso), where round-off of x - xhat is as large as the price of a force, and spikes of a million scene sizes;
targets that leave half of the edges slack; loads that buckle the membrane. Refused in a sentence: every edge slack, vertices
that coincide, nothing fixed, a scene a million sizes from the origin.
"""

import multiprocessing
import resource
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from rows import Row, measured, print_table, shown
from stress import membranes, wishes
from stress.scenes import Case, Made
from stress.verdict import judged

import relax
from relax.factor import available_engines

AXES = (*membranes.AXES, *wishes.AXES)
SIDES = {"small": 5, "full": 9}
SECONDS = 30  # of the processor, for one case: the slowest of them takes a third
FEW = 2  # values an axis at the small size: its two ends
SLOW = (
    "one stiff edge",
    "half stiff",
    "mixed stiffness",
    "slivers",
    "near coincident",
    "components",
    "strip",
    "load down",
    "metric",
)
LOADED = (relax.solve, relax.form, relax.build_scene, available_engines())  # imported once, before there are processes
FAULTS = ("WRONG", "CRASH", "HANG")
FIGURES = ("equilibrium", "stationarity", "off support", "smallest pivot", "drift", "supports", "as planted")


def solved(make: Callable[[], Made]) -> dict[str, Any]:
    """Outcome, sentence and figures of one case."""
    try:
        problem, truth = make()
        design = relax.solve(problem)
    except relax.RelaxError as error:
        return {"outcome": "refused", "sentence": str(error)}
    verdict, said = judged(design), design.certificate
    faults = verdict.faults(said, design.settings["solver"]["tolerance"])
    warned = [*problem.scene.warnings, *said.warnings]
    if faults:
        outcome, sentences = "WRONG", faults
    elif not said.converged:
        outcome, sentences = "not converged, says so", [design.stop, *warned]
    else:
        outcome, sentences = "solved with warning" if warned else "solved", warned
    planted = "" if truth is None else bool(np.array_equal(design.forces.any(axis=1), truth.any(axis=1)))
    figures = (verdict.equilibrium, verdict.stationarity, verdict.off_support, verdict.pushed, verdict.drift, said.supports)
    return {"outcome": outcome, "sentence": "; ".join(sentences), **dict(zip(FIGURES, (*figures, planted), strict=True))}


def child(make: Callable[[], Made], out: Connection) -> None:
    """Solve in this process: the limit on its time ends what hangs, and what crashes takes nothing with it."""
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    warnings.simplefilter("error")
    try:
        row = solved(make)
    except Exception as error:  # whatever is no sentence of relax's should not have come out
        row = {"outcome": "CRASH", "sentence": f"{type(error).__name__}: {error}"}
    out.send(row)


def measure(name: str, value: Any, make: Callable[[], Made]) -> Row:
    """One row."""
    context = multiprocessing.get_context("fork")  # the cases are functions, and importing takes longer than solving
    mine, theirs = context.Pipe(duplex=False)
    began = time.perf_counter()
    process = context.Process(target=child, args=(make, theirs))
    process.start()
    theirs.close()
    try:
        row = mine.recv()
    except EOFError:
        process.join()
        late = time.perf_counter() - began >= SECONDS
        row = {"outcome": "HANG" if late else "CRASH", "sentence": f"ended by signal {-(process.exitcode or 0)}"}
    process.join()
    row = {"axis": name, "value": shown(value), **dict.fromkeys(("outcome", *FIGURES), ""), **row}
    sentence = row.pop("sentence")
    return {**row, "seconds": time.perf_counter() - began, "sentence": sentence}


def chosen(axis: Callable[[int], Iterator[Case]], size: str) -> list[Case]:
    """The cases of an axis; at the small size first and last, of SLOW axes the first two."""
    cases = list(axis(SIDES[size]))
    if size == "small" and name_of(axis) in SLOW:
        return cases[:2]
    return cases if size == "full" else [cases[i] for i in np.linspace(0, len(cases) - 1, FEW).round().astype(int)]


def all_rows(size: str) -> list[Row]:
    """Every row of one size."""
    return [measure(name_of(axis), *case) for axis in AXES for case in chosen(axis, size)]


def name_of(axis: Callable[[int], Iterator[Case]]) -> str:
    """As in the column `axis`."""
    return axis.__name__.replace("_", " ")


def digest(rows: list[Row]) -> list[Row]:
    """One line an axis: what it varies, how many values are solved, and which are not."""
    lines = []
    for axis in AXES:
        mine = [row for row in rows if row["axis"] == name_of(axis)]
        fine = [row for row in mine if row["outcome"].startswith("solved")]
        ends = [f"{row['value']} ({row['outcome']})" for row in mine if row not in fine]
        what = (axis.__doc__ or "").rstrip(".")
        lines.append({"axis": name_of(axis), "what": what, "solved": f"{len(fine)} of {len(mine)}", "breaks at": "; ".join(ends)})
    return lines


def main() -> int:
    """Measure and print; the digest goes where it does not disturb a reader of the rows."""
    rows = measured(__doc__ or "", SIDES, all_rows)
    output, sys.stdout = sys.stdout, sys.stderr
    print_table(digest(rows))
    sys.stdout = output
    return 1 if any(row["outcome"] in FAULTS for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
