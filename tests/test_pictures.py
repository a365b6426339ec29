"""Every picture holds what its numbers are, reads in print, and comes again from the folder alone."""

import itertools
import os
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import zoo
from folders import write_scene
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.text import Annotation, Text
from test_trade_off import curve_of

import relax
from relax import studies
from relax.cli import run
from relax.design.methods.lagrangian import lagrangian
from relax.files import results
from relax.plots import curve, field, gallery, picture, rounding, style, tensions, trace
from relax.plots.tensions import slack_edges

MODULES = {"picture": picture, "tensions": tensions, "trace": trace, "rounding": rounding, "values": field}


@pytest.fixture(scope="module")
def tent():
    """One planted mast by the paper's own method: many small forces before rounding, one after."""
    return relax.solve(relax.Problem(zoo.planted(9).scene), method=lagrangian)


@pytest.fixture(scope="module")
def roof():
    """Two masts under a roof with cables on two of its sides, some of its edges slack, brought to rest."""
    plan = zoo.planted(9, zoo.TWO_MASTS)
    settings = {**plan.scene.settings, "membrane": {**plan.scene.settings["membrane"]}}
    paths = (list(range(9)), list(range(8, 81, 9)))
    settings["membrane"]["cables"] = [{"path": path, "stiffness": 1.0, "rest_scale": 1.0} for path in paths]
    rest = np.where(np.arange(len(plan.scene.rest_length)) % 17 == 3, 1.5, 1.0) * plan.scene.rest_length
    return relax.form(relax.Problem(replace(plan.scene, settings=settings, rest_length=rest), weight=1e-3), plan.forces)


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Draws a picture by name and gives its figure."""

    def draw(name, *what):
        caught = []
        module = MODULES.get(name, curve)
        monkeypatch.setattr(module, "save", lambda figure, path: caught.append(figure))
        gallery.PICTURES.get(name, relax.draw_trade_off)(*what, tmp_path / f"{name}.png")
        return caught[0]

    return draw


def words(figure):
    """Every text that is drawn, with its box in dots, the numbers beside supports left out: they stand where supports do."""
    drawn, real = [], Text.draw

    def draw(text, renderer, *rest, **options):
        drawn.append(text)
        real(text, renderer, *rest, **options)

    with mock.patch.object(Text, "draw", draw):
        figure.canvas.draw()
    shown = {id(text): text for text in drawn if text.get_text().strip()}.values()
    numbers = [text for text in shown if isinstance(text, Annotation) and text.get_text().isdigit()]
    return [(text, text.get_window_extent()) for text in shown if text not in numbers]


@pytest.mark.parametrize("case", ["tent", "roof"])
@pytest.mark.parametrize("name", [*gallery.PICTURES, "trade-off"])
def test_words_are_readable_in_print_inside_the_picture_and_apart(name, case, drawn, request):
    what = relax.trade_off(curve_of((0, 0.0752), (1, 0.0523), (101, 0.0412), (125, 0.0282))), request.getfixturevalue(case)
    figure = drawn(name, what[name != "trade-off"])
    assert figure.get_figwidth() in (style.COLUMN, style.PAGE)
    shown = words(figure)
    assert min(text.get_fontsize() for text, _ in shown) >= 6.0
    for text, box in shown:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height, text.get_text()
    for (one, first), (other, second) in itertools.combinations(shown, 2):
        over = min(first.x1, second.x1) - max(first.x0, second.x0), min(first.y1, second.y1) - max(first.y0, second.y0)
        assert min(over) <= 1.0, (one.get_text(), other.get_text())


UNITS = {
    "picture": {"x, m", "y, m", "forces"},
    "tensions": {"x, m", "y, m", "tension of an edge, mN"},
    "trace": {"step", "seconds", "objective, m\u00b2", "stationarity", "supports"},
    "rounding": {"x, m", "y, m", "force, N"},
    "values": {"x, m", "y, m", "pull / steepest slope of R; above 1 a small mast pays"},
}


@pytest.mark.parametrize("name", gallery.PICTURES)
def test_axes_say_their_units(name, drawn, tent):
    assert UNITS[name] <= {text.get_text() for text, _ in words(drawn(name, tent))}


def test_the_distance_is_in_the_unit_that_reads_best(drawn, tent):
    for lift, said in ((1e-5, "\u00b5m"), (1e-2, "mm"), (5.0, "m")):
        moved = replace(
            tent, positions=tent.problem.scene.target + lift * np.array([0, 0, 1.0]) * ~tent.problem.scene.fixed[:, None]
        )
        figure = drawn("picture", moved)
        bar = figure.axes[2].xaxis
        assert bar.get_label_text() == f"distance to the wanted shape, {said}"
        factor = {"\u00b5m": 1e-6, "mm": 1e-3, "m": 1.0}[said]
        figure.canvas.draw()
        for label in bar.get_ticklabels():
            assert float(label.get_text()) * factor == pytest.approx(label.get_position()[0])


def test_forces_are_bars_with_newtons(drawn, roof):
    figure = drawn("picture", roof)
    bars, sizes = figure.axes[1].containers or figure.axes[-1].containers, [mast.magnitude for mast in roof.supports]
    assert len(sizes) == 2
    assert [bar.get_width() for bar in bars[0]] == sizes
    said = {text.get_text() for text, _ in words(figure)}
    assert {style.newtons(size) for size in sizes} <= said


def test_of_many_forces_the_largest_stand_alone(drawn, tent):
    count = 40
    forces = np.zeros_like(tent.forces)
    forces[tent.problem.membrane.free[:count], 2] = 1.0 + np.arange(count)
    figure = drawn("picture", replace(tent, forces=forces))
    axes = figure.axes[-1]
    assert [bar.get_width() for bar in axes.containers[0]] == [float(size) for size in range(17, 41)]
    assert "16 more,\nup to 16 N" in {text.get_text() for text, _ in words(figure)}


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (0.0, "0 N"),
        (3e-7, "300 nN"),
        (2e-12, "2e-12 N"),
        (2.5e-5, "25 \u00b5N"),
        (0.3033, "303 mN"),
        (999.7, "1 kN"),
        (2.5e8, "250 MN"),
    ],
)
def test_newtons(size, said):
    assert style.newtons(size) == said


LENGTHS = [(5.8e-5, "58 \u00b5m"), (0.0228, "22.8 mm"), (35.9, "35.9 m"), (3591.0, "3590 m")]


@pytest.mark.parametrize(("length", "said"), LENGTHS)
def test_metres(length, said, drawn, tent):
    assert style.metres(length) == said
    design = replace(tent, certificate=replace(tent.certificate, rms_distance=length))
    for name in ("picture", "rounding"):
        assert any(f"rms distance {said}" in text.get_text() for text, _ in words(drawn(name, design)))


def coloured(collection, colour):
    return int(np.isclose(collection.get_edgecolors(), to_rgba(colour)).all(axis=1).sum())


def test_cables_are_ropes_in_perspective_and_plan(drawn, roof, tent):
    for design, cables in ((roof, 16), (tent, 0)):
        space, plan = drawn("picture", design).axes[:2]
        painted = max(space.findobj(PolyCollection), key=lambda collection: len(collection.get_paths()))
        # struts are dark too: 40 pieces each
        assert coloured(painted, style.CABLE_CORE) == cables
        assert (
            sum(len(lines.get_paths()) for lines in plan.findobj(LineCollection) if coloured(lines, style.CABLE_CORE)) == cables
        )


def test_every_edge_is_drawn_in_the_colour_of_its_tension(drawn, roof):
    axes = drawn("tensions", roof).axes[0]
    membrane = roof.problem.membrane
    tension, slack = membrane.tension(roof.positions), slack_edges(membrane, roof.positions)
    cable = np.array([edge[1] < 9 or (edge % 9 == 8).all() for edge in roof.problem.scene.mesh.edges])
    assert slack.any() and not slack.all() and cable.sum() == 16
    np.testing.assert_array_equal(slack & ~cable, (tension < 0) & ~cable)
    taut, pushed, casing, core = axes.findobj(LineCollection)
    assert [len(lines.get_paths()) for lines in (taut, casing, core)] == [(~slack & ~cable).sum(), 16, 16]
    assert len(pushed.get_paths()) == slack.sum() and f"slack: {slack.sum()} of" in pushed.get_label()
    top = tension[~slack & ~cable].max()
    by_ends = {
        tuple(np.round(path.vertices, 12).ravel()): colour
        for path, colour in zip(taut.get_paths(), taut.get_edgecolors(), strict=True)
    }
    for edge in np.flatnonzero(~slack & ~cable):
        ends = tuple(np.round(roof.positions[roof.problem.scene.mesh.edges[edge], :2], 12).ravel())
        np.testing.assert_allclose(by_ends[ends], style.TENSION(tension[edge] / top), atol=1e-9)


def test_force_densities_are_never_slack_but_may_push():
    scene = zoo.force_density_net()
    scene = getattr(scene, "scene", scene)
    membrane = replace(scene.membrane, spring_constant=np.where(np.arange(len(scene.mesh.edges)) == 2, -1.0, 1.0))
    assert np.flatnonzero(slack_edges(membrane, scene.target)).tolist() == [2]


def test_the_trace_is_the_trace(drawn, tent):
    axes = np.array(drawn("trace", tent).axes).reshape(3, 2)
    run = tent.trace
    supports = [int(forces.any(axis=1).sum()) for forces in run.forces]
    for row, values in zip(axes, (run.objective, run.stationarity, supports), strict=True):
        for panel, along in zip(row, (np.arange(len(supports)), run.seconds), strict=True):
            np.testing.assert_array_equal(panel.lines[0].get_xdata(), along)
            np.testing.assert_allclose(panel.lines[0].get_ydata(), values, atol=1e-16)
            rounded = [note for note in run.notes if "rounding" in note]
            assert [len(line.get_xdata()) for line in panel.lines[1:3]] == [len(supports) - len(rounded), len(rounded)]
    assert axes[1, 0].lines[-1].get_ydata()[0] == tent.problem.scene.settings["solver"]["tolerance"]


def test_a_trace_of_one_step_and_of_many(drawn, tent):
    whole = tent.trace
    for count in (1, 70):
        index = np.arange(count) % len(whole.notes)
        arrays = {name: getattr(whole, name)[index] for name in ("positions", "forces", "objective", "seconds")}
        part = replace(whole, **arrays, notes=tuple(whole.notes[i] for i in index))
        assert len(drawn("trace", replace(tent, trace=part)).axes) == 6


def test_small_forces_are_seen_before_rounding(drawn, tent):
    figure = drawn("rounding", tent)
    before, after = figure.axes[:2]
    sizes = [np.linalg.norm(forces, axis=1) for forces in (tent.trace.unrounded_forces, tent.forces)]
    largest = max(size.max() for size in sizes)
    for panel, size in ((before, sizes[0]), (after, sizes[1])):
        (marks,) = panel.findobj(PathCollection)
        assert len(marks.get_offsets()) == (size > 1e-6 * largest).sum()
        assert f"{(size > 1e-6 * largest).sum()} force" in panel.get_title(loc="left")
    assert (sizes[0] > 1e-6 * largest).sum() > 5 and (sizes[1] > 1e-6 * largest).sum() == 1
    # the mark of a force a thousand times smaller is three decades of six smaller, and still a third of a millimetre
    marks = before.findobj(PathCollection)[0]
    assert np.sqrt(marks.get_sizes().min()) >= rounding.LEAST and np.sqrt(marks.get_sizes().max()) == pytest.approx(
        rounding.MOST, rel=1e-2
    )
    panel = next(axes for axes in figure.axes if axes.get_ylabel() == "force, N")
    assert [len(line.get_ydata()) for line in panel.lines] == [(size > 1e-6 * largest).sum() for size in sizes]
    assert panel.lines[0].get_ydata().tolist() == sorted(sizes[0][sizes[0] > 1e-6 * largest], reverse=True)


def test_the_value_of_a_mast_is_the_pull_that_explain_gives(drawn, roof):
    said = relax.explain(roof.problem, roof.positions, roof.forces).pull
    faces = roof.problem.scene.mesh.faces
    colours = drawn("values", roof).axes[0].findobj(PolyCollection)[0].get_facecolors()
    mean = [np.mean([said[v] for v in face if v >= 0 and np.isfinite(said[v])] or [np.nan]) for face in faces]
    top = max(np.nanmax(said), field.PULL.top)
    for value, colour in zip(mean, colours, strict=True):
        np.testing.assert_allclose(colour, style.NOWHERE if np.isnan(value) else style.WORTH(value / top), atol=1e-9)


@pytest.mark.parametrize(("kind", "begins"), [("png", b"\x89PNG"), ("PDF", b"%PDF"), ("svg", b"<?xml")])
def test_the_ending_names_the_format_and_the_bytes_come_again(kind, begins, tent, tmp_path):
    path = tmp_path / f"tensions.{kind}"
    relax.draw_tensions(tent, path)
    content = path.read_bytes()
    assert content.startswith(begins)
    relax.draw_tensions(tent, path)
    assert path.read_bytes() == content
    if kind == "PDF":
        assert b"/FontFile2" in content and b"CreationDate" not in content  # words in a font that is in the file; no clock


def test_large_meshes_go_into_vector_files_as_pixels_and_words_stay_words(monkeypatch, tent, tmp_path):
    def content():
        relax.draw_tensions(tent, tmp_path / "tensions.svg")
        return (tmp_path / "tensions.svg").read_text()

    lines = content()
    monkeypatch.setattr("relax.plots.plan.SHAPES", 100)
    pixels = content()
    assert "<image" in pixels and pixels.count("<path") + 200 < lines.count("<path")
    assert pixels.count('id="text_') == lines.count('id="text_') > 10


@pytest.mark.parametrize("name", ["tensions.bmp", "tensions"])
def test_another_ending_is_refused(name, tent, tmp_path):
    with pytest.raises(relax.InputError, match=r"\.png, \.pdf, \.svg"):
        relax.draw_tensions(tent, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_title_too_long_is_cut_and_the_figures_stay(drawn, tent):
    settings = {**tent.problem.scene.settings, "title": "A very long name of a roof over a courtyard " * 5}
    long = replace(tent, problem=replace(tent.problem, scene=replace(tent.problem.scene, settings=settings)))
    for name in ("picture", "trace"):
        said = drawn(name, long).texts[0].get_text()
        assert "\u2026" in said and said.split(": ")[1] == drawn(name, tent).texts[0].get_text().split(": ")[1]


# the command


@pytest.fixture
def solved(tmp_path, monkeypatch):
    """hill-result, made without its scene's files beside it, in the current folder."""
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, "[penalty]\nweight = 0.02\n")
    assert run(["solve", "hill.toml", "--quiet"]) == 0
    for name in ("hill.toml", "hill.npy"):
        os.remove(name)
    return tmp_path / "hill-result"


