"""Run time against error: every method, back-end and peer on each scene, in benchopt, under one judge with its clock stopped.

Question: how near the best known objective, and how near the first-order conditions, is each method after so many seconds?

    python experiments/run_time.py                                  five minutes
    python experiments/run_time.py --size small                     some seconds
    python experiments/run_time.py --pictures experiments/pictures  draws the curves and the performance profiles too
    benchopt run experiments/benchmark --no-cache --no-plot --output ./points.parquet

`benchmark/` is a benchopt benchmark (`pip install -e '.[benchmark]'`): `objective.py` judges, `datasets/` are scenes, and a file
in `solvers/` is a method, where others' drop in; see its README. It needs neither conda nor a network. A run begins with a
problem on a mesh never seen and ends with rounded supports: start, model building and rounding are in its time, imports and
compilation are not. One run gives the whole curve: methods keep their steps and the clock, and nothing is judged until they end.
A point is judged as it would stand, without the forces that the smoothing made (up to the penalty's resolution) and at rest, so
none is below the best for not being in equilibrium. `best` is the lowest such value of any method.

A row is a run: seconds until its objective is 1e-2, 1e-4 and 1e-6 (relative) above the best, at the end, and the judge's figures
of the last point; `equilibrium` is the worst of all points as they were handed in. A back-end stands for the default method with
its steps as cone programs (`cone, ...`) and the moves of the search after them. IPOPT and skglm take what their models hold: any
force at any vertex under the power penalty, and the group lasso on a linear membrane, which is convex as it stands and where the
design matrix K^-1 B is made in full. Pictures show the first-order violation: stationarity on the supports, or how far the
steepest candidate without one is above its price, whichever is larger; and performance profiles (Dolan and More 2002): the share
of the problems that a method takes which it brings to 1e-2, 1e-4, 1e-6 above the best within a factor of the fastest. Exit status
1 if the default does not converge, or ends more than 1 % above the best.

Finding (one run of each on two cores, rslab; the machine did little else). The default brings 11 of 12 problems to 1e-6 above
the best, each within 1.6 times the time of the fastest, and all to 1 %. Cone steps with the moves bring 10, in 1.6 times the
fastest's time by the working set (median), 5 by Clarabel, 6 through cvxpy, 17 by OSQP (vertical supports, one problem); greedy
11, in 8 times. Reweighted l1 alone, IRLS and the augmented Lagrangian bring the 8 planted ones, in 1.2, 16 and 24 times, IPOPT
5 of the 9 that it takes, in 12 times. No method is best everywhere: greedy ends 0.1 % below the default on bumps at 36 x 36.
On nets skglm takes four fifths of our time at 169 vertices, and 2.6 times as long at 625, where it makes a matrix of 1,587 x
1,587. Stationarity alone misleads: greedy is stationary after each support that it adds, the candidates that it has not added
yet say no.
"""

import argparse
import io
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rows import print_table, write_rows

HERE = Path(__file__).parent
SCENES: Mapping[
    str, Mapping[str, tuple[str, ...]]
] = {  # by picture, named as benchopt names them: parameters in alphabetical order
    "small": {"small": ("net[side=9]", "planted[direction=any,side=11]")},
    "full": {
        "planted": ("scene[scene=tent]", "scene[scene=five-masts]", "scene[scene=tent-noisy]", "planted[direction=any,side=21]"),
        "sizes": ("planted[direction=any,side=50]", "planted[direction=vertical,side=21]", "net[side=13]", "net[side=25]"),
        "shapes": ("scene[scene=bumps]", "bumps[side=36]", "scene[scene=pavilion]", "scene[scene=terrain]"),
    },
}
LEVELS = {"1e-2": 1e-2, "1e-4": 1e-4, "1e-6": 1e-6}  # relative, above the best
ENOUGH = 1e-2  # relative: the default may end so much above the best; the problem is not convex
DEFAULT = "sequential"
LEAST = 1e-13  # what is nearer to the best is round-off, and drawn here
PEERS = {"casadi": "IPOPT", "skglm": "skglm"}
STEPS = 100_000  # more than any method takes: benchopt stops a curve at 100 points unless told
OKABE_ITO = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7")
LOOKS = {  # colour, line, marker: told apart without colour too
    "sequential": (0, "-", "o"),
    "reweighted-l1": (5, "-", "s"),
    "greedy": (3, "-", "^"),
    "irls": (7, "-", "v"),
    "lagrangian": (6, "-", "D"),
    "cone, working-set": (5, "--", "P"),
    "cone, clarabel": (2, "--", "X"),
    "cone, osqp": (3, "--", "<"),
    "cone, cvxpy": (1, "--", ">"),
    "ipopt": (6, ":", "*"),
    "skglm": (7, ":", "h"),
}


