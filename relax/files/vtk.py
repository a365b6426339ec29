"""Meshes of the VTK family by meshio, once it is seen that the file holds no more than it can: meshio believes every count.

A header of a hundred bytes may announce terabytes, and a packed block of a megabyte may unfold to a gigabyte.
"""

import contextlib
import io
import lzma
import math
import re
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.bytes import unpacked
from relax.files.checks import escaped
from relax.files.polygons import Polygons

IGNORED_CELLS = frozenset(["vertex", "line", "empty"])
FACE_CELLS = {"triangle": (0, 1, 2), "quad": (0, 1, 2, 3), "polygon": None, "pixel": (0, 1, 3, 2)}  # corners in turn
LONGEST_COUNT = 16  # digits; a file that could hold more does not exist
# a line of a legacy file that is no row of numbers: a keyword or the name of a field, then counts
NAMED = re.compile(rb"^[^\n]*[A-Za-z_]{3}[^\n]*$", re.MULTILINE)


def read_vtk(path: Path, content: bytes) -> tuple[Floats, Polygons]:
    """Points and polygons of a VTK or VTU file, by meshio."""
    kind = path.suffix[1:].lower()
    cells = _announced_vtk(content) if kind == "vtk" else _announced_vtu(content)
    mesh = _meshio_read(path, kind)
    # of a damaged file meshio may return a single number
    if any(np.ndim(table) != 2 for table in (mesh.points, *(block.data for block in mesh.cells))) or mesh.points.shape[1] > 3:
        raise InputError(f"this is not a {kind.upper()} file that can be read; save it again, or as OBJ")
    if sum(len(block.data) for block in mesh.cells) != cells:
        raise InputError(
            f"the file announces {cells} cells, but {sum(len(block.data) for block in mesh.cells)} can be read: it is cut short "
            "or holds triangle strips or other cells that are not read; save it as OBJ"
        )
    polygons: Polygons = []
    for block in mesh.cells:
        if block.type in IGNORED_CELLS:
            continue
        if block.type not in FACE_CELLS:
            raise InputError(
                f"it holds cells of the kind {block.type}: a membrane is made of triangles and quads; save its surface"
            )
        corners = np.asarray(block.data, dtype=np.int64)
        polygons += corners[:, FACE_CELLS[block.type] or slice(None)].tolist()
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    return points, polygons


def _meshio_read(path: Path, kind: str) -> Any:
    """The file as meshio has it: without its prints, its warnings and its exit."""
    import meshio  # a tenth of a second that only the VTK family costs

    silence = io.StringIO()
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # numbers that numpy gives up on in the middle: meshio would go on with those read so far
            warnings.filterwarnings("error", message="string or file could not be read to its end")
            with _unpacking(unpacked(path.stat().st_size)):
                return meshio.read(path, file_format=kind)
    except InputError:
        raise
    except (SystemExit, Exception):
        # the reasons meshio gives are for programmers, often empty
        raise InputError(f"this is not a {kind.upper()} file that can be read; save it again, or as OBJ") from None


def _announced_vtk(content: bytes) -> int:
    """Number of cells that a legacy VTK file says it has."""
    dataset = re.search(rb"^DATASET\s+(\w+)", content, re.MULTILINE | re.IGNORECASE)
    if dataset is None or dataset[1].upper() != b"UNSTRUCTURED_GRID":
        found = escaped(dataset[1].decode(errors="replace"), 20) if dataset else "no dataset"
        raise InputError(f"it holds {found}, expected UNSTRUCTURED_GRID: save the surface as OBJ, PLY or VTU")
    for line in NAMED.finditer(content, dataset.end()):
        counts = [_count(word) for word in line[0].split()[1:] if word.isdigit()]
        many = max(counts, default=0) if line[0][:6].upper() == b"CELLS " else math.prod(counts)
        if many > len(content):
            name = escaped(line[0].split()[0].decode(errors="replace"), 20)
            raise InputError(
                f"its {name} are {max(counts):,}, more than a file of {len(content):,} bytes holds: it is damaged; save it again"
            )
    types = re.search(rb"^CELL_TYPES\s+(\d+)", content, re.MULTILINE | re.IGNORECASE)
    return _count(types[1]) if types else 0


def _announced_vtu(content: bytes) -> int:
    """Number of cells that a VTU file says it has; of several pieces meshio keeps the last one's cells alone."""
    pieces = re.findall(rb"<Piece\b[^>]*>", content)
    if len(pieces) != 1:
        raise InputError(f"it holds {len(pieces)} pieces, expected one: save the surface as one piece, or as OBJ")
    if b"<!ENTITY" in content:
        raise InputError("it defines entities of its own, which no VTU file needs: save it again")
    cells = re.search(rb"NumberOfCells\s*=\s*[\"']\s*(\d+)", pieces[0])
    return _count(cells[1]) if cells else 0


def _count(digits: bytes) -> int:
    """A count that a file announces."""
    if len(digits) > LONGEST_COUNT:
        raise InputError(f"it announces {digits[:8].decode()}... of something, a number of {len(digits)} digits: save it again")
    return int(digits)


class _Unpacker:
    """A module of a compression in meshio's place, whose blocks together unfold to no more than a number of bytes."""

    def __init__(self, module: Any, left: list[int]) -> None:
        self.module, self.left = module, left

    def __getattr__(self, name: str) -> Any:
        """Everything else is the module's: another thread may be writing meanwhile."""
        return getattr(self.module, name)

    def decompress(self, packed: bytes) -> bytes:
        """What is in the block."""
        stream = self.module.decompressobj() if self.module is zlib else self.module.LZMADecompressor()
        content: bytes = stream.decompress(packed, max(self.left[0], 0) + 1)
        self.left[0] -= len(content)
        if self.left[0] < 0:
            raise InputError("its packed data unfold to many times the size of the file: save it without compression, or as OBJ")
        if not stream.eof:
            raise EOFError
        return content


@contextlib.contextmanager
def _unpacking(most: int) -> Iterator[None]:
    """Let meshio unpack `most` bytes and no more."""
    from meshio.vtu import _vtu

    left = [most]
    try:
        _vtu.zlib, _vtu.lzma = _Unpacker(zlib, left), _Unpacker(lzma, left)
        yield
    finally:
        _vtu.zlib, _vtu.lzma = zlib, lzma
