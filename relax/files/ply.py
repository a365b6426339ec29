"""Reader of PLY meshes, text and binary, with any elements and properties beside vertices and faces.

meshio misreads binary files whose faces carry more than their list of corners, and finds no faces where that list is called
`vertex_index`; the tests hold this reader against it where it is right.
"""

import re
import struct
from dataclasses import dataclass, field

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.checks import escaped
from relax.files.polygons import Polygons

CODES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"},
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")
LONGEST_COUNT = 16  # digits; a file that could hold more rows does not exist
CUT_SHORT = "the file is cut short or its header is wrong; save it again"


@dataclass(frozen=True)
class _Property:
    name: str
    code: str
    count_code: str | None  # of a list's length; None: a single value


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class _Body:
    """What follows the header, read from front to back."""

    order: str  # of bytes; empty: text
    content: bytes
    words: list[bytes]
    at: int = 0

    def take(self, code: str, count: int) -> tuple[float, ...]:
        """The next `count` values of one type."""
        if self.order:
            layout = struct.Struct(f"{self.order}{max(count, 0)}{code}")
            if count < 0 or self.at + layout.size > len(self.content):
                raise InputError(CUT_SHORT)
            self.at += layout.size
            return layout.unpack_from(self.content, self.at - layout.size)
        if count < 0 or self.at + count > len(self.words):
            raise InputError(CUT_SHORT)
        self.at += count
        words = self.words[self.at - count : self.at]
        try:
            return tuple(float(word) if code in "fd" else int(word) for word in words)
        except ValueError:
            raise InputError(f"{b' '.join(words)[:40].decode(errors='replace')!r} is no list of {count} numbers") from None

    def left(self) -> bool:
        """Whether anything but blanks follows."""
        return bool(self.content[self.at :].strip()) if self.order else self.at < len(self.words)


def read_ply(content: bytes) -> tuple[Floats, Polygons]:
    """Points and polygons of a PLY file."""
    end = re.search(rb"^end_header[ \t]*\r?\n", content, re.MULTILINE)
    if not content.startswith(b"ply") or end is None:
        raise InputError('expected a PLY header, from "ply" to "end_header"')
    order, elements = _header(content[: end.start()].decode("latin-1").splitlines())
    rest = content[end.end() :]
    body = _Body(order, rest, [] if order else rest.split())
    points = np.zeros((0, 3))
    polygons: Polygons = []
    for element in elements:
        if element.name == "vertex":
            points = _points(element, body)
        elif element.name == "face":
            polygons = _faces(element, body)
        else:
            _rows(element, body)
    if body.left():
        raise InputError(f"more data follows than the header announces: {CUT_SHORT}")
    return points, polygons


def _header(lines: list[str]) -> tuple[str, list[_Element]]:
    """Byte order and elements."""
    order: str | None = None
    elements: list[_Element] = []
    for line in lines[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in ORDERS:
                order = ORDERS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < LONGEST_COUNT:
                elements.append(_Element(name, int(count)))
            case ["property", "list", count, kind, name] if elements and kind in CODES and CODES.get(count, "f") not in "fd":
                elements[-1].properties.append(_Property(name, CODES[kind], CODES[count]))
            case ["property", kind, name] if elements and kind in CODES:
                elements[-1].properties.append(_Property(name, CODES[kind], None))
            case _:
                raise InputError(f'the header has a line that PLY does not know: "{escaped(line.strip(), 60)}"')
    if order is None:
        raise InputError("the header names no format: expected ascii, binary_little_endian or binary_big_endian, 1.0")
    return order, elements


def _points(element: _Element, body: _Body) -> Floats:
    names = [item.name for item in element.properties]
    if any(item.count_code for item in element.properties) or "x" not in names or "y" not in names:
        raise InputError("its vertices need the properties x, y and z, and no lists")
    columns = [names.index(name) for name in ("x", "y", "z") if name in names]
    values = np.zeros((0, len(names)))
    if element.count:
        values = np.array([row[0] for row in _rows(element, body)])
    points = np.zeros((element.count, 3))
    points[:, : len(columns)] = values[:, columns]
    return points


def _faces(element: _Element, body: _Body) -> Polygons:
    lists = [item.name for item in element.properties if item.count_code]
    found = [lists.index(name) for name in CORNERS if name in lists]
    if not found:
        raise InputError(f"its faces need a list {CORNERS[0]}; it has {', '.join(lists) or 'none'}")
    return [[int(corner) for corner in row[1][found[0]]] for row in _rows(element, body)]


def _rows(element: _Element, body: _Body) -> list[tuple[list[float], list[tuple[float, ...]]]]:
    """The single values and the lists of each row of an element."""
    rows = []
    for _ in range(element.count if element.properties else 0):
        single: list[float] = []
        lists: list[tuple[float, ...]] = []
        for item in element.properties:
            if item.count_code is None:
                single += body.take(item.code, 1)
            else:
                lists.append(body.take(item.code, int(body.take(item.count_code, 1)[0])))
        rows.append((single, lists))
    return rows
