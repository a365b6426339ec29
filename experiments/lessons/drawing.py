"""What the lessons draw with: colours that colour-blind eyes tell apart, a membrane in perspective, a field in plan."""

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure

from relax.membrane.mesh import Mesh
from relax.plots.perspective import cut_lines, face_patches, line_patches, paint, place_camera
from relax.plots.style import ERROR
from relax.plots.view import full_corners

# M. Okabe, K. Ito: Color Universal Design (2008)
BLUE, ORANGE, GREEN, SKY, PINK, BLACK = "#0072b2", "#d55e00", "#009e73", "#56b4e9", "#cc79a7", "#1a1a1a"
COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY, BLACK)
LIGHT = np.array([-0.55, -0.25, 0.8])


def new_figure(width: float = 7.2, height: float = 3.2, columns: int = 1) -> tuple[Figure, np.ndarray]:
    """A figure of `width` by `height` inches, and its axes side by side (columns,)."""
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    return figure, figure.subplots(1, columns, squeeze=False)[0]


def label(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Words on both axes and above them; no box around."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, loc="left", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)


def draw_plan(axes: Axes, mesh: Mesh, flat: np.ndarray, values: np.ndarray, top: float | None = None) -> ScalarMappable:
    """A field of the vertices (V,) in plan, as the mean over each face; returns the scale for a colour bar."""
    corners = full_corners(mesh.faces)
    scale = ScalarMappable(Normalize(0.0, top or float(np.nanmax(values)) or 1.0), ERROR)
    colours = scale.to_rgba(values[corners[:, :3]].mean(axis=1))
    axes.add_collection(PolyCollection(list(flat[corners][:, :, :2]), facecolors=colours, edgecolors=colours, linewidths=0.3))
    axes.set_aspect("equal")
    axes.autoscale_view()
    return scale


def mark(axes: Axes, places: np.ndarray, words: str, symbol: str = "o") -> None:
    """Mark places (k, 3) in plan."""
    axes.plot(*places[:, :2].T, symbol, color=BLACK, markerfacecolor="none", markersize=9, markeredgewidth=1.4, label=words)


def _light(positions: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """How bright each face is, from 0.6 to 1 (F,)."""
    one, other, third = np.moveaxis(positions[corners[:, :3]], 1, 0)
    normal = np.cross(other - one, third - one)
    return 0.6 + 0.4 * np.clip(np.abs(normal @ LIGHT) / np.linalg.norm(LIGHT) / np.linalg.norm(normal, axis=1), 0.0, 1.0)


def draw_shape(axes: Axes, mesh: Mesh, positions: np.ndarray, forces: np.ndarray, colour: str = SKY) -> None:
    """A membrane in perspective, with the line of action of every support force (V, 3) down to z = 0."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    high[2] = max(high[2], low[2] + 0.15)
    camera = place_camera(np.minimum(low, 0.0), high, -62.0, 20.0)
    corners = full_corners(mesh.faces)
    colours = np.tile(to_rgba(colour), (len(corners), 1))
    colours[:, :3] *= _light(positions, corners)[:, None]
    layers = [face_patches(positions, corners, colours)]
    stands = np.flatnonzero(np.linalg.norm(forces, axis=1) > 0)
    if stands.size:
        head, force = positions[stands], forces[stands]
        rise = np.where(np.abs(force[:, 2]) > 0.2 * np.linalg.norm(force, axis=1), force[:, 2], np.inf)
        starts, ends = cut_lines(head, head - force * (head[:, 2] / rise)[:, None], 20)
        layers.append(line_patches(starts, ends, to_rgba(BLACK), 2.0, -0.05))
    paint(axes, camera, layers)
    for top, bottom in camera.project(np.stack([starts[::20], ends[19::20]], axis=1))[0] if stands.size else ():
        axes.plot(*np.array([top, bottom]).T, color=BLACK, linewidth=2.0, alpha=0.5)  # what stands behind the membrane
        axes.plot(*top, "o", color=BLACK, markersize=4, markeredgecolor="white", markeredgewidth=0.6)
    box = np.stack(np.meshgrid(*zip(np.minimum(low, 0.0), high, strict=True)), axis=-1).reshape(-1, 3)
    axes.update_datalim(camera.project(box)[0])
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.margins(0.0)
    axes.set_axis_off()


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown; numbers with five digits."""
    lines = [[f"{cell:.5g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in [list(header), ["---"] * len(header), *lines])


def quick_picture(mesh: Mesh, positions: np.ndarray, wanted: np.ndarray, forces: np.ndarray, planted: np.ndarray) -> str:
    """A membrane over the unit square in perspective and in plan, as SVG: a slider cannot wait for matplotlib (0.3 s).

    Colours are the distance to the `wanted` shape, darkest from 0.1 m on; squares are the planted supports, dots those found.
    """
    corners = mesh.faces[:, :3]
    colours = ERROR(np.minimum(np.linalg.norm(positions - wanted, axis=1)[corners].mean(axis=1) / 0.1, 1.0))[:, :3]
    camera = place_camera(np.array([0.0, 0.0, -0.1]), np.array([1.0, 1.0, 0.5]), -62.0, 20.0)  # the same for every answer
    screen, depth = camera.project(positions)
    left, right = [225, 150] + 260 * screen * [1, -1], [480, 270] + 240 * positions[:, :2] * [1, -1]
    far_first = np.argsort(depth[corners].mean(axis=1))
    parts = [*_polygons(left, corners[far_first], (colours * _light(positions, corners)[:, None])[far_first])]
    parts += _polygons(right, corners, colours)
    for vertex in np.flatnonzero(forces.any(axis=1)):
        head, force = positions[vertex], forces[vertex]
        foot = head - force * head[2] / force[2] if abs(force[2]) > 0.2 * np.linalg.norm(force) else head
        (x, y), (a, b) = left[vertex], [225, 150] + 260 * camera.project(foot)[0] * [1, -1]
        parts.append(f'<path d="M{x:.1f} {y:.1f}L{a:.1f} {b:.1f}" stroke="{BLACK}" stroke-width="2.5" opacity="0.6"/>')
        for (x, y), radius in ((left[vertex], 3.0), (right[vertex], 14 * np.sqrt(np.linalg.norm(force)) + 1)):
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="{BLACK}"/>')
    for x, y in right[planted.any(axis=1)] - 12:
        parts.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="24" height="24" fill="none" stroke="{ORANGE}" stroke-width="2"/>')
    words = (
        (480, 288, "0"),
        (700, 288, "1 m"),
        (480, 20, "plan: squares planted, dots found"),
        (20, 288, "pale: at the wanted shape; darkest: 0.1 m off"),
    )
    parts += [f'<text x="{x}" y="{y}" font-size="13" font-family="sans-serif">{text}</text>' for x, y, text in words]
    return f'<svg viewBox="0 0 740 300" width="100%" role="img" aria-label="The membrane and its supports">{"".join(parts)}</svg>'


def _polygons(places: np.ndarray, corners: np.ndarray, colours: np.ndarray) -> Iterable[str]:
    """Triangles (F, 3) of places (V, 2), filled with colours (F, 3)."""
    for (a, b, c), (red, green, blue) in zip(places[corners].round(1).tolist(), (255 * colours).astype(int), strict=True):
        ink = f"rgb({red},{green},{blue})"
        yield f'<path d="M{a[0]} {a[1]}L{b[0]} {b[1]}L{c[0]} {c[1]}Z" fill="{ink}" stroke="{ink}" stroke-width="0.6"/>'
