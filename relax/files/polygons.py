"""Readers of the plain mesh formats OBJ, OFF and STL: points and polygons exactly as the file numbers them.

meshio reads these too, but gives wrong faces for legal OBJ files (negative indices, colours behind the coordinates), knows
no quads in OFF and stumbles over blank lines in STL; the tests hold these readers against it where it is right.
"""

from collections.abc import Iterator

import numpy as np

from relax.arrays import Floats
from relax.errors import InputError
from relax.files.checks import escaped

Polygons = list[list[int]]

# OBJ statements that say nothing of points and faces; any other is refused, since a face may hide in it
OBJ_IGNORED = frozenset(
    "vt vn vp p l g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj".split()
)
OFF_HEADERS = frozenset(["OFF", "COFF", "NOFF", "CNOFF"])  # with colours and normals behind the coordinates
STL_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
STL_HEADER = 84  # bytes: 80 of comment, then the number of facets


def read_obj(content: bytes) -> tuple[Floats, Polygons]:
    """Points and polygons of a Wavefront OBJ file; negative indices count back from the last vertex read."""
    points: list[list[float]] = []
    polygons: Polygons = []
    for line, words in _statements(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")):
        if words[0] == "v":
            if len(words) == 5 and _number(words[4], line) != 1:
                raise InputError(
                    f"line {line}: a vertex with a weight other than 1 is a rational curve's; save as a polygon mesh"
                )
            points.append(_numbers([*words[1:4], "0"][:3] if len(words) == 3 else words[1:4], line))
        elif words[0] == "f":
            corners = [_whole(word.split("/")[0], line) for word in words[1:]]
            if 0 in corners:
                raise InputError(f"line {line}: a face names vertex 0, but OBJ counts vertices from 1: mend the face")
            polygons.append([corner - 1 if corner > 0 else len(points) + corner for corner in corners])
            if min(polygons[-1], default=0) < 0:
                raise InputError(f"line {line}: a face counts back beyond the first vertex: mend the face")
        elif words[0] not in OBJ_IGNORED:
            raise InputError(
                f'line {line}: unknown statement "{escaped(words[0], 20)}": expected v, f or another statement of polygon meshes'
            )
    return _array(points), polygons


def read_off(content: bytes) -> tuple[Floats, Polygons]:
    """Points and polygons of an OFF file; colours are skipped."""
    lines = list(_statements(content))
    if not lines or lines[0][1][0] not in OFF_HEADERS:
        raise InputError('expected the first word to be "OFF" (text; binary OFF is not read: save as text)')
    counts = lines.pop(0)[1][1:]
    if not counts and lines:
        counts = lines.pop(0)[1]
    if len(counts) < 2:
        raise InputError("expected the numbers of vertices, faces and edges behind OFF")
    vertices, faces = _whole(counts[0], 1), _whole(counts[1], 1)
    if min(vertices, faces) < 0 or len(lines) != vertices + faces:
        raise InputError(
            f"the header announces {vertices} vertices and {faces} faces, but {len(lines)} lines follow: it is cut short or "
            "has lines too many; save it again"
        )
    points = [_numbers(words[:3], line) for line, words in lines[:vertices]]
    polygons = []
    for line, words in lines[vertices:]:
        size = _whole(words[0], line)
        corners = [_whole(word, line) for word in words[1 : size + 1]]
        if len(corners) != size:
            raise InputError(f"line {line}: a face of {words[0]} corners names {len(corners)}: mend the face")
        polygons.append(corners)
    return _array(points), polygons


def read_stl(content: bytes) -> tuple[Floats, Polygons]:
    """Points and triangles of a binary or text STL file; equal corners are one vertex, in order of first appearance."""
    # many binary files start with "solid" as text files do, so the length decides
    facets = int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
    if len(content) == STL_HEADER + facets * STL_FACET.itemsize:
        with np.errstate(invalid="ignore"):  # of a signalling nan, which is refused as any other
            corners = np.frombuffer(content, STL_FACET, facets, STL_HEADER)["corners"].astype(float).reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid" and b"\0" not in content:
        corners = _stl_text(content)
    else:
        raise InputError(
            f"{len(content)} bytes do not fit the {facets} facets that the file announces: it is cut short or no STL file"
        )
    if not len(corners):
        return np.zeros((0, 3)), []
    # adding 0 makes -0.0 and 0.0 one number
    _, first, which = np.unique(corners + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return corners[first[order]], rank[which.ravel()].reshape(-1, 3).tolist()


def _stl_text(content: bytes) -> Floats:
    """Corners (3 F, 3) of a text STL file."""
    corners: list[list[float]] = []
    facets = 0
    last = ""
    for line, words in _statements(content):
        last = words[0].lower()
        if last == "vertex":
            corners.append(_numbers(words[1:], line))
        elif last == "endfacet":
            facets += 1
            if len(corners) != 3 * facets:
                raise InputError(f"line {line}: a facet ends here that has no three corners: save the file again")
        elif last not in ("solid", "endsolid", "facet", "outer", "endloop"):
            raise InputError(
                f'line {line}: unknown word "{escaped(words[0], 20)}": expected facet, vertex or another word of STL'
            )
    if last != "endsolid" or len(corners) != 3 * facets:
        raise InputError('the file does not end with "endsolid": it is cut short; save it again')
    return _array(corners)


def _statements(content: bytes) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each line that is not blank, without comments."""
    for line, text in enumerate(content.decode("utf-8", errors="replace").split("\n"), start=1):
        words = text.split("#", 1)[0].split()
        if words:
            yield line, words


def _numbers(words: list[str], line: int) -> list[float]:
    """Three coordinates."""
    if len(words) != 3:
        raise InputError(f"line {line}: expected three coordinates, found {len(words)}")
    return [_number(word, line) for word in words]


def _number(word: str, line: int) -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(f'line {line}: "{escaped(word, 20)}" is not a number') from None


def _whole(word: str, line: int) -> int:
    try:
        return int(word)
    except ValueError:
        raise InputError(f'line {line}: "{escaped(word, 20)}" is not a whole number') from None


def _array(points: list[list[float]]) -> Floats:
    return np.array(points, dtype=float).reshape(-1, 3)
