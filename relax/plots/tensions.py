"""The tension of every edge, in plan: colours in newtons, slack edges marked, cables apart."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from relax.arrays import Floats, Mask
from relax.membrane.membrane import Membrane
from relax.plots.plan import draw_edges, draw_supports, frame_plan
from relax.plots.style import (
    CABLE,
    CABLE_CORE,
    COLUMN,
    CORNER,
    INK,
    POINT,
    SLACK,
    TENSION,
    colour_bar,
    headline,
    new_figure,
    newtons,
    rope,
    save,
)
from relax.plots.view import View, look_at

if TYPE_CHECKING:
    from relax.design.solve import Design

HEIGHT = 3.75  # inches
WIDEST = 0.9  # points: an edge


def draw_tensions(design: "Design", path: Path) -> None:
    """Write the edge tensions of `design` to `path` (.png, .pdf or .svg), as wide as a column: 3.5 by 3.75 inches.

    Edges shorter than their rest length (of a force density: those that push) are blue and dashed. Cables carry more than
    fabric; the legend gives their tensions, and the colours are those of the other edges.
    """
    scene, view = design.problem.scene, look_at(design)
    tension, slack = scene.membrane.tension(design.positions), slack_edges(scene.membrane, design.positions)
    roped = _along(view)
    figure = new_figure(COLUMN, HEIGHT)
    axes = figure.add_axes((0.13, 0.215, 0.84, 0.66))
    taut = ~slack & ~roped
    scale = ScalarMappable(Normalize(0.0, max(float(tension[taut].max(initial=0.0)), np.finfo(float).tiny)), TENSION)
    # the largest last, so that it lies on top where edges meet
    order = np.flatnonzero(taut)[np.argsort(tension[taut], kind="stable")]
    edges = scene.mesh.edges
    # edges of a fine mesh are thinner, or they would cover each other
    width = min(WIDEST, 0.4 * 72 * COLUMN / np.sqrt(len(edges)))
    draw_edges(axes, view, edges[order], colors=scale.to_rgba(tension[order]), linewidths=width)
    if slack.any():
        said = f"slack: {int(slack.sum())} of {len(slack)}"
        draw_edges(axes, view, edges[slack], colors=[SLACK], linewidths=width, linestyles="dashed", label=said)
    if roped.any():
        draw_edges(axes, view, edges[roped], colors=[CABLE], linewidths=1.8)
        draw_edges(axes, view, edges[roped], colors=[CABLE_CORE], linewidths=0.8)
        axes.add_line(rope(f"cables: {_range(tension[roped])}"))
    if scene.fixed.any():
        axes.plot(*view.flat[scene.fixed].T, label="fixed", **POINT)
    draw_supports(axes, view, INK)  # a tie-down's own orange is lost among the tensions
    frame_plan(axes, view, "")
    colour_bar(figure, scale, (0.13, 0.09, 0.84, 0.02), "tension of an edge", "N")
    headline(figure, scene.title, f"tensions {_range(tension)}")
    figure.legend(*axes.get_legend_handles_labels(), ncols=3, handlelength=1.6, columnspacing=1.2, **CORNER)
    save(figure, path)


def slack_edges(membrane: Membrane, positions: Floats) -> Mask:
    """Which edges (E,) are shorter than their rest length; of force densities, which have none, those that push."""
    if membrane.linear:
        return membrane.spring_constant < 0
    return membrane.edge_state(positions).length < membrane.rest_length


def _along(view: View) -> Mask:
    """Which edges (E,) have a cable along them."""
    there = {(min(pair), max(pair)) for pair in view.cables.tolist()}
    return np.array([tuple(edge) in there for edge in view.scene.mesh.edges.tolist()], dtype=bool)


def _range(values: Floats) -> str:
    return f"{_signed(values.min())} to {_signed(values.max())}"


def _signed(value: float) -> str:
    return ("\N{MINUS SIGN}" if value < 0 else "") + newtons(abs(value))
