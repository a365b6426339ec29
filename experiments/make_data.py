"""Make every made file of data/: the planted tents, the bumps, the pavilion and the terrain.

Question: from which formulas, forces and sources do the meshes and height fields of data/ come, and can anybody make them again?

    python experiments/make_data.py                     writes data/ anew
    python experiments/make_data.py --output FOLDER     writes the same files elsewhere, for comparison

The scene files (data/*.toml) are written by hand; stiffness and prestress of the planted scenes are read from them, so that a
planted shape always belongs to its scene. Everything is deterministic: the one generator of random numbers has its seed here.

Finding: a second run leaves data/ as it is, byte for byte; tests/test_data.py compares the contents on other machines. The
planted shapes are in equilibrium with their forces to 1e-12 of the largest tension, and every edge of theirs is taut.
"""

import argparse
import csv
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import Delaunay

from relax.arrays import Floats, Ints
from relax.files.schema import resolve
from relax.membrane.equilibrium import find_equilibrium
from relax.membrane.mesh import Mesh, grid_mesh, mesh_from_faces
from relax.membrane.scene import Scene, build_scene

DATA = Path(__file__).resolve().parent.parent / "data"

TENT_SIDE = 21  # vertices along a side of the unit square
TENT_FORCES = {181: (0.04, -0.02, 0.3)}  # newtons; vertex 181 is row 8, column 13: x = 0.65, y = 0.40

FIVE_MASTS_SEED = 5
FIVE_MASTS_SPACING = 0.62  # metres between neighbouring vertices
FIVE_MASTS_FORCES = (  # where in plan, metres, and the force, newtons
    ((3.9, 1.5), (150.0, 90.0, 1300.0)),
    ((0.1, -0.2), (-80.0, 160.0, 1600.0)),
    ((-3.6, -2.0), (-220.0, -60.0, 1200.0)),
    ((-2.2, 2.4), (80.0, -120.0, -900.0)),
    ((2.2, -2.6), (130.0, -90.0, -1000.0)),
)

SCALLOPED_SIDE = 23  # vertices along a side
SCALLOPED_HALF = 6.0  # metres from the middle to a side of the square of the corners
SCALLOPED_SAG = 0.16  # of that: how far the middle of each side is drawn in
SCALLOPED_FORCES = (  # where in plan, metres, and the force, newtons
    ((-1.5, -1.5), (40.0, -60.0, 900.0)),
    ((1.9, 1.4), (60.0, 30.0, 700.0)),
)

SAIL_SIDE = 19  # vertices along a side
SAIL_HALF = 5.0  # metres from the middle to a side of the square of the corners
SAIL_SAG = 0.16  # of that, as above
SAIL_PULL = 6000.0  # newtons by which each corner is pulled out, along x and along y
# newtons upwards: in the middle, at two opposite corners, at the two others
SAIL_UP, SAIL_HIGH, SAIL_LOW = 1600.0, -200.0, -600.0

BUMPS_SIDE = 26  # samples along a side of the unit square
BUMPS = ((0.28, 0.30, 0.24, 0.16), (0.72, 0.38, 0.22, 0.20), (0.44, 0.74, 0.22, 0.18))  # x, y, radius, height of each cap

PAVILION_RINGS, PAVILION_SPOKES = 12, 48

TERRAIN_CELL = 250.0  # metres
TERRAIN_SHAPE = (30, 36)  # rows, columns
TERRAIN_CORNER = (140, 120)  # sample of the source that becomes the north-west corner
TERRAIN_BLUR = 2.0  # source samples: half of the new spacing is 1.4 of them, so that nothing folds back into longer waves
METRES_PER_DEGREE = 111_132.95  # of latitude, at 45 degrees on WGS 84; within 0.1 % here


@dataclass(frozen=True)
class Planted:
    """A membrane, its flat shape (V, 3), the forces put on it (V, 3) newtons and the shape they gave (V, 3) metres."""

    mesh: Mesh
    flat: Floats
    forces: Floats
    shape: Floats


