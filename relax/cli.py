"""The command line: reads, calls, prints; no mathematics. Whatever is slow to import is imported by the command that uses it."""

import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from relax.design.methods import METHODS
from relax.errors import InputError, RelaxError
from relax.exchange import completion, export, new
from relax.screen import print_check, print_design, progress, warn
from relax.shell import (
    BAD_INPUT,
    DONE,
    INTERRUPTED,
    NOT_CONVERGED,
    complete_names,
    complete_starts,
    hold_interrupts,
    json_option,
    output_option,
    quiet_option,
    result_argument,
    result_pictures,
    scene_argument,
    set_option,
    start_of,
)
from relax.studies import compare, explain, path, plot

if TYPE_CHECKING:
    from relax.design.solve import Design

# the registries import scipy, which help does not wait for; a test holds these to them
BACKENDS = "auto, working-set, clarabel, osqp (vertical supports), cvxpy (readable, slow)"
PENALTIES = "power (the paper's), group-lasso, log-sum, mcp, scad, count"
EXAMPLE = """\b
Example, from the project's folder:
    relax new roof.obj                writes roof.toml, a scene file to start from
    relax solve data/tent.toml        writes tent-result/
    relax check tent-result           judges it again from its files alone
"""
EXIT_STATUS = """\b
Exit status: 0 done; 1 ran but did not converge (the result is written and says so);
2 bad input (one sentence, nothing written); 130 interrupted (what there is is written; form: nothing).
"""


