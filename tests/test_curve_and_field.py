"""The trade-off curve and the field show what they are given."""

import numpy as np
import pytest
import zoo
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image
from test_trade_off import curve_of

import relax
from relax.plots import field as field_plot
from relax.plots.style import BEST, INK, WORTH, plain_marks


def drawn(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), dtype=float) / 255


def near(pixels, colour):
    """Where a picture has a colour (rows, columns)."""
    return np.argwhere(np.abs(pixels - to_rgb(colour)).max(axis=2) < 0.02)


@pytest.mark.parametrize("points", [((0, 1.0), (1, 0.1), (5, 0.03), (10, 0.01)), ((3, 0.0),), ((0, 1.0), (0, 1.0), (2, 0.0))])
def test_the_knee_is_marked_on_both_sides(points, tmp_path):
    curve = relax.trade_off(curve_of(*points))
    relax.draw_trade_off(curve, tmp_path / "curve.png", "title")
    pixels = drawn(tmp_path / "curve.png")
    assert pixels.shape == (900, 2100, 3)
    marks = near(pixels, BEST)
    height, width = pixels.shape[:2]
    above = marks[marks[:, 0] < 0.85 * height]  # without the legend
    left, right = (above[above[:, 1] < width / 2], above[above[:, 1] >= width / 2])
    assert len(left) > 50 and len(right) > 50
    # both sides share the axis of rms distance
    assert abs(left[:, 0].mean() - right[:, 0].mean()) < 2


def test_a_farther_knee_is_drawn_higher(tmp_path):
    heights = []
    for rms in (0.3, 0.05):
        curve = relax.trade_off(curve_of((0, 1.0), (1, rms), (10, 0.01)))
        assert curve.knee == 1
        relax.draw_trade_off(curve, tmp_path / "curve.png")
        heights.append(near(drawn(tmp_path / "curve.png"), BEST)[:, 0].min())
    assert heights[0] < heights[1]


def test_the_largest_value_is_marked_where_it_is(tmp_path):
    scene = zoo.grid_scene(9, zoo.hill)
    spots = []
    for vertex in (2 * 9 + 2, 6 * 9 + 6):
        values = np.where(scene.fixed, np.nan, 0.1)
        values[vertex] = 2.0
        relax.draw_field(scene, values, [4 * 9 + 4], tmp_path / "field.png")
        pixels = drawn(tmp_path / "field.png")
        assert pixels.shape == (1125, 1050, 3)
        marks = near(pixels, "#d55e00")
        marks = marks[marks[:, 0] > 120]  # without the legend
        spots.append(marks.mean(axis=0))
        # the triangles around it have the colour of their corners' mean, of a scale that ends at the largest value
        dark = near(pixels, WORTH((2.0 + 0.1 + 0.1) / 3 / 2.0)[:3])
        assert np.abs(dark[dark[:, 0] < 920].mean(axis=0) - spots[-1]).max() < 25
    assert spots[0][0] > spots[1][0] and spots[0][1] < spots[1][1]


def test_a_field_without_values_is_drawn(tmp_path):
    scene = zoo.grid_scene(5, zoo.hill)
    relax.draw_field(scene, np.full(25, np.nan), [], tmp_path / "field.png", field_plot.FIT)
    assert not near(drawn(tmp_path / "field.png"), "#d55e00").size


def test_what_was_asked_for_is_marked_and_the_legend_fits(tmp_path):
    curve = relax.trade_off(curve_of((0, 0.0752), (1, 0.0523), (101, 0.0412), (125, 0.0282)))
    assert curve.knee != 3
    relax.draw_trade_off(curve, tmp_path / "curve.png", "title", 3)
    pixels = drawn(tmp_path / "curve.png")
    assert (pixels[:, :12] == 1).all() and (pixels[:, -12:] == 1).all()
    plain = tmp_path / "plain.png"
    relax.draw_trade_off(curve, plain, "title", curve.knee)
    assert len(near(pixels, INK)) > len(near(drawn(plain), INK)) + 200


def test_a_short_axis_has_plain_marks_apart():
    """Two decades or less in half a picture: matplotlib's own marks, 2 x 10^-1 and so on, lie over each other."""
    figure = Figure(figsize=(4.0, 3.0), dpi=100)
    axes = figure.subplots()
    axes.set_xscale("log")
    axes.plot([0.2, 6.0], [0.0, 1.0])
    plain_marks(axes.xaxis, np.array([0.2, 6.0]))
    FigureCanvasAgg(figure).draw()
    shown = [label.get_text() for label in axes.get_xticklabels(which="both") if label.get_text()]
    assert {"0.5", "1", "2", "5"} <= set(shown) and not any("10^" in text for text in shown)


def test_small_values_of_a_field_are_written_out(tmp_path):
    """No power of ten is split off into the words below the bar: the right end of their line is white."""
    scene = zoo.grid_scene(5, zoo.hill)
    relax.draw_field(scene, np.where(scene.fixed, np.nan, 1.56e-6), [], tmp_path / "field.png", field_plot.FIT)
    assert (drawn(tmp_path / "field.png")[1070:, 1010:] == 1).all()
