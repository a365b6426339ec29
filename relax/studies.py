"""Commands that look at more than one answer, or more closely at one: path, compare, explain, plot."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from relax.errors import InputError, RelaxError
from relax.screen import COMPARE_COLUMNS, EXPLAIN_COLUMNS, PATH_COLUMNS, print_notes, print_table, warn, work
from relax.shell import (
    DONE,
    INTERRUPTED,
    NOT_CONVERGED,
    hold_interrupts,
    output_option,
    quiet_option,
    result_argument,
    result_pictures,
    rows_option,
    scene_argument,
    set_option,
    start_of,
)

if TYPE_CHECKING:
    from relax.design.explain import Explanation
    from relax.design.mast_values import MastValues
    from relax.design.solve import Design
    from relax.design.trade_off import TradeOff
    from relax.files import StoredResult

Kind = TypeVar("Kind")
# as relax/files/results.py has them, which imports numpy; a test holds these to it
PICTURES, FORMATS = ("picture", "tensions", "trace", "rounding", "values"), ("png", "pdf", "svg")


@click.command(epilog="\b\nExample: relax path data/bumps.toml --count 5")
@scene_argument
@click.option("--count", metavar="N", type=click.IntRange(min=0), help="The best fit with at most N supports.")
@click.option("--rms", metavar="D", type=float, help="The fewest supports within an rms distance of D metres.")
@output_option("<scene name>-path in the current folder; ours in it is replaced, other files are kept")
@set_option
@rows_option
@quiet_option
def path(scene: Path, count: int | None, rms: float | None, output: Path | None, **options: Any) -> int:
    """Find the trade-off between few supports and a close fit.

    One design a weight, from "nothing stands" down. The one at the knee of the curve, or the one that --count or --rms asks for,
    is a result folder of its own, best/. Exit status 1 where that is not reached.
    """
    from relax.design.path import BISECTIONS, LONGEST, STEPS
    from relax.design.path import path as designs_of
    from relax.design.problem import Problem
    from relax.design.trade_off import choose, trade_off
    from relax.files import load_scene
    from relax.files.tables import check_path_output, path_rows, rows_as_json

    folder = output or Path(f"{scene.stem}-path")
    check_path_output(folder)
    problem = Problem(load_scene(scene, options["assignments"]))
    most = STEPS if count is None and rms is None else LONGEST + BISECTIONS
    with work("weight", most, quiet=options["quiet"], bound="at most") as weights:
        weights.timed = count is None and rms is None  # else it ends where that is reached, which nobody knows
        designs = designs_of(problem, count=count, rms=rms, callback=weights.step)
        found, broken = _gathered(designs, lambda design: weights.done(f"{design.problem.strength:.3g}, {design}"))
    index, reached = choose(found, count, rms)
    curve = trade_off(found)
    rows = path_rows(found, curve, index)
    with hold_interrupts() as came:
        _write_path(folder, found[index], curve, index, rows)
    best = found[index]
    if options["as_json"]:
        click.echo(rows_as_json(rows), nl=False)
    elif not options["quiet"]:
        print_table(rows, PATH_COLUMNS)
        asked = "the knee of the curve" if count is None and rms is None else f"at most {count} supports" if rms is None else ""
        click.echo(f"{problem.scene.title}: {asked or f'rms distance at most {rms:g} m'}: {best}")
        click.echo(f"written to {folder}/, this design to {folder / 'best'}/")
    warn(dict.fromkeys([*problem.scene.warnings, *best.certificate.warnings, *([] if reached else [found[-1].stop])]))
    if broken or came or found[-1].interrupted:
        return INTERRUPTED
    return DONE if reached and best.certificate.converged else NOT_CONVERGED


def _gathered(items: Iterable[Kind], each: Callable[[Kind], None] = lambda _: None) -> tuple[list[Kind], bool]:
    """What comes until Ctrl-C, and whether that ended it; nothing at all is the caller's interrupt."""
    found: list[Kind] = []
    try:
        for item in items:
            found.append(item)
            each(item)
    except KeyboardInterrupt:
        if not found:
            raise
        return found, True
    return found, False


