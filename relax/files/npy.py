"""Arrays in numpy's format, whose header is looked at before anything is loaded: a file of a few bytes may announce terabytes."""

import io
import math
import warnings
import zipfile
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from relax.errors import InputError
from relax.files.bytes import unpacked

MOST_HEADER = 65_535  # bytes, what the first version of the format allows; a table of numbers takes some hundred


class Header(NamedTuple):
    """What an array's header announces."""

    shape: tuple[int, ...]
    fortran: bool
    kind: np.dtype[Any]

    @property
    def size(self) -> int:
        """Bytes of its values."""
        return math.prod(self.shape) * self.kind.itemsize


def read_header(stream: Any) -> Header:
    """The header of the array that `stream` holds, which is left at its first value; raises InputError if there is none."""
    try:
        version = np.lib.format.read_magic(stream)
        width, parse = {
            (1, 0): (2, np.lib.format.read_array_header_1_0),
            (2, 0): (4, np.lib.format.read_array_header_2_0),
        }[version]
        length = stream.read(width)
        if int.from_bytes(length, "little") > MOST_HEADER:
            raise ValueError
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # headers written by Python 2 are fine
            shape, fortran, kind = parse(io.BytesIO(length + stream.read(int.from_bytes(length, "little"))))
    except Exception:
        raise InputError("this is no array in numpy's format (.npy): save it with numpy.save") from None
    if kind.hasobject:
        raise InputError("it holds pickled objects, which may run any code and are never loaded: save an array of numbers")
    if any(isinstance(length, bool) or length < 0 for length in shape):
        raise InputError(f"its header has the shape {str(shape)[:40]}: expected whole numbers of 0 or above; save it again")
    return Header(tuple(shape), fortran, kind)


def read_values(stream: Any, header: Header) -> Any:
    """The values behind a header, cut to no less than it announces; the caller has looked at its size."""
    content = stream.read(header.size)
    if len(content) != header.size:
        raise InputError(f"its header announces {header.size:,} bytes of numbers, but {len(content):,} follow: it is cut short")
    return np.ndarray(header.shape, header.kind, content, order="F" if header.fortran else "C")


def read_archive(content: bytes, names: Iterable[str], look: Callable[[str, Header], None]) -> dict[str, Any]:
    """Arrays of an .npz archive by name; `look` sees each header before the values are loaded, and refuses what is wrong.

    Raises
    ------
    InputError
        An archive that is none, is damaged, lacks an array or unfolds to far more than it is; the message does not name the file.
    """
    arrays: dict[str, Any] = {}
    left = unpacked(len(content))
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            there = set(archive.namelist())
            for name in names:
                if f"{name}.npy" not in there:
                    raise InputError(f"it has no array {name}: write the result again with relax solve")
                with archive.open(f"{name}.npy") as stream:
                    header = _header_of(name, stream)
                    look(name, header)
                    left -= header.size
                    if left < 0:
                        raise InputError(
                            f"{name} unfolds to many times the size of the file: write the result again with relax solve"
                        )
                    arrays[name] = read_values(stream, header)
    except InputError:
        raise
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, KeyError, MemoryError, NotImplementedError, RuntimeError):
        raise InputError(
            "this is no archive of numpy arrays, or it is damaged: write the result again with relax solve"
        ) from None
    except Exception:
        # zlib, struct and tokenize have errors of their own for damaged content
        raise InputError("it is damaged: write the result again with relax solve") from None
    return arrays


def _header_of(name: str, stream: Any) -> Header:
    try:
        return read_header(stream)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