def test_plot_draws_all_into_the_result_and_keeps_the_rest(solved, capfd):
    (solved / "notes.txt").write_text("mine")
    (solved / "trace.pdf").write_text("mine")
    before = {path.name: path.read_bytes() for path in solved.iterdir()}
    assert run(["plot", "hill-result"]) == 0
    out, err = capfd.readouterr()
    assert err == "" and "written to hill-result/" in out and "tensions.png" in out
    after = {path.name: path.read_bytes() for path in solved.iterdir()}
    assert set(after) - set(before) == {f"{name}.png" for name in gallery.PICTURES} - {"picture.png"}
    # the picture that solve drew comes again, from the folder alone, to the last byte
    assert {name: after[name] for name in before} == before


def test_plot_one_picture_in_another_format_and_folder(solved, capfd):
    assert run(["plot", "hill-result", "-o", "print", "--only", "trace", "--only", "rounding", "--format", "pdf", "--quiet"]) == 0
    assert sorted(path.name for path in Path("print").iterdir()) == ["rounding.pdf", "trace.pdf"]
    assert capfd.readouterr() == ("", "")
    assert run(["plot", "hill-result", "--only", "rose"]) == 2
    assert "'rose' is not one of" in capfd.readouterr().err


def test_a_result_that_is_replaced_keeps_no_picture_of_the_old_one(solved, tmp_path):
    assert run(["plot", "hill-result", "--quiet", "--only", "tensions", "--format", "svg"]) == 0
    (solved / "mine.png").write_text("mine")
    write_scene(tmp_path, "[penalty]\nweight = 0.03\n")
    assert run(["solve", "hill.toml", "--quiet"]) == 0
    assert not (solved / "tensions.svg").exists() and (solved / "mine.png").exists()


