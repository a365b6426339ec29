"""The scene format as a table: every section and key with its default, its check and a phrase of what is possible."""

import difflib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from relax.convex.backends import BACKENDS
from relax.design.methods import METHODS
from relax.errors import InputError
from relax.files.checks import (
    Check,
    RefusedError,
    above,
    at_least,
    box,
    either,
    escaped,
    list_of,
    nonzero,
    number,
    one_of,
    shown,
    table_of,
    text,
    truth,
    whole,
)
from relax.sparsity.parameters import Numbers, parameters
from relax.sparsity.penalties import PENALTIES, make_penalty

Settings = dict[str, Any]
Raw = Mapping[str, Any]

MESH_SUFFIXES = (".obj", ".ply", ".off", ".stl", ".vtk", ".vtu")
HEIGHT_SUFFIXES = (".npy", ".npz", ".csv", ".txt", ".asc", ".png", ".tif", ".tiff")
DEFAULT_WEIGHT = 0.01


@dataclass(frozen=True)
class Key:
    """One key of the format: its default (None: absent), the check of a value, and what is possible in words or names."""

    default: Any
    check: Check
    possible: str | tuple[str, ...]


def _names(default: str, *names: str) -> Key:
    return Key(default, one_of(*names), names)


def _file(suffixes: tuple[str, ...]) -> Check:
    def check(value: Any) -> str:
        path = text(value)
        if os.path.splitext(path)[1].lower() not in suffixes:
            raise RefusedError
        return path

    return check


def _parameters() -> dict[str, Key]:
    """The parameters of all penalties; a key that several share takes the same numbers in each. Each fills in its defaults."""
    return {
        name: Key(None, _allowed(numbers), numbers.words)
        for kind in PENALTIES.values()
        for name, numbers in parameters(kind).items()
    }


def _allowed(numbers: Numbers) -> Check:
    def check(value: Any) -> float:
        plain = number(value)
        if not numbers.allows(plain):
            raise RefusedError
        return plain

    return check


_vertices = list_of(whole)

SCHEMA: dict[str, dict[str, Key]] = {
    "target": {
        "mesh": Key(None, _file(MESH_SUFFIXES), f"a mesh file ({' '.join(MESH_SUFFIXES)})"),
        "heights": Key(None, _file(HEIGHT_SUFFIXES), f"a height field ({' '.join(HEIGHT_SUFFIXES)})"),
        "spacing": Key(None, list_of(above(0), 2, 2), "two numbers above 0, [dx, dy], metres between samples"),
        "height_scale": Key(1.0, nonzero, "a finite number other than 0"),
        "diagonals": _names("alternating", "alternating", "both", "none"),
        "noise": Key(
            None,
            table_of({"sigma": at_least(0)}, {"seed": (whole, 0)}),
            "a table { sigma = metres, 0 or above, seed = a whole number, 0 or above }",
        ),
        "metric": _names("pairs", "pairs", "normal", "height"),
        "area_weights": Key(default=False, check=truth, possible="true or false"),
    },
    "membrane": {
        "springs": _names("hookean", "hookean", "tension-only", "force-density"),
        "material": _names("fabric", "fabric", "cables"),
        "stiffness": Key(1.0, above(0), "a number above 0"),
        "rest": Key(
            "plan",
            either(one_of("plan", "target"), _file(MESH_SUFFIXES)),
            f'"plan", "target" or a mesh file ({" ".join(MESH_SUFFIXES)})',
        ),
        "rest_scale": Key(0.7, above(0), "a number above 0"),
        "loads": Key((0.0, 0.0, 0.0), list_of(number, 3, 3), "three finite numbers, newtons per square metre"),
        "cables": Key(
            (),
            list_of(table_of({"path": list_of(whole, 2), "stiffness": above(0)}, {"rest_scale": (above(0), 1.0)})),
            "a list of tables { path = [vertices], stiffness = newtons above 0, rest_scale = a number above 0 }",
        ),
    },
    "supports": {
        "fixed": Key(
            "boundary",
            either(one_of("boundary", "corners", "none"), _vertices),
            '"boundary", "corners", "none" or a list of vertices, whole numbers from 0',
        ),
        "candidates": Key(
            "free",
            either(one_of("free"), _vertices, table_of({"box": box})),
            '"free", a list of vertices, whole numbers from 0, or { box = [[x0, y0], [x1, y1]] }',
        ),
        "direction": Key(
            "any",
            either(one_of("any", "vertical", "up"), table_of({"lean": at_least(0, 90)})),
            '"any", "vertical", "up" or { lean = degrees from 0 to 90 }',
        ),
        "weights": _names("uniform", "uniform", "height"),
        "max_force": Key(None, above(0), "a number above 0, newtons"),
        "always": Key((), _vertices, "a list of vertices, whole numbers from 0"),
        "never": Key((), _vertices, "a list of vertices, whole numbers from 0"),
        "ground": Key(None, number, "a finite number, metres"),
    },
    "penalty": {
        "name": _names("power", *PENALTIES),
        "weight": Key(None, above(0), "a number above 0"),
        "weight_fraction": Key(None, above(0, 1), "a number above 0 and at most 1"),
        **_parameters(),
    },
    "rounding": {"refit": _names("penalised", "penalised", "debiased")},
    "solver": {
        "method": _names(next(iter(METHODS)), *METHODS),
        "backend": _names("auto", "auto", *BACKENDS),
        "start": Key("auto", text, '"auto", "target", "heavy" or a result folder'),
        "tolerance": Key(1e-8, above(0), "a number above 0"),
    },
}


