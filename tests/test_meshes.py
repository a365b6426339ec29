import meshio
import numpy as np
import pytest
from folders import mutations, refused, write

from relax.errors import InputError
from relax.files.meshes import read_mesh
from relax.membrane.mesh import mesh_from_faces

POINTS = np.array([[0, 0, 0.5], [1, 0, 0], [1, 1, 0.1], [0, 1, 0], [2, 0.5, 1 / 3]])
FACES = np.array([[0, 1, 2, 3], [1, 4, 2, -1]])
TRIANGLES = np.array([[0, 1, 2, -1], [0, 2, 3, -1], [1, 4, 2, -1]])


def refusal(path):
    return refused(lambda: read_mesh(path))


def by_meshio(path, faces=FACES, **options):
    blocks = [("quad", faces[faces[:, 3] >= 0]), ("triangle", faces[faces[:, 3] < 0][:, :3])]
    mesh = meshio.Mesh(POINTS, [(kind, cells.astype(np.int32)) for kind, cells in blocks if len(cells)])
    meshio.write(path, mesh, **options)
    return path


@pytest.mark.parametrize(
    ("name", "faces", "options"),
    [
        ("a.obj", FACES, {}),
        ("a.ply", FACES, {"binary": True}),
        ("a.ply", FACES, {"binary": False}),
        ("a.off", TRIANGLES, {}),
        ("a.vtk", FACES, {"file_format": "vtk42"}),
        ("a.vtk", FACES, {"file_format": "vtk42", "binary": False}),
        ("a.vtk", FACES, {"file_format": "vtk"}),
        ("a.vtk", FACES, {"file_format": "vtk", "binary": False}),
        ("a.vtu", FACES, {"binary": True}),
        ("a.vtu", FACES, {"binary": False}),
    ],
)
def test_what_meshio_writes_is_read(tmp_path, capfd, name, faces, options):
    positions, got = read_mesh(by_meshio(tmp_path / name, faces, **options))
    np.testing.assert_allclose(positions, POINTS, atol=1e-11)
    np.testing.assert_array_equal(got, faces)
    assert got.dtype == np.int64
    capfd.readouterr()
    read_mesh(tmp_path / name)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("binary", [True, False])
def test_stl_corners_are_merged_in_order_of_first_appearance(tmp_path, binary):
    path = by_meshio(tmp_path / "a.stl", TRIANGLES[[2, 0, 1]], binary=binary)
    positions, faces = read_mesh(path)
    np.testing.assert_allclose(positions, POINTS[[1, 4, 2, 0, 3]], atol=1e-7)
    np.testing.assert_array_equal(faces, [[0, 1, 2, -1], [3, 0, 2, -1], [3, 2, 4, -1]])


def test_obj_forms_that_meshio_gets_wrong(tmp_path):
    text = """# comment\r
mtllib a.mtl
o thing
v 0 0 0.5 1 0 0
v 1 0 0  # trailing comment
v 1 1 0.1
vt 0 0
vn 0 0 1
v 0 1 0
g first second
s off
usemtl x

f -4/1/1 -3/1/1 \\
  -2/1/1 -1/1/1
v 2 0.5 .3333333333333333
f 2//1 5//1 3//1
l 1 2
"""
    positions, faces = read_mesh(write(tmp_path, "A.OBJ", text))
    np.testing.assert_allclose(positions, POINTS, atol=1e-15)
    np.testing.assert_array_equal(faces, FACES)


