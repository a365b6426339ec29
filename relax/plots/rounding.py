"""Before and after rounding, side by side: the shape's distance, every force however small, and their sizes in order."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator

from relax.arrays import Floats
from relax.plots.plan import plan_panel
from relax.plots.style import (
    BEST,
    INK,
    PAGE,
    SMALL,
    TINY,
    WORDS,
    colour_bar,
    headline,
    metres,
    new_figure,
    newtons,
    quiet_axes,
    save,
)
from relax.plots.trace import traced
from relax.plots.view import View, look_at_shape

if TYPE_CHECKING:
    from relax.design.solve import Design

HEIGHT = 2.75  # inches
DECADES = 6  # below the largest force: smaller ones are round-off of the solvers, and are not counted
LEAST, MOST = 1.0, 5.5  # points: marks of forces at the ends of these decades


def draw_rounding(design: "Design", path: Path) -> None:
    """Write shape and forces before and after rounding to `path` (.png, .pdf or .svg), as wide as a page: 7 by 2.75 inches.

    Left and middle: plans, coloured alike; the mark of a force grows with its logarithm, over six decades below the largest.
    Right: all forces in order of size, before (open) and after (filled).

    Raises
    ------
    InputError
        The design has no trace.
    """
    trace, scene = traced(design), design.problem.scene
    sizes = [np.linalg.norm(forces, axis=1) for forces in (trace.unrounded_forces, design.forces)]
    largest = max(float(size.max(initial=0.0)) for size in sizes)
    views = [look_at_shape(scene, positions) for positions in (trace.unrounded_positions, design.positions)]
    top = max(float(view.distance.max()) for view in views)
    views = [replace(view, top=top) for view in views]
    figure = new_figure(PAGE, HEIGHT)
    for left, view, size, words in zip((0.06, 0.38), views, sizes, ("before rounding", "after rounding"), strict=True):
        place = (left, 0.285, 0.27, 0.585)
        plan_panel(figure.add_axes(place), view, view.colours, f"{words}: {said_forces(size, largest)}", dots(size, largest))
    colour_bar(figure, views[0].scale, (0.06, 0.125, 0.59, 0.025), "distance to the wanted shape", "m")
    draw_ranks(figure.add_axes((0.745, 0.15, 0.235, 0.72)), sizes)
    headline(figure, scene.title, f"rms distance {metres(design.certificate.rms_distance)} after rounding")
    save(figure, path)


def said_forces(size: Floats, largest: float) -> str:
    """How many forces of magnitudes (V,) there are, and the largest of them."""
    count = count_forces(size, largest)
    return f"{count} force{'s' * (count != 1)}" + (f", up to {newtons(float(size.max()))}" if count else "")


def count_forces(size: Floats, largest: float) -> int:
    """How many forces of magnitudes (V,) are drawn."""
    return int((size > 10.0**-DECADES * largest).sum())


def dots(size: Floats, largest: float) -> Callable[[Axes, View], None]:
    """Draws the forces of magnitudes (V,) on a plan: larger and darker by decades."""

    def draw(axes: Axes, view: View) -> None:
        shown = np.flatnonzero(size > 10.0**-DECADES * largest)
        shown = shown[np.argsort(size[shown], kind="stable")]
        share = 1.0 + np.log10(size[shown] / (largest or 1.0)) / DECADES
        diameter = LEAST + (MOST - LEAST) * share
        colours = [BEST if part < 0.5 else INK for part in share]
        axes.scatter(
            view.flat[shown, 0], view.flat[shown, 1], s=diameter**2, c=colours, edgecolors="white", linewidths=0.25, zorder=3
        )

    return draw


def draw_ranks(axes: Axes, sizes: list[Floats]) -> None:
    """Forces in order of size, before and after rounding, on logarithmic scales."""
    largest = max(float(size.max(initial=0.0)) for size in sizes)
    looks: Any = ({"marker": "o", "markerfacecolor": "white", "label": "before"}, {"marker": "s", "label": "after", "zorder": 3})
    most = 1
    for size, look in zip(sizes, looks, strict=True):
        ordered = np.sort(size[size > 10.0**-DECADES * largest])[::-1]
        most = max(most, len(ordered))
        mark: Any = {"color": INK, "linestyle": "none", "markersize": 3.0, "markeredgewidth": 0.6} | look
        axes.plot(1 + np.arange(len(ordered)), ordered, **mark)
    quiet_axes(axes)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(numticks=DECADES + 2))
    axes.yaxis.set_minor_locator(FixedLocator([]))
    if largest:
        axes.set_ylim(10.0**-DECADES * largest / 2, 3.0 * largest)
    if most > 20:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        axes.set_xlim(0.5, max(most, 2) + 0.5)
    axes.set_xlabel("number of the force, by size", labelpad=1.0, **WORDS)
    axes.set_ylabel("force, N", labelpad=1.0, **WORDS)
    axes.tick_params(labelsize=TINY)
    place: Any = {"loc": "lower right", "bbox_to_anchor": (1.02, 0.985), "ncols": 2, "handletextpad": 0.1, "columnspacing": 0.8}
    axes.legend(fontsize=SMALL, frameon=False, borderaxespad=0.0, **place)
