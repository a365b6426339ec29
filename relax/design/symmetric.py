"""A symmetric problem by one vertex of each orbit: every number is the whole problem's over the order of the group."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from relax.arrays import Floats, Ints
from relax.design.problem import Problem
from relax.design.shape import Shape
from relax.factor import Factor
from relax.membrane.membrane import Membrane
from relax.membrane.mesh import Mesh
from relax.membrane.orbits import OrbitMembrane, orbit_membrane
from relax.membrane.symmetry import Symmetry, find_symmetry
from relax.sparsity.supports import OrbitSupports, Supports


@dataclass(frozen=True, kw_only=True)
class SymmetricProblem(Problem):
    """The symmetric answers of a problem: a problem of the same kind, with as many times fewer unknowns as the group has maps.

    `scene` has the representatives' arrays, relative to the axis; `original` is the whole problem. (MATHEMATICS.md, "Symmetry")
    """

    original: Problem
    symmetry: Symmetry
    orbits: OrbitMembrane

    @property
    def membrane(self) -> Membrane:
        return self.orbits

    @cached_property
    def supports(self) -> Supports:
        plain = super().supports
        vertices = self.membrane.free[plain.vertices]
        share, invariant = self.symmetry.share[vertices], self._along(self.symmetry.invariant[vertices])
        return OrbitSupports(plain.vertices, plain.weights, plain.free, plain.reach, share=share, invariant=invariant)

    @cached_property
    def roughness(self) -> float:
        """That of the whole: the representatives' neighbours are not all at hand."""
        return self.original.roughness

    def _along(self, maps: Floats) -> Floats:
        """Maps of vectors (k, 3, 3) as maps of amplitudes (k, c, c)."""
        axes = self.original.supports.reach.axes
        return maps[:, axes][:, :, axes]

    def columns(self, factor: Factor, groups: Ints) -> Floats:
        supports = self.supports
        assert isinstance(supports, OrbitSupports)
        right = np.zeros((factor.matrix.shape[0], len(groups), supports.width))
        blocks = supports.share[groups, None, None] * supports.invariant[groups]
        right[supports.rows[groups], np.arange(len(groups))[:, None], :] = blocks
        return factor.solve(np.asfortranarray(right.reshape(len(right), -1)))

    @cached_property
    def _candidates(self) -> tuple[Ints, Floats]:
        """Group of every candidate of the whole (k,), and Q that takes its representative there (k, 3, 3)."""
        vertices = np.flatnonzero(self.original.scene.candidates & ~self.original.scene.fixed)
        group = np.full(len(self.symmetry.representatives), -1)
        group[self.membrane.free[self.supports.vertices]] = np.arange(len(self.supports.vertices))
        return group[self.symmetry.orbit[vertices]], self.symmetry.turns[self.symmetry.element[vertices]]

    def candidates_at(self, positions: Floats, amplitudes: Floats) -> tuple[Ints, Floats, Floats]:
        group, turns = self._candidates
        place = positions[self.membrane.free][self.supports.vertices]
        force = Supports.forces(self.supports, amplitudes)[self.supports.vertices]
        return group, np.einsum("cij,cj->ci", turns, place[group]), np.einsum("cij,cj->ci", turns, force[group])

    def one_of_each(self, candidates: Ints) -> Ints:
        """Of the whole's candidates (k,) one of each orbit."""
        return candidates[np.unique(self._candidates[0][candidates], return_index=True)[1]]

    def whole(self, shape: Shape) -> Shape:
        """The whole membrane in a shape of its representatives."""
        original, scene = self.original, self.original.scene
        positions = self.symmetry.whole(shape.positions) + self.symmetry.axis
        positions[scene.fixed] = scene.start[scene.fixed]
        group, turns = self._candidates
        amplitudes = np.einsum("cij,cj->ci", self._along(turns), shape.amplitudes[group])
        assert len(amplitudes) == len(original.supports.vertices)
        return Shape(positions, amplitudes, None, shape.factorizations)


def symmetric_problem(problem: Problem) -> SymmetricProblem | None:
    """The problem by its representatives; None where it has no symmetry, or a linear membrane makes factors cheap.

    None too where a part has no fixed vertex: its translations along the axis and its balance would have to be symmetric as well.
    """
    plain = problem.membrane.linear or problem.membrane.floating
    symmetry = None if plain else find_symmetry(problem.scene)
    if symmetry is None:
        return None
    scene, share, chosen = problem.scene, symmetry.share, symmetry.representatives
    orbits = orbit_membrane(problem.membrane, symmetry)
    reduced = replace(
        scene,
        mesh=Mesh(len(chosen), np.zeros((0, 4), dtype=np.int64), orbits.edges),
        target=symmetry.mean(scene.target - symmetry.axis),
        clean_target=symmetry.mean(scene.clean_target - symmetry.axis),
        start=symmetry.mean(scene.start - symmetry.axis),
        rest_length=orbits.rest_length,
        spring_constant=orbits.spring_constant,
        loads=symmetry.mean(scene.loads) * share[:, None],
        fixed=scene.fixed[chosen],
        candidates=scene.candidates[chosen],
        metric=symmetry.mean_blocks(scene.metric) * share[:, None, None],
        support_weight=scene.support_weight[chosen] * share,
    )
    return SymmetricProblem(reduced, problem.penalty, problem.weight, original=problem, symmetry=symmetry, orbits=orbits)
