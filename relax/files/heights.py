"""Height fields from files: numbers from arrays, text and pictures, one height a sample, y growing with the row."""

import io
import math
import os
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.bytes import MOST_BYTES, open_bytes, read_bytes
from relax.files.checks import escaped
from relax.files.npy import read_header, read_values
from relax.files.schema import HEIGHT_SUFFIXES

MOST_SAMPLES = 4_000_000  # far beyond what can be solved, far below what fills a memory
MOST_AXES = 8  # of an array's shape that a sentence repeats
MOST_TEXT = 128_000_000  # bytes: 4 million numbers of 32 characters
FIRST_WORDS = {"ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "nodata_value"}
HEADER_LENGTH = 4096  # characters, more than six lines of a name and a number need
ESRI_NODATA = -9999.0  # where the file names none
GDAL_NODATA = 42113  # the TIFF tag that GDAL writes
DEPTHS = ("L", "I;16", "I;16B", "I;16L", "I;16N", "I", "F")  # Pillow's picture modes of one channel


def read_heights(path: Path) -> tuple[Floats, tuple[float, float] | None]:
    """Heights z[row, column] of a file and, where it says so itself, the spacing of its samples.

    Parameters
    ----------
    path : Path
        .npy, .npz (array z), .csv (commas), .txt (blanks), .asc (ESRI grid), .png or .tif (one channel, raw values).
        Pictures and .asc are flipped, so that y grows with the row; at most 4 million samples.

    Returns
    -------
    heights : (rows, columns)
    spacing : (dx, dy) metres or None

    Raises
    ------
    InputError
        A file that is missing, broken or cut short, has too few or too many samples, a height that is not finite, or
        pickled objects, which are never loaded. The message does not name the file.
    """
    suffix = path.suffix.lower()
    if suffix not in HEIGHT_SUFFIXES:
        raise InputError(f'"{suffix}" is no height field that is read here; possible: {" ".join(HEIGHT_SUFFIXES)}')
    spacing = None
    if suffix in (".png", ".tif", ".tiff"):
        heights = _read_picture(path)
    elif suffix == ".npy":
        with open_bytes(path) as stream:
            heights = _read_array(stream)
    elif suffix == ".npz":
        heights = _read_archive(path)
    elif suffix == ".asc":
        heights, spacing = _read_esri(_read_text(path))
    else:
        heights = _read_table(_read_text(path), "," if suffix == ".csv" else None)
    _check_shape(heights.shape)
    bad = np.argwhere(~np.isfinite(heights))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"row {row}, column {column} is {heights[row, column]}: every height must be a finite number; fill the gap"
        )
    # the first row of a picture or a map is its northern edge
    return (heights[::-1].copy() if suffix in (".png", ".tif", ".tiff", ".asc") else heights), spacing


def _check_shape(shape: tuple[int, ...]) -> None:
    """Refuse what is no grid, or one too large, before it is loaded where the shape is known by then."""
    size = " x ".join(f"{length:,}" if length < MOST_BYTES else f"{float(length):g}" for length in shape[:MOST_AXES])
    if len(shape) != 2:
        raise InputError(f"it has {len(shape)} dimensions ({size or 'a single number'}), expected two: rows and columns")
    if min(shape) < 2:
        raise InputError(f"it has {shape[0]} rows and {shape[1]} columns: a height field needs at least 2 of each")
    if math.prod(shape) > MOST_SAMPLES:
        raise InputError(f"it has {size} samples, more than the {MOST_SAMPLES:,} that are read: resample it")


def _read_array(stream: Any) -> Floats:
    """An array in numpy's format, of numbers."""
    header = read_header(stream)
    if header.kind.kind not in "fiu":
        raise InputError(f"it holds values of the kind {header.kind}, expected real numbers: save it as float64")
    _check_shape(header.shape)
    return np.asarray(read_values(stream, header).astype(float))


def _read_archive(path: Path) -> Floats:
    try:
        with open_bytes(path) as content, zipfile.ZipFile(content) as archive:
            if "z.npy" not in archive.namelist():
                names = ", ".join(name.removesuffix(".npy") for name in archive.namelist()[:8])
                raise InputError(
                    f"it has no array z; it has {escaped(names) or 'none'}: save it with numpy.savez(file, z=heights)"
                )
            with archive.open("z.npy") as stream:
                return _read_array(stream)
    except InputError:
        raise
    except Exception:
        raise InputError("this is no archive of numpy arrays (.npz), or it is damaged: save it again") from None


def _read_text(path: Path) -> str:
    content = read_bytes(path, MOST_TEXT)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"byte {error.start} is no text: expected numbers in UTF-8") from None


def _read_table(text: str, delimiter: str | None) -> Floats:
    """Numbers in lines; the quick reader first, then a slow one that finds the fault."""
    first = next((line for line in text.splitlines() if line.split("#")[0].strip()), "")
    columns = len(first.split("#")[0].split(delimiter))
    if not first:
        raise InputError("it holds no numbers")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of blank lines, which are fine
            # one row more than is allowed, to see that there are too many; it sets aside all that it is told
            most = min(MOST_SAMPLES // max(columns, 1), text.count("\n") + text.count("\r")) + 1
            return np.loadtxt(io.StringIO(text), delimiter=delimiter, ndmin=2, comments="#", max_rows=most)
    except (ValueError, OverflowError):
        raise InputError(_fault(text, delimiter, columns)) from None


def _fault(text: str, delimiter: str | None, columns: int) -> str:
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].split(delimiter)
        if not line.split("#")[0].strip():
            continue
        if len(words) != columns:
            return f"line {number} has {len(words)} numbers, the first has {columns}: every row needs as many"
        for column, word in enumerate(words):
            try:
                float(word)
            except ValueError:
                by = "commas" if delimiter else "blanks"
                found = escaped(word.strip(), 20)
                return f'line {number}, column {column}: "{found}" is not a number: expected numbers parted by {by}'
    return "it is not a table of numbers: save it again"


