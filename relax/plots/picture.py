"""The picture of a design: membrane, wanted shape and supports in perspective, and the plan with the supports numbered."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from relax.arrays import Floats
from relax.plots.perspective import Camera, Patches, cut_lines, face_patches, line_patches, paint, place_camera, slice_surface
from relax.plots.view import LOOKS, View, look_at

if TYPE_CHECKING:
    from relax.design.solve import Design

SIZE = (10.0, 4.75)  # inches
DOTS = 160  # per inch: 1600 x 760 pixels
TINY, SMALL, LARGE = 8.0, 9.0, 11.0  # points: readable where the picture is as wide as a column of text

WANTED, HELD, GROUND, GRID = to_rgba("#333333", 0.45), to_rgba("#5a4632"), to_rgba("#f1f0ec"), to_rgba("#d5d3cc")
TICK: Any = {"fontsize": TINY, "color": "#555555"}
POINT: Any = {"linestyle": "", "marker": "o", "markersize": 3.0, "color": HELD}
STILL: Any = {"autolim": False}  # limits are set by hand

PIECES = 40  # of a strut: shorter than the faces it passes between
SLICES = 13  # of the wanted shape along its longer side
CONTOURS = 8
NEAR = 0.04  # of the scene's size: lines on a surface are painted after it
BEHIND = 0.05  # of the size: a strut sorts as if farther, since the middle of the long faces at a tip lies lower than the tip
FAINT = 0.45  # opacity of what stands behind the membrane
MANY = 15  # more supports than this are numbered in the plan alone
LIGHT = np.array([-0.55, -0.25, 0.8])


def draw_picture(design: "Design", path: Path) -> None:
    """Write the picture of `design` to `path`, a PNG of 1600 x 760 pixels.

    Left: the membrane, coloured by its distance to the wanted shape, slices of the wanted shape, and the supports down to
    the ground. Right: the plan, with the supports numbered in the order of `design.supports`.
    """
    view = look_at(design)
    figure = Figure(figsize=SIZE, dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    _draw_perspective(figure.add_axes((0.0, 0.065, 0.645, 0.865)), view)
    _draw_plan(figure.add_axes((0.69, 0.215, 0.30, 0.675)), view)
    bar = figure.colorbar(view.scale, cax=figure.add_axes((0.70, 0.115, 0.28, 0.022)), orientation="horizontal")
    bar.set_label("distance to the wanted shape, metres", fontsize=SMALL)
    _plain_ticks(bar.ax.xaxis)
    bar.outline.set_visible(False)
    figure.text(0.015, 0.955, _title(design), fontsize=LARGE, va="center")
    figure.legend(handles=list(_legend(view)), loc="lower left", bbox_to_anchor=(0.01, 0), ncols=6, fontsize=SMALL, frameon=False)
    figure.savefig(path, dpi=DOTS, format="png")


def _title(design: "Design") -> str:
    kinds = [mast.kind for mast in design.supports]
    named = [(kinds.count(kind), kind) for kind in LOOKS if kind in kinds]
    counted = ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for count, kind in named)
    figures = f"{counted or 'no support'}, rms distance {design.certificate.rms_distance:.3g} m"
    return f"{design.problem.scene.title}: {figures}" + ("" if design.certificate.converged else " (not converged)")


def _legend(view: View) -> Iterator[Line2D]:
    kinds = {strut.kind for strut in view.struts}
    for kind, look in LOOKS.items():
        if kind in kinds:
            yield Line2D([], [], color=look.colour, linewidth=look.width, marker=look.foot, markersize=4, label=kind)
    yield Line2D([], [], color=HELD, linewidth=1.3, label="fixed")
    yield Line2D([], [], color=WANTED, linewidth=0.8, label="wanted shape, sliced")


def _draw_perspective(axes: Axes, view: View) -> None:
    wide = np.ptp(view.scene.target, axis=0)
    # the longer side across the picture
    camera = place_camera(view.low, view.high, -62.0 if wide[0] >= wide[1] else -28.0, 26.0)
    axes.set_axis_off()
    axes.set_aspect("equal")
    _draw_ground(axes, camera, view)
    starts, ends = view.design.positions[view.held_sides.T]
    fabric = face_patches(view.design.positions, view.corners, _lit_colours(view))
    paint(axes, camera, [fabric, *_slices(view), line_patches(starts, ends, HELD, 1.3, NEAR * view.size), *_struts(view)])
    _draw_ends(axes, camera, view)
    corners = np.stack(np.meshgrid(*zip(view.low, view.high, strict=True)), axis=-1).reshape(-1, 3)
    place = camera.project(corners)[0]
    margin = 0.05 * np.ptp(place, axis=0).max()
    axes.set_xlim(place[:, 0].min() - 1.6 * margin, place[:, 0].max() + margin)
    axes.set_ylim(place[:, 1].min() - margin, place[:, 1].max() + margin)


def _lit_colours(view: View) -> Floats:
    """Light the colours of the faces from the upper left, so that the form shows."""
    corner = np.moveaxis(view.design.positions[view.corners], 1, 0)
    # the cross product of a quad's diagonals; a triangle's last corner is its first, which gives its sides
    normal = np.cross(corner[2] - corner[0], corner[3] - corner[1])
    length = np.linalg.norm(normal, axis=1)
    upward = normal * np.where(normal[:, 2] < 0, -1.0, 1.0)[:, None] / np.where(length > 0, length, 1.0)[:, None]
    shade = 0.72 + 0.28 * np.clip(upward @ LIGHT / np.linalg.norm(LIGHT), 0.0, 1.0)
    lit: Floats = view.colours * np.column_stack([shade, shade, shade, np.ones_like(shade)])
    return lit


def _slices(view: View) -> Iterator[Patches]:
    """Lines of the wanted shape at equal steps of x and y: as dense on any mesh."""
    target = view.scene.target
    low, high = target.min(axis=0), target.max(axis=0)
    step = float((high - low)[:2].max()) / SLICES
    for axis in (0, 1):
        count = int((high - low)[axis] / step)
        for level in 0.5 * (low + high)[axis] + step * (np.arange(count) - 0.5 * (count - 1)):
            starts, ends = slice_surface(target, view.triangles, axis, float(level))
            yield line_patches(starts, ends, WANTED, 0.5, NEAR * view.size)


def _struts(view: View) -> Iterator[Patches]:
    for strut in view.struts:
        starts, ends = cut_lines(strut.head[None], strut.end[None], PIECES)
        yield line_patches(starts, ends, strut.look.colour, strut.look.width, -BEHIND * view.size)


def _draw_ground(axes: Axes, camera: Camera, view: View) -> None:
    """Draw the ground as a sheet with a grid, and metres along its two near edges and an upright at the left."""
    low, high, level = view.low, view.high, view.scene.ground
    sheet = np.array([[low[0], low[1], level], [high[0], low[1], level], [high[0], high[1], level], [low[0], high[1], level]])
    lines = []
    outward = 0.02 * (high - low)[:2].max()
    for axis, other, side in ((0, 1, -1.0), (1, 0, 1.0)):
        for value in _ticks(low[axis], high[axis], 6):
            ends = np.full((2, 3), level)
            ends[:, axis] = value
            ends[:, other] = (low[other], high[other])[:: -int(side)]
            lines.append(camera.project(ends)[0])
            x, y = camera.project(ends[0] + side * outward * np.eye(3)[other])[0]
            axes.text(x, y, _number_text(value), ha="right" if side < 0 else "left", va="top", **TICK)
    lines.append(camera.project(np.array([low, [low[0], low[1], high[2]]]))[0])
    heights = _ticks(low[2], high[2], 4)[1:]
    # a flat scene has room for one number on its short upright
    for value in heights if len(heights) > 1 and np.ptp(heights[:2]) > 0.05 * view.size else heights[-1:]:
        mark = np.array([[low[0], low[1], value], [low[0] - 0.5 * outward, low[1], value]])
        lines.append(camera.project(mark)[0])
        x, y = lines[-1][1]
        axes.text(x, y, _number_text(value) + " ", ha="right", va="center", **TICK)
    ground = PolyCollection([camera.project(sheet)[0]], facecolors=[GROUND], edgecolors=[GRID], linewidths=0.8, zorder=0)
    axes.add_collection(ground, **STILL)
    axes.add_collection(LineCollection(lines, colors=[GRID], linewidths=0.7, zorder=0.5), **STILL)


def _draw_ends(axes: Axes, camera: Camera, view: View) -> None:
    """Draw heads, feet, numbers and fixed points, and the struts once more: faintly, where they stand behind the membrane."""
    axes.plot(*camera.project(view.design.positions[view.held_points])[0].T, **POINT)
    for number, strut in enumerate(view.struts, start=1):
        colour, width = strut.look.colour, strut.look.width
        head, end = camera.project(np.array([strut.head, strut.end]))[0]
        axes.plot(*np.array([head, end]).T, color=colour, linewidth=width, alpha=FAINT)
        if strut.kind == "stay":
            _arrow(axes, head, end, colour)
        elif strut.whole:
            for order, opacity in ((0.8, 1.0), (2.0, FAINT)):
                axes.plot(*end, marker=strut.look.foot, color=colour, markersize=4, zorder=order, alpha=opacity)
        axes.plot(*head, marker="o", color=colour, markersize=3.5, markeredgecolor="white", markeredgewidth=0.6)
        if len(view.struts) <= MANY:
            _number(axes, head, number, LARGE)


def _arrow(axes: Axes, start: Floats, end: Floats, colour: Any) -> None:
    arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=arrow)


def _number(axes: Axes, place: Floats, number: int, size: float) -> None:
    halo = [withStroke(linewidth=2.0, foreground="white")]
    spot = float(place[0]), float(place[1])
    axes.annotate(str(number), spot, (3, 3), textcoords="offset points", fontsize=size, path_effects=halo)


def _draw_plan(axes: Axes, view: View) -> None:
    flat = view.design.positions[:, :2]
    fabric = PolyCollection(list(flat[view.corners]), facecolors=view.colours, edgecolors=view.colours, linewidths=0.4)
    axes.add_collection(fabric, **STILL)
    heights = view.scene.target[:, 2]
    for level in np.linspace(heights.min(), heights.max(), CONTOURS + 2)[1:-1]:
        lines = np.stack(slice_surface(view.scene.target, view.triangles, 2, float(level)), axis=1)
        axes.add_collection(LineCollection(list(lines[:, :, :2]), colors=[WANTED], linewidths=0.5), **STILL)
    axes.add_collection(LineCollection(list(flat[view.held_sides]), colors=[HELD], linewidths=1.3), **STILL)
    axes.plot(*flat[view.held_points].T, **POINT)
    white: Any = {"markeredgecolor": "white", "markeredgewidth": 0.6, "markersize": 4.5}
    for number, strut in enumerate(view.struts, start=1):
        look = strut.look
        axes.plot(*np.array([strut.head, strut.end]).T[:2], color=look.colour, linewidth=0.6 * look.width)
        axes.plot(*strut.head[:2], marker=look.head, color=look.colour, **white)
        _number(axes, strut.head, number, SMALL if len(view.struts) <= MANY else TINY)
    axes.set_aspect("equal")
    margin = 0.03 * (view.high - view.low)[:2].max()
    axes.set_xlim(view.low[0] - margin, view.high[0] + margin)
    axes.set_ylim(view.low[1] - margin, view.high[1] + margin)
    for axis in (axes.xaxis, axes.yaxis):
        _plain_ticks(axis)
    axes.set_title("plan, metres", fontsize=SMALL, loc="left")
    axes.spines[:].set_visible(False)


def _ticks(low: float, high: float, count: int) -> Floats:
    values = np.asarray(MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low, high))
    room = 1e-9 * (high - low)
    return values[(values >= low - room) & (values <= high + room)]


def _plain_ticks(axis: Axis) -> None:
    """Set few, plain numbers: the exponents that matplotlib splits off would hang in the wrong place."""
    axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axis.set_major_formatter(lambda value, _: _number_text(value))
    axis.set_tick_params(labelsize=TINY)


def _number_text(value: float) -> str:
    return f"{value:.6g}".replace("-", "\N{MINUS SIGN}")
