"""The picture of a design: membrane, wanted shape and supports in perspective, the plan, and the forces of the supports."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from relax.plots.plan import plan_panel
from relax.plots.space import draw_space
from relax.plots.style import (
    HELD,
    PAGE,
    SMALL,
    TINY,
    WANTED,
    WORDS,
    colour_bar,
    headline,
    metres,
    new_figure,
    newtons,
    rope,
    save,
)
from relax.plots.view import LOOKS, View, look_at

if TYPE_CHECKING:
    from relax.design.solve import Design

HEIGHT = 3.3  # inches
BARS = 24  # forces shown by themselves, one a line


def draw_picture(design: "Design", path: Path) -> None:
    """Write the picture of `design` to `path` (.png, .pdf or .svg), as wide as a page: 7 by 3.3 inches.

    Left: the membrane coloured by its distance to the wanted shape, that shape as slices, supports in the colour of their
    kind, fixed edges, cables, the ground. Middle: the plan with the contours of the wanted shape. Right: the size of each
    support's force by its number.
    """
    view = look_at(design)
    figure = new_figure(PAGE, HEIGHT)
    draw_space(figure.add_axes((0.0, 0.07, 0.535, 0.86)), view)
    plan_panel(figure.add_axes((0.585, 0.315, 0.24, 0.56)), view, view.colours, "plan")
    colour_bar(figure, view.scale, (0.585, 0.16, 0.24, 0.022), "distance to the wanted shape", "m")
    _draw_forces(figure.add_axes((0.862, 0.16, 0.09, 0.715)), view)
    headline(figure, view.scene.title, _said(design, view))
    look: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, -0.01), "frameon": False, "fontsize": SMALL}
    figure.legend(handles=list(_legend(view)), ncols=6, handlelength=1.8, columnspacing=1.2, **look)
    save(figure, path)


def _said(design: "Design", view: View) -> str:
    figures = f"{view.counted}, rms distance {metres(design.certificate.rms_distance)}"
    return figures + ("" if design.certificate.converged else " (not converged)")


def _legend(view: View) -> Iterator[Line2D]:
    kinds = {strut.kind for strut in view.struts}
    for kind, look in LOOKS.items():
        if kind in kinds:
            yield Line2D([], [], color=look.colour, linewidth=look.width, marker=look.foot, markersize=3, label=kind)
    if view.scene.fixed.any():
        yield Line2D([], [], color=HELD, linewidth=1.0, label="fixed")
    if len(view.cables):
        yield rope("cable")
    yield Line2D([], [], color=WANTED, linewidth=0.6, label="wanted shape, sliced")


def _draw_forces(axes: Axes, view: View) -> None:
    """A bar for the force of each support, the number of the support at its left, the force in newtons at its end.

    Of many supports the largest stand alone, and one line says what is left.
    """
    sizes = np.array([strut.magnitude for strut in view.struts])
    shown = np.sort(np.argsort(-sizes, kind="stable")[:BARS])
    rows = np.arange(len(shown))
    colours = [view.struts[index].look.colour for index in shown]
    axes.barh(rows, sizes[shown], height=0.35, color=colours)
    for row, index in zip(rows, shown, strict=True):
        axes.annotate(newtons(sizes[index]), (sizes[index], row), (2, 0), textcoords="offset points", va="center", fontsize=TINY)
    axes.set_yticks(rows, [str(index + 1) for index in shown], fontsize=TINY)
    axes.tick_params(length=0.0, pad=1.0)
    axes.set_xticks([])
    axes.set_ylim(BARS - 0.3, -0.8)  # lines as high with one support as with many
    axes.set_xlim(0.0, 2.1 * sizes.max(initial=0.0) or 1.0)  # the rest is for the words at the longest
    axes.spines[["top", "right", "bottom"]].set_visible(False)
    axes.spines["left"].set(linewidth=0.5, bounds=(-0.5, max(len(rows) - 0.5, -0.5)))
    left = len(sizes) - len(shown)
    rest = f"{left} more,\nup to {newtons(np.sort(sizes)[left - 1])}" if left else ""
    axes.set_title("forces" if len(sizes) else "no force", loc="left", pad=3.0, **WORDS)
    if rest:
        axes.text(0.0, BARS - 0.2, rest, fontsize=TINY, va="top")
