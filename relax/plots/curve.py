"""The trade-off curve of a path: rms distance against the number of supports and against the weight, its knee marked."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from relax.arrays import Floats
from relax.plots.style import (
    BEST,
    INK,
    LINE,
    OTHERS,
    PAGE,
    SMALL,
    TINY,
    WORDS,
    headline,
    new_figure,
    plain_marks,
    quiet_axes,
    save,
)

if TYPE_CHECKING:
    from relax.design.trade_off import TradeOff

HEIGHT = 3.0  # inches


def draw_trade_off(curve: "TradeOff", path: Path, title: str = "", chosen: int | None = None) -> None:
    """Write the curve to `path` (.png, .pdf or .svg), as wide as a page: 7 by 3 inches.

    `chosen`: the design that was asked for, where that is not the knee. Left: the designs that no other beats, joined, the
    others beside them. Right: the same designs by weight, with the number of supports written where it changes.
    """
    figure = new_figure(PAGE, HEIGHT)
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
        quiet_axes(axes)
    plain_marks(left.yaxis, rms)
    plain_marks(right.xaxis, curve.weight)
    left.set_ylabel("rms distance, m", **WORDS)
    close: Any = {"columnspacing": 1.2, "handlelength": 1.4, "handletextpad": 0.4}  # four entries on a line
    labels = left.get_legend_handles_labels()
    figure.legend(*labels, fontsize=SMALL, frameon=False, loc="lower center", ncols=4, **close)
    headline(figure, title)
    figure.subplots_adjust(left=0.08, right=0.985, bottom=0.215, top=0.92, wspace=0.06)
    save(figure, path)


def _draw_supports(axes: Axes, curve: "TradeOff", rms: Floats) -> None:
    order = np.flatnonzero(curve.efficient)
    order = order[np.argsort(curve.supports[order], kind="stable")]
    line: Any = {"color": LINE, "linewidth": 1.1, "marker": "o", "markersize": 3.5}
    axes.plot(curve.supports[order], rms[order], label="no other is nearer with as few", **line)
    beaten = ~curve.efficient
    if beaten.any():
        axes.plot(curve.supports[beaten], rms[beaten], "x", color=OTHERS, markersize=3.5, label="others")
    axes.plot(curve.supports[curve.knee], rms[curve.knee], label=f"knee: {_said(curve, curve.knee)}", **_KNEE)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set_xlabel("number of supports", **WORDS)


def _said(curve: "TradeOff", index: int) -> str:
    count = int(curve.supports[index])
    return f"{count} support{'s' * (count != 1)}, {curve.rms_distance[index]:.3g} m"


def _draw_weights(axes: Axes, curve: "TradeOff", rms: Floats) -> None:
    order = np.argsort(-curve.weight, kind="stable")
    axes.plot(curve.weight[order], rms[order], color=LINE, linewidth=1.1, marker="o", markersize=3.5)
    axes.plot(curve.weight[curve.knee], rms[curve.knee], **_KNEE)
    axes.set_xscale("log")
    axes.margins(x=0.1)  # room for the number beside the lightest
    before = -1
    for index in order:
        if curve.supports[index] != before:
            before = int(curve.supports[index])
            spot = float(curve.weight[index]), float(rms[index])
            axes.annotate(str(before), spot, (-3, 5), textcoords="offset points", ha="right", fontsize=TINY)
    axes.set_xlabel("weight of the penalty (numbers: supports)", **WORDS)


_KNEE: Any = {
    **{"color": "none", "marker": "D", "markersize": 7.5, "markeredgecolor": BEST, "markeredgewidth": 1.4, "linestyle": "none"},
    "zorder": 4,
}
_ASKED: Any = {**_KNEE, "marker": "s", "markeredgecolor": INK}
