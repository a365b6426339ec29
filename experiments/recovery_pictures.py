"""The two pictures of recovery.py: precision and recall by factor, and fit against count with what the weight does."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from recovery import Run

Formulation = tuple[str, float, str]
DOTS = 160  # per inch: 1280 pixels across
SMALL = 9.0  # points: readable where the picture is as wide as a column of text
# Okabe and Ito, told apart by every kind of colour vision; their yellow is too pale for a line, so the last is grey
COLOURS = ("#000000", "#e69f00", "#0072b2", "#56b4e9", "#009e73", "#d55e00", "#cc79a7", "#999999")
MARKS = "osD^vP*X"
FACTORS = {
    "noise": ("noise, % of mast height", 100.0),
    "masts": ("masts", 1.0),
    "nearest": ("spacing, edges", 1.0),
    "edges": ("edges a side", 1.0),
}


def draw_factors(taken: Mapping[Formulation, Mapping[int, "Run"]], path: Path, label: Callable[[Formulation], str]) -> None:
    """Write mean precision and recall of each formulation against each factor, over all levels of the others."""
    figure = Figure(figsize=(8.0, 5.0), dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, len(FACTORS), sharey="row", sharex="col")
    for row, figure_name in zip(grid, ("precision", "recall"), strict=True):
        for axes, (factor, (words, scale)) in zip(row, FACTORS.items(), strict=True):
            for formulation, style in zip(taken, _styles(), strict=False):
                runs = list(taken[formulation].values())
                at = np.array([np.floor(run.factors[factor] * 1e6 + 0.5) / 1e6 for run in runs])
                at = np.floor(at) if factor == "nearest" else at
                value = np.array([run.found[figure_name] for run in runs])
                places = [place for place in np.unique(at) if np.isfinite(place)]
                means = [np.nanmean(value[at == place]) for place in places]
                axes.plot(scale * np.array(places), means, label=label(formulation), **style)
            _plain(axes)
            if figure_name == "recall":
                axes.set_xlabel(words, fontsize=SMALL)
        row[0].set_ylabel(f"{figure_name}, by vertex", fontsize=SMALL)
    grid[0, 0].set_ylim(0, 1.04)
    grid[1, 0].set_ylim(0.55, 1.02)  # no formulation finds fewer
    _legend(figure, grid[0, 0])
    figure.subplots_adjust(left=0.075, right=0.99, bottom=0.21, top=0.985, wspace=0.08, hspace=0.08)
    figure.savefig(path, dpi=DOTS, format="png")


def draw_weights(runs: Sequence["Run"], path: Path, label: Callable[[Formulation], str]) -> None:
    """Write, over the weights of each formulation: fit against count on the noisy scenes; and how often all is right."""
    figure = Figure(figsize=(8.0, 4.2), dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    formulations = dict.fromkeys(run.formulation for run in runs)
    for formulation, style in zip(formulations, _styles(), strict=False):
        own = [run for run in runs if run.formulation == formulation and run.factors["noise"] > 0]
        costs = sorted({run.cost for run in own})
        groups = [[run for run in own if run.cost == cost] for cost in costs]
        count = [np.mean([run.found["supports"] / run.factors["masts"] for run in group]) for group in groups]
        misfit = [np.median([run.misfit for run in group]) for group in groups]
        left.plot(count, misfit, label=label(formulation), **style)
        right.plot(costs, [np.mean([run.exact for run in group]) for group in groups], **style)
    left.axvline(1, color="#bbbbbb", linewidth=0.8)
    left.axhline(1, color="#bbbbbb", linewidth=0.8)
    for axes, marks in ((left, (1, 2, 5, 10, 20)), (right, costs)):
        axes.set_xscale("log")
        axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
        axes.minorticks_off()
    right.set_ylim(0, None)
    left.set_xlabel("supports found, per planted mast (mean)", fontsize=SMALL)
    left.set_ylabel("rms distance over that of the noise (median)", fontsize=SMALL)
    right.set_xlabel("cost of a typical mast, over height times noise", fontsize=SMALL)
    right.set_ylabel("share of scenes with every mast right", fontsize=SMALL)
    for axes in (left, right):
        _plain(axes)
    _legend(figure, left)
    figure.subplots_adjust(left=0.08, right=0.985, bottom=0.26, top=0.975, wspace=0.2)
    figure.savefig(path, dpi=DOTS, format="png")


def _styles() -> list[dict[str, Any]]:
    looks = zip(COLOURS, MARKS, strict=True)
    return [{"color": colour, "marker": mark, "markersize": 4.5, "linewidth": 1.2} for colour, mark in looks]


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=SMALL)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(figure: Figure, axes: Axes) -> None:
    figure.legend(*axes.get_legend_handles_labels(), fontsize=SMALL, frameon=False, loc="lower center", ncols=4)