def test_points_in_the_plane_get_no_height(tmp_path):
    positions, _ = read_mesh(write(tmp_path, "a.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n"))
    np.testing.assert_array_equal(positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nelement face 1\n"
    ply += "property list uchar int vertex_index\nend_header\n0 0\n1 0\n0 1\n3 0 1 2\n"
    np.testing.assert_array_equal(read_mesh(write(tmp_path, "a.ply", ply))[0], positions)


def test_off_with_quads_colours_and_comments(tmp_path):
    text = "OFF # c\n\n4 1 0\n0 0 0\n1 0 0\n1 1 0 # c\n0 1 0\n4  0 1 2 3  255 0 0\n"
    positions, faces = read_mesh(write(tmp_path, "a.off", text))
    np.testing.assert_array_equal(faces, [[0, 1, 2, 3]])
    assert len(positions) == 4
    text = "COFF\n3 1 0\n0 0 0 255 0 0 255\n1 0 0 255 0 0 255\n1 1 0 255 0 0 255\n3 0 1 2\n"
    np.testing.assert_array_equal(read_mesh(write(tmp_path, "a.off", text))[1], [[0, 1, 2, -1]])


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_with_more_than_corners(tmp_path, order):
    name = "little" if order == "<" else "big"
    header = f"""ply
format binary_{name}_endian 1.0
comment faces carry a colour, vertices one in front, and there are edges
element vertex 3
property uchar red
property double x
property double y
property double z
element face 2
property uchar red
property list uchar ushort vertex_index
property list uchar float texcoord
element edge 1
property int vertex1
property int vertex2
end_header
"""
    body = b"".join(
        np.array([(9, *point)], [("r", "u1"), ("p", f"{order}f8", 3)]).tobytes()
        for point in [((0, 0, 1),), ((1, 0, 2),), ((0, 1, 3),)]
    )
    for corners in ([0, 1, 2], [2, 1, 0]):
        body += b"\x07\x03" + np.array(corners, f"{order}u2").tobytes() + b"\x01" + np.array([0.5], f"{order}f4").tobytes()
    body += np.array([0, 1], f"{order}i4").tobytes()
    path = write(tmp_path, "a.ply", header.encode() + body)
    positions, faces = read_mesh(path)
    np.testing.assert_array_equal(positions, [[0, 0, 1], [1, 0, 2], [0, 1, 3]])
    np.testing.assert_array_equal(faces, [[0, 1, 2, -1], [2, 1, 0, -1]])
    assert "cut short" in refusal(write(tmp_path, "b.ply", path.read_bytes()[:-1]))
    assert "more data" in refusal(write(tmp_path, "b.ply", path.read_bytes() + b"x"))


def test_lines_and_points_beside_faces_are_skipped(tmp_path):
    cells = [("line", np.array([[0, 1]])), ("triangle", TRIANGLES[:, :3]), ("vertex", np.array([[0]]))]
    meshio.write(tmp_path / "a.vtu", meshio.Mesh(POINTS, cells))
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.vtu")[1], TRIANGLES)


OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 2 0\n"


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.obj", OBJ + "f 1 2 3 4 5\n", "face 0 has 5 corners: only triangles and quads"),
        ("a.obj", OBJ + "f 1 2\n", "face 0 has 2 corners"),
        ("a.obj", OBJ, "no faces"),
        ("a.obj", "", "no faces"),
        ("a.obj", OBJ + "f 1 2 9\n", "face 0 names vertex 8, but the mesh has vertices 0 to 4"),
        ("a.obj", OBJ + "f 0 2 3\n", "line 6: a face names vertex 0, but OBJ counts vertices from 1"),
        ("a.obj", OBJ + "f 1 -6 3\n", "line 6: a face counts back beyond the first vertex"),
        ("a.obj", OBJ + "f 1 x 3\n", 'line 6: "x" is not a whole number'),
        ("a.obj", OBJ + "q 1 2 3\n", 'line 6: unknown statement "q"'),
        (
            "a.obj",
            "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            "vertex 0 is at [0.0, 0.0, nan]: every coordinate must be a finite number",
        ),
        ("a.obj", "v 0 0 1e999\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 0 is at"),
        ("a.obj", "v 0\nf 1 1 1\n", "line 1: expected three coordinates"),
        ("a.obj", "v 0 0 0 2\n", "line 1: a vertex with a weight"),
        ("a.off", "NO\n", 'expected the first word to be "OFF"'),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n", "announces 3 vertices and 1 faces, but 3 lines follow"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "line 6: a face of 3 corners names 2"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "face 0 names vertex -1"),
        ("a.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", 'does not end with "endsolid"'),
        ("a.stl", b"\0" * 84 + b"x", "do not fit"),
        ("a.stl", b"\0" * 84, "no faces"),
        ("a.ply", "ply\nformat ascii 1.0\n", "expected a PLY header"),
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty complex x\nend_header\n",
            'a line that PLY does not know: "property',
        ),
        ("a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\n", "it holds POLYDATA, expected UNSTRUCTURED_GRID"),
        ("a.vtk", "rubbish", "no dataset"),
        ("a.vtu", "<VTKFile><Piece/></VTKFile>", "this is not a VTU file that can be read"),
        ("a.vtu", "rubbish", "it holds 0 pieces"),
        ("a.vtp", "", '".vtp" is no mesh format that is read here; possible: .obj'),
    ],
)
def test_bad_files_get_one_sentence(tmp_path, capfd, name, content, sentence):
    assert sentence in refusal(write(tmp_path, name, content))
    assert capfd.readouterr() == ("", "")