def _write_path(folder: Path, best: "Design", curve: "TradeOff", index: int, rows: list[dict[str, Any]]) -> None:
    from relax.files.tables import write_path
    from relax.plots.curve import draw_trade_off

    title = best.problem.scene.title
    curves = {"trade-off.png": lambda path: draw_trade_off(curve, path, title, index)}
    write_path(folder, rows, best, curves, result_pictures(best))


@click.command(epilog="\b\nExample: relax compare data/tent-noisy.toml")
@scene_argument
@output_option("<scene name>-compare in the current folder; ours in it is replaced, other files are kept")
@set_option
@rows_option
@quiet_option
def compare(scene: Path, output: Path | None, **options: Any) -> int:
    """Run every penalty, method and back-end on one scene.

    All from the same start. Each answer is pruned and refitted under the paper's penalty, and judged in its objective; a run that
    cannot be made is a row that says why.
    """
    from relax.convex.backends import BACKENDS
    from relax.design.compare import compare as rows_of
    from relax.design.compare import ranked
    from relax.design.methods import METHODS
    from relax.design.problem import Problem
    from relax.files import load_scene
    from relax.files.folders import check_folder
    from relax.files.tables import COMPARE_FILES, rows_as_json, write_comparison
    from relax.sparsity.penalties import PENALTIES

    folder = output or Path(f"{scene.stem}-compare")
    check_folder(folder, COMPARE_FILES)
    problem = Problem(load_scene(scene, options["assignments"]))
    start = start_of(scene, problem.scene)

    # the first row, then every other penalty, method and back-end
    total = len(PENALTIES) + len(METHODS) - 1 + len(BACKENDS)
    with work("run", total, quiet=options["quiet"]) as runs:
        rows_so_far = rows_of(problem, start, runs.step)
        found, broken = _gathered(rows_so_far, lambda row: runs.done(f"{row.penalty}, {row.method}, {row.backend}: {row.stop}"))
    rows = [row.flat() for row in ranked(found)]
    with hold_interrupts() as came:
        write_comparison(folder, rows)
    if options["as_json"]:
        click.echo(rows_as_json(rows), nl=False)
    elif not options["quiet"]:
        print_table(rows, COMPARE_COLUMNS)
        print_notes(rows)
        click.echo(f"{problem.scene.title}: every answer refitted and judged under the paper's penalty")
        click.echo(f"above: by how much, as a share of the lowest objective; all figures are written to {folder}/")
    warn(dict.fromkeys(problem.scene.warnings))
    return INTERRUPTED if broken or came or found[-1].interrupted else DONE


@click.command(epilog="\b\nExample: relax explain tent-result")
@result_argument
@output_option("nothing is written")
@click.option("--gains", is_flag=True, help="Also what a new mast at each candidate promises: a solve each.")
@rows_option
@quiet_option
def explain(result: Path, output: Path | None, *, gains: bool, **options: Any) -> int:
    """Say what each support of a result is worth.

    Each is taken out and the others are refitted. Writes nothing without -o. With it: the field of what a mast elsewhere would be
    worth, too. Exit status 1 where the result did not converge.
    """
    from dataclasses import asdict

    from relax.design.explain import explain as explained
    from relax.design.mast_values import refuse_floating
    from relax.design.problem import Problem
    from relax.files import load_result
    from relax.files.folders import check_folder
    from relax.files.tables import EXPLAIN_FILES, rows_as_json

    if output is not None:
        check_folder(output, EXPLAIN_FILES)
    if gains and output is None:
        raise InputError("--gains: the field it makes is only written: name a folder with -o")
    stored = load_result(result)
    if gains:
        refuse_floating(Problem(stored.scene))
    standing = int(stored.forces.any(axis=1).sum())
    with work("support", standing, quiet=options["quiet"]) as supports:
        found = explained(Problem(stored.scene), stored.positions, stored.forces, callback=lambda _: supports.done(""))
    values = None
    if gains and not found.interrupted:
        values = _gains(stored, quiet=options["quiet"])
    broken = found.interrupted or (gains and values is None)
    if output is not None:
        with hold_interrupts() as came:
            _write_explanation(output, stored, found, values)
        broken |= bool(came)
    rows = [asdict(support) for support in found.supports]
    if options["as_json"]:
        click.echo(rows_as_json(rows), nl=False)
    elif not options["quiet"]:
        print_table(rows, EXPLAIN_COLUMNS)
        click.echo(
            "+: the rise of distance and objective without it, the others refitted; estimate: of + objective, by the model"
        )
        click.echo(f"{stored.scene.title}: {found.assurance.sentence}")
        if output is not None:
            click.echo(f"written to {output}/")
    warn(found.certificate.warnings)
    if broken:
        return INTERRUPTED
    return DONE if found.certificate.converged else NOT_CONVERGED


