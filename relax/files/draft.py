"""A commented scene file to start from, for a mesh or a height field: every key with its default and what is possible.

Keys, defaults and choices come from the table of the format (schema.py), so the draft cannot say anything else than what is read.
"""

import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.checks import shown
from relax.files.heights import read_heights
from relax.files.meshes import read_mesh
from relax.files.scenes import scene_from
from relax.files.schema import HEIGHT_SUFFIXES, MESH_SUFFIXES, SCHEMA, applies
from relax.membrane.scene import Scene

FRACTION = 0.1  # of the largest useful weight: few supports, and some on most scenes
PROPORTION = 5.0  # of a height field whose spacing nobody knows: so many times as wide as high
NEGLIGIBLE = 1e-3  # of stiffness times span, the scale of the forces: below this a force is smoothed away
# what a key means, where its name and its choices do not say so
MEANING: Mapping[tuple[str, str], str] = {
    ("target", "spacing"): "metres between samples along x and y",
    ("target", "height_scale"): "multiplies the heights, to bring them to metres",
    ("target", "diagonals"): "of the grid's cells",
    ("target", "noise"): "added to the target",
    ("target", "metric"): "distance of vertex pairs, along the target's normal, or of heights alone",
    ("target", "area_weights"): "count each vertex by its share of the plan area",
    ("membrane", "springs"): "law of the edges",
    ("membrane", "material"): "what stiffness means: fabric N/m, cables N; force-density springs: N/m of every edge",
    ("membrane", "stiffness"): "without loads the shape does not depend on it, and forces are in proportion to it",
    ("membrane", "rest"): "rest lengths are measured on the plan of the target, on the target, or on a mesh numbered alike",
    ("membrane", "rest_scale"): "times this: below 1 the membrane is prestressed",
    ("membrane", "loads"): "per square metre of plan",
    ("membrane", "cables"): "along mesh edges",
    ("supports", "fixed"): "vertices that are held",
    ("supports", "candidates"): "where a support may stand",
    ("supports", "direction"): '"up": pushing only; lean: pushing, at most so many degrees from upright',
    ("supports", "weights"): "what a support costs, the same everywhere or by its height above the ground",
    ("supports", "max_force"): "of one support",
    ("supports", "always"): "vertices in the support whatever comes",
    ("supports", "never"): "vertices where none may stand",
    ("supports", "ground"): "height of the ground; default: the lowest point of the target",
    ("penalty", "name"): 'what "few supports" means; "power" is the paper\'s',
    ("penalty", "weight"): "instead of weight_fraction: k_sparse itself, larger means fewer supports",
    ("penalty", "weight_fraction"): "of the weight from which on no support pays; larger means fewer supports",
    ("penalty", "exponent"): "the smaller, the fewer and the larger the supports",
    ("penalty", "smoothing"): "newtons squared, small beside the square of a support's force; grows with stiffness squared",
    ("rounding", "refit"): "last solve on the supports found, with the penalty or without",
    ("solver", "method"): "how supports are looked for",
    ("solver", "backend"): "who takes the convex steps",
    ("solver", "start"): "where the search begins",
    ("solver", "tolerance"): "of the stationarity",
}
UNSAID = {("membrane", "stiffness"), ("membrane", "rest_scale"), ("membrane", "rest"), ("supports", "fixed"), ("penalty", "name")}


def draft_scene(source: str | os.PathLike[str], place: str | os.PathLike[str]) -> tuple[str, Scene]:
    """The text of a scene file that lies at `place` and asks for the shape in `source`, and the scene that it describes.

    Parameters
    ----------
    source : path of a mesh or a height field
    place : path
        Where the file is to lie, since its paths are relative to it; nothing is written.

    Returns
    -------
    text : str
        TOML; what people change is set, every other key is there as a comment with its default.
    scene : Scene

    Raises
    ------
    InputError
        A file of another kind, one that cannot be read, or a shape that no membrane can be made of.
    """
    source, place = Path(source), Path(place)
    suffix = source.suffix.lower()
    if suffix not in (*MESH_SUFFIXES, *HEIGHT_SUFFIXES):
        possible = " ".join((*MESH_SUFFIXES, *HEIGHT_SUFFIXES))
        raise InputError(f"{source}: this is neither a mesh nor a height field that is read here; possible: {possible}")
    key = "mesh" if suffix in MESH_SUFFIXES else "heights"
    try:
        positions, facts, chosen = _of_mesh(source) if key == "mesh" else _of_heights(source)
        name = Path(os.path.relpath(source.absolute(), place.absolute().parent)).as_posix()
        span = float(np.ptp(positions[:, :2], axis=0).max()) or 1.0
        chosen |= {("target", key): name, ("penalty", "weight_fraction"): FRACTION}
        # a force scale of stiffness 1 times the span; the power of ten that is nearest
        chosen[("penalty", "smoothing")] = float(f"1e{round(2 * np.log10(NEGLIGIBLE * span))}")
        low = float(positions[:, 2].min())
        text = _text(source.stem, [f"{source.name}: {facts}", _size(positions)], chosen, low)
        return text, scene_from(tomllib.loads(text), place)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