# keys that mean something only beside certain values of others: (section, key): (applies to these settings, the condition)
_PENALTIES: dict[str, tuple[str, ...]] = {
    key: tuple(name for name, kind in PENALTIES.items() if key in parameters(kind)) for key in _parameters()
}


def _has_heights(settings: Settings) -> bool:
    return settings["target"]["heights"] is not None


def _has_penalty(names: tuple[str, ...], settings: Settings) -> bool:
    return settings["penalty"]["name"] in names


_CONDITIONS: dict[tuple[str, str], tuple[Callable[[Settings], bool], str]] = {
    **{("target", key): (_has_heights, "a height field (target.heights)") for key in ("spacing", "height_scale", "diagonals")},
    **{
        ("penalty", key): (
            partial(_has_penalty, names),
            "penalty.name = " + " or ".join(f'"{name}"' for name in names),
        )
        for key, names in _PENALTIES.items()
    },
}


def applies(section: str, name: str, *, heights: bool, penalty: str = "power") -> bool:
    """Whether a key means something in a scene with a height field (else a mesh) and this penalty."""
    if (section, name) not in _CONDITIONS:
        return True
    settings = {"target": {"heights": "" if heights else None}, "penalty": {"name": penalty}}
    return _CONDITIONS[section, name][0](settings)


def resolve(raw: Raw, stem: str = "scene") -> Settings:
    """Complete settings from what a scene file says.

    Parameters
    ----------
    raw : the file's sections and keys, as TOML gives them
    stem : str
        Title where the file has none.

    Returns
    -------
    dict
        Every section and key of the format in plain JSON values; None for an optional key that is absent or does not apply.

    Raises
    ------
    InputError
        Names the key, what was found and what is possible.
    """
    _refuse_unknown("section", raw, ["title", *SCHEMA])
    settings: Settings = {"title": _title(raw.get("title", stem))}
    given: list[tuple[str, str]] = []
    for section, keys in SCHEMA.items():
        found = raw.get(section, {})
        if not isinstance(found, Mapping):
            raise InputError(f"{section} = {shown(found)}: expected a section [{section}] with keys")
        _refuse_unknown("key", found, keys, f"{section}.")
        settings[section] = {name: _value(section, name, found) for name in keys}
        given += [(section, name) for name in found]
    _check_target(settings["target"])
    _check_applies(settings, given)
    _check_penalty(settings["penalty"])
    return settings


