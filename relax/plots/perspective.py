"""A small painter of 3-D scenes: patches and lines, sorted together from far to near, on ordinary matplotlib axes.

Matplotlib's own 3-D axes sort whole artists, so a mast under a membrane is drawn either before all of it or after all of it.
Here everything is one list of patches, and a strut is cut into short pieces that find their place between the faces.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from relax.arrays import Floats, Ints
from relax.plots.style import SHAPES

Colour = tuple[float, float, float, float]


@dataclass(frozen=True)
class Camera:
    """A point of view: `towards` (3,) points from the `centre` (3,) of the scene to the eye, `distance` metres away."""

    centre: Floats
    distance: float
    towards: Floats
    right: Floats
    up: Floats

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Screen places (..., 2) and depths (...), both metres at the centre; depth grows towards the eye."""
        offset = points - self.centre
        depth = offset @ self.towards
        scale = self.distance / (self.distance - depth)
        return np.stack([offset @ self.right * scale, offset @ self.up * scale], axis=-1), depth


def place_camera(low: Floats, high: Floats, azimuth: float, elevation: float) -> Camera:
    """Place a camera that sees the box from `low` to `high` (3,), from `azimuth` and `elevation` degrees."""
    turn, rise = np.radians([azimuth, elevation])
    towards = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    # three diagonals away: lines that run off still converge a little, nothing is distorted
    return Camera(0.5 * (low + high), 3.0 * float(np.linalg.norm(high - low)), towards, right, np.cross(towards, right))


@dataclass(frozen=True)
class Patches:
    """Things to paint, N at a time: faces, or lines as patches without an inside.

    Parameters
    ----------
    corners : (N, 4, 3) metres; a triangle repeats a corner, a line both ends
    inside, outline : (N, 4) red, green, blue, opacity
    width : (N,) points
    nearer : (N,) metres
        Added to the depth when sorting, so that a line on a surface is painted after it.
    """

    corners: Floats
    inside: Floats
    outline: Floats
    width: Floats
    nearer: Floats


def face_patches(positions: Floats, corners: Ints, colours: Floats) -> Patches:
    """Faces by their `corners` (F, 4), a triangle repeating one, filled with `colours` (F, 4)."""
    count = len(corners)
    # a hairline of the same colour closes the seams that antialiasing leaves between neighbours
    return Patches(positions[corners], colours, colours, np.full(count, 0.4), np.zeros(count))


def line_patches(starts: Floats, ends: Floats, colour: Colour, width: float, nearer: float = 0.0) -> Patches:
    """Straight lines from `starts` to `ends` (N, 3)."""
    corners = np.stack([starts, ends, ends, starts], axis=1)
    count = len(corners)
    nothing = np.zeros((count, 4))
    return Patches(corners, nothing, np.tile(colour, (count, 1)), np.full(count, width), np.full(count, nearer))


def cut_lines(starts: Floats, ends: Floats, pieces: int) -> tuple[Floats, Floats]:
    """Cut the lines (N, 3) into `pieces` each: starts and ends (N * pieces, 3)."""
    share = np.linspace(0.0, 1.0, pieces + 1)[None, :, None]
    points = starts[:, None] + share * (ends - starts)[:, None]
    return points[:, :-1].reshape(-1, 3), points[:, 1:].reshape(-1, 3)


def paint(axes: Axes, camera: Camera, layers: Sequence[Patches]) -> None:
    """Paint all patches of all layers together, the farthest first."""
    corners = np.concatenate([layer.corners for layer in layers])
    screen, depth = camera.project(corners)
    order = np.argsort(depth.mean(axis=1) + np.concatenate([layer.nearer for layer in layers]), kind="stable")
    axes.add_collection(
        PolyCollection(
            list(screen[order]),
            facecolors=np.concatenate([layer.inside for layer in layers])[order],
            edgecolors=np.concatenate([layer.outline for layer in layers])[order],
            linewidths=np.concatenate([layer.width for layer in layers])[order],
            capstyle="round",
            joinstyle="round",
            rasterized=len(order) > SHAPES,
        ),
        autolim=False,
    )


def slice_surface(positions: Floats, triangles: Ints, axis: int, level: float) -> tuple[Floats, Floats]:
    """Where the plane `axis` = `level` cuts the triangles (T, 3): starts and ends of segments (k, 3)."""
    above = positions[:, axis] >= level
    cut = triangles[(above[triangles].any(axis=1)) & ~above[triangles].all(axis=1)]
    # turn each triangle so that its lone corner comes first; the plane cuts the two sides that meet there
    side = above[cut]
    lone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), side.argmin(axis=1))
    first, second, third = np.take_along_axis(cut, (lone[:, None] + np.arange(3)) % 3, axis=1).T
    return _crossing(positions[first], positions[second], axis, level), _crossing(positions[first], positions[third], axis, level)


def _crossing(one: Floats, other: Floats, axis: int, level: float) -> Floats:
    share = (level - one[:, axis]) / (other[:, axis] - one[:, axis])
    return one + share[:, None] * (other - one)
