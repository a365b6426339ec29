"""Commands at both ends of the work: a scene file to start from, a result for other programs, completion for the shell."""

from pathlib import Path
from typing import Any

import click

from relax.errors import InputError
from relax.shell import DONE, Named, quiet_option, result_argument

KINDS = ("compas", "obj")  # the registry imports numpy, which help does not wait for; a test holds this to it
SHELLS = ("bash", "zsh", "fish")


@click.command(epilog="\b\nExample: relax new roof.obj && relax solve roof.toml")
@click.argument("shape", metavar="MESH_OR_HEIGHTS", type=Named(path_type=Path))
@click.option(
    "-o", "--output", metavar="SCENE.toml", type=Named(path_type=Path), help="Default: <name>.toml in the current folder."
)
@quiet_option
def new(shape: Path, output: Path | None, *, quiet: bool) -> int:
    """Write a scene file to start from.

    For a mesh or a height field: what people change is set, every other key is a comment with its default. It can be solved as it
    is. A file that exists is not replaced.
    """
    from relax.files.draft import draft_scene

    place = output or Path(f"{shape.stem}.toml")
    if place.is_symlink() or place.exists():
        raise InputError(f"{place}: this is there already, and is not replaced: remove it, or name another file with -o")
    if not place.absolute().parent.is_dir():
        raise InputError(f"{place}: its folder does not exist: make it, or name another file with -o")
    text, scene = draft_scene(shape, place)
    try:
        with place.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError:
        place.unlink(missing_ok=True)
        raise
    if not quiet:
        said = [line.removeprefix("# ") for line in text.splitlines()[:2]]
        guessed = [line for line in text.splitlines() if "A GUESS" in line]
        click.echo("\n".join([*said, *(f"to be put right: {line}" for line in guessed), f"written to {place}"]))
        for sentence in scene.warnings:
            click.echo(f"relax: warning: {sentence}", err=True)
    return DONE


@click.command(epilog="\b\nExample: relax export tent-result --to compas")
@result_argument
@click.option(
    "--to", "kind", type=click.Choice(KINDS), required=True, help="compas: a network as JSON; obj: with the supports as lines."
)
@click.option("-o", "--output", metavar="FILE", type=Named(path_type=Path), help="Default: <name>-export in the current folder.")
@quiet_option
def export(result: Path, kind: str, output: Path | None, *, quiet: bool) -> int:
    """Write a result for other programs.

    For those that want more than the membrane.obj, membrane.vtu and supports.csv of every result folder.
    """
    from relax.files import load_result
    from relax.files.network import SUFFIX
    from relax.files.network import export as write

    name = result.absolute().name.removesuffix("-result")
    place = output or Path(f"{name}-export{SUFFIX[kind]}")
    write(load_result(result), place, kind)
    if not quiet:
        click.echo(f"written to {place}")
    return DONE


@click.command(epilog='\b\nExample, in ~/.bashrc: eval "$(relax completion bash)"')
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> int:
    """Print what a shell needs to complete commands.

    bash and zsh: eval "$(relax completion bash)" in ~/.bashrc, or ~/.zshrc; fish: relax completion fish | source in
    ~/.config/fish/config.fish. It completes commands, options, scene files, result folders and the keys of a scene.
    """
    from click.shell_completion import get_completion_class

    kind: Any = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "relax", "_RELAX_COMPLETE").source(), nl=False)
    return DONE
