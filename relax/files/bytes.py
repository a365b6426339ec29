"""Files opened or read as bytes, or a sentence on why not."""

import os
from pathlib import Path
from typing import BinaryIO

from relax.errors import InputError

MOST_BYTES = 1_000_000_000  # no mesh that can be solved comes near
UNPACKED = 32_000_000, 100  # bytes, and for each byte of a packed file; fields of zeros pack to a thousandth, points do not


def unpacked(size: int) -> int:
    """Bytes that a packed file of `size` bytes may unfold to: an honest one stays below, one made to fill a memory does not."""
    return UNPACKED[0] + UNPACKED[1] * size


def open_bytes(path: Path) -> BinaryIO:
    """Open the file at `path` for reading.

    Raises
    ------
    InputError
        A file that is missing, a folder or a device, or unreadable; the message does not name it.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"this is a {'folder' if path.is_dir() else 'device'}: name a file")
        return path.open("rb")
    except FileNotFoundError:
        raise InputError("no such file: check the path") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read ({reason}): check the path and its permissions") from None


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Content of the file at `path`, which holds `most` bytes at most; raises InputError as `open_bytes` does."""
    with open_bytes(path) as stream:
        # read(n) sets n bytes aside before it knows how many there are
        size = os.fstat(stream.fileno()).st_size
        content = stream.read(min(size, most) + 1)
    if len(content) > most:
        raise InputError(f"the file is larger than {most:,} bytes: thin it out")
    return content