def test_missing_files_and_folders(tmp_path):
    assert "no such file" in refusal(tmp_path / "a.obj")
    (tmp_path / "b.obj").mkdir()
    assert "this is a folder" in refusal(tmp_path / "b.obj")


def test_a_vtu_in_pieces_is_refused_since_meshio_drops_all_but_the_last(tmp_path):
    text = by_meshio(tmp_path / "a.vtu", binary=False).read_text()
    start, stop = text.index("<Piece"), text.index("</Piece>") + len("</Piece>")
    assert "it holds 2 pieces" in refusal(write(tmp_path, "b.vtu", text[:stop] + text[start:stop] + text[stop:]))


def test_solids_are_no_membrane(tmp_path):
    meshio.write(tmp_path / "a.vtu", meshio.Mesh(POINTS, [("tetra", np.array([[0, 1, 2, 3]]))]))
    assert "cells of the kind tetra" in refusal(tmp_path / "a.vtu")


def test_a_legacy_vtk_cut_short_is_noticed(tmp_path):
    content = by_meshio(tmp_path / "a.vtk", file_format="vtk42", binary=False).read_bytes()
    whole = len(content.rstrip())
    for length in range(20, whole):
        try:
            positions, faces = read_mesh(write(tmp_path, "b.vtk", content[:length]))
        except InputError:
            continue
        pytest.fail(f"{length} of {whole} bytes gave {len(positions)} vertices and {len(faces)} faces")


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.obj", {}),
        ("a.off", {}),
        ("a.stl", {"binary": True}),
        ("a.stl", {"binary": False}),
        ("a.ply", {"binary": True}),
        ("a.ply", {"binary": False}),
        ("a.vtk", {"file_format": "vtk42", "binary": False}),
        ("a.vtk", {"file_format": "vtk", "binary": True}),
        ("a.vtu", {"binary": True}),
        ("a.vtu", {"binary": False}),
    ],
)
def test_damaged_files_end_in_a_mesh_or_one_sentence(tmp_path, capfd, name, options):
    content = by_meshio(tmp_path / name, TRIANGLES, **options).read_bytes()
    capfd.readouterr()
    for mutant in mutations(content, 120, seed=len(name) + len(content)):
        path = write(tmp_path, f"mutant{name[1:]}", mutant)
        try:
            positions, faces = read_mesh(path)
            assert np.isfinite(positions).all() and faces.max() < len(positions) and faces[:, :3].min() >= 0
            mesh_from_faces(len(positions), faces)
        except InputError as error:
            assert "\n" not in str(error)
    assert capfd.readouterr() == ("", "")
