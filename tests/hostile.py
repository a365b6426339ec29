"""Hostile files for every reader: sound ones, traps made by hand, mutations, and a process that reads them under limits."""

import base64
import json
import lzma
import math
import re
import resource
import signal
import struct
import subprocess
import sys
import time
import tracemalloc
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path

import meshio
import numpy as np
from folders import bump
from PIL import Image

WAIT = 10  # times as long by the clock: others may be at work
SECONDS = 2.0  # of the processor, for one file of a few kilobytes; the readers take some milliseconds
# bytes for the same, and for each byte of it: packed data may unfold to 32 MB, held twice; a number of a text becomes an object
PEAK, SHARE = 100_000_000, 40
SPACE = 6_000_000_000  # bytes of address space, so that what goes wrong here does not take the machine with it
HUGE = 999_999_999_999

POINTS = np.array([[x, y, 0.1 * x * y] for y in range(3) for x in range(3)], dtype=float)
QUADS = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]])
TRIANGLES = np.vstack([QUADS[:, :3], QUADS[:, [0, 2, 3]]])
SCENE = """title = "Hill"
[target]
heights = "hill.npy"
spacing = [0.2, 0.2]
noise = { sigma = 0.001, seed = 3 }
[membrane]
loads = [0.0, 0.0, -0.01]
cables = [{ path = [8, 9, 10], stiffness = 2.0, rest_scale = 0.9 }]
[supports]
candidates = { box = [[0.1, 0.1], [1.1, 1.1]] }
direction = { lean = 30.0 }
never = [24]
[penalty]
name = "power"
weight_fraction = 0.1
"""


@dataclass(frozen=True)
class Case:
    """One file to be read: what reads it, its name, content, and how it came about."""

    kind: str  # mesh, heights, scene, result
    format: str
    name: str
    how: str
    content: bytes


@dataclass(frozen=True)
class Answer:
    """What came of it: "read", "refused", or what must not be: "crash", "hang", "memory", "noise"; with words and cost."""

    format: str
    how: str
    outcome: str
    words: str
    seconds: float
    peak: int


def _saved(save, *arguments, **options) -> bytes:
    stream = BytesIO()
    save(stream, *arguments, **options)
    return stream.getvalue()


def _by_meshio(folder: Path, suffix: str, cells, **options) -> bytes:
    path = folder / f"seed{suffix}"
    meshio.write(path, meshio.Mesh(POINTS, cells), **options)
    content = path.read_bytes()
    path.unlink()
    return content