def test_plot_writes_all_or_nothing(solved, monkeypatch, capfd):
    def full(*_):
        raise OSError(28, "No space left on device")

    before = sorted(path.name for path in solved.iterdir())
    monkeypatch.setattr("relax.plots.rounding.save", full)
    assert run(["plot", "hill-result"]) == 1
    assert sorted(path.name for path in solved.iterdir()) == before
    assert "No space left" in capfd.readouterr().err


def test_a_picture_that_does_not_exist_for_this_shape_is_left_out_with_a_word(solved, monkeypatch, capfd):
    def singular(*_):
        raise relax.EquilibriumError("the stiffness is singular")

    monkeypatch.setattr("relax.design.mast_values.pull", singular)
    assert run(["plot", "hill-result"]) == 0
    out, err = capfd.readouterr()
    assert "values.png is not drawn: the stiffness is singular" in err and "values" not in out
    assert (solved / "trace.png").exists() and not (solved / "values.png").exists()


def test_without_a_trace_the_rest_is_drawn(solved, capfd):
    os.remove(solved / "trace.npz")
    assert run(["plot", "hill-result", "-o", "out"]) == 0
    assert "trace.png is not drawn: no step" in capfd.readouterr().err
    assert sorted(path.name for path in Path("out").iterdir()) == ["picture.png", "tensions.png", "values.png"]
    assert run(["plot", "hill-result", "-o", "none", "--only", "trace"]) == 2
    assert "no step of this run is kept" in capfd.readouterr().err and not Path("none").exists()


def test_the_lists_of_pictures_and_formats_are_one():
    assert studies.PICTURES == results.PICTURES == tuple(gallery.PICTURES)
    assert studies.FORMATS == results.FORMATS == style.FORMATS


def test_a_legend_names_nothing_that_is_not_there(drawn, roof):
    scene = roof.problem.scene
    free = roof.problem.replace(scene=replace(scene, fixed=np.zeros_like(scene.fixed)))
    for name in ("picture", "tensions"):
        assert "fixed" in {text.get_text() for text, _ in words(drawn(name, roof))}
        assert "fixed" not in {text.get_text() for text, _ in words(drawn(name, replace(roof, problem=free)))}


def test_no_support_has_the_hue_of_the_tensions(drawn, tent):
    forces = np.where(tent.forces.any(axis=1)[:, None], [0.0, 0.0, -1.0], 0.0)  # tie-downs, which are orange elsewhere
    axes = drawn("tensions", replace(tent, forces=forces)).axes[0]
    heads = [line for line in axes.lines if line.get_marker() == "v"]
    assert heads and all(to_rgba(line.get_color()) == style.INK for line in heads)