def curves(scenes: list[str], solvers: list[str] | None = None, compiled: str = "yes") -> Any:
    """A pandas frame of all points of all solvers on some scenes: what benchopt's Parquet file holds, without its prefixes.

    `solvers`: names or files of some; `compiled`: "no" lets skglm run interpreted, where compiling it takes longer than all else.
    """
    os.environ["BENCHOPT_RAISE_ON_ERROR"] = "1"  # a solver that fails is a fault here, not a gap in a table
    if compiled == "no":
        os.environ["NUMBA_DISABLE_JIT"] = "1"
    import pandas as pd
    from benchopt import run_benchmark

    said = io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "run.parquet"
        try:
            with redirect_stdout(said):
                run_benchmark(
                    HERE / "benchmark",
                    dataset_names=scenes,
                    solver_names=solvers,
                    max_runs=STEPS,
                    plot_result=False,
                    show_progress=False,
                    no_cache=True,  # a cache would be written into the benchmark's folder, and return old times
                    output_file=str(output),
                )
        except BaseException:
            print(said.getvalue(), file=sys.stderr)
            raise
        frame = pd.read_parquet(output)
    frame = frame.rename(columns=lambda name: name.removeprefix("objective_"))
    frame["best"] = frame.groupby("dataset_name")["value"].transform("min")
    frame["above"] = frame["value"] / frame["best"] - 1
    return frame


def rows_of(frame: Any) -> list[dict[str, Any]]:
    """One row a run."""
    rows = []
    for (scene, method), points in frame.groupby(["dataset_name", "solver_name"], sort=False):
        last = points.iloc[-1]
        reached = {f"{name} above, s": seconds_to(points, level) for name, level in LEVELS.items()}
        rows.append(
            {
                "scene": scene,
                "vertices": int(last["vertices"]),
                "method": method,
                "points": len(points),
                **reached,
                "end, s": float(last["time"]),
                "objective": float(last["value"]),
                "above": float(last["above"]),
                "supports": float(last["supports"]),
                "stationarity": float(last["stationarity"]),
                "equilibrium": float(points["equilibrium"].max()),
                "converged": bool(last["converged"]),
                "says": last["said"],
            }
        )
    return rows


def seconds_to(points: Any, level: float) -> float:
    """When a run first was within a relative level of the best; nan if never."""
    # the least, not the first in order: a solver that is run anew for each tolerance is sometimes sooner with more digits
    return float(points.loc[points["above"] <= level, "time"].min())


def profile(rows: list[dict[str, Any]], level: str) -> dict[str, tuple[np.ndarray, int]]:
    """Of each method: its times over the fastest's, sorted, of the problems it brought to a level, and how many it took."""
    key = f"{level} above, s"
    fastest: dict[str, float] = {}
    for row in rows:
        fastest[row["scene"]] = min(fastest.get(row["scene"], np.inf), np.nan_to_num(row[key], nan=np.inf))
    found = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        ratios = np.array([row[key] / fastest[row["scene"]] for row in own])
        found[method] = (np.sort(ratios[np.isfinite(ratios)]), len(own))
    return found