def _gains(stored: "StoredResult", *, quiet: bool) -> "MastValues | None":
    """What a mast at each candidate promises; None after Ctrl-C."""
    from relax.design.mast_values import mast_values
    from relax.design.problem import Problem

    problem = Problem(stored.scene)
    with work("candidate", len(problem.supports.vertices), quiet=quiet) as candidates:
        told = 0

        def tell(record: Mapping[str, int]) -> None:
            nonlocal told
            candidates.total = record["total"]
            candidates.done("", record["done"] - told)
            told = record["done"]

        try:
            return mast_values(problem, stored.positions, stored.forces, callback=tell)
        except KeyboardInterrupt:
            return None


def _write_explanation(folder: Path, stored: "StoredResult", found: "Explanation", values: "MastValues | None") -> None:
    from relax.files.tables import write_explanation
    from relax.plots.field import FIT, PULL, draw_field

    fields, look = {"pull": found.pull}, PULL
    if values is not None:
        fields |= {"fit": values.fit, "gain": values.gain, "force": values.force}
        look = FIT
    heads = [support.vertex for support in found.supports]
    picture = {"values.png": lambda path: draw_field(stored.scene, fields[look.name], heads, path, look)}
    write_explanation(folder, found, stored.scene, stored.positions, fields, picture)


@click.command(epilog="\b\nExample: relax plot tent-result --only trace --format pdf")
@result_argument
@output_option("RESULT_DIR itself; the pictures drawn are replaced, other files are kept")
@click.option("--only", type=click.Choice(PICTURES), multiple=True, help="These pictures alone; once for each.")
@click.option("--format", "kind", type=click.Choice(FORMATS), default="png", help="PDF and SVG are for print. Default: png.")
@quiet_option
def plot(result: Path, output: Path | None, only: tuple[str, ...], kind: str, *, quiet: bool) -> int:
    """Draw the pictures of a result, from its folder alone.

    Shape and forces, tensions of the edges, the trace, before and after rounding, and what a mast elsewhere would be worth.
    """
    from relax.files import load_result
    from relax.files.folders import check_folder, write_whole
    from relax.plots.gallery import PICTURES as DRAWN

    folder = output or result
    names = list(dict.fromkeys(only or PICTURES))
    files = [f"{name}.{kind}" for name in names]
    check_folder(folder, files)
    design = load_result(result).design()
    left_out: dict[str, RelaxError] = {}

    def fill(stage: Path) -> None:
        for name, file in zip(names, files, strict=True):
            try:
                DRAWN[name](design, stage / file)
            except RelaxError as error:
                left_out[file] = error
                if len(left_out) == len(files):
                    raise

    with hold_interrupts() as came:
        write_whole(folder, files, fill)
    if not quiet:
        drawn = ", ".join(file for file in files if file not in left_out)
        click.echo(f"{design.problem.scene.title}: {drawn} written to {folder}/")
    warn([f"{file} is not drawn: {error}" for file, error in left_out.items()])
    return INTERRUPTED if came else DONE