def seeds(folder: Path, result: Path | None = None) -> list[Case]:
    """A sound file of every format and flavour, those of a result folder among them; `folder` is for what needs a path."""
    mixed = [("quad", QUADS[:2]), ("triangle", TRIANGLES[2:4])]
    flat = [("triangle", TRIANGLES)]
    meshes = {
        "obj": (".obj", mixed, {}),
        "off": (".off", flat, {}),
        "stl": (".stl", flat, {"binary": True}),
        "stl text": (".stl", flat, {"binary": False}),
        "ply": (".ply", mixed, {"binary": True}),
        "ply text": (".ply", mixed, {"binary": False}),
        "vtk": (".vtk", mixed, {"file_format": "vtk"}),
        "vtk text": (".vtk", mixed, {"file_format": "vtk", "binary": False}),
        "vtk 4.2": (".vtk", mixed, {"file_format": "vtk42"}),
        "vtk 4.2 text": (".vtk", mixed, {"file_format": "vtk42", "binary": False}),
        "vtu": (".vtu", mixed, {"binary": True}),
        "vtu plain": (".vtu", mixed, {"binary": True, "compression": None}),
        "vtu text": (".vtu", mixed, {"binary": False}),
    }
    cases = [
        Case("mesh", name, suffix, "seed", _by_meshio(folder, suffix, cells, **options))
        for name, (suffix, cells, options) in meshes.items()
    ]
    z = bump(4)
    grey = (255 * z).astype(np.uint8)
    rows = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in z)
    asc = f"ncols 4\nnrows 4\nxllcorner 0\nyllcorner 0\ncellsize 0.5\nNODATA_value -9999\n{rows}\n"
    heights = {
        "npy": (".npy", _saved(np.save, z)),
        "npz": (".npz", _saved(np.savez, z=z)),
        "npz packed": (".npz", _saved(np.savez_compressed, z=z)),
        "csv": (".csv", rows.replace(" ", ",").encode()),
        "txt": (".txt", rows.encode()),
        "asc": (".asc", asc.encode()),
        "png": (".png", _saved(Image.fromarray(grey).save, format="PNG")),
        "png 16": (".png", _saved(Image.fromarray(grey.astype(np.uint16)).save, format="PNG")),
        "tif": (".tif", _saved(Image.fromarray(z.astype(np.float32)).save, format="TIFF")),
        "tif packed": (".tif", _saved(Image.fromarray(grey).save, format="TIFF", compression="tiff_lzw")),
        "tif deflated": (".tif", _saved(Image.fromarray(grey).save, format="TIFF", compression="tiff_adobe_deflate")),
    }
    cases += [Case("heights", name, suffix, "seed", content) for name, (suffix, content) in heights.items()]
    cases.append(Case("scene", "toml", ".toml", "seed", SCENE.encode()))
    if result is not None:
        for name in ("result.json", "result.npz", "trace.npz"):
            cases.append(Case("result", name, name, "seed", (result / name).read_bytes()))
    return cases