def planting_scene(name: str, mesh: Mesh, flat: Floats, rim: Floats) -> Scene:
    """Build the membrane of data/`name`.toml on the flat mesh, its fixed vertices where `rim` (V, 3) has them."""
    settings = resolve(tomllib.loads((DATA / f"{name}.toml").read_text(encoding="utf-8")), name)
    return build_scene(settings, mesh, rim, flat)


def plant(scene: Scene, flat: Floats, forces: Floats) -> Planted:
    """Find the shape that `forces` (V, 3) give the membrane: a target whose supports are known."""
    found = find_equilibrium(scene.membrane, scene.start, forces[~scene.fixed])
    if not found.found:
        raise RuntimeError(f"no equilibrium under the planted forces: {found.stop}")
    return Planted(scene.mesh, flat, forces, found.positions)


def tent() -> Planted:
    """One mast, off-centre and leaning a little, under a unit square whose flat edge is fixed."""
    mesh = grid_mesh(TENT_SIDE, TENT_SIDE, "alternating")
    flat = square_grid(np.zeros((TENT_SIDE, TENT_SIDE)), 1.0 / (TENT_SIDE - 1))
    forces = np.zeros_like(flat)
    for vertex, force in TENT_FORCES.items():
        forces[vertex] = force
    return plant(planting_scene("tent", mesh, flat, flat), flat, forces)


def square_grid(heights: Floats, spacing: float) -> Floats:
    """Vertices (rows * columns, 3) of a height field."""
    row, column = np.indices(heights.shape)
    return np.column_stack([column.ravel() * spacing, row.ravel() * spacing, heights.ravel()])


def outline_radius(angle: Floats) -> Floats:
    """Outline of five-masts in polar coordinates, metres: an egg with a dent."""
    return 6.0 * (1.0 + 0.16 * np.cos(2 * angle - 0.5) + 0.08 * np.cos(3 * angle + 1.0))


def outline_points(spacing: float) -> Floats:
    """Points (k, 2) on the outline of five-masts, as far apart along it as a whole number of `spacing` allows."""
    angle = np.linspace(0.0, 2 * np.pi, 4001)
    curve = outline_radius(angle)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    count = round(along[-1] / spacing)
    at = np.interp(np.arange(count) * along[-1] / count, along, angle)
    return outline_radius(at)[:, None] * np.column_stack([np.cos(at), np.sin(at)])


def irregular_triangulation() -> tuple[Floats, Ints]:
    """Delaunay triangles of a jittered hexagonal lattice inside the outline: points (V, 2) and faces (F, 4)."""
    step = FIVE_MASTS_SPACING
    row, column = np.indices((40, 40)) - 20
    lattice = step * np.column_stack([(column + 0.5 * (row % 2)).ravel(), (np.sqrt(0.75) * row).ravel()])
    lattice += np.random.default_rng(FIVE_MASTS_SEED).uniform(-0.22, 0.22, lattice.shape) * step
    room = outline_radius(np.arctan2(lattice[:, 1], lattice[:, 0])) - np.linalg.norm(lattice, axis=1)
    points = np.vstack([outline_points(step), lattice[room > 0.6 * step]])
    faces = Delaunay(points).simplices
    middle = points[faces].mean(axis=1)
    # Delaunay fills the convex hull; the dents of the outline are not membrane
    faces = faces[np.linalg.norm(middle, axis=1) < outline_radius(np.arctan2(middle[:, 1], middle[:, 0]))]
    one, other = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    clockwise = one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]
    faces[clockwise] = faces[clockwise][:, ::-1]
    # each triangle starts at its lowest vertex and triangles ascend, so the order does not hang on the library's version
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    return points, np.column_stack([faces, np.full(len(faces), -1)])