def _title(value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"title = {shown(value)}: expected text")
    return value


def _refuse_unknown(what: str, found: Raw, known: Any, prefix: str = "") -> None:
    for name in found:
        if name not in known:
            homes = [f"{section}.{key}" for section, keys in SCHEMA.items() for key in keys if key == name and not prefix]
            meant = f"perhaps {homes[0]} is meant; " if homes else _meant(name, known)
            raise InputError(f"{prefix}{escaped(str(name))}: unknown {what}; {meant}possible are {', '.join(known)}")


def _meant(found: Any, known: Any) -> str:
    close = difflib.get_close_matches(str(found), list(known), n=1, cutoff=0.6)
    return f'perhaps "{close[0]}" is meant; ' if close else ""


def _value(section: str, name: str, found: Raw) -> Any:
    """The checked value of a key, or its default."""
    key = SCHEMA[section][name]
    if name not in found:
        return _default(key)
    value = found[name]
    try:
        plain = key.check(value)
    except RefusedError as refusal:
        detail = f" ({refusal})" if str(refusal) else ""
        raise InputError(f"{section}.{name} = {shown(value)}{detail}: {_expected(key, value)}") from None
    return plain


def _default(key: Key) -> Any:
    return list(key.default) if isinstance(key.default, tuple) else key.default


def _expected(key: Key, value: Any) -> str:
    if isinstance(key.possible, str):
        return f"expected {key.possible}"
    return f"{_meant(value, key.possible)}expected {' or '.join(shown(name) for name in key.possible)}"


def _check_target(target: Settings) -> None:
    if target["mesh"] is None and target["heights"] is None:
        raise InputError("target: neither mesh nor heights is given; name the file of the shape that is wanted in one of them")
    if target["mesh"] is not None and target["heights"] is not None:
        raise InputError("target: both mesh and heights are given; keep one of them")
    # an ESRI grid says its cell size itself
    if target["heights"] is not None and target["spacing"] is None and not target["heights"].lower().endswith(".asc"):
        raise InputError("target.spacing is missing: with heights, give [dx, dy], the metres between samples along x and y")


def _check_applies(settings: Settings, given: list[tuple[str, str]]) -> None:
    """Refuse keys that were given where they mean nothing, and set the others of that kind to None."""
    for (section, name), (applies, condition) in _CONDITIONS.items():
        if applies(settings):
            continue
        if (section, name) in given:
            raise InputError(
                f"{section}.{name} = {shown(settings[section][name])}: this key applies only with {condition}; leave it out"
            )
        settings[section][name] = None


def _check_penalty(penalty: Settings) -> None:
    if penalty["weight"] is not None and penalty["weight_fraction"] is not None:
        raise InputError("penalty: both weight and weight_fraction are given; keep one of them")
    if penalty["weight"] is None and penalty["weight_fraction"] is None:
        penalty["weight"] = DEFAULT_WEIGHT
    made = make_penalty(penalty)  # refuses what is missing, and numbers that do not go together
    penalty.update({name: getattr(made, name) for name in parameters(type(made))})


def drop_replaced(section: str, keys: dict[str, Any], changed: set[str]) -> None:
    """Take out of `keys` what an override made pointless: the other way to say the same, or parameters of another penalty."""
    for one, other in (("mesh", "heights"), ("heights", "mesh"), ("weight", "weight_fraction"), ("weight_fraction", "weight")):
        if one in changed and other not in changed:
            keys.pop(other, None)
    if section == "penalty" and "name" in changed:
        for name, penalties in _PENALTIES.items():
            if name not in changed and keys.get("name") not in penalties:
                keys.pop(name, None)
    if section == "target" and "mesh" in changed:
        for name in {"spacing", "height_scale", "diagonals"} - changed:
            keys.pop(name, None)