def npy(shape: str, descr: str = "<f8", body: bytes = b"\0" * 64) -> bytes:
    """An array in numpy's format with any header."""
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive of these files."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def png(width: int, height: int, body: bytes = b"", depth: int = 8) -> bytes:
    """A PNG that announces a size; `body` is what its one data chunk holds."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body or zlib.compress(b"")) + chunk(b"IEND", b"")


def tiff(tags: dict[int, tuple[int, int]], start: int = 8) -> bytes:
    """A TIFF of these tags (type 3: 16 bits, 4: 32 bits), its directory at `start`."""
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, (kind, value) in sorted(tags.items()))
    return (
        b"II*\0" + struct.pack("<I", start) + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 8 if start == 8 else 0)
    )


def traps() -> list[Case]:
    """Files made by hand to be expensive or confusing; every one is to be refused."""
    zeros = b"\0" * 20_000_000  # packs to 20 kilobytes
    bomb = zipped({"z.npy": npy("(2500, 1000)", body=zeros)})
    wide = {
        256: (4, 60_000),
        257: (4, 60_000),
        258: (3, 32),
        259: (3, 1),
        262: (3, 1),
        273: (4, 8),
        277: (3, 1),
        279: (4, 64),
        339: (3, 3),
    }
    xyz = "property float x\nproperty float y\nproperty float z\n"
    ply = "ply\nformat {}\nelement vertex {}\n" + xyz + "element face {}\n{}end_header\n{}"
    corners = "property list uchar int vertex_indices\n"
    grid = "# vtk DataFile Version 4.2\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 double\n0 0 0\n"
    vtu = (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"{}><UnstructuredGrid>'
        '<Piece NumberOfPoints="{}" NumberOfCells="{}">{}</Piece></UnstructuredGrid></VTKFile>'
    )
    points = '<Points><DataArray type="Float64" NumberOfComponents="3" format="{}">{}</DataArray></Points>'
    lol = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    found: list[tuple[str, str, str, str, bytes | str]] = [
        ("mesh", "obj", ".obj", "index 1e12", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {HUGE}\n"),
        ("mesh", "obj", ".obj", "index of 5000 digits", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 " + "9" * 5000 + "\n"),
        ("mesh", "obj", ".obj", "a face of 100000 corners", "v 0 0 0\n" + "f " + "1 " * 100_000 + "\n"),
        ("mesh", "obj", ".obj", "not a number", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("mesh", "obj", ".obj", "infinite", "v 0 0 0\nv 1 0 -inf\nv 0 1 0\nf 1 2 3\n"),
        ("mesh", "obj", ".obj", "binary rubbish", bytes(range(256)) * 64),
        ("mesh", "off", ".off", "vertices 1e12", f"OFF\n{HUGE} 1 0\n0 0 0\n"),
        ("mesh", "off", ".off", "a face of 1e12 corners", f"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n{HUGE} 0 1 2\n"),
        ("mesh", "off", ".off", "negative counts", "OFF\n-3 4 0\n0 0 0\n"),
        ("mesh", "off", ".off", "a face of -1 corners", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n-1 0 1 2\n"),
        ("mesh", "stl", ".stl", "facets 4e9", b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 50),
        (
            "mesh",
            "stl",
            ".stl",
            "not a number",
            b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12f", *[math.nan] * 12) + b"\0\0",
        ),
        ("mesh", "ply", ".ply", "vertices 1e12", ply.format("ascii 1.0", HUGE, 1, corners, "0 0 0\n")),
        ("mesh", "ply", ".ply", "binary vertices 1e12", ply.format("binary_little_endian 1.0", HUGE, 1, corners, "\0" * 99)),
        ("mesh", "ply", ".ply", "vertices without properties", f"ply\nformat ascii 1.0\nelement vertex {HUGE}\nend_header\n"),
        (
            *("mesh", "ply", ".ply", "1e12 rows of nothing but an empty list"),
            f"ply\nformat ascii 1.0\nelement junk {HUGE}\nproperty list uchar int a\nend_header\n0 0 0 0\n",
        ),
        (
            "mesh",
            "ply",
            ".ply",
            "vertices of z alone",
            f"ply\nformat ascii 1.0\nelement vertex {HUGE}\nproperty float z\nend_header\n1",
        ),
        (
            *("mesh", "ply", ".ply", "a list of 4e9 corners"),
            ply.format("binary_little_endian 1.0", 0, 1, "property list uint double vertex_indices\n", "").encode()
            + b"\xff" * 12,
        ),
        ("mesh", "ply", ".ply", "a count of 5000 digits", ply.format("ascii 1.0", "9" * 5000, 1, corners, "0 0 0\n")),
        (
            "mesh",
            "vtk",
            ".vtk",
            "points 1e12",
            f"# vtk DataFile Version 4.2\nt\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS {HUGE} double\n",
        ),
        (
            *("mesh", "vtk", ".vtk", "cells 1e12"),
            f"{grid}CELLS {HUGE} {HUGE}\n3 0 0 0\n",
        ),
        (
            *("mesh", "vtk", ".vtk", "cell types 1e12"),
            f"{grid}CELL_TYPES {HUGE}\n5\n",
        ),
        ("mesh", "vtu", ".vtu", "points 1e12", vtu.format("", HUGE, HUGE, points.format("ascii", "0 0 0"))),
        ("mesh", "vtu", ".vtu", "cells of 5000 digits", vtu.format("", 1, "9" * 5000, points.format("ascii", "0 0 0"))),
        (
            *("mesh", "vtu", ".vtu", "a binary block of 4e9 bytes"),
            vtu.format(' header_type="UInt32"', 1, 1, points.format("binary", "/////wAAAAA=")),
        ),
        (
            *("mesh", "vtu", ".vtu", "4e9 packed blocks"),
            vtu.format(
                ' header_type="UInt32" compressor="vtkZLibDataCompressor"', 1, 1, points.format("binary", "////////////////AAAA")
            ),
        ),
        *(
            ("mesh", "vtu", ".vtu", f"a bomb packed by {name}", _vtu_bomb(vtu, points, name, packed))
            for name, packed in (("ZLib", zlib.compress(3 * zeros, 9)), ("LZMA", lzma.compress(3 * zeros, preset=0)))
        ),
        ("mesh", "vtu", ".vtu", "a billion laughs", f'<!DOCTYPE x [<!ENTITY l0 "ha">{lol}]>' + vtu.format("", 1, 1, "&l9;")),
        (
            *("mesh", "vtu", ".vtu", "an entity that names a file"),
            '<!DOCTYPE x [<!ENTITY l SYSTEM "file:///etc/passwd">]>' + vtu.format("", 1, 1, "&l;"),
        ),
        ("mesh", "vtu", ".vtu", "100000 elements deep", "<Piece>" + "<a>" * 100_000),
        ("heights", "npy", ".npy", "1e12 samples", npy(f"({HUGE},)")),
        ("heights", "npy", ".npy", "1e6 x 1e6 samples", npy("(1000000, 1000000)")),
        ("heights", "npy", ".npy", "a negative shape", npy("(-1, 4)")),
        ("heights", "npy", ".npy", "truth for a shape", npy("(True, True)")),
        ("heights", "npy", ".npy", "a million dimensions", npy("(" + "1," * 9000 + ")")),
        ("heights", "npy", ".npy", "a header 3000 brackets deep", npy("(" * 3000 + ")" * 3000)),
        ("heights", "npy", ".npy", "values of 2 gigabytes each", npy("(2, 2)", "<V2000000000")),
        ("heights", "npy", ".npy", "text", npy("(2, 2)", "<U4")),
        ("heights", "npy", ".npy", "complex numbers", npy("(2, 2)", "<c16")),
        ("heights", "npy", ".npy", "pickled objects", npy("(2, 2)", "|O")),
        ("heights", "npy", ".npy", "not a number", _saved(np.save, np.full((3, 3), np.nan))),
        ("heights", "npz", ".npz", "1e12 samples", zipped({"z.npy": npy(f"({HUGE}, 2)")})),
        ("heights", "npz", ".npz", "a bomb with a small shape", zipped({"z.npy": npy("(3, 4000000)", body=zeros)})),
        ("heights", "npz", ".npz", "a bomb for a header", zipped({"z.npy": b"\x93NUMPY\x02\x00\xff\xff\xff\x7f" + zeros})),
        ("heights", "npz", ".npz", "a bomb cut short", bomb[: len(bomb) // 2]),
        ("heights", "npz", ".npz", "another name", zipped({"../../z.npy": npy("(2, 2)")})),
        ("heights", "csv", ".csv", "a line of a million numbers", "0," * 1_000_000 + "0\n"),
        ("heights", "csv", ".csv", "a number of 100000 digits", "1,2\n3," + "9" * 100_000 + "\n"),
        ("heights", "csv", ".csv", "no text", b"\xff\xfe\x00\x01" * 10),
        ("heights", "txt", ".txt", "infinite", "0 1\ninf 2\n"),
        ("heights", "txt", ".txt", "nothing but line ends", "\n" * 100_000),
        ("heights", "txt", ".txt", "nothing but comments", "# x\n" * 100_000),
        ("heights", "asc", ".asc", "1e12 columns", f"ncols {HUGE}\nnrows {HUGE}\ncellsize 1\n1 2 3\n"),
        ("heights", "asc", ".asc", "columns without end", "ncols 1e308\nnrows 1e308\ncellsize 1\n1 2 3\n"),
        ("heights", "asc", ".asc", "columns not a number", "ncols nan\nnrows inf\ncellsize 1\n1 2 3\n"),
        ("heights", "asc", ".asc", "header without end", "ncols 4\n" * 100_000),
        ("heights", "png", ".png", "2e9 x 2e9 pixels", png(2_000_000_000, 2_000_000_000)),
        ("heights", "png", ".png", "20000 x 20000 pixels", png(20_000, 20_000)),
        ("heights", "png", ".png", "no pixels", png(0, 0)),
        ("heights", "png", ".png", "a bomb in few pixels", png(4, 4, zlib.compress(zeros))),
        ("heights", "png", ".png", "a bomb in a chunk of text", _with_text(png(4, 4), zeros)),
        ("heights", "tif", ".tif", "60000 x 60000 pixels", tiff(wide)),
        ("heights", "tif", ".tif", "a directory that names itself", tiff({256: (4, 2), 257: (4, 2)}, start=8)),
        ("heights", "tif", ".tif", "a directory beyond the end", tiff(wide, start=4_000_000_000)),
        ("heights", "tif", ".tif", "4e9 strips", _many_strips()),
        ("scene", "toml", ".toml", "10000 brackets deep", "a = " + "[" * 10_000),
        ("scene", "toml", ".toml", "10000 tables deep", "a = " + "{a=" * 10_000),
        ("scene", "toml", ".toml", "a key of 5000 parts", ".".join("a" * 5000) + " = 1\n"),
        ("scene", "toml", ".toml", "a section of 5000 parts", "[" + ".".join("a" * 5000) + "]\n"),
        ("scene", "toml", ".toml", "a number of 100000 digits", SCENE.replace("= 3 ", f"= {'9' * 100_000} ")),
        ("scene", "toml", ".toml", "sigma without end", SCENE.replace("0.001", "inf")),
        ("scene", "toml", ".toml", "a spacing of 1e308", SCENE.replace("[0.2, 0.2]", "[1e308, 1e308]")),
        ("scene", "toml", ".toml", "a spacing of 1e-308", SCENE.replace("[0.2, 0.2]", "[1e-308, 1e-308]")),
        ("scene", "toml", ".toml", "a vertex of 1e18", SCENE.replace("[24]", "[1000000000000000000]")),
        ("scene", "toml", ".toml", "a vertex of 30 digits", SCENE.replace("[24]", f"[{'9' * 30}]")),
        ("scene", "toml", ".toml", "a cable to a vertex of 1e18", SCENE.replace("9, 10", "9, 1000000000000000000")),
        ("scene", "toml", ".toml", "a path that is no name", SCENE.replace("hill.npy", "a\\u0000.npy")),
        ("scene", "toml", ".toml", "a path of 100000 letters", SCENE.replace("hill.npy", "a" * 100_000 + ".npy")),
        ("scene", "toml", ".toml", "a start of 100000 letters", SCENE + f'[solver]\nstart = "{"a" * 100_000}"\n'),
        ("scene", "toml", ".toml", "an unknown key of 100000 letters", SCENE + "a" * 100_000 + " = 1\n"),
        ("scene", "toml", ".toml", "a penalty of 100000 letters", SCENE.replace('"power"', f'"{"a" * 100_000}"')),
    ]
    made = [
        Case(kind, form, name, how, text if isinstance(text, bytes) else text.encode()) for kind, form, name, how, text in found
    ]
    for name, kind in (
        (".obj", "mesh"),
        (".ply", "mesh"),
        (".vtu", "mesh"),
        (".npy", "heights"),
        (".png", "heights"),
        (".toml", "scene"),
    ):
        made += [Case(kind, name[1:], name, how, content) for how, content in (("empty", b""), ("zeros", b"\0" * 4096))]
    return made


def result_traps() -> list[Case]:
    """The same for the files of a result."""
    deep = "[" * 100_000
    small = zipped({"positions.npy": npy(f"({HUGE}, 3)")})
    zeros = b"\0" * 20_000_000
    bomb = zipped({"positions.npy": npy("(100000000, 3)", body=zeros)})
    text = zipped({"notes.npy": npy("(1000000000,)", "<U1000")})
    return [
        Case("result", "result.json", "result.json", "100000 brackets deep", deep.encode()),
        Case("result", "result.json", "result.json", "settings 100000 deep", ('{"settings": {"a": ' + deep).encode()),
        Case(
            "result",
            "result.json",
            "result.json",
            "a number of 100000 digits",
            ('{"settings": {}, "a": ' + "9" * 100_000 + "}").encode(),
        ),
        Case("result", "result.json", "result.json", "empty", b""),
        Case("result", "result.json", "result.json", "an array", b"[]"),
        Case("result", "result.json", "result.json", "settings that are text", b'{"settings": "all"}'),
        *(Case("result", name, name, "1e12 vertices", small) for name in ("result.npz", "trace.npz")),
        *(Case("result", name, name, "a bomb", bomb) for name in ("result.npz", "trace.npz")),
        *(Case("result", name, name, "empty", b"") for name in ("result.npz", "trace.npz")),
        Case("result", "trace.npz", "trace.npz", "1e9 notes of 1000 letters", text),
    ]


def _vtu_bomb(vtu: str, points: str, name: str, packed: bytes) -> str:
    """Points in one packed block."""
    block = base64.b64encode(struct.pack("<4I", 1, 60_000_000, 0, len(packed))).decode() + base64.b64encode(packed).decode()
    head = f' header_type="UInt32" compressor="vtk{name}DataCompressor"'
    return vtu.format(head, 2_500_000, 1, points.format("binary", block))


def _with_text(picture: bytes, content: bytes) -> bytes:
    """The picture with a packed chunk of text behind its header."""
    text = b"Comment\0\0" + zlib.compress(content)
    chunk = struct.pack(">I", len(text)) + b"zTXt" + text + struct.pack(">I", zlib.crc32(b"zTXt" + text))
    return picture[:33] + chunk + picture[33:]


def _many_strips() -> bytes:
    whole = bytearray(
        tiff({256: (4, 4), 257: (4, 4), 258: (3, 8), 259: (3, 1), 262: (3, 1), 273: (4, 8), 277: (3, 1), 279: (4, 16)})
    )
    at = whole.index(struct.pack("<HH", 273, 4)) + 4
    whole[at : at + 4] = b"\xff\xff\xff\xff"
    return bytes(whole)


NUMBER = re.compile(rb"(?<![\w.+-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])", re.IGNORECASE)
WORDS = (b"-1", b"0", b"1e12", b"999999999999", b"9" * 400, b"nan", b"inf", b"1e400", b"", b"x", b"1 1", b"\xff")
FIELDS = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff", b"\x00\x00\x00\x00", b"\x00\x00\x00\x80", b"\xff" * 8)


def mutants(seed: Case, count: int, number: int) -> Iterator[Case]:
    """Of one sound file: cut short, bytes flipped, pieces left out, doubled or swapped, numbers and fields made absurd."""
    rng = np.random.default_rng([number, len(seed.content)])
    content = seed.content
    spans = [match.span() for match in NUMBER.finditer(content)]
    ways = ["cut", "flipped", "left out", "doubled", "swapped", "field", *(["number"] * 3 if len(spans) > 5 else ["field"])]
    for index in range(count):
        way, mutant = ways[index % len(ways)], bytearray(content)
        at, to = sorted(rng.integers(len(mutant), size=2).tolist())
        if way == "cut":
            del mutant[at:]
        elif way == "flipped":
            for place in rng.integers(len(mutant), size=int(rng.integers(1, 6))):
                mutant[place] ^= 1 << int(rng.integers(8))
        elif way == "left out":
            del mutant[at : min(to, at + 64)]
        elif way == "doubled":
            mutant[at:at] = mutant[at : min(to, at + 256)]
        elif way == "swapped":
            size = int(rng.integers(1, 9))
            mutant[at : at + size], mutant[to : to + size] = mutant[to : to + size], mutant[at : at + size]
        elif way == "number":
            first, last = spans[int(rng.integers(len(spans)))]
            mutant[first:last] = WORDS[int(rng.integers(len(WORDS)))]
        else:
            # headers are where the counts are
            place = at if rng.random() < 0.3 else int(rng.integers(min(len(mutant), 400)))
            field = FIELDS[int(rng.integers(len(FIELDS)))]
            mutant[place : place + len(field)] = field
        yield Case(seed.kind, seed.format, seed.name, f"{way} {index}", bytes(mutant))


def read_all(cases: list[Case], folder: Path, result: Path | None = None, seconds: float = SECONDS) -> list[Answer]:
    """What the readers make of the cases, in a process of its own; a crash of that process is an answer too."""
    listed = []
    for index, case in enumerate(cases):
        (folder / f"{index}").write_bytes(case.content)
        listed.append({"kind": case.kind, "format": case.format, "name": case.name, "how": case.how})
    (folder / "cases.json").write_text(json.dumps(listed))
    command = [sys.executable, __file__, str(folder), str(seconds), *([str(result)] if result else [])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    answers = [Answer(**json.loads(line)) for line in done.stdout.splitlines() if line.startswith("{")]
    if len(answers) < len(cases):
        lost = cases[len(answers)]
        answers.append(
            Answer(lost.format, lost.how, "crash", f"the process ended with {done.returncode}: {done.stderr[-500:]}", 0, 0)
        )
    return answers


def _reader(kind: str, name: str, folder: Path, result: Path | None):
    """The place of the file to be read, and what reads it."""
    from relax.files import load_result, load_scene
    from relax.files.heights import read_heights
    from relax.files.meshes import read_mesh

    if kind == "mesh":
        return folder / f"file{name}", read_mesh
    if kind == "heights":
        return folder / f"file{name}", read_heights
    if kind == "scene":
        np.save(folder / "hill.npy", bump())
        return folder / "file.toml", load_scene
    place = folder / "result"
    if not place.exists():
        place.mkdir()
    for other in ("result.json", "result.npz", "trace.npz"):
        (place / other).write_bytes((result / other).read_bytes())

    def load(_):
        stored = load_result(place)
        return stored.design() if name == "trace.npz" else stored

    return place / name, load


def _answer(case: dict, content: bytes, folder: Path, result: Path | None, limit: float) -> Answer:
    from relax.errors import InputError

    def too_long(*_):
        raise TimeoutError

    path, read = _reader(case["kind"], case["name"], folder, result)
    path.write_bytes(content)
    signal.signal(signal.SIGALRM, too_long)
    tracemalloc.reset_peak()
    before, began = tracemalloc.get_traced_memory()[0], time.process_time()
    signal.setitimer(signal.ITIMER_REAL, WAIT * limit)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read(path)
        outcome, words = "read", ""
    except InputError as error:
        words = str(error)
        outcome = "refused" if "\n" not in words and 10 < len(words) < 600 else "noise"
    except TimeoutError:
        outcome, words = "hang", ""
    except BaseException as error:
        outcome, words = "crash", f"{type(error).__name__}: {error}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    seconds = time.process_time() - began
    peak = tracemalloc.get_traced_memory()[1] - before - SHARE * len(content)
    if outcome in ("read", "refused"):
        outcome = "hang" if seconds > limit else "memory" if peak > PEAK else outcome
    return Answer(case["format"], case["how"], outcome, words, round(seconds, 4), peak)


def main() -> None:
    """Read the cases of a folder one by one and print an answer a line."""
    folder, limit, result = Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]) if len(sys.argv) > 3 else None
    resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE))
    tracemalloc.start()
    import meshio.vtu  # noqa: F401 - what libraries cost to import is no file's fault

    import relax.design.solve
    import relax.files.meshes  # noqa: F401 - the same

    for index, case in enumerate(json.loads((folder / "cases.json").read_text())):
        answer = _answer(case, (folder / str(index)).read_bytes(), folder, result, limit)
        sys.stdout.write(json.dumps(asdict(answer)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
