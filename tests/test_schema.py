import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.errors import InputError
from relax.files.schema import LATER, SCHEMA, resolve

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
    (scene(penalty={"name": "l1"}), 'penalty.name = "l1": expected "group-lasso" or "power"'),
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


LATER_VALUES = [
    ("target", "metric", "normal"),
    ("target", "metric", "height"),
    ("target", "area_weights", True),
    ("membrane", "cables", [{"path": [0, 1], "stiffness": 1}]),
    ("supports", "direction", "vertical"),
    ("supports", "direction", "up"),
    ("supports", "direction", {"lean": 30}),
    ("supports", "weights", "height"),
    ("supports", "max_force", 10),
    ("supports", "always", [1]),
    *(("penalty", "name", name) for name in ("log-sum", "mcp", "scad", "count")),
    ("solver", "method", "lagrangian"),
    ("solver", "backend", "osqp"),
]


@pytest.mark.parametrize(("section", "key", "value"), LATER_VALUES)
def test_features_of_later_versions_are_refused_as_such(section, key, value, monkeypatch):
    raw = scene(**{section: {key: value}}) if section != "target" else {"target": {**HEIGHTS, key: value}}
    with pytest.raises(InputError, match=rf"^{section}\.{key} = .* not in this version yet; leave the key out"):
        resolve(raw)
    # taking the one line out of the table is all that it takes
    monkeypatch.delitem(LATER, (section, key))
    extra = {"log-sum": {"scale": 1}, "mcp": {"knee": 1}, "scad": {"knee": 1}}.get(value if isinstance(value, str) else "", {})
    raw[section] = {**raw[section], **extra}
    got = resolve(raw)[section][key]
    assert got in (value, [{"path": [0, 1], "stiffness": 1.0, "rest_scale": 1.0}], {"lean": 30.0})


def test_the_sentence_on_a_later_feature():
    with pytest.raises(InputError) as caught:
        resolve(scene(supports={"direction": "up"}))
    assert str(caught.value) == (
        'supports.direction = "up": supports in a chosen direction are not in this version yet; leave the key out (default "any")'
    )


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
