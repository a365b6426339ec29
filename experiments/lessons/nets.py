"""The net of lessons 2 to 5: a square with a fixed edge and force densities as springs, by hand and as the library's problem.

With force densities K does not depend on the shape and is the same in x, y and z: K = S (x) I_3, so that one small dense
matrix S says everything, and every statement about the inverse problem can be checked to the last digit.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

import relax

DATA = Path(__file__).resolve().parents[2] / "data"


@dataclass(frozen=True)
class Net:
    """A net of side x side vertices over the unit square, flat without supports, and a wanted shape.

    `density` is the force density q of every edge, N/m; `wanted` (V, 3) is xhat, `planted` (V, 3) the forces that made it.
    """

    side: int
    density: float
    wanted: np.ndarray
    planted: np.ndarray

    @cached_property
    def mesh(self) -> relax.Mesh:
        """Triangles with alternating diagonals; vertex = row * side + column."""
        return relax.grid_mesh(self.side, self.side, "alternating")

    @cached_property
    def flat(self) -> np.ndarray:
        """The shape without supports (V, 3)."""
        row, column = np.divmod(np.arange(self.side**2), self.side)
        return np.column_stack([column, row, 0 * row]) / (self.side - 1)

    @cached_property
    def free(self) -> np.ndarray:
        """The n vertices inside; those on the edge of the square are fixed."""
        row, column = np.divmod(np.arange(self.side**2), self.side)
        last = self.side - 1
        return np.flatnonzero((row > 0) & (row < last) & (column > 0) & (column < last))

    @cached_property
    def stiffness(self) -> np.ndarray:
        """S (n, n): for each edge +q at both ends on the diagonal and -q between them; fixed vertices are left out."""
        whole = np.zeros((self.side**2, self.side**2))
        for a, b in self.mesh.edges:
            whole[[a, b], [a, b]] += self.density
            whole[[a, b], [b, a]] -= self.density
        return whole[np.ix_(self.free, self.free)]

    @cached_property
    def offset(self) -> np.ndarray:
        """The flat net relative to the wanted shape, c = flat - xhat on the free vertices (n, 3)."""
        return (self.flat - self.wanted)[self.free]

    def shape(self, forces: np.ndarray) -> np.ndarray:
        """The net at rest under support forces (n, 3): one linear solve."""
        positions = self.flat.copy()
        positions[self.free] += np.linalg.solve(self.stiffness, forces)
        return positions

    def on_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values of the free vertices on all vertices, 0 on the edge."""
        whole = np.zeros((self.side**2, *values.shape[1:]))
        whole[self.free] = values
        return whole

    def noisy(self, sigma: float, seed: int) -> "Net":
        """The same with normal noise of standard deviation `sigma` metres on each coordinate of the free vertices."""
        noise = self.on_vertices(np.random.default_rng(seed).normal(0.0, sigma, (len(self.free), 3)))
        return replace(self, wanted=self.wanted + noise)

    def problem(self, penalty: object, weight: float, refit: str = "penalised") -> relax.Problem:
        """The inverse problem on this net, for the library; `refit`: "penalised", or "debiased" without R on the support."""
        said = _settings()
        springs = {**said["membrane"], "springs": "force-density", "stiffness": self.density}
        settings = {**said, "title": "Net", "membrane": springs, "rounding": {"refit": refit}}
        return relax.Problem(relax.build_scene(settings, self.mesh, self.wanted, self.flat), penalty=penalty, weight=weight)


@cache
def _settings() -> Mapping[str, Any]:
    """Every key of a scene, as the tent has them."""
    return relax.load_scene(DATA / "tent.toml").settings


def planted_net(side: int, density: float, masts: Iterable[tuple[int, tuple[float, float, float]]]) -> Net:
    """A net whose wanted shape is its own under the given forces: (vertex, (x, y, z) newtons) each."""
    bare = Net(side, density, np.zeros((side**2, 3)), np.zeros((side**2, 3)))
    forces = bare.planted.copy()
    for vertex, force in masts:
        forces[vertex] = force
    return replace(bare, wanted=bare.shape(forces[bare.free]), planted=forces)


def sizes(forces: np.ndarray) -> np.ndarray:
    """|p_i| of each row."""
    return np.linalg.norm(forces, axis=1)


def three_masts(sigma: float = 0.01) -> Net:
    """The net of lessons 3 to 5: 13 x 13 vertices, three planted masts, noise of `sigma` metres."""
    masts = [(45, (0.04, -0.02, 0.3)), (109, (0.0, 0.03, 0.25)), (115, (-0.03, 0.0, 0.2))]
    return planted_net(13, 0.3, masts).noisy(sigma, seed=2)
