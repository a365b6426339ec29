"""The page holds the design and nothing that could do harm: arrays come back, no address is loaded, no text becomes a script."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import relax
from relax.design.masts import standing_masts
from relax.files.schema import resolve
from relax.membrane.mesh import grid_mesh
from relax.membrane.scene import build_scene
from relax.plots.page import draw_page, page
from relax.plots.page.content import MOST_BYTES, MOST_STEPS, page_content, thinned
from relax.plots.view import look_at

DATA = Path(__file__).parent.parent / "data"
ASSETS = Path(page.__file__).parent
EVIL = "</script><img src=x onerror=alert(1)>{{content}}<!-- \u2028 & \"'"


class Elements(HTMLParser):
    """Every element of a page as (tag, attributes, text)."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append([tag, dict(attrs), ""])

    def handle_endtag(self, tag):
        self.found.append(["", {}, ""])  # what follows belongs to no element of interest

    def handle_data(self, data):
        if self.found:
            self.found[-1][2] += data

    def named(self, tag):
        return [element for element in self.found if element[0] == tag]


@pytest.fixture(scope="module")
def design():
    return relax.solve(relax.Problem(relax.load_scene(DATA / "pavilion.toml")))


@pytest.fixture(scope="module")
def text(design, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "view.html"
    draw_page(design, path)
    return path.read_text(encoding="utf-8")


def content_of(text):
    return json.loads(next(body for _, attributes, body in Elements(text).named("script") if attributes.get("id") == "content"))


def unpacked(content, name, kind, *shape):
    return np.frombuffer(base64.b64decode(content[name]), kind).reshape(shape)


def test_every_step_comes_back_as_it_was(design, text):
    content, trace, scene = content_of(text), design.trace, design.problem.scene
    count = len(trace.notes)
    assert [step["note"] for step in content["steps"]] == list(trace.notes)
    assert content["total"] == count
    origin = np.array(content["origin"])
    size = np.linalg.norm(np.subtract(content["high"], content["low"]))
    target = unpacked(content, "target", "<f4", -1, 3) + origin
    np.testing.assert_allclose(target, scene.target, atol=1e-7 * size)  # 24 bits of half the size
    offsets = unpacked(content, "offsets", "<i2", count, -1, 3) * np.array(content["unit"])[:, None, None]
    # half a unit beside the exact displacement, and the unit is 1 / 32767 of the largest
    room = 0.5001 * np.abs(trace.positions - scene.target).max(axis=(1, 2)) / 32767
    assert (np.abs(offsets - (trace.positions - scene.target)).max(axis=(1, 2)) <= room).all()
    np.testing.assert_array_equal(unpacked(content, "faces", "<i4", -1, 4), scene.mesh.faces)
    begin = np.cumsum([0, *content["counts"]])
    heads, forces = unpacked(content, "heads", "<i4", -1), unpacked(content, "forces", "<f4", -1, 3)
    for step in range(count):
        mine = slice(begin[step], begin[step + 1])
        np.testing.assert_array_equal(heads[mine], np.flatnonzero(trace.forces[step].any(axis=1)))
        np.testing.assert_array_equal(forces[mine], trace.forces[step][heads[mine]].astype("f4"))
        said = content["steps"][step]
        assert (said["objective"], said["stationarity"]) == (trace.objective[step], trace.stationarity[step])
    assert heads[-content["counts"][-1] :].tolist() == [mast.vertex for mast in design.supports]


def test_colours_ground_and_fixed_edge_are_those_of_the_picture(design, text):
    content, view = content_of(text), look_at(design)
    colours = unpacked(content, "colours", "u1", 256, 3)
    for share in (0.0, 0.3, 1.0):
        expected = 255 * np.array(view.scale.cmap(share))[:3]
        np.testing.assert_allclose(colours[round(255 * share)], expected, atol=2.5)
    assert content["ground"] + content["origin"][2] == pytest.approx(design.problem.scene.ground)
    np.testing.assert_array_equal(unpacked(content, "held", "<i4", -1, 2), view.held_sides)
    slices = unpacked(content, "slices", "<f4", -1, 2, 3) + np.array(content["origin"])
    np.testing.assert_allclose(slices[:, 0], view.slices[0], atol=1e-5)
    assert content["kinds"]["tie-down"] == "#d55e00"


def test_cables_are_the_edges_that_the_scene_names():
    design = relax.solve(relax.Problem(relax.load_scene(DATA / "scalloped.toml")))
    edges = unpacked(page_content(design, look_at(design)), "cables", "<i4", -1, 2).tolist()
    assert edges[:2] == [[0, 1], [1, 2]] and len(edges) == 4 * 22
    known = {tuple(edge) for edge in design.problem.scene.mesh.edges.tolist()}
    assert {tuple(sorted(edge)) for edge in edges} <= known


def test_the_same_design_gives_the_same_bytes(design, text, tmp_path):
    draw_page(design, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == text


def test_nothing_is_loaded_from_anywhere(text):
    loading = {"src", "href", "data", "poster", "action", "srcset", "background"}
    named = [value for _, attributes, _ in Elements(text).found for name, value in attributes.items() if name in loading]
    assert named == ["data:,"]
    assert set(re.findall(r"https?://[\w./]+", text)) == {"http://www.w3.org/1999/xhtml"}  # the name of a name space
    ours = "".join((ASSETS / name).read_text() for name in (*page.SCRIPTS, "page.css"))
    assert not re.search(r"url\(|@import|fetch\(|XMLHttpRequest|WebSocket|sendBeacon|eval\(|innerHTML", ours)


def test_the_policy_lets_these_scripts_run_and_no_other(text):
    elements = Elements(text)
    policy = next(a["content"] for _, a, _ in elements.named("meta") if a.get("http-equiv") == "Content-Security-Policy")
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'" and "unsafe" not in policy and "http" not in policy

    def allowed(bodies):
        return {f"'sha256-{base64.b64encode(hashlib.sha256(body.encode()).digest()).decode()}'" for body in bodies}

    scripts = [body for _, attributes, body in elements.named("script") if "type" not in attributes]
    assert len(scripts) == 2 and set(rules["script-src"].split()) == allowed(scripts)
    assert set(rules["style-src"].split()) == allowed(body for *_, body in elements.named("style"))


def test_titles_and_notes_stay_text(design, tmp_path):
    scene = design.problem.scene
    evil = replace(scene, settings={**scene.settings, "title": EVIL})
    trace = replace(design.trace, notes=(EVIL,) * len(design.trace.notes))
    case = replace(design, problem=replace(design.problem, scene=evil), trace=trace, stop=EVIL)
    draw_page(case, tmp_path / "evil.html")
    text = (tmp_path / "evil.html").read_text(encoding="utf-8")
    elements = Elements(text)
    assert not elements.named("img") and len(elements.named("script")) == 3
    assert elements.named("h1")[0][2].strip() == EVIL.strip() == elements.named("title")[0][2].strip()
    assert content_of(text)["steps"][0]["note"] == EVIL


def synthetic(side, steps, dense):
    """A design with `steps` steps over `side` x `side` vertices, every one of them a support of each step if `dense`."""
    row, column = np.indices((side, side))
    target = np.column_stack([column.ravel(), row.ravel(), np.sin(0.1 * column.ravel())]).astype(float)
    settings = resolve({"target": {"mesh": "grid.obj"}, "supports": {"ground": -2.0}})
    scene = build_scene(settings, grid_mesh(side, side, "alternating"), target, None)
    random = np.random.default_rng(0)
    positions = target + random.normal(0, 0.1, (steps, side * side, 3))
    forces = np.zeros_like(positions)
    forces[:, :: 1 if dense else 997] = random.normal(0, 1.0, (steps, side * side if dense else -(-side * side // 997), 3))
    figures = {name: np.linspace(1.0, 2.0, steps) for name in ("objective", "stationarity", "seconds")}
    return SimpleNamespace(
        problem=SimpleNamespace(scene=scene),
        positions=positions[-1],
        forces=forces[-1],
        certificate=SimpleNamespace(rms_distance=0.1, objective=2.0, stationarity=None, converged=False),
        seconds=3.0,
        stop="at most 30 steps were asked for",
        supports=standing_masts(positions[-1], forces[-1], -2.0),
        trace=SimpleNamespace(
            positions=positions,
            forces=forces,
            notes=("step",) * steps,
            unrounded_positions=positions[-3],
            unrounded_forces=forces[-3],
            **figures,
        ),
    )


@pytest.mark.parametrize("dense", [False, True])
def test_ten_thousand_vertices_stay_under_ten_megabytes(dense, tmp_path):
    draw_page(synthetic(100, 30, dense), tmp_path / "view.html")
    assert (tmp_path / "view.html").stat().st_size < 10e6
    content = content_of((tmp_path / "view.html").read_text(encoding="utf-8"))
    shown = [step["step"] for step in content["steps"]]
    assert len(shown) == 30 if not dense else 20 < len(shown) < 30
    assert content["total"] == 30 and shown[0] == 0 and shown[-1] == 29 and shown[content["before"]] == 27
    assert "not converged (at most 30 steps" in (tmp_path / "view.html").read_text(encoding="utf-8")


def test_a_state_before_rounding_that_is_no_step_and_a_result_that_is_none_are_added():
    case = synthetic(4, 3, dense=False)
    case.trace.unrounded_positions = case.positions + 1.0
    content = page_content(case, look_at(case))
    assert [step["note"] for step in content["steps"]] == ["step", "step", "before rounding", "step"] and content["before"] == 2
    case.positions = case.positions + 2.0
    content = page_content(case, look_at(case))
    assert [step["note"] for step in content["steps"]][-2:] == ["before rounding", "result"]
    figures = {"objective": 2.0, "stationarity": None, "seconds": 3.0}  # what the judge says of it
    assert content["steps"][-1] == {"step": 4, "note": "result", **figures}
    for name in ("positions", "forces", "objective", "stationarity", "seconds", "notes"):
        setattr(case.trace, name, getattr(case.trace, name)[:0])
    case.trace.unrounded_positions, case.trace.unrounded_forces = case.positions, case.forces
    content = page_content(case, look_at(case))
    assert [step["note"] for step in content["steps"]] == ["result"] and content["before"] == 0


def test_figures_that_are_none_become_null():
    case = synthetic(4, 3, dense=False)
    case.trace.stationarity[1] = np.nan
    assert page_content(case, look_at(case))["steps"][1]["stationarity"] is None


def test_long_runs_are_thinned_evenly():
    assert thinned([10] * 5, {2}) == [0, 1, 2, 3, 4]
    many = thinned([10] * 5000, {1234})
    assert len(many) in (MOST_STEPS, MOST_STEPS + 1) and {0, 1234, 4999} <= set(many)
    gaps = np.diff([step for step in many if step != 1234])
    assert gaps.max() <= 27 and gaps.min() >= 23
    heavy = [MOST_BYTES // 10] * 30
    few = thinned(heavy, {0, 17, 29})
    assert {0, 17, 29} <= set(few) and len(few) in (9, 10)
    assert thinned([MOST_BYTES] * 9, {0, 5, 8}) == [0, 5, 8]  # what is needed is shown whatever its size


def test_the_library_is_the_version_that_is_asked_for_and_brings_its_licence():
    asked = json.loads((ASSETS / "library" / "package.json").read_text())["devDependencies"]["three"]
    locked = json.loads((ASSETS / "library" / "package-lock.json").read_text())["packages"]["node_modules/three"]
    bundle = (ASSETS / "three.min.js").read_text()
    assert bundle.startswith(f"/*! three.js {asked}, ") and locked["version"] == asked and locked["license"] == "MIT"
    assert "Permission is hereby granted" in bundle and f'"{asked.split(".")[1]}"' in bundle
    assert "</script" not in bundle
    used = {name for script in page.SCRIPTS for name in re.findall(r"THREE\.(\w+)", (ASSETS / script).read_text())}
    parts = (ASSETS / "library" / "parts.js").read_text()
    assert {name for name in used if not re.search(rf"\b{name}\b", parts)} == set()
