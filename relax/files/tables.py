"""Tables of runs: a path of designs, a comparison, an explanation; one flat row each, as CSV and as JSON."""

import csv
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.exports import write_field
from relax.files.folders import check_folder, write_whole
from relax.files.results import OURS, Draw, plain, write_result

if TYPE_CHECKING:
    from relax.design.explain import Explanation
    from relax.design.solve import Design
    from relax.design.trade_off import TradeOff
    from relax.membrane.scene import Scene

Row = Mapping[str, Any]
BEST = "best"  # a result folder inside a path's
PATH_FILES = ("path.csv", "path.json", "trade-off.png")
COMPARE_FILES = ("compare.csv", "compare.json")
EXPLAIN_FILES = ("explain.csv", "explain.json", "values.csv", "values.vtu", "values.png")


def path_rows(designs: Sequence["Design"], curve: "TradeOff", chosen: int) -> list[dict[str, Any]]:
    """A row a weight: every figure of the judge, and whether the design is efficient, at the knee, and the one in best/."""
    return [
        {
            "weight": design.problem.strength,
            **design.certificate.figures(),
            "total_force": float(curve.force[index]),
            "efficient": bool(curve.efficient[index]),
            "knee": index == curve.knee,
            "chosen": index == chosen,
            "iterations": design.iterations,
            "factorizations": design.factorizations,
            "seconds": design.seconds,
            "interrupted": design.interrupted,
            "stop": design.stop,
        }
        for index, design in enumerate(designs)
    ]


def check_path_output(folder: str | os.PathLike[str]) -> None:
    """Refuse a path at which no folder of a path can be written; raises InputError as `check_output` does."""
    check_folder(folder, PATH_FILES)
    best = Path(folder) / BEST
    if os.path.lexists(best) and not best.is_dir():
        raise InputError(f"{folder}: {BEST} is a file, where a result folder belongs: move it, or use another -o")
    strange = [entry.name for entry in best.iterdir() if entry.name not in OURS] if best.is_dir() else []
    if strange:
        raise InputError(f"{best}: {strange[0]} is not ours, and this folder is replaced whole: move it, or use another -o")


def write_path(
    folder: str | os.PathLike[str],
    rows: Sequence[Row],
    best: "Design",
    pictures: Mapping[str, Draw],
    of_best: Mapping[str, Draw],
) -> None:
    """Write the folder of a path whole, or leave what is there as it was.

    Parameters
    ----------
    folder : path
    rows : as `path_rows` makes them
    best : Design
        Goes into best/, a result folder.
    pictures, of_best : mappings of a file's name to a function that draws it, in the folder and in best/
    """
    check_path_output(folder)

    def fill(stage: Path) -> None:
        _write_rows(stage / "path", rows)
        write_result(stage / BEST, best, pictures=of_best)
        for name, draw in pictures.items():
            draw(stage / name)

    write_whole(Path(folder), (*PATH_FILES, BEST), fill)


def write_comparison(folder: str | os.PathLike[str], rows: Sequence[Row]) -> None:
    """Write compare.csv and compare.json into a folder, both or neither."""
    check_folder(folder, COMPARE_FILES)
    write_whole(Path(folder), COMPARE_FILES, lambda stage: _write_rows(stage / "compare", rows))


def write_explanation(
    folder: str | os.PathLike[str],
    found: "Explanation",
    scene: "Scene",
    positions: Floats,
    fields: Mapping[str, Floats],
    pictures: Mapping[str, Draw],
) -> None:
    """Write what each support is worth, and fields of the vertices (V,) by name, into a folder, all or nothing."""
    check_folder(folder, EXPLAIN_FILES)

    def fill(stage: Path) -> None:
        _write_rows(stage / "explain", [asdict(support) for support in found.supports])
        place = {"vertex": np.arange(len(positions)), **dict(zip("xyz", positions.T, strict=True))}
        names = [*place, *fields]
        columns = zip(*(values.tolist() for values in (*place.values(), *fields.values())), strict=True)
        _write_csv(stage / "values.csv", names, [dict(zip(names, line, strict=True)) for line in columns])
        write_field(stage / "values.vtu", scene, positions, fields)
        for name, draw in pictures.items():
            draw(stage / name)

    write_whole(Path(folder), EXPLAIN_FILES, fill)


def rows_as_json(rows: Sequence[Row]) -> str:
    """The rows as a JSON array of flat objects; a number that is not finite becomes null."""
    return json.dumps(plain(list(rows)), indent=2, allow_nan=False) + "\n"


def _write_rows(stem: Path, rows: Sequence[Row]) -> None:
    stem.with_suffix(".json").write_text(rows_as_json(rows), encoding="utf-8")
    _write_csv(stem.with_suffix(".csv"), list(dict.fromkeys(name for row in rows for name in row)), rows)


def _write_csv(path: Path, names: Sequence[str], rows: Sequence[Row]) -> None:
    """Header and rows; a cell is empty where there is no value or no number."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, names)
        table.writeheader()
        table.writerows(plain(list(rows)))