def _read_esri(text: str) -> tuple[Floats, tuple[float, float]]:
    """An ESRI ASCII grid: header lines of a name and a number, then the heights from north to south."""
    header: dict[str, float] = {}
    words = text[:HEADER_LENGTH].split()
    while words and words[0][:1].isalpha() and words[0].lower() not in ("nan", "inf", "infinity"):
        name, value, *words = [*words, ""]
        if name.lower() not in FIRST_WORDS:
            raise InputError(f'its header has the word "{escaped(name, 20)}", which ESRI grids do not know: save it again')
        header[name.lower()] = _header_number(name, value)
    missing = [name for name in ("ncols", "nrows", "cellsize") if name not in header]
    if missing:
        raise InputError(f"its header lacks {missing[0]}: an ESRI grid starts with ncols, nrows, corner and cellsize")
    rows, columns, cell = header["nrows"], header["ncols"], header["cellsize"]
    if not (rows.is_integer() and columns.is_integer() and rows > 0 and columns > 0 and cell > 0):
        raise InputError(f"its header has nrows = {rows:g}, ncols = {columns:g}, cellsize = {cell:g}: expected numbers above 0")
    shape = (int(rows), int(columns))
    _check_shape(shape)
    words = text.split(maxsplit=2 * len(header) + math.prod(shape))[2 * len(header) :]
    if len(words) != math.prod(shape):
        more = "more" if len(words) > math.prod(shape) else f"{len(words):,}"
        raise InputError(f"its header announces {shape[0]} rows of {shape[1]} heights, but {more} follow: save it again")
    try:
        heights = np.array(words, dtype=float).reshape(shape)
    except ValueError:
        wrong = next((word for word in words if not _is_number(word)), words[0])
        raise InputError(f'"{escaped(wrong, 20)}" is not a number: expected heights parted by blanks') from None
    _refuse_nodata(heights, header.get("nodata_value", ESRI_NODATA))
    return heights, (cell, cell)


def _header_number(name: str, word: str) -> float:
    if not _is_number(word) or (name != "nodata_value" and not math.isfinite(float(word))):
        raise InputError(f'its header has {name} = "{escaped(word, 20)}": expected a number')
    return float(word)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _refuse_nodata(heights: Floats, nodata: float) -> None:
    missing = np.argwhere(heights == nodata)
    if len(missing):
        row, column = missing[0]
        raise InputError(
            f"row {row}, column {column} is {nodata:g}, the mark of a sample without data ({len(missing)} in all): "
            "fill the gaps or crop them away"
        )


def _read_picture(path: Path) -> Floats:
    """Raw values of a picture of one channel, top row first; its size is looked at before it is decoded."""
    from PIL import Image, UnidentifiedImageError  # pictures alone need it

    try:
        content = io.BytesIO(read_bytes(path))  # of a file, a chunk that claims 2 GB would be given 2 GB
        with warnings.catch_warnings():
            # Pillow only warns of truncated data and of pictures large enough to fill the memory
            warnings.simplefilter("error")
            with Image.open(content, formats=["PNG", "TIFF"]) as picture:
                _check_picture(picture)
                with _silent_libtiff():
                    heights = np.asarray(picture).astype(float)
                nodata = getattr(picture, "tag_v2", {}).get(GDAL_NODATA)
    except InputError:
        raise
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise InputError(f"it has many more pixels than the {MOST_SAMPLES:,} samples that are read: resample it") from None
    except UnidentifiedImageError:
        raise InputError("this is no PNG or TIFF picture, or one of a kind that Pillow does not read: save it again") from None
    except Exception:
        raise InputError("the picture is damaged or cut short: save it again") from None
    if nodata is not None and _is_number(str(nodata).strip("\0 ")):
        _refuse_nodata(heights, float(str(nodata).strip("\0 ")))
    return heights


@contextmanager
def _silent_libtiff() -> Iterator[None]:
    """Keep file descriptor 2 to ourselves: libtiff writes its complaints there, past Python."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _check_picture(picture: Any) -> None:
    width, height = picture.size
    _check_shape((height, width))
    if picture.mode not in DEPTHS:
        raise InputError(
            f"it is a picture of the kind {picture.mode}, expected one channel of 8, 16 or 32 bits: save it in grey levels"
        )
    if getattr(picture, "n_frames", 1) != 1:
        raise InputError(f"it holds {picture.n_frames} pictures, expected one: save the one that is meant")
    # Pillow stretches grey levels of 2 and 4 bits and turns "white is zero" round: these are not the raw values
    layout = str(picture.tile[0].args) if picture.tile else ""
    if any(kind in layout for kind in ("L;2", "L;4", "L;I", "L;R")):
        raise InputError("its grey levels are packed or inverted, so they are no heights: save it with 8, 16 or 32 bits a pixel")
