import importlib.util
import json
import math
from dataclasses import dataclass
from typing import Annotated

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.convex.backends import BACKENDS
from relax.design.methods import METHODS
from relax.errors import InputError
from relax.files import schema
from relax.files.schema import SCHEMA, drop_replaced, resolve
from relax.sparsity.parameters import Numbers
from relax.sparsity.penalties import PENALTIES, GroupLasso, make_penalty

HEIGHTS = {"heights": "a.npy", "spacing": [1, 2]}


def scene(**sections):
    return {"target": dict(HEIGHTS), **sections}


def test_the_defaults_are_those_of_the_format():
    assert resolve(scene(), "tent") == {
        "title": "tent",
        "target": {
            "mesh": None,
            "heights": "a.npy",
            "spacing": [1.0, 2.0],
            "height_scale": 1.0,
            "diagonals": "alternating",
            "noise": None,
            "metric": "pairs",
            "area_weights": False,
        },
        "membrane": {
            "springs": "hookean",
            "material": "fabric",
            "stiffness": 1.0,
            "rest": "plan",
            "rest_scale": 0.7,
            "loads": [0.0, 0.0, 0.0],
            "cables": [],
        },
        "supports": {
            "fixed": "boundary",
            "candidates": "free",
            "direction": "any",
            "weights": "uniform",
            "max_force": None,
            "always": [],
            "never": [],
            "ground": None,
        },
        "penalty": {
            "name": "power",
            "weight": 0.01,
            "weight_fraction": None,
            "exponent": 0.5,
            "smoothing": 1e-6,
            "scale": None,
            "knee": None,
            "shape": None,
        },
        "rounding": {"refit": "penalised"},
        "solver": {"method": "sequential", "backend": "auto", "start": "auto", "tolerance": 1e-8},
    }


def test_what_is_given_is_kept_and_is_plain_json():
    raw = {
        "title": "x",
        "target": {"mesh": "a.obj", "noise": {"sigma": 1, "seed": 3}},
        "membrane": {"springs": "force-density", "material": "cables", "loads": [0, 0, -1], "rest": "flat.obj", "rest_scale": 1},
        "supports": {"fixed": [0, 5], "candidates": {"box": [[0, 0], [1, 2]]}, "never": [3], "ground": -1},
        "penalty": {"name": "group-lasso", "weight_fraction": 1},
        "solver": {"start": "some/folder", "backend": "cvxpy"},
    }
    got = resolve(raw)
    assert json.loads(json.dumps(got, allow_nan=False)) == got
    assert got["target"]["noise"] == {"sigma": 1.0, "seed": 3}
    assert got["target"]["spacing"] is got["target"]["diagonals"] is got["target"]["height_scale"] is None
    assert got["supports"]["candidates"] == {"box": [[0.0, 0.0], [1.0, 2.0]]}
    assert got["supports"]["fixed"] == [0, 5]
    assert got["penalty"]["weight"] is None and got["penalty"]["weight_fraction"] == 1
    assert got["penalty"]["exponent"] is got["penalty"]["smoothing"] is None
    assert resolve({"target": {"mesh": "a.obj", "noise": {"sigma": 1}}})["target"]["noise"] == {"sigma": 1.0, "seed": 0}


def test_resolved_settings_resolve_to_themselves():
    got = resolve(scene(penalty={"weight": 2}))
    kept = {
        name: {k: v for k, v in keys.items() if v is not None} if isinstance(keys, dict) else keys for name, keys in got.items()
    }
    assert resolve(kept) == got


