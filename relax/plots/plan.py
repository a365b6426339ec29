"""The plan: membrane, wanted contours, what is fixed, cables and supports from above; the panel that most pictures share."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from relax.arrays import Floats, Ints
from relax.plots.perspective import Colour, slice_surface
from relax.plots.style import CABLE, CABLE_CORE, HELD, LARGE, POINT, SHAPES, SMALL, STILL, TINY, WANTED, WORDS, halo, plain_ticks
from relax.plots.view import View

CONTOURS = 8
MANY, CROWD = 15, 60  # more supports than this are numbered small, or are marks alone


def draw_fabric(axes: Axes, view: View, colours: Floats) -> None:
    """The faces in their colours (F, 4), where they lie."""
    fabric = PolyCollection(list(view.flat[view.corners]), facecolors=colours, edgecolors=colours, linewidths=0.3)
    fabric.set_rasterized(len(colours) > SHAPES)
    axes.add_collection(fabric, **STILL)


def draw_contours(axes: Axes, view: View) -> None:
    """Contours of the wanted shape at equal steps of height."""
    heights = view.scene.target[:, 2]
    for level in np.linspace(heights.min(), heights.max(), CONTOURS + 2)[1:-1]:
        lines = np.stack(slice_surface(view.scene.target, view.triangles, 2, float(level)), axis=1)
        axes.add_collection(LineCollection(list(lines[:, :, :2]), colors=[WANTED], linewidths=0.3), **STILL)


def draw_held(axes: Axes, view: View) -> None:
    """Fixed sides and points, and the cables."""
    axes.add_collection(LineCollection(list(view.flat[view.held_sides]), colors=[HELD], linewidths=1.0), **STILL)
    axes.plot(*view.flat[view.held_points].T, **POINT)
    for colour, width in ((CABLE, 1.8), (CABLE_CORE, 0.8)):
        lines = LineCollection(list(view.flat[view.cables]), colors=[colour], linewidths=width, capstyle="round")
        axes.add_collection(lines, **STILL)


def draw_supports(axes: Axes, view: View, ink: Colour | None = None) -> None:
    """Heads with their numbers, and where their struts run; all in `ink`, where the colours of the kinds mean something else."""
    white: Any = {"markeredgecolor": "white", "markeredgewidth": 0.4, "markersize": 3.5}
    size = SMALL if len(view.struts) <= MANY else TINY
    for number, strut in enumerate(view.struts, start=1):
        look, colour = strut.look, ink or strut.look.colour
        if len(view.struts) <= CROWD:
            axes.plot(*np.array([strut.head, strut.end]).T[:2], color=colour, linewidth=0.6 * look.width)
            draw_number(axes, strut.head, number, size)
        axes.plot(*strut.head[:2], marker=look.head, color=colour, **white)


def draw_number(axes: Axes, place: Floats, number: int, size: float = LARGE) -> None:
    """The number of a support beside its head."""
    spot = float(place[0]), float(place[1])
    axes.annotate(str(number), spot, (2, 2), textcoords="offset points", fontsize=size, path_effects=halo())


def draw_edges(axes: Axes, view: View, edges: Ints, **looks: Any) -> LineCollection:
    """Edges (k, 2) as lines."""
    lines = LineCollection(list(view.flat[edges]), capstyle="round", **looks)
    lines.set_rasterized(len(edges) > SHAPES)
    axes.add_collection(lines, **STILL)
    return lines


def frame_plan(axes: Axes, view: View, title: str = "plan") -> None:
    """Limits, equal scales and metres on both axes."""
    axes.set_aspect("equal", anchor="N")
    margin = 0.03 * (view.high - view.low)[:2].max()
    axes.set_xlim(view.low[0] - margin, view.high[0] + margin)
    axes.set_ylim(view.low[1] - margin, view.high[1] + margin)
    for axis in (axes.xaxis, axes.yaxis):
        plain_ticks(axis, 4)
    axes.tick_params(length=2.0, width=0.5, pad=2.0)
    axes.set_xlabel("x, m", labelpad=1.0, **WORDS)
    axes.set_ylabel("y, m", labelpad=1.0, **WORDS)
    axes.set_title(title, loc="left", pad=3.0, **WORDS)
    axes.spines[:].set_visible(False)


def plan_panel(axes: Axes, view: View, colours: Floats, title: str, marks: Callable[[Axes, View], None] = draw_supports) -> None:
    """All of it: fabric in `colours` (F, 4), contours, what is held, and the supports as `marks` draws them."""
    draw_fabric(axes, view, colours)
    draw_contours(axes, view)
    draw_held(axes, view)
    marks(axes, view)
    frame_plan(axes, view, title)
