"""All of a file as bytes, or a sentence on why not."""

from pathlib import Path

from relax.errors import InputError

MOST_BYTES = 1_000_000_000  # no mesh or height field that can be solved comes near


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Content of the file at `path`.

    Raises
    ------
    InputError
        A file that is missing, a folder, unreadable or larger than `most` bytes; the message does not name it.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"this is a {'folder' if path.is_dir() else 'device'}: name a file")
        with path.open("rb") as stream:
            content = stream.read(most + 1)
    except FileNotFoundError:
        raise InputError("no such file: check the path") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read ({getattr(error, 'strerror', None) or error}): check the path and its permissions"
        ) from None
    if len(content) > most:
        raise InputError(f"the file is larger than {most:,} bytes: thin it out")
    return content
