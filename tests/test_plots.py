"""The picture shows what is there: membrane, wanted shape, supports of each kind; and things hide what is behind them."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from relax.arrays import Floats
from relax.design.masts import standing_masts
from relax.files.schema import resolve
from relax.membrane.mesh import grid_mesh
from relax.membrane.scene import Scene, build_scene
from relax.plots.perspective import cut_lines, face_patches, line_patches, paint, place_camera, slice_surface
from relax.plots.picture import draw_picture
from relax.plots.style import MAST, STAY, TIE_DOWN


def grid_scene(diagonals: str = "alternating", unit: float = 1.0, fixed: str = "boundary") -> Scene:
    """A shallow dome over 9 x 7 vertices, `unit` metres apart."""
    row, column = np.indices((9, 7))
    height = 0.5 * np.sin(np.pi * row / 8) * np.sin(np.pi * column / 6)
    target = unit * np.column_stack([column.ravel(), row.ravel(), height.ravel()]).astype(float)
    settings = resolve({"title": "Dome", "target": {"mesh": "dome.obj"}, "supports": {"fixed": fixed, "ground": -unit}})
    return build_scene(settings, grid_mesh(9, 7, diagonals), target, None)


def design(scene: Scene, forces: dict[int, tuple[float, float, float]], lift: float = 0.1) -> SimpleNamespace:
    """What `draw_picture` reads of a design: the shape is the wanted one, lifted at its free vertices."""
    size = float(np.ptp(scene.target))
    positions = scene.target + lift * size * np.array([0.0, 0.0, 1.0]) * ~scene.fixed[:, None]
    whole = np.zeros_like(positions)
    for vertex, force in forces.items():
        whole[vertex] = force
    return SimpleNamespace(
        problem=SimpleNamespace(scene=scene),
        positions=positions,
        forces=whole,
        certificate=SimpleNamespace(rms_distance=lift * size, converged=True),
        supports=standing_masts(positions, whole, scene.ground),
    )


def drawn(case: SimpleNamespace, folder: Path) -> Floats:
    draw_picture(case, folder / "picture.png")
    with Image.open(folder / "picture.png") as image:
        assert image.format == "PNG"
        assert image.size == (2100, 990)
        return np.asarray(image.convert("RGB")) / 255.0


def coloured(pixels: Floats, colour: tuple[float, ...]) -> int:
    return int((np.abs(pixels - colour[:3]).max(axis=-1) < 0.03).sum())


@pytest.mark.parametrize("diagonals", ["alternating", "none", "both"])
def test_a_picture_without_supports(diagonals, tmp_path):
    pixels = drawn(design(grid_scene(diagonals), {}), tmp_path)
    left, right = pixels[200:780, :1100], pixels[130:730, 1230:1730]
    assert left.std() > 0.05
    assert right.std() > 0.05
    assert coloured(pixels, TIE_DOWN) == 0
    assert coloured(pixels, STAY) == 0


def test_each_kind_of_support_has_its_colour(tmp_path):
    scene = grid_scene()
    nothing = drawn(design(scene, {}), tmp_path)
    for force, colour in (((0.1, 0, 1), MAST), ((0, 0.1, -1), TIE_DOWN), ((1, 0, 0), STAY)):
        pixels = drawn(design(scene, {31: force}), tmp_path)
        assert coloured(pixels, colour) > coloured(nothing, colour) + 100


@pytest.mark.parametrize("unit", [1e-6, 1e5])
def test_tiny_and_huge_scenes_look_like_any_other(unit, tmp_path):
    forces = {31: (0.0, 0.0, 1.0), 24: (0.0, 0.0, -1.0)}
    usual = drawn(design(grid_scene(), forces), tmp_path)[200:780, 260:1100]
    other = drawn(design(grid_scene(unit=unit), forces), tmp_path)[200:780, 260:1100]
    assert np.abs(usual - other).mean() < 0.02


def test_a_foot_far_away_does_not_shrink_the_rest(tmp_path):
    scene = grid_scene()
    upright = drawn(design(scene, {31: (0.0, 0.0, 1.0)}), tmp_path)
    flat = drawn(design(scene, {31: (1.0, 0.0, 1e-6)}), tmp_path)
    paper = [int((pixels[200:780, :1100].min(axis=-1) < 0.99).sum()) for pixels in (upright, flat)]
    assert paper[1] > 0.5 * paper[0]


def test_corners_alone_fixed_a_shape_on_target_and_forty_supports(tmp_path):
    scene = grid_scene("none", fixed="corners")
    drawn(design(scene, {}, lift=0.0), tmp_path)
    drawn(design(scene, {vertex: (0.0, 0.1, 1.0) for vertex in range(10, 50)}), tmp_path)
    flat = grid_scene()
    flat = replace(flat, target=flat.target * [1, 1, 0], clean_target=flat.target * [1, 1, 0])
    drawn(design(flat, {}, lift=0.0), tmp_path)


def test_a_flat_scene_on_the_ground_without_supports(tmp_path):
    flat = grid_scene()
    flat = replace(flat, target=flat.target * [1, 1, 0], clean_target=flat.target * [1, 1, 0])
    flat.settings["supports"]["ground"] = 0.0
    drawn(design(flat, {}, lift=0.0), tmp_path)


def test_the_title_says_when_a_run_did_not_converge(tmp_path):
    case = design(grid_scene(), {})
    usual = drawn(case, tmp_path)
    case.certificate.converged = False
    assert not np.array_equal(drawn(case, tmp_path)[:80], usual[:80])


def test_drawing_leaves_pyplot_and_its_global_state_alone():
    code = "import sys, relax.plots.picture; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def painted(strut_depth: float) -> int:
    """Red pixels of a line in front of (positive) or behind (negative) a grey square that the camera sees head-on."""
    camera = place_camera(np.array([0.0, -1.0, -1.0]), np.array([0.0, 1.0, 1.0]), 0.0, 0.0)
    square = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], dtype=float)
    figure = Figure(figsize=(1, 1), dpi=50)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_xlim(-1.2, 1.2)
    axes.set_ylim(-1.2, 1.2)
    line = line_patches(*cut_lines(np.array([[strut_depth, 0, -0.5]]), np.array([[strut_depth, 0, 0.5]]), 8), (1, 0, 0, 1), 3.0)
    paint(axes, camera, [line, face_patches(square, np.array([[0, 1, 2, 3]]), np.array([[0.5, 0.5, 0.5, 1.0]]))])
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3] / 255.0
    return coloured(pixels, (1.0, 0.0, 0.0))


def test_a_face_hides_what_is_behind_it_and_nothing_else():
    assert painted(0.2) > 10
    assert painted(-0.2) == 0


def test_the_camera_centres_the_box_and_near_things_are_larger():
    camera = place_camera(np.array([-1.0, -2.0, 0.0]), np.array([3.0, 2.0, 2.0]), -62.0, 26.0)
    place, depth = camera.project(np.array([1.0, 0.0, 1.0]))
    np.testing.assert_allclose([*place, depth], 0.0, atol=1e-12)
    axes = np.array([camera.right, camera.up, camera.towards])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    near, far = (camera.project(camera.centre + camera.right + step * camera.towards)[0][0] for step in (1.0, -1.0))
    assert near > 1.0 > far


def test_slices_lie_in_their_plane_and_on_the_surface():
    points = np.array([[0, 0, 0], [2, 0, 2], [0, 2, 4], [2, 2, 6]], dtype=float)  # the plane z = x + 2 y
    starts, ends = slice_surface(points, np.array([[0, 1, 2], [1, 3, 2]]), 0, 0.5)
    both = np.vstack([starts, ends])
    np.testing.assert_allclose(both[:, 0], 0.5)
    np.testing.assert_allclose(both[:, 2], both[:, 0] + 2 * both[:, 1])
    assert np.linalg.norm(ends - starts, axis=1).sum() == pytest.approx(2 * np.sqrt(5))
    assert len(slice_surface(points, np.array([[0, 1, 2]]), 0, 9.0)[0]) == 0
