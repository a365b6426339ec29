"""The trade-off curve of a path: rms distance against the number of supports and against the weight, its knee marked."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from relax.arrays import Floats

if TYPE_CHECKING:
    from relax.design.trade_off import TradeOff

SIZE = (8.0, 4.0)  # inches
DOTS = 180  # per inch: 1440 x 720 pixels
SMALL, LARGE = 9.0, 10.5  # points: readable where the picture is as wide as a column of text
# told apart by every kind of colour vision (Okabe and Ito), and by their marks without colour
EFFICIENT, BEATEN, KNEE, ASKED = "#0072b2", "#999999", "#d55e00", "#1a1a1a"
FEW = 1.6  # decades: a narrower axis shows marks between the powers of ten
BETWEEN = ((0.6, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)), (FEW, (1.0, 2.0, 5.0)))  # up to so many decades, these


def draw_trade_off(curve: "TradeOff", path: Path, title: str = "", chosen: int | None = None) -> None:
    """Write the curve to `path`, a PNG of 1440 x 720 pixels; `chosen`: the design that was asked for, where that is not the knee.

    Left: the designs that no other beats, joined, the others beside them. Right: the same designs by weight, with the number
    of supports written where it changes.
    """
    figure = Figure(figsize=SIZE, dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    # round-off of a target that is reached exactly
    rms = np.maximum(curve.rms_distance, 1e-15)
    _draw_supports(left, curve, rms)
    _draw_weights(right, curve, rms)
    if chosen is not None and chosen != curve.knee:
        left.plot(curve.supports[chosen], rms[chosen], label=f"asked for: {_said(curve, chosen)}", **_ASKED)
        right.plot(curve.weight[chosen], rms[chosen], **_ASKED)
    for axes in (left, right):
        axes.set_yscale("log")
        axes.tick_params(labelsize=SMALL)
        axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    _plain_marks(left.yaxis, rms)
    _plain_marks(right.xaxis, curve.weight)
    left.set_ylabel("rms distance, m", fontsize=SMALL)
    close: Any = {"columnspacing": 1.0, "handlelength": 1.4, "handletextpad": 0.4}  # four entries on a line
    labels = left.get_legend_handles_labels()
    figure.legend(*labels, fontsize=SMALL, frameon=False, loc="lower center", ncols=4, **close)
    figure.suptitle(title, fontsize=LARGE, x=0.01, y=0.985, ha="left")
    figure.subplots_adjust(left=0.095, right=0.985, bottom=0.23, top=0.91, wspace=0.06)
    figure.savefig(path, dpi=DOTS, format="png")


def _plain_marks(axis: Axis, values: Floats) -> None:
    """Mark a short logarithmic axis at plain numbers; matplotlib's powers of ten would run into each other."""
    decades = np.log10(values.max() / values.min())
    for most, marks in BETWEEN:
        if decades < most:
            axis.set_major_locator(LogLocator(subs=marks))
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            break
    axis.set_minor_formatter(lambda *_: "")


def _draw_supports(axes: Axes, curve: "TradeOff", rms: Floats) -> None:
    order = np.flatnonzero(curve.efficient)
    order = order[np.argsort(curve.supports[order], kind="stable")]
    line: Any = {"color": EFFICIENT, "linewidth": 1.4, "marker": "o", "markersize": 4.5}
    axes.plot(curve.supports[order], rms[order], label="no other is nearer with as few", **line)
    beaten = ~curve.efficient
    if beaten.any():
        axes.plot(curve.supports[beaten], rms[beaten], "x", color=BEATEN, markersize=4.5, label="others")
    axes.plot(curve.supports[curve.knee], rms[curve.knee], label=f"knee: {_said(curve, curve.knee)}", **_KNEE)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set_xlabel("number of supports", fontsize=SMALL)


def _said(curve: "TradeOff", index: int) -> str:
    count = int(curve.supports[index])
    return f"{count} support{'s' * (count != 1)}, {curve.rms_distance[index]:.3g} m"


def _draw_weights(axes: Axes, curve: "TradeOff", rms: Floats) -> None:
    order = np.argsort(-curve.weight, kind="stable")
    axes.plot(curve.weight[order], rms[order], color=EFFICIENT, linewidth=1.4, marker="o", markersize=4.5)
    axes.plot(curve.weight[curve.knee], rms[curve.knee], **_KNEE)
    axes.set_xscale("log")
    axes.margins(x=0.1)  # room for the number beside the lightest
    before = -1
    for index in order:
        if curve.supports[index] != before:
            before = int(curve.supports[index])
            spot = float(curve.weight[index]), float(rms[index])
            axes.annotate(str(before), spot, (-3, 5), textcoords="offset points", ha="right", fontsize=SMALL)
    axes.set_xlabel("weight of the penalty (numbers: supports)", fontsize=SMALL)


_KNEE: Any = {
    **{"color": "none", "marker": "D", "markersize": 10, "markeredgecolor": KNEE, "markeredgewidth": 1.8, "linestyle": "none"},
    "zorder": 4,
}
_ASKED: Any = {**_KNEE, "marker": "s", "markeredgecolor": ASKED}