def draw_curves(frame: Any, scenes: Sequence[str], path: Path) -> None:
    """Objective above the best, and violation of the first-order conditions, against seconds; a row a scene."""
    import matplotlib.pyplot as plt

    figure, grid = plt.subplots(len(scenes), 2, figsize=(7.2, 1.9 * len(scenes) + 0.9), squeeze=False, layout="constrained")
    frame = frame[frame["dataset_name"].isin(scenes)]
    methods = [name for name in LOOKS if name in set(frame["solver_name"])]
    for scene, axes in zip(scenes, grid, strict=True):
        here = frame[frame["dataset_name"] == scene]
        for method in methods:
            points = here[here["solver_name"] == method]
            if not len(points):
                continue
            seconds = np.maximum(points["time"], 1e-4)
            for axis, column in zip(axes, ("above", "violation"), strict=True):
                axis.plot(seconds, np.maximum(points[column], LEAST), **look(method, len(points)))
        for axis, name in zip(axes, ("objective over the best - 1", "first-order violation"), strict=True):
            axis.set(xscale="log", yscale="log", ylabel=name)
            axis.set_ylim(bottom=LEAST / 3)
            axis.grid(color="0.9", linewidth=0.5)
        axes[0].set_title(f"{scene}, {int(here['vertices'].iloc[0]):,} vertices", loc="left", fontsize=8)
    for axis in grid[-1]:
        axis.set_xlabel("seconds, without judging")
    finish(figure, methods, path)


def draw_profiles(rows: list[dict[str, Any]], path: Path) -> None:
    """Shares of problems brought to each level within a factor of the fastest."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(LEVELS), figsize=(7.2, 3.3), sharey=True, layout="constrained")
    taken = {}
    for axis, level in zip(axes, LEVELS, strict=True):
        found = profile(rows, level)
        largest = 2 * max((ratios.max() for ratios, _ in found.values() if len(ratios)), default=1.0)
        for method in [name for name in LOOKS if name in found]:
            ratios, taken[method] = found[method]
            share = np.arange(1, len(ratios) + 1) / taken[method]
            steps = (
                np.concatenate([[1.0], ratios, [largest]]),
                np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]]),
            )
            axis.step(*steps, where="post", **look(method, len(ratios) + 2))
        axis.set(xscale="log", xlabel="time over the fastest's", ylim=(-0.02, 1.02))
        axis.set_title(f"objective within {level} of the best", fontsize=8)
        axis.grid(color="0.9", linewidth=0.5)
    axes[0].set_ylabel("share of the problems taken")
    finish(figure, list(taken), path, [f"{method} ({count})" for method, count in taken.items()])


def look(method: str, points: int) -> dict[str, Any]:
    """Colour, line and marker of a method; markers on some ten of its points."""
    colour, line, marker = LOOKS[method]
    shown = {"marker": marker, "markersize": 3.5, "markevery": max(1, points // 10)}
    return {"color": OKABE_ITO[colour], "linestyle": line, "linewidth": 2.0 if method == DEFAULT else 1.1, **shown}


def finish(figure: Any, methods: list[str], path: Path, names: list[str] | None = None) -> None:
    """One legend below, and the file."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D
    from PIL import Image

    lines = [Line2D([], [], **look(method, 1)) for method in methods]
    figure.legend(lines, names or methods, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    for axis in figure.axes:
        axis.tick_params(labelsize=7)
        axis.xaxis.label.set_size(8)
        axis.yaxis.label.set_size(8)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=130)
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(64).save(path, optimize=True)  # a third of the bytes


def main() -> int:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=list(SCENES), default="full")
    parser.add_argument("--output", type=Path, help="a CSV file for the rows")
    parser.add_argument("--points", type=Path, help="a Parquet file for every point of every curve")
    parser.add_argument("--pictures", type=Path, help="a folder for run-time-*.png")
    chosen = parser.parse_args()
    scenes = SCENES[chosen.size]
    for package, name in PEERS.items():
        if find_spec(package) is None:
            print(f"{package} is not installed, so {name} is left out: pip install -e '.[benchmark]'", file=sys.stderr)
    frame = curves([scene for group in scenes.values() for scene in group], compiled="no" if chosen.size == "small" else "yes")
    rows = rows_of(frame)
    print_table(rows)
    if chosen.output:
        write_rows(chosen.output, rows)
    if chosen.points:
        frame.to_parquet(chosen.points)
    if chosen.pictures:
        for picture, group in scenes.items():
            draw_curves(frame, group, chosen.pictures / f"run-time-{picture}.png")
        draw_profiles(rows, chosen.pictures / "run-time-profiles.png")
    default = [row for row in rows if row["method"] == DEFAULT]
    return 0 if all(row["converged"] and row["above"] <= ENOUGH for row in default) else 1


if __name__ == "__main__":
    sys.exit(main())
