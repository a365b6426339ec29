"""The trace of a run: objective, stationarity and number of supports, against step and against seconds."""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator

from relax.arrays import Floats, Mask
from relax.errors import InputError
from relax.plots.style import (
    BEST,
    COLUMN,
    FAINT_INK,
    LINE,
    SMALL,
    TINY,
    WORDS,
    headline,
    new_figure,
    number_text,
    plain_marks,
    plain_ticks,
    quiet_axes,
    save,
    ticks,
)
from relax.plots.view import objective_unit

if TYPE_CHECKING:
    from relax.design.solve import Design
    from relax.design.trace import Trace

HEIGHT = 3.5  # inches
FLOOR = 1e-17  # a stationarity below is round-off of round-off
WIDE, NARROW = 10.0, 1.01  # times: a range beyond the first is drawn by decades, one within the second from its lowest
CROWD = 60  # steps: more of them are a line without marks
COUNTS = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 100000, 1000000)
FEW_COUNTS, ROOMY = 12, 20  # supports: up to the first one by one, up to the second with 2 and 5 between 1 and 10


def draw_trace(design: "Design", path: Path) -> None:
    """Write the trace of `design` to `path` (.png, .pdf or .svg), as wide as a column: 3.5 by 3.5 inches.

    Open marks: steps before rounding; filled squares: steps after it began. A dotted line: another start begins. The dashed
    line is the stationarity that the scene asks for.

    Raises
    ------
    InputError
        The design has no trace.
    """
    trace, scene = traced(design), design.problem.scene
    figure = new_figure(COLUMN, HEIGHT)
    panels = figure.subplots(3, 2, sharex="col", sharey="row")
    rounding = np.array(["rounding" in note for note in trace.notes], dtype=bool)
    starts = [note.split(":")[0].split(",")[0] for note in trace.notes]
    begins = np.array([now != before for before, now in pairwise(starts)], dtype=bool)
    supports = trace.forces.any(axis=2).sum(axis=1)
    steps = np.arange(len(trace.objective), dtype=float)
    for column, along in zip(panels.T, (steps, trace.seconds), strict=True):
        for axes, values in zip(column, (trace.objective, np.maximum(trace.stationarity, FLOOR), supports), strict=True):
            _draw_run(axes, along, values, rounding)
            for place in along[1:][begins]:
                axes.axvline(place, color=FAINT_INK, linewidth=0.6, linestyle=":")
            quiet_axes(axes)
        column[1].axhline(scene.settings["solver"]["tolerance"], color=BEST, linewidth=0.7, linestyle="--")
    _scale_objective(panels[0, 0], trace.objective, objective_unit(scene))
    panels[1, 0].set_yscale("log")
    panels[1, 0].yaxis.set_major_locator(LogLocator(numticks=6))
    panels[1, 0].yaxis.set_minor_formatter(lambda *_: "")
    _scale_counts(panels[2, 0], supports)
    panels[1, 0].set_ylabel("stationarity", **WORDS)
    panels[2, 0].set_ylabel("supports", **WORDS)
    panels[2, 0].xaxis.set_major_locator(MaxNLocator(5, integer=True, min_n_ticks=1))
    panels[2, 0].set_xlim(-0.03 * len(steps) - 0.5, 1.03 * len(steps) - 0.5)
    panels[2, 1].set_xlim(0.0, 1.05 * float(trace.seconds[-1]) or 1.0)
    panels[2, 0].set_xlabel("step", **WORDS)
    plain_ticks(panels[2, 1].xaxis, 4)
    panels[2, 1].set_xlabel("seconds", **WORDS)
    headline(figure, scene.title, f"{len(steps)} step{'s' * (len(steps) != 1)}, {trace.seconds[-1]:.2g} s")
    _explain_marks(figure, rounding, begins)
    figure.align_ylabels(panels[:, 0])
    figure.subplots_adjust(left=0.2, right=0.975, bottom=0.18, top=0.925, hspace=0.16, wspace=0.08)
    save(figure, path)


def traced(design: "Design") -> "Trace":
    """The trace of a design, if it has one: a folder may have lost it."""
    if not len(design.trace.objective):
        raise InputError("no step of this run is kept (trace.npz is missing): solve again")
    return design.trace


def _draw_run(axes: Axes, along: Floats, values: Floats, rounding: Mask) -> None:
    axes.plot(along, values, color=LINE, linewidth=0.9)
    if len(along) > CROWD:
        return
    mark: Any = {"linestyle": "none", "markeredgecolor": LINE, "markeredgewidth": 0.8}
    axes.plot(along[~rounding], values[~rounding], marker="o", markersize=3.2, markerfacecolor="white", **mark)
    axes.plot(along[rounding], values[rounding], marker="s", markersize=2.8, markerfacecolor=LINE, **mark)


def _scale_objective(axes: Axes, objective: Floats, unit: str) -> None:
    """By decades over a wide range; over a narrow one what is above the lowest is written, or every number began alike."""
    low, high = float(objective.min()), float(objective.max())
    axes.set_ylabel(f"objective, {unit}", **WORDS)
    if 0 < low and high > WIDE * low:
        axes.set_yscale("log")
        plain_marks(axes.yaxis, objective)
        return
    base = low if low < high < NARROW * low else 0.0
    if base:
        axes.text(0.97, 0.9, f"above {base:.4g} {unit}", ha="right", va="top", transform=axes.transAxes, fontsize=TINY)
        axes.yaxis.set_major_locator(FixedLocator(list(base + ticks(0.0, high - base, 3))))
    else:
        axes.yaxis.set_major_locator(MaxNLocator(4))
    # differences have few digits; whole values all that tell them apart
    axes.yaxis.set_major_formatter(lambda value, _: f"{value - base:.2g}" if base else number_text(value))


def _scale_counts(axes: Axes, supports: Floats) -> None:
    most = max(int(supports.max()), 1)
    if most > FEW_COUNTS:
        axes.set_yscale("symlog", linthresh=1.0)
        # between the decades only where there is room
        shown = [count for count in COUNTS if count <= most and (most <= ROOMY or str(count)[0] in "01")]
        axes.yaxis.set_major_locator(FixedLocator(shown))
        axes.yaxis.set_minor_locator(FixedLocator([]))
    else:
        axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.yaxis.set_major_formatter(lambda value, _: number_text(value))
    axes.set_ylim(bottom=-0.08 * min(most, FEW_COUNTS) ** 0.5, top=1.35 * most)  # marks at 0 stand whole


def _explain_marks(figure: Any, rounding: Mask, begins: Mask) -> None:
    mark: Any = {"color": LINE, "linewidth": 0.9, "markeredgecolor": LINE, "markeredgewidth": 0.8}
    handles = [
        Line2D([], [], marker="o", markersize=3.2, markerfacecolor="white", label="step", **mark),
        *([Line2D([], [], marker="s", markersize=2.8, label="after rounding", **mark)] if rounding.any() else []),
        Line2D([], [], color=BEST, linewidth=0.7, linestyle="--", label="asked for"),
        *([Line2D([], [], color=FAINT_INK, linewidth=0.6, linestyle=":", label="new start")] if begins.any() else []),
    ]
    look: Any = {"fontsize": SMALL, "frameon": False, "handlelength": 1.7, "columnspacing": 1.0, "handletextpad": 0.4}
    figure.legend(handles=handles, loc="lower center", ncols=4, bbox_to_anchor=(0.5, -0.01), **look)