BAD = [
    ({"targets": {}}, 'targets: unknown section; perhaps "target" is meant'),
    (scene(penalty={"wieght": 1}), 'penalty.wieght: unknown key; perhaps "weight" is meant'),
    (scene(penalty={"zzz": 1}), "penalty.zzz: unknown key; possible are name, weight"),
    (scene(membrane={"springs": "hookaen"}), '= "hookaen": perhaps "hookean" is meant; expected "hookean" or "tension-only"'),
    (scene(membrane={"stiffness": 0}), "membrane.stiffness = 0: expected a number above 0"),
    (scene(membrane={"stiffness": -1.5}), "membrane.stiffness = -1.5: expected a number above 0"),
    (scene(membrane={"stiffness": True}), "membrane.stiffness = true: expected a number above 0"),
    (scene(membrane={"stiffness": "1"}), 'membrane.stiffness = "1": expected a number'),
    (scene(membrane={"stiffness": math.nan}), "membrane.stiffness = nan: expected a number"),
    (scene(membrane={"stiffness": math.inf}), "membrane.stiffness = inf: expected a number"),
    (scene(membrane={"stiffness": 10**400}), "membrane.stiffness = a whole number of over 20 digits: expected"),
    (scene(membrane={"stiffness": 1e40}), "membrane.stiffness = 1e+40 (beyond 1e+30): expected"),
    (scene(membrane={"rest_scale": 0}), "membrane.rest_scale = 0: expected a number above 0"),
    (scene(membrane={"loads": [0, 0]}), "membrane.loads = [0, 0]: expected three finite numbers"),
    (scene(membrane={"loads": [0, math.nan, 0]}), "membrane.loads = [0, nan, 0] (entry 1 is nan): expected three"),
    (scene(membrane={"rest": "flat"}), 'membrane.rest = "flat": expected "plan", "target" or a mesh file'),
    ({"target": {"heights": "a.npy"}}, "target.spacing is missing"),
    ({"target": {"heights": "a.npy", "spacing": 1}}, "target.spacing = 1: expected two numbers above 0"),
    ({"target": {"heights": "a.npy", "spacing": [0, 1]}}, "entry 0 is 0"),
    ({"target": {"heights": "a.npy", "mesh": "a.obj"}}, "target: both mesh and heights are given"),
    ({"target": {}}, "target: neither mesh nor heights is given"),
    ({}, "target: neither mesh nor heights is given"),
    ({"target": 3}, "target = 3: expected a section"),
    ({"title": 3, "target": HEIGHTS}, "title = 3: expected text"),
    ({"target": {"mesh": "a.gltf"}}, 'target.mesh = "a.gltf": expected a mesh file (.obj'),
    ({"target": {"mesh": "a\0.obj"}}, "target.mesh"),
    ({"target": {"heights": "a.mat", "spacing": [1, 1]}}, 'target.heights = "a.mat": expected a height field (.npy'),
    ({"target": {"mesh": "a.obj", "spacing": [1, 1]}}, "target.spacing = [1.0, 1.0]: this key applies only with a height field"),
    ({"target": {"mesh": "a.obj", "diagonals": "both"}}, "target.diagonals"),
    ({"target": {"mesh": "a.obj", "height_scale": 1.0}}, "target.height_scale"),
    ({"target": {**HEIGHTS, "height_scale": 0}}, "target.height_scale = 0: expected a finite number other than 0"),
    ({"target": {**HEIGHTS, "noise": {"sigma": -1}}}, "target.noise = { sigma = -1 } (sigma is -1): expected a table"),
    ({"target": {**HEIGHTS, "noise": {"seed": 1}}}, "(sigma is missing in it)"),
    ({"target": {**HEIGHTS, "noise": {"sigma": 1, "seed": -1}}}, "(seed is -1)"),
    ({"target": {**HEIGHTS, "noise": {"sigma": 1, "seed": 1.5}}}, "(seed is 1.5)"),
    ({"target": {**HEIGHTS, "noise": {"sigma": 1, "sede": 1}}}, "(sede is unknown in it)"),
    (scene(supports={"fixed": "edge"}), 'supports.fixed = "edge": expected "boundary", "corners", "none" or a list'),
    (scene(supports={"fixed": [0, -1]}), "supports.fixed = [0, -1] (entry 1 is -1)"),
    (scene(supports={"fixed": [True]}), "entry 0 is true"),
    (scene(supports={"candidates": {"box": [[0, 0]]}}), "supports.candidates"),
    (
        {"target": {**HEIGHTS, "metric": "hight"}},
        'target.metric = "hight": perhaps "height" is meant; expected "pairs" or "normal"',
    ),
    ({"target": {**HEIGHTS, "area_weights": 1}}, "target.area_weights = 1: expected true or false"),
    (scene(membrane={"cables": [{"path": [0], "stiffness": 1}]}), "membrane.cables"),
    (
        scene(membrane={"cables": [{"path": [0, 1]}]}),
        "membrane.cables = [{ path = [0, 1] }] (entry 0: stiffness is missing in it)",
    ),
    (scene(membrane={"cables": [{"path": [0, 1], "stiffness": 0}]}), "expected a list of tables { path = [vertices], stiffness"),
    (scene(membrane={"cables": [{"path": [0, 1], "stiffness": 1, "rest_scale": 0}]}), "membrane.cables"),
    (scene(membrane={"cables": {"path": [0, 1], "stiffness": 1}}), "membrane.cables"),
    (scene(supports={"direction": {"lean": 91}}), 'supports.direction = { lean = 91 } (lean is 91): expected "any", "vertical"'),
    (scene(supports={"direction": "down"}), 'supports.direction = "down": expected "any", "vertical", "up" or { lean'),
    (scene(supports={"weights": "length"}), 'supports.weights = "length": expected "uniform" or "height"'),
    (scene(supports={"max_force": 0}), "supports.max_force = 0: expected a number above 0, newtons"),
    (scene(supports={"always": [0.5]}), "supports.always = [0.5] (entry 0 is 0.5): expected a list of vertices"),
    (scene(supports={"ground": "low"}), 'supports.ground = "low": expected a finite number'),
    (scene(penalty={"weight": 1, "weight_fraction": 0.1}), "penalty: both weight and weight_fraction are given"),
    (scene(penalty={"weight": 0}), "penalty.weight = 0: expected a number above 0"),
    (scene(penalty={"weight_fraction": 1.5}), "penalty.weight_fraction = 1.5: expected a number above 0 and at most 1"),
    (scene(penalty={"exponent": 0}), "penalty.exponent = 0: expected a number above 0 and at most 1"),
    (scene(penalty={"exponent": 1.1}), "penalty.exponent = 1.1"),
    (scene(penalty={"smoothing": -1}), "penalty.smoothing = -1"),
    (scene(penalty={"smoothing": 0}), "penalty.smoothing = 0: with exponent = 0.5"),
    (
        scene(penalty={"name": "group-lasso", "exponent": 0.5}),
        'penalty.exponent = 0.5: this key applies only with penalty.name = "power"',
    ),
    (scene(penalty={"name": "group-lasso", "smoothing": 1.0}), "penalty.smoothing"),
    (scene(penalty={"knee": 1.0}), 'penalty.knee = 1.0: this key applies only with penalty.name = "mcp" or "scad"'),
    (scene(penalty={"name": "l1"}), 'penalty.name = "l1": expected "group-lasso" or "power" or "log-sum" or "mcp" or "scad" or'),
    (scene(penalty={"name": "log-sum"}), 'penalty.scale is missing: penalty.name = "log-sum" needs it; give a number above 0'),
    (scene(penalty={"name": "mcp"}), 'penalty.knee is missing: penalty.name = "mcp" needs it; give a number above 0, newtons'),
    (scene(penalty={"name": "scad", "shape": 3}), 'penalty.knee is missing: penalty.name = "scad" needs it'),
    (
        scene(penalty={"name": "mcp", "knee": 1, "shape": 3}),
        'penalty.shape = 3.0: this key applies only with penalty.name = "scad"',
    ),
    (scene(penalty={"name": "count", "scale": 1}), 'penalty.scale = 1.0: this key applies only with penalty.name = "log-sum"'),
    (scene(penalty={"name": "log-sum", "scale": 0}), "penalty.scale = 0: expected a number above 0, newtons"),
    (scene(penalty={"name": "mcp", "knee": "1"}), 'penalty.knee = "1": expected a number above 0, newtons'),
    (scene(penalty={"name": "scad", "knee": 1, "shape": 2}), "penalty.shape = 2: expected a number above 2"),
    (scene(rounding={"refit": "penalized"}), 'perhaps "penalised" is meant'),
    (scene(solver={"tolerance": 0}), "solver.tolerance = 0: expected a number above 0"),
    (scene(solver={"start": 3}), "solver.start = 3: expected"),
]


