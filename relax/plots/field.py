"""The value of a mast at every vertex, in plan: where one more support would pay, and where the others stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from relax.arrays import Floats
from relax.plots.view import ERROR, full_corners

if TYPE_CHECKING:
    from relax.membrane.scene import Scene

SIZE = (5.6, 5.2)  # inches
DOTS = 180  # per inch
SMALL, LARGE = 9.0, 10.5  # points
NOWHERE = to_rgba("#e3e1db")  # where no support may stand


@dataclass(frozen=True)
class Look:
    """A field's name in tables, the words beside its colours, and the value that the colours reach at least."""

    name: str
    words: str
    top: float


PULL = Look("pull", "pull / steepest slope of the penalty: above 1 a small support pays", 1.0)
FIT = Look("fit", "fall of the distance term that a mast promises, its price not counted, {unit}", 0.0)


def draw_field(scene: "Scene", values: Floats, heads: Sequence[int], path: Path, look: Look = PULL) -> None:
    """Write a field of the vertices (V,), nan where it has no value, to `path`, a PNG of 1008 x 936 pixels, `heads` marked."""
    figure = Figure(figsize=SIZE, dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.1, 0.2, 0.87, 0.68))
    flat, known = scene.target[:, :2], np.isfinite(values)
    scale = ScalarMappable(Normalize(0.0, max(float(values[known].max(initial=0.0)), look.top) or 1.0), ERROR)
    colours = _face_colours(scene, values, scale)
    corners = list(flat[full_corners(scene.mesh.faces)])
    axes.add_collection(PolyCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.3))
    chosen = list(heads)
    mark: Any = {"linestyle": "none", "marker": "o", "markersize": 6, "color": "#1a1a1a", "markeredgecolor": "white"}
    if chosen:
        axes.plot(*flat[chosen].T, label="support", **mark)
    if known.any() and values[known].max() > 0:
        _mark_best(axes, flat[int(np.nanargmax(np.where(known, values, np.nan)))], largest=float(values[known].max()))
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.tick_params(labelsize=SMALL)
    axes.set_xlabel("x, m", fontsize=SMALL)
    axes.set_ylabel("y, m", fontsize=SMALL)
    axes.spines[:].set_visible(False)
    figure.suptitle(scene.title, fontsize=LARGE, x=0.02, y=0.98, ha="left")
    figure.legend(
        *axes.get_legend_handles_labels(), fontsize=SMALL, frameon=False, loc="upper left", bbox_to_anchor=(0.0, 0.955), ncols=2
    )
    bar = figure.colorbar(scale, cax=figure.add_axes((0.1, 0.095, 0.87, 0.02)), orientation="horizontal")
    # E_dist weighs squares of lengths by areas where that is asked for
    bar.set_label(look.words.format(unit="m\u2074" if scene.settings["target"]["area_weights"] else "m\u00b2"), fontsize=SMALL)
    # the power of ten that matplotlib splits off would be written into the words
    bar.ax.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    bar.ax.xaxis.set_major_formatter(lambda value, _: f"{value:.6g}")
    bar.ax.tick_params(labelsize=SMALL)
    bar.outline.set_visible(False)
    figure.savefig(path, dpi=DOTS, format="png")


def _face_colours(scene: "Scene", values: Floats, scale: ScalarMappable) -> Any:
    """Of each face (F, 4): the mean of its own corners that have a value; the padding of a triangle is none of them."""
    faces = scene.mesh.faces
    counts = np.isfinite(values)[faces] & (faces >= 0)
    counted = counts.sum(axis=1)
    mean = np.where(counts, values[faces], 0.0).sum(axis=1) / np.maximum(counted, 1)
    return np.where(counted[:, None] > 0, scale.to_rgba(mean), NOWHERE)


def _mark_best(axes: Any, place: Floats, largest: float) -> None:
    mark: Any = {"color": "#d55e00", "markersize": 11, "markeredgewidth": 2.2, "linestyle": "none"}
    halo = [withStroke(linewidth=3.0, foreground="white")]
    axes.plot(*place, marker="+", path_effects=halo, label=f"largest, {largest:.3g}", **mark)