def main() -> None:
    """Run the command line and leave with its exit status."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Exit status of a command line; errors are one sentence on stderr."""
    try:
        status = app.main(args=list(arguments), prog_name="relax", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return DONE
    except (click.ClickException, click.Abort, RelaxError) as error:
        sentence, status = _refusal(error)
        click.echo(f"relax: {' '.join(sentence.split())}", err=True)
    except BrokenPipeError:
        _drop_output()
        status = NOT_CONVERGED
    except OSError as error:
        with suppress(OSError):  # the screen may be what is full
            click.echo(f"relax: cannot be written ({error.strerror or error}): make room or write to another place", err=True)
        try:
            sys.stdout.flush()
        except OSError:
            _drop_output()
        status = NOT_CONVERGED
    return status if isinstance(status, int) else DONE


def _drop_output() -> None:
    """Let go of a stdout that takes nothing more; without this Python complains once more when it closes it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _refusal(error: Exception) -> tuple[str, int]:
    """One sentence on an error, and the exit status it means."""
    if isinstance(error, click.Abort):
        return "interrupted: nothing was written", INTERRUPTED
    if isinstance(error, click.UsageError):
        command = error.ctx.command_path if error.ctx else "relax"
        return f"{error.format_message().rstrip('.')}; {command} --help shows what is possible", BAD_INPUT
    if isinstance(error, click.ClickException):
        return error.format_message(), BAD_INPUT
    return str(error), BAD_INPUT if isinstance(error, InputError) else NOT_CONVERGED


@click.group(
    epilog=EXAMPLE + "\n" + EXIT_STATUS,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="relax-tensile", message="relax %(version)s")
def app() -> None:
    """Inverse form-finding of tensile structures: from the shape you want to the few masts that hold it."""


@app.command(epilog="\b\nExample: relax solve data/tent.toml --set penalty.weight=0.02 -o tent-light")
@scene_argument
@output_option("<scene name>-result in the current folder; ours in it is replaced, other files are kept")
@click.option("--method", metavar="M", shell_complete=complete_names("solver", "method"), help=f"Solver: {', '.join(METHODS)}.")
@click.option(
    "--backend", metavar="B", shell_complete=complete_names("solver", "backend"), help=f"Who solves a convex step: {BACKENDS}."
)
@click.option(
    "--penalty",
    metavar="P",
    shell_complete=complete_names("penalty", "name"),
    help=f"{PENALTIES}; some need parameters, given with --set.",
)
@click.option("--weight", metavar="K", type=float, help="Weight of the penalty: larger means fewer supports.")
@click.option("--exponent", metavar="A", type=float, help="Exponent of the power penalty, above 0 and at most 1.")
@click.option(
    "--start", metavar="DIR", shell_complete=complete_starts, help='A result folder to start from, or "auto", "target", "heavy".'
)
@set_option
@json_option
@quiet_option
def solve(scene: Path, output: Path | None, **options: Any) -> int:
    """Find the few supports that hold the wanted shape.

    The membrane in equilibrium that comes closest to the shape in SCENE.toml, and the masts and tie-downs under it.
    """
    from relax.design.problem import Problem
    from relax.design.solve import solve as find_design
    from relax.files import check_output, load_scene

    folder = output or Path(f"{scene.stem}-result")
    check_output(folder)
    began = time.perf_counter()
    loaded = load_scene(scene, _overrides(scene, options))
    start = start_of(scene, loaded, options["start"])
    read_seconds = time.perf_counter() - began
    with progress(quiet=options["quiet"]) as callback:
        design = find_design(Problem(loaded), start=start, callback=callback)
    interrupted = _finish(design, folder, read_seconds, options) or design.interrupted
    return INTERRUPTED if interrupted else DONE if design.certificate.converged else NOT_CONVERGED


def _overrides(scene: Path, options: Mapping[str, Any]) -> list[str]:
    """Short options as the `--set` that they stand for; `--set` itself comes last and wins."""
    from relax.files.scenes import STARTS, holds_result

    start = options["start"]
    if start is not None and start not in STARTS:
        if not start or not holds_result(Path(start)):
            raise InputError(
                f'--start {start or "(empty)"}: this is neither "auto", "target" nor "heavy", and no result folder either; '
                "name one of them, or a folder that relax solve wrote"
            )
        # what is typed counts from here, what a scene says from its own folder
        start = os.path.relpath(start, scene.parent)
    given = {
        **{"solver.method": options["method"], "solver.backend": options["backend"], "solver.start": start},
        **{"penalty.name": options["penalty"], "penalty.weight": options["weight"], "penalty.exponent": options["exponent"]},
    }
    # JSON's way of writing text and numbers is TOML's too, but for nan and inf
    short = [
        f"{key}={json.dumps(value) if isinstance(value, str) else value}" for key, value in given.items() if value is not None
    ]
    return [*short, *options["assignments"]]


@app.command(epilog="\b\nExample: relax form tent-result")
@result_argument
@output_option("<name>-form-result beside RESULT_DIR, <name> without its -result")
@click.option(
    "--method",
    type=click.Choice(["newton", "dynamic-relaxation", "force-density"]),
    default="newton",
    help="How to find the shape; where it is unique all three agree. Default: newton.",
)
@json_option
@quiet_option
def form(result: Path, output: Path | None, method: str, **options: Any) -> int:
    """Find the shape under the forces of a result.

    Forward form-finding, from the flat start under the support forces that RESULT_DIR holds.
    """
    from relax.design.form import form as find_shape
    from relax.design.optimality import EQUILIBRIUM
    from relax.design.problem import Problem
    from relax.files import check_output, load_result

    place = result.absolute()
    folder = output or place.parent / f"{place.name.removesuffix('-result')}-form-result"
    check_output(folder)
    began = time.perf_counter()
    stored = load_result(result)
    read_seconds = time.perf_counter() - began
    with progress(quiet=options["quiet"]) as callback:
        design = find_shape(Problem(stored.scene), stored.forces, method, callback)
    if _finish(design, folder, read_seconds, options):
        return INTERRUPTED
    # a shape is asked for, not the best one: that it rests and stands is enough
    return DONE if design.certificate.equilibrium <= EQUILIBRIUM and design.certificate.stable else NOT_CONVERGED


@app.command(epilog="\b\nExample: relax check tent-result")
@result_argument
@click.option("--json", "as_json", is_flag=True, help="Print result.json with the recomputed figures, `agrees` and `differing`.")
@quiet_option
def check(result: Path, *, as_json: bool, quiet: bool) -> int:
    """Judge a result again, from its folder alone.

    Exit status 0 if every figure of result.json agrees and the result converged, else 1.
    """
    from relax.design.optimality import judge
    from relax.design.problem import Problem
    from relax.files import load_result
    from relax.files.stored import differing

    stored = load_result(result)
    refit = stored.scene.settings["rounding"]["refit"]
    certificate = judge(Problem(stored.scene), stored.positions, stored.forces, refit=refit)
    wrong = differing(stored.figures, certificate.figures())
    if as_json:
        judged = {**stored.figures, **certificate.figures(), "agrees": not wrong, "differing": wrong}
        click.echo(json.dumps(judged, indent=2))
    elif not quiet:
        print_check(stored, certificate.figures(), wrong)
    warn(certificate.warnings)
    if wrong:
        click.echo(f"relax: {result}: result.json does not hold for {', '.join(wrong)}", err=True)
    return DONE if certificate.converged and not wrong else NOT_CONVERGED


def _finish(design: "Design", folder: Path, read_seconds: float, options: Mapping[str, Any]) -> bool:
    """Write the result, then say what it is; whether Ctrl-C came meanwhile, which does not lose a finished run."""
    with hold_interrupts() as came:
        from relax.files import write_result

        write_result(folder, design, read_seconds, result_pictures(design))
    try:
        if options["as_json"]:
            click.echo((folder / "result.json").read_text(encoding="utf-8"), nl=False)
        elif not options["quiet"]:
            print_design(design, folder)
        warn(dict.fromkeys([*design.problem.scene.warnings, *design.certificate.warnings]))
    except KeyboardInterrupt:  # the result is there, so this is no "nothing was written"
        return True
    return bool(came)


for command in (compare, path, explain, plot, new, export, completion):
    app.add_command(command)

if __name__ == "__main__":
    main()