Chosen = dict[tuple[str, str], Any]


def _of_mesh(source: Path) -> tuple[Floats, str, Chosen]:
    positions, faces = read_mesh(source)
    quads = int((faces[:, 3] >= 0).sum())
    kinds = [f"{count:,} {name}" for count, name in ((len(faces) - quads, "triangles"), (quads, "quads")) if count]
    return positions, f"{len(positions):,} vertices, {' and '.join(kinds)}", {}


def _of_heights(source: Path) -> tuple[Floats, str, Chosen]:
    heights, spacing = read_heights(source)
    rows, columns = heights.shape
    chosen: Chosen = {}
    if spacing is None:
        high = float(np.ptp(heights)) or 1.0
        step = float(f"{PROPORTION * high / (max(rows, columns) - 1):.1g}")
        spacing = (step, step)
        chosen[("target", "spacing")] = [step, step]
    row, column = np.divmod(np.arange(heights.size), columns)
    positions = np.column_stack([column * spacing[0], row * spacing[1], heights.ravel()])
    return positions, f"{rows:,} rows of {columns:,} heights", chosen


def _size(positions: Floats) -> str:
    (x, y, z), low = np.ptp(positions, axis=0), positions[:, 2].min()
    return f"{x:.4g} m along x, {y:.4g} m along y, {z:.4g} m high, from z = {low:.4g} m; z is up"


def _text(title: str, facts: list[str], chosen: Chosen, low: float) -> str:
    """The whole file; `low` is the default of supports.ground."""
    lines = [f"# {line}" for line in facts]
    lines += [
        "# A key behind # is at its default: take the # away to change it. relax/FORMATS.md has all of them in full.",
        f"title = {json.dumps(title, ensure_ascii=False)}",
    ]
    heights = ("target", "heights") in chosen
    for section, keys in SCHEMA.items():
        lines += ["", f"[{section}]"]
        for name, key in keys.items():
            at = (section, name)
            if at in chosen:
                lines.append(_line(name, chosen[at], _about(at, chosen)))
            elif applies(section, name, heights=heights) and name not in ("mesh", "heights"):
                default = _default(at, key.default, low)
                lines.append(("" if at in UNSAID else "# ") + _line(name, default, _about(at, chosen)))
    return "\n".join(lines) + "\n"


def _default(at: tuple[str, str], default: Any, low: float) -> Any:
    """What a key has by default, or an example where it is absent by default."""
    examples = {
        ("target", "noise"): {"sigma": 0.01, "seed": 0},
        ("supports", "max_force"): 10.0,
        ("supports", "ground"): low,
        ("penalty", "weight"): 0.01,
        ("penalty", "exponent"): 0.5,
    }
    return examples.get(at) if default is None else default


def _line(name: str, value: Any, about: str) -> str:
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else shown(value)
    return f"{name} = {text}  # {about}"


def _about(at: tuple[str, str], chosen: Chosen) -> str:
    """Meaning and choices of a key."""
    key = SCHEMA[at[0]][at[1]]
    possible = key.possible if isinstance(key.possible, str) else " | ".join(shown(name) for name in key.possible)
    said = "; ".join(words for words in (MEANING.get(at, ""), possible) if words)
    if at in chosen and at == ("target", "spacing"):
        return f"A GUESS, {PROPORTION:g} times as wide as high: the file does not say it; {MEANING[at]}"
    return said
