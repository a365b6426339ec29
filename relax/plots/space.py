"""The panel in space: membrane, wanted shape as slices, fixed edges, cables, supports and the ground, in perspective."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from relax.arrays import Floats
from relax.plots.perspective import Camera, Patches, cut_lines, face_patches, line_patches, paint, place_camera
from relax.plots.plan import MANY, draw_number
from relax.plots.style import (
    CABLE,
    CABLE_CORE,
    GRID,
    GROUND,
    HELD,
    LARGE,
    POINT,
    STILL,
    TICK,
    WANTED,
    number_text,
    ticks,
)
from relax.plots.view import View

PIECES = 40  # of a strut: shorter than the faces it passes between
NEAR = 0.04  # of the scene's size: lines on a surface are painted after it
BEHIND = 0.05  # of the size: a strut sorts as if farther, since the middle of the long faces at a tip lies lower than the tip
FAINT = 0.45  # opacity of what stands behind the membrane
LIGHT = np.array([-0.55, -0.25, 0.8])


def draw_space(axes: Axes, view: View) -> None:
    """Draw all of it, seen from a side on which the longer side lies across the picture."""
    wide = np.ptp(view.scene.target, axis=0)
    # the longer side across the picture
    camera = place_camera(view.low, view.high, -62.0 if wide[0] >= wide[1] else -28.0, 26.0)
    axes.set_axis_off()
    axes.set_aspect("equal")
    _draw_ground(axes, camera, view)
    starts, ends = view.positions[view.held_sides.T]
    fabric = face_patches(view.positions, view.corners, _lit_colours(view))
    slices = line_patches(*view.slices, WANTED, 0.35, NEAR * view.size)
    held = line_patches(starts, ends, HELD, 1.0, NEAR * view.size)
    paint(axes, camera, [fabric, slices, held, *_ropes(view), *_struts(view)])
    _draw_ends(axes, camera, view)
    corners = np.stack(np.meshgrid(*zip(view.low, view.high, strict=True)), axis=-1).reshape(-1, 3)
    place = camera.project(corners)[0]
    margin = 0.05 * np.ptp(place, axis=0).max()
    axes.set_xlim(place[:, 0].min() - 3.4 * margin, place[:, 0].max() + margin)
    axes.set_ylim(place[:, 1].min() - margin, place[:, 1].max() + margin)


def _ropes(view: View) -> Iterator[Patches]:
    """Cables: a light core painted over a dark line."""
    starts, ends = view.positions[view.cables.T]
    yield line_patches(starts, ends, CABLE, 1.8, NEAR * view.size)
    yield line_patches(starts, ends, CABLE_CORE, 0.8, 2.0 * NEAR * view.size)


def _lit_colours(view: View) -> Floats:
    """Light the colours of the faces from the upper left, so that the form shows."""
    corner = np.moveaxis(view.positions[view.corners], 1, 0)
    # the cross product of a quad's diagonals; a triangle's last corner is its first, which gives its sides
    normal = np.cross(corner[2] - corner[0], corner[3] - corner[1])
    length = np.linalg.norm(normal, axis=1)
    upward = normal * np.where(normal[:, 2] < 0, -1.0, 1.0)[:, None] / np.where(length > 0, length, 1.0)[:, None]
    shade = 0.72 + 0.28 * np.clip(upward @ LIGHT / np.linalg.norm(LIGHT), 0.0, 1.0)
    lit: Floats = view.colours * np.column_stack([shade, shade, shade, np.ones_like(shade)])
    return lit


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
        values = ticks(low[axis], high[axis], 6)
        for value in values:
            ends = np.full((2, 3), level)
            ends[:, axis] = value
            ends[:, other] = (low[other], high[other])[:: -int(side)]
            lines.append(camera.project(ends)[0])
            x, y = camera.project(ends[0] + side * outward * np.eye(3)[other])[0]
            axes.text(x, y, _length_text(value, values[-1]), ha="right" if side < 0 else "left", va="top", **TICK)
    lines.append(camera.project(np.array([low, [low[0], low[1], high[2]]]))[0])
    heights = ticks(low[2], high[2], 4)[1:]
    # a flat scene has room for one number on its short upright
    for value in heights if len(heights) > 1 and np.ptp(heights[:2]) > 0.05 * view.size else heights[-1:]:
        mark = np.array([[low[0], low[1], value], [low[0] - 0.5 * outward, low[1], value]])
        lines.append(camera.project(mark)[0])
        x, y = lines[-1][1]
        axes.text(x, y, _length_text(value, heights[-1]) + " ", ha="right", va="center", **TICK)
    ground = PolyCollection([camera.project(sheet)[0]], facecolors=[GROUND], edgecolors=[GRID], linewidths=0.5, zorder=0)
    axes.add_collection(ground, **STILL)
    axes.add_collection(LineCollection(lines, colors=[GRID], linewidths=0.5, zorder=0.5), **STILL)


def _length_text(value: float, last: float) -> str:
    """A number on an axis in space, whose last one has the unit."""
    return number_text(value) + (" m" if value == last else "")


def _draw_ends(axes: Axes, camera: Camera, view: View) -> None:
    """Draw heads, feet, numbers and fixed points, and the struts once more: faintly, where they stand behind the membrane."""
    axes.plot(*camera.project(view.positions[view.held_points])[0].T, **POINT)
    for number, strut in enumerate(view.struts, start=1):
        colour, width = strut.look.colour, strut.look.width
        head, end = camera.project(np.array([strut.head, strut.end]))[0]
        axes.plot(*np.array([head, end]).T, color=colour, linewidth=width, alpha=FAINT)
        if strut.kind == "stay":
            _arrow(axes, head, end, colour)
        elif strut.whole:
            for order, opacity in ((0.8, 1.0), (2.0, FAINT)):
                axes.plot(*end, marker=strut.look.foot, color=colour, markersize=3, zorder=order, alpha=opacity)
        axes.plot(*head, marker="o", color=colour, markersize=2.8, markeredgecolor="white", markeredgewidth=0.4)
        if len(view.struts) <= MANY:
            draw_number(axes, head, number, LARGE)


def _arrow(axes: Axes, start: Floats, end: Floats, colour: Any) -> None:
    arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=arrow)