@pytest.mark.parametrize(("raw", "sentence"), BAD)
def test_bad_values_are_named_in_one_sentence(raw, sentence):
    with pytest.raises(InputError) as caught:
        resolve(raw)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_smoothing_is_fine_where_the_penalty_is_convex():
    assert resolve(scene(penalty={"smoothing": 0, "exponent": 1}))["penalty"]["smoothing"] == 0


PENALTY_KEYS = {
    "group-lasso": {},
    "power": {"exponent": 0.5, "smoothing": 1e-6},
    "log-sum": {"scale": 2.0},
    "mcp": {"knee": 2.0},
    "scad": {"knee": 2.0, "shape": 3.7},
    "count": {},
}


@pytest.mark.parametrize("name", PENALTY_KEYS)
def test_each_penalty_has_its_own_keys_and_no_other(name):
    keys = PENALTY_KEYS[name]
    needed = {key: value for key, value in keys.items() if key in ("scale", "knee")}
    got = resolve(scene(penalty={"name": name, **needed}))["penalty"]
    assert {key for key, value in got.items() if value is not None} == {"name", "weight", *keys}
    assert {key: got[key] for key in keys} == keys
    made = make_penalty(got)
    assert made.name == name and {key: getattr(made, key) for key in keys} == keys
    assert set(PENALTY_KEYS) == set(PENALTIES) == set(SCHEMA["penalty"]["name"].possible)


