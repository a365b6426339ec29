"""The value of a mast at every vertex, in plan: where one more support would pay, and where the others stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from relax.arrays import Floats
from relax.plots.plan import draw_fabric, draw_held, frame_plan
from relax.plots.style import BEST, COLUMN, CORNER, INK, NOWHERE, WORTH, colour_bar, halo, headline, new_figure, save
from relax.plots.view import look_at_shape, objective_unit

if TYPE_CHECKING:
    from relax.design.solve import Design
    from relax.membrane.scene import Scene

HEIGHT = 3.75  # inches


@dataclass(frozen=True)
class Look:
    """A field's name in tables, the words beside its colours, and the value that the colours reach at least."""

    name: str
    words: str
    top: float


PULL = Look("pull", "pull / steepest slope of R; above 1 a small mast pays", 0.01)
FIT = Look("fit", "fall of E_dist that a mast promises, without R, {unit}", 0.0)


def draw_values(design: "Design", path: Path) -> None:
    """Write the value of a mast at every vertex of `design`, its pull, to `path`; as `draw_field` does.

    Raises
    ------
    EquilibriumError
        The stiffness is singular at this shape, so that no pull exists.
    """
    from relax.design.mast_values import pull

    values = pull(design.problem, design.positions, design.forces)
    draw_field(design.problem.scene, values, [mast.vertex for mast in design.supports], path)


def draw_field(scene: "Scene", values: Floats, heads: Sequence[int], path: Path, look: Look = PULL) -> None:
    """Write a field of the vertices (V,), nan where it has no value, to `path`, `heads` marked; 3.5 by 3.75 inches.

    In plan, over the wanted shape. Vertices without a value are grey.
    """
    view = look_at_shape(scene, scene.target)
    figure = new_figure(COLUMN, HEIGHT)
    axes = figure.add_axes((0.13, 0.215, 0.84, 0.66))
    known = np.isfinite(values)
    scale = ScalarMappable(Normalize(0.0, max(float(values[known].max(initial=0.0)), look.top) or 1.0), WORTH)
    draw_fabric(axes, view, _face_colours(scene, values, scale))
    draw_held(axes, view)
    mark: Any = {"linestyle": "none", "marker": "o", "markersize": 4, "color": INK, "markeredgecolor": "white"}
    if len(heads):
        axes.plot(*view.flat[list(heads)].T, label="support", markeredgewidth=0.5, **mark)
    if known.any() and values[known].max() > 0:
        _mark_best(axes, view.flat[int(np.nanargmax(np.where(known, values, np.nan)))], largest=float(values[known].max()))
    frame_plan(axes, view, "")
    headline(figure, scene.title, "what a mast is worth")
    figure.legend(*axes.get_legend_handles_labels(), ncols=3, handlelength=1.6, columnspacing=1.2, **CORNER)
    colour_bar(figure, scale, (0.13, 0.09, 0.84, 0.02), look.words.format(unit=objective_unit(scene)))
    save(figure, path)


def _face_colours(scene: "Scene", values: Floats, scale: ScalarMappable) -> Any:
    """Of each face (F, 4): the mean of its own corners that have a value; the padding of a triangle is none of them."""
    faces = scene.mesh.faces
    counts = np.isfinite(values)[faces] & (faces >= 0)
    counted = counts.sum(axis=1)
    mean = np.where(counts, values[faces], 0.0).sum(axis=1) / np.maximum(counted, 1)
    return np.where(counted[:, None] > 0, scale.to_rgba(mean), NOWHERE)


def _mark_best(axes: Any, place: Floats, largest: float) -> None:
    mark: Any = {"color": BEST, "markersize": 8, "markeredgewidth": 1.6, "linestyle": "none"}
    axes.plot(*place, marker="+", path_effects=halo(2.2), label=f"largest, {largest:.3g}", **mark)
