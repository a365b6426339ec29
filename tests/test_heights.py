import io
import os
import struct
import zipfile
import zlib

import numpy as np
import pytest
from folders import mutations, refused, write
from PIL import Image

from relax.errors import InputError
from relax.files import heights as module
from relax.files.heights import read_heights

Z = np.array([[0.0, 1.5, -2.0], [3.25, 4.0, 5.0]])


def refusal(path):
    return refused(lambda: read_heights(path))


def saved(save, *arguments, **options):
    stream = io.BytesIO()
    save(stream, *arguments, **options)
    return stream.getvalue()


def picture(array, kind="PNG", **options):
    return saved(Image.fromarray(np.asarray(array)).save, format=kind, **options)


ASC = "NCOLS 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 0.5\nNODATA_value -1\n3.25 4 5\n0 1.5 -2\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.npy", saved(np.save, Z)),
        ("a.npy", saved(np.save, np.asfortranarray(Z))),
        ("a.npy", saved(np.save, Z.astype(">f4"))),
        ("a.npz", saved(np.savez, other=np.zeros(3), z=Z)),
        ("a.npz", saved(np.savez_compressed, z=Z)),
        ("a.csv", "0,1.5,-2\n3.25, 4 ,5\n"),
        ("a.csv", "\ufeff# a comment\r\n0,1.5,-2\r\n\r\n3.25,4,5"),
        ("a.txt", "0 1.5\t-2\n  3.25 4e0 5\n"),
        ("a.TIF", picture(Z[::-1].astype(np.float32), "TIFF")),
    ],
)
def test_each_format_gives_the_same_heights(tmp_path, name, content):
    heights, spacing = read_heights(write(tmp_path, name, content))
    np.testing.assert_array_equal(heights, Z)
    assert heights.dtype == np.float64 and spacing is None


def test_an_esri_grid_is_flipped_and_says_its_spacing(tmp_path):
    heights, spacing = read_heights(write(tmp_path, "a.asc", ASC))
    np.testing.assert_array_equal(heights, Z)
    assert spacing == (0.5, 0.5)
    wrapped = ASC.replace("3.25 4 5\n0", "3.25\n4 5 0")
    np.testing.assert_array_equal(read_heights(write(tmp_path, "a.asc", wrapped))[0], Z)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", ["png", "tif", "tiff"])
def test_pictures_give_raw_values_and_are_flipped(tmp_path, kind, suffix):
    raw = np.array([[0, 1, 2], [200, np.iinfo(kind).max, 7]], dtype=kind)
    heights, spacing = read_heights(write(tmp_path, f"a.{suffix}", picture(raw, "PNG" if suffix == "png" else "TIFF")))
    np.testing.assert_array_equal(heights, raw[::-1])
    assert spacing is None


def test_wide_integer_tiff(tmp_path):
    raw = np.array([[-5, 70000], [1, 2]], dtype=np.int32)
    np.testing.assert_array_equal(read_heights(write(tmp_path, "a.tif", picture(raw, "TIFF")))[0], raw[::-1])


class Trap:
    """What unpickling this does is raise."""

    def __reduce__(self):
        return (pytest.fail, ("a pickle was loaded",))