def test_another_penalty_by_name_drops_the_keys_of_the_one_before():
    keys = {"name": "log-sum", "scale": 2.0, "weight": 3.0}
    drop_replaced("penalty", keys, {"name"})
    assert keys == {"name": "log-sum", "scale": 2.0, "weight": 3.0}
    keys["name"] = "mcp"
    drop_replaced("penalty", keys, {"name"})
    assert keys == {"name": "mcp", "weight": 3.0}


def test_a_new_penalty_is_one_class_and_its_name_in_the_registry(monkeypatch):
    @dataclass(frozen=True)
    class Exponential(GroupLasso):
        rate: Annotated[float, Numbers("a number above 0, 1 / newton", lambda rate: rate > 0)]
        shape: Annotated[float, Numbers("a number above 2", lambda shape: shape > 2)] = 5.0
        name = "exponential"

    monkeypatch.setitem(PENALTIES, "exponential", Exponential)
    spec = importlib.util.spec_from_file_location("schema_again", schema.__file__)
    again = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(again)
    got = again.resolve(scene(penalty={"name": "exponential", "rate": 2}))["penalty"]
    # each penalty fills in its own default of a key that two have
    assert (got["rate"], got["shape"]) == (2, 5)
    assert again.resolve(scene(penalty={"name": "scad", "knee": 1}))["penalty"]["shape"] == 3.7
    with pytest.raises(InputError, match=r"penalty\.rate = 0: expected a number above 0, 1 / newton"):
        again.resolve(scene(penalty={"name": "exponential", "rate": 0}))
    with pytest.raises(InputError, match=r'penalty\.rate is missing: penalty\.name = "exponential" needs it'):
        again.resolve(scene(penalty={"name": "exponential"}))
    with pytest.raises(InputError, match=r'applies only with penalty\.name = "scad" or "exponential"'):
        again.resolve(scene(penalty={"shape": 4}))


def test_defaults_given_explicitly_are_fine():
    raw = scene(
        supports={"direction": "any", "weights": "uniform", "always": []},
        membrane={"cables": []},
        penalty={"name": "power"},
        solver={"method": "sequential", "backend": "clarabel"},
    )
    raw["target"] |= {"metric": "pairs", "area_weights": False}
    assert resolve(raw)["solver"]["backend"] == "clarabel"


VALUES = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.sampled_from(["power", "plan", "a.npy"])
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(["sigma", "seed", "box", "lean"]), inner)
    ),
    max_leaves=6,
)
KEYS = st.sampled_from([(section, key) for section, keys in SCHEMA.items() for key in [*keys, "unknown"]])


@given(st.dictionaries(KEYS, VALUES, max_size=4))
@settings(max_examples=200, deadline=None)
def test_any_value_is_taken_as_plain_json_or_refused(changes):
    raw = scene()
    for (section, key), value in changes.items():
        raw.setdefault(section, {})[key] = value
    try:
        json.dumps(resolve(raw), allow_nan=False)
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("section", "key", "value", "kept"),
    [
        ("target", "metric", "normal", "normal"),
        ("target", "metric", "height", "height"),
        ("target", "area_weights", True, True),
        ("membrane", "cables", [{"path": [0, 1], "stiffness": 1}], [{"path": [0, 1], "stiffness": 1.0, "rest_scale": 1.0}]),
        ("supports", "direction", "vertical", "vertical"),
        ("supports", "direction", "up", "up"),
        ("supports", "direction", {"lean": 30}, {"lean": 30.0}),
        ("supports", "direction", {"lean": 0}, {"lean": 0.0}),
        ("supports", "weights", "height", "height"),
        ("supports", "max_force", 10, 10.0),
        ("supports", "always", [1, 4], [1, 4]),
        *(("solver", "method", name, name) for name in METHODS),
        *(("solver", "backend", name, name) for name in BACKENDS),
    ],
)
def test_what_a_scene_can_ask_for(section, key, value, kept):
    raw = scene(**{section: {key: value}}) if section != "target" else {"target": {**HEIGHTS, key: value}}
    got = resolve(raw)
    assert got[section][key] == kept
    assert json.loads(json.dumps(got)) == got