def five_masts() -> Planted:
    """Five leaning supports, three that push and two that pull, under an irregular mesh with a curved, wavy rim."""
    points, faces = irregular_triangulation()
    mesh = mesh_from_faces(len(points), faces)
    flat = np.column_stack([points, np.full(len(points), 3.0)])
    rim = flat.copy()
    rim[:, 2] += 0.5 * np.cos(2 * np.arctan2(points[:, 1], points[:, 0]))
    forces = np.zeros_like(flat)
    for place, force in FIVE_MASTS_FORCES:
        forces[np.argmin(np.linalg.norm(points - place, axis=1))] = force
    return plant(planting_scene("five-masts", mesh, flat, rim), flat, forces)


def drawn_in(side: int, sag: float) -> tuple[Floats, Floats, Floats, Floats]:
    """A square of side 2 whose sides are parabolas drawn in by `sag`: u, v of each vertex before, and x, y after."""
    u, v = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-1.0, 1.0, side)] * 2))
    return u, v, u * (1.0 - sag * (1.0 - v**2)), v * (1.0 - sag * (1.0 - u**2))


def sail() -> Planted:
    """A sail that touches no building: pulled out and down at four corners, two of them more, over a mast in the middle."""
    u, v, x, y = drawn_in(SAIL_SIDE, SAIL_SAG)
    flat = np.column_stack([SAIL_HALF * x, SAIL_HALF * y, np.full(u.size, 4.0)])
    forces = np.zeros_like(flat)
    corners = np.flatnonzero(np.abs(u * v) == 1)
    forces[corners, :2] = SAIL_PULL * np.column_stack([u, v])[corners]
    forces[corners, 2] = np.where((u * v)[corners] > 0, SAIL_HIGH, SAIL_LOW)
    forces[u.size // 2, 2] = SAIL_UP
    mesh = grid_mesh(SAIL_SIDE, SAIL_SIDE, "alternating")
    return plant(planting_scene("sail", mesh, flat, flat), flat, forces)


def scalloped() -> Planted:
    """Two masts under a roof that hangs from four corners, two high and two low, by cables along its free, drawn-in sides."""
    u, v, x, y = drawn_in(SCALLOPED_SIDE, SCALLOPED_SAG)
    flat = np.column_stack([SCALLOPED_HALF * x, SCALLOPED_HALF * y, np.full(u.size, 3.5)])
    rim = flat.copy()
    rim[:, 2] += 1.5 * u * v
    forces = np.zeros_like(flat)
    for place, force in SCALLOPED_FORCES:
        forces[np.argmin(np.linalg.norm(flat[:, :2] - place, axis=1))] = force
    mesh = grid_mesh(SCALLOPED_SIDE, SCALLOPED_SIDE, "alternating")
    return plant(planting_scene("scalloped", mesh, flat, rim), flat, forces)


def bumps() -> Floats:
    """Three convex caps on a flat unit square: at each sample the highest of h (1 - d^2 / r^2) and 0, metres."""
    x, y = np.meshgrid(*[np.linspace(0.0, 1.0, BUMPS_SIDE)] * 2)
    caps = [height * (1.0 - ((x - u) ** 2 + (y - v) ** 2) / radius**2) for u, v, radius, height in BUMPS]
    return np.maximum(np.max(caps, axis=0), 0.0)


def pavilion() -> tuple[Floats, Ints]:
    """Lay a star wave over a polar grid, metres: vertices (V, 3) and faces (F, 4), triangles round the centre, quads outside.

    With s = distance from the centre / distance of the rim there, z = 5 + 2 w(s) cos(6 a), where w rises from 0 at the centre
    to 1 on the crest s = 2/3 and falls to 1/2 at the rim, both along half waves; the rim is a star of radius 10 + cos(6 a).
    """
    angle = 2 * np.pi * np.arange(PAVILION_SPOKES) / PAVILION_SPOKES
    share = np.repeat(np.arange(1, PAVILION_RINGS + 1) / PAVILION_RINGS, PAVILION_SPOKES)
    turn = np.tile(angle, PAVILION_RINGS)
    radius = share * (10.0 + np.cos(6 * turn))
    crest = 2.0 / 3.0
    rising = np.sin(0.5 * np.pi * share / crest) ** 2
    falling = 0.75 + 0.25 * np.cos(np.pi * (share - crest) / (1.0 - crest))
    height = 5.0 + 2.0 * np.where(share <= crest, rising, falling) * np.cos(6 * turn)
    vertices = np.vstack([[0.0, 0.0, 5.0], np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])])
    ring = 1 + np.arange(PAVILION_RINGS * PAVILION_SPOKES).reshape(PAVILION_RINGS, PAVILION_SPOKES)
    after = np.roll(ring, -1, axis=1)
    fan = np.column_stack([np.zeros(PAVILION_SPOKES, dtype=int), ring[0], after[0], np.full(PAVILION_SPOKES, -1)])
    quads = np.stack([ring[:-1], ring[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    return vertices, np.vstack([fan, quads])


def terrain() -> Floats:
    """Heights (rows, columns) in metres, row 0 in the north: a piece of the Jacksboro fault, smoothed, on square cells."""
    from matplotlib.cbook import get_sample_data  # only this one file needs it

    source = get_sample_data("jacksboro_fault_dem.npz")
    smooth = gaussian_filter(source["elevation"].astype(float), TERRAIN_BLUR)
    # the file's ymin is the latitude of its first row, the northern edge; dx and dy are degrees
    north = float(source["ymin"]) - TERRAIN_CORNER[0] * float(source["dy"])
    metres_down = METRES_PER_DEGREE * float(source["dy"])
    metres_across = METRES_PER_DEGREE * float(source["dx"]) * np.cos(np.radians(north))
    row, column = np.indices(TERRAIN_SHAPE)
    at = [TERRAIN_CORNER[0] + row * TERRAIN_CELL / metres_down, TERRAIN_CORNER[1] + column * TERRAIN_CELL / metres_across]
    return map_coordinates(smooth, at, order=1)


def write_obj(path: Path, vertices: Floats, faces: Ints) -> None:
    """Wavefront OBJ with 17 digits, so that what is read is what was planted, bit for bit."""
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*vertex) for vertex in vertices.tolist()]
    lines += ["f " + " ".join(str(corner + 1) for corner in face if corner >= 0) for face in faces.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def write_asc(path: Path, heights: Floats) -> None:
    """ESRI ASCII grid, decimetres: finer digits would claim more than the survey knows."""
    rows, columns = heights.shape
    head = f"ncols {columns}\nnrows {rows}\nxllcorner 0\nyllcorner 0\ncellsize {TERRAIN_CELL:g}\nNODATA_value -9999\n"
    body = "\n".join(" ".join(f"{z:.1f}" for z in row) for row in heights.tolist())
    path.write_text(head + body + "\n", encoding="ascii", newline="\n")


def write_planted(path: Path, planted: dict[str, Planted]) -> None:
    """Write the truth of the planted scenes, a row a support: scene, vertex, force in newtons."""
    with path.open("w", encoding="ascii", newline="") as handle:
        table = csv.writer(handle, lineterminator="\n")
        table.writerow(["scene", "vertex", "fx", "fy", "fz"])
        for name, case in planted.items():
            for vertex in np.flatnonzero(case.forces.any(axis=1)):
                table.writerow([name, vertex, *case.forces[vertex].tolist()])


def make_data(folder: Path) -> None:
    """Write all made files into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    planted = {"tent": tent(), "five-masts": five_masts(), "scalloped": scalloped(), "sail": sail()}
    for name, case in planted.items():
        write_obj(folder / f"{name}.obj", case.shape, case.mesh.faces)
        write_obj(folder / f"{name}-flat.obj", case.flat, case.mesh.faces)
    write_planted(folder / "planted.csv", planted)
    np.save(folder / "bumps.npy", bumps())
    write_obj(folder / "pavilion.obj", *pavilion())
    write_asc(folder / "terrain.asc", terrain())


def main() -> None:
    """Make the files."""
    parser = argparse.ArgumentParser(description="make every made file of data/")
    parser.add_argument("--output", type=Path, default=DATA, help="folder to write to (default: data/)")
    folder = parser.parse_args().output
    make_data(folder)
    print(f"wrote the made files to {folder}")


if __name__ == "__main__":
    main()