def png_header(width, height):
    """A PNG that announces a size and holds next to nothing."""

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    pixels = zlib.compress(b"\0" * 1000)
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def npy_header(shape, kind="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue()


NAN = np.array([[0.0, 1.0], [2.0, np.nan]])


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.npy", saved(np.save, Z[:1]), "it has 1 rows and 3 columns: a height field needs at least 2 of each"),
        ("a.npy", saved(np.save, Z[:, :1]), "it has 2 rows and 1 columns"),
        ("a.csv", "1,2,3\n", "it has 1 rows and 3 columns"),
        ("a.txt", "1\n2\n", "it has 2 rows and 1 columns"),
        ("a.npy", saved(np.save, np.zeros(3)), "it has 1 dimensions (3), expected two"),
        ("a.npy", saved(np.save, np.float64(3)), "it has 0 dimensions (a single number)"),
        ("a.npy", saved(np.save, np.zeros((2, 2, 2))), "it has 3 dimensions (2 x 2 x 2)"),
        ("a.npy", saved(np.save, NAN), "row 1, column 1 is nan: every height must be a finite number"),
        ("a.npy", saved(np.save, np.where(np.isnan(NAN), np.inf, NAN)), "row 1, column 1 is inf"),
        ("a.csv", "1,2\n3,nan\n", "row 1, column 1 is nan"),
        ("a.tif", picture(NAN.astype(np.float32), "TIFF"), "row 1, column 1 is nan"),
        ("a.npy", saved(np.save, np.array([[Trap(), 1], [2, 3]], dtype=object), allow_pickle=True), "pickled objects"),
        ("a.npz", saved(np.savez, z=np.array([[Trap(), 1], [2, 3]], dtype=object), allow_pickle=True), "pickled objects"),
        ("a.npy", b"\x80\x04cos\nsystem\n.", "this is no array in numpy's format"),
        ("a.npy", b"", "this is no array in numpy's format"),
        ("a.npy", saved(np.save, Z)[:-1], "announces 48 bytes of numbers, but 47 follow: it is cut short"),
        ("a.npy", saved(np.save, Z.astype(complex)), "expected real numbers"),
        ("a.npy", saved(np.save, Z > 0), "expected real numbers"),
        ("a.npy", npy_header((40_000, 40_000)), "it has 40,000 x 40,000 samples, more than the 4,000,000"),
        ("a.npz", saved(np.savez, height=Z), "it has no array z; it has height"),
        ("a.npz", saved(np.savez, z=Z)[:-30], "this is no archive"),
        ("a.csv", "1,2\n3\n", "line 2 has 1 numbers, the first has 2"),
        ("a.csv", "1,2\n\n3,4,5\n", "line 3 has 3 numbers, the first has 2"),
        ("a.csv", "1,2\n3,x\n", 'line 2, column 1: "x" is not a number: expected numbers parted by commas'),
        ("a.csv", "1 2\n3 4\n", 'line 1, column 0: "1 2" is not a number: expected numbers parted by commas'),
        ("a.txt", "1,2\n3,4\n", 'line 1, column 0: "1,2" is not a number: expected numbers parted by blanks'),
        ("a.csv", "", "it holds no numbers"),
        ("a.csv", "# nothing\n", "it holds no numbers"),
        ("a.csv", b"1,\xff\n", "byte 2 is no text"),
        ("a.asc", ASC.replace("3.25", "-1"), "row 0, column 0 is -1, the mark of a sample without data (1 in all)"),
        (
            "a.asc",
            ASC.replace("NODATA_value -1\n", "").replace("3.25", "-9999"),
            "row 0, column 0 is -9999, the mark of a sample",
        ),
        ("a.asc", ASC.replace(" -2\n", "\n"), "its header announces 2 rows of 3 heights, but 5 follow"),
        ("a.asc", ASC + " 7 8", "its header announces 2 rows of 3 heights, but more follow"),
        ("a.asc", ASC.replace("cellsize 0.5\n", ""), "its header lacks cellsize"),
        ("a.asc", ASC.replace("cellsize 0.5", "dx 0.5"), 'its header has the word "dx"'),
        ("a.asc", ASC.replace("cellsize 0.5", "cellsize x"), 'its header has cellsize = "x"'),
        ("a.asc", ASC.replace("cellsize 0.5", "cellsize 0"), "cellsize = 0: expected numbers above 0"),
        ("a.asc", ASC.replace("4 5", "4 y"), '"y" is not a number'),
        ("a.asc", ASC.replace("4 5", "4 nan"), "row 0, column 2 is nan"),
        ("a.asc", "ncols", "its header has ncols"),
        ("a.asc", ASC.replace("NCOLS 3", "NCOLS 40000").replace("nrows 2", "nrows 40000"), "it has 40,000 x 40,000 samples"),
        ("a.png", png_header(40_000, 40_000), "many more pixels than the 4,000,000"),
        ("a.png", png_header(9_000, 10_000), "many more pixels than the 4,000,000"),
        ("a.png", png_header(2_000, 3_000), "it has 3,000 x 2,000 samples, more than the 4,000,000"),
        ("a.png", png_header(2_000, 1_000), "the picture is damaged or cut short"),
        ("a.png", picture(np.zeros((4, 4, 3), np.uint8)), "a picture of the kind RGB, expected one channel"),
        ("a.png", picture(np.zeros((4, 4, 4), np.uint8)), "a picture of the kind RGBA"),
        ("a.png", saved(Image.new("P", (4, 4)).save, format="PNG"), "a picture of the kind P"),
        ("a.png", saved(Image.new("1", (4, 4)).save, format="PNG"), "a picture of the kind 1"),
        ("a.png", b"rubbish", "this is no PNG or TIFF picture"),
        ("a.mat", b"", '".mat" is no height field that is read here'),
    ],
)
def test_bad_files_get_one_sentence(tmp_path, capfd, name, content, sentence):
    assert sentence in refusal(write(tmp_path, name, content))
    assert capfd.readouterr() == ("", "")


def test_grey_levels_that_pillow_would_stretch_are_refused(tmp_path):
    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = zlib.compress(b"\0\x1b" * 4)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 2, 0, 0, 0, 0))
    content = b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    assert "packed or inverted" in refusal(write(tmp_path, "a.png", content))


def test_several_pictures_in_one_file_are_refused(tmp_path):
    frames = [Image.fromarray(Z.astype(np.float32)) for _ in range(2)]
    content = saved(frames[0].save, format="TIFF", save_all=True, append_images=frames[1:])
    assert "it holds 2 pictures" in refusal(write(tmp_path, "a.tif", content))


def test_nodata_of_a_tiff_is_refused(tmp_path):
    content = picture(Z.astype(np.float32), "TIFF", tiffinfo={42113: "-2"})
    assert "row 0, column 2 is -2, the mark of a sample without data" in refusal(write(tmp_path, "a.tif", content))


def test_too_many_samples_in_text_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MOST_SAMPLES", 8)
    assert "more than the 8 that are read" in refusal(write(tmp_path, "a.csv", "1,2\n" * 5))
    assert read_heights(write(tmp_path, "a.csv", "1,2\n" * 4))[0].shape == (4, 2)
    monkeypatch.setattr(module, "MOST_TEXT", 10)
    assert "larger than 10 bytes" in refusal(write(tmp_path, "a.csv", "1,2\n" * 4))


def test_arrays_and_pictures_are_judged_by_their_header_before_they_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "read_bytes", lambda *_: pytest.fail("all of the file was read"))
    path = write(tmp_path, "a.npy", npy_header((40_000, 40_000)))
    os.truncate(path, 12_800_000_128)  # a hole: takes no room on the disk
    assert "it has 40,000 x 40,000 samples" in refusal(path)
    path.unlink()


def test_missing_files_and_folders(tmp_path):
    assert "no such file" in refusal(tmp_path / "a.npy")
    (tmp_path / "b.csv").mkdir()
    assert "this is a folder" in refusal(tmp_path / "b.csv")


def test_an_archive_that_unpacks_to_far_more_than_it_announces_is_not_unpacked(tmp_path):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("z.npy", saved(np.save, Z) + b"\0" * 50_000_000)
    np.testing.assert_array_equal(read_heights(write(tmp_path, "a.npz", stream.getvalue()))[0], Z)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.npy", saved(np.save, Z)),
        ("a.npz", saved(np.savez_compressed, z=Z)),
        ("a.csv", b"0,1.5,-2\n3.25,4,5\n"),
        ("a.txt", b"0 1.5 -2\n3.25 4 5\n"),
        ("a.asc", ASC.encode()),
        ("a.png", picture((Z * 10).astype(np.uint8))),
        ("a.tif", picture(Z.astype(np.float32), "TIFF")),
        ("a.tif", picture(Z.astype(np.float32), "TIFF", compression="tiff_lzw")),
    ],
)
def test_damaged_files_end_in_heights_or_one_sentence(tmp_path, capfd, name, content):
    for mutant in mutations(content, 200, seed=len(content)):
        try:
            heights, _ = read_heights(write(tmp_path, name, mutant))
            assert heights.ndim == 2 and np.isfinite(heights).all()
        except InputError as error:
            assert "\n" not in str(error)
    assert capfd.readouterr() == ("", "")
