"""The inverse problem (equation 1 of the paper): a scene, a penalty and its weight, and the terms they define.

min over x, p   sum_i (x_i - xhat_i)^T M_i (x_i - xhat_i) + k_sparse sum_g c_g phi(|p_g|)     s.t.   f(x) + g + p = 0
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import bsr_array, csc_array

from relax.arrays import Floats, Ints, Mask
from relax.convex.subproblem import Subproblem
from relax.errors import InputError
from relax.factor import Factor, FloatingFactor, Translations, translations
from relax.membrane.membrane import Membrane
from relax.membrane.scene import Scene
from relax.membrane.target import noise_level
from relax.sparsity.penalties import Penalty, make_penalty
from relax.sparsity.reach import reach_of
from relax.sparsity.resultants import Resultants
from relax.sparsity.supports import Supports, sizes


@dataclass(frozen=True)
class Problem:
    """What is asked for.

    Parameters
    ----------
    scene : Scene
    penalty : Penalty, optional
        Default: the scene's [penalty].
    weight : float, optional
        k_sparse, length^2 / force^alpha; default: the scene's, None while that is given as a fraction of the largest
        useful weight (`relax.solve` finds it).

    Raises
    ------
    InputError
        A weight that is not a positive number.
    """

    scene: Scene
    penalty: Penalty = None  # type: ignore[assignment]  # filled in below
    weight: float | None = None

    def __post_init__(self) -> None:
        said = self.scene.settings["penalty"]
        if self.penalty is None:
            object.__setattr__(self, "penalty", make_penalty(said))
        if self.weight is None and said.get("weight") is not None:
            object.__setattr__(self, "weight", float(said["weight"]))
        if self.weight is not None and not (np.isfinite(self.weight) and self.weight > 0):
            raise InputError(f"penalty.weight is {self.weight}: give a positive number")

    def replace(self, **changes: Any) -> "Problem":
        """The same problem with other fields."""
        return replace(self, **changes)

    @property
    def membrane(self) -> Membrane:
        return self.scene.membrane

    @cached_property
    def supports(self) -> Supports:
        free = self.membrane.free
        candidates = np.flatnonzero(self.scene.candidates[free])
        said = self.scene.settings["supports"]
        reach = reach_of(said["direction"], said["max_force"])
        return Supports(candidates, self.scene.support_weight[free][candidates], len(free), reach)

    def standing(self, amplitudes: Floats) -> Mask:
        """Which groups carry a force, or stand whatever comes (m,)."""
        stands: Mask = np.any(amplitudes != 0, axis=1) | self.supports.always
        return stands

    def all_forces(self, amplitudes: Floats) -> Floats:
        """Support forces of all vertices (V, 3), zero where none stands."""
        forces = np.zeros_like(self.scene.target)
        forces[self.membrane.free] = self.supports.forces(amplitudes)
        return forces

    def columns(self, factor: Factor, groups: Ints) -> Floats:
        """K^-1 B of some groups (3n, ck): how the membrane moves under a unit of each amplitude."""
        return factor.inverse_columns(self.supports.rows[groups].ravel())

    def candidates_at(self, positions: Floats, amplitudes: Floats) -> tuple[Ints, Floats, Floats]:
        """Every vertex where a support may stand: its group (c,), its place (c, 3) and the force there (c, 3)."""
        place = positions[self.membrane.free][self.supports.vertices]
        return np.arange(len(place)), place, self.supports.forces(amplitudes)[self.supports.vertices]

    @cached_property
    def loads(self) -> Floats:
        """G on the free vertices (n, 3)."""
        return self.scene.loads[self.membrane.free]

    @cached_property
    def metric(self) -> csc_array:
        """M (3n, 3n), block-diagonal."""
        blocks = self.scene.metric[self.membrane.free]
        count = len(blocks)
        rows = bsr_array((blocks, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count)).tocsr()
        rows.eliminate_zeros()
        return csc_array(rows)

    @cached_property
    def roughness(self) -> float:
        """What the target shows of noise, in mean edge lengths of the start."""
        edge = np.linalg.norm(self.membrane.edge_vectors(self.scene.start), axis=1).mean()
        return noise_level(self.scene.target, self.scene.mesh.edges, self.membrane.free) / float(edge)

    @cached_property
    def size(self) -> float:
        """Diagonal of the target's bounding box, metres."""
        return float(np.linalg.norm(np.ptp(self.scene.clean_target, axis=0)))

    def offset(self, positions: Floats) -> Floats:
        """Offset r = x - xhat on the free vertices, (n, 3)."""
        free = self.membrane.free
        return positions[free] - self.scene.target[free]

    def distance(self, positions: Floats) -> float:
        """E_dist (equation 2)."""
        offset = self.offset(positions).ravel()
        return float(offset @ (self.metric @ offset))

    def sparsity(self, amplitudes: Floats) -> float:
        """R: k_sparse sum_g c_g phi(|s_g|), zero where nothing stands."""
        return float(self.group_costs(sizes(amplitudes)).sum())

    def group_costs(self, size: Floats) -> Floats:
        """R_g = k_sparse c_g phi(t) of each group's force magnitude, (m,)."""
        return self.strength * self.supports.weights * self.penalty.value(size)

    def slope_scale(self, amplitudes: Floats) -> float:
        """sigma: the largest mean slope R_g / |s_g| of a standing support, by which stationarity is measured; 1 if none."""
        size = sizes(amplitudes)
        stands = size > 0
        if not stands.any():
            return 1.0
        scale = float((self.group_costs(size)[stands] / size[stands]).max())
        if scale == 0:  # only supports without a price stand: as if they had that of others
            scale = float((self.strength * self.penalty.value(size[stands]) / size[stands]).max())
        return scale or float(np.finfo(float).tiny)

    def step_lengths(self, amplitudes: Floats, scale: float) -> Floats:
        """Tau = |s_g| / sigma of each group (k,), by which a projected gradient is measured; of its largest where s_g is 0."""
        size = sizes(amplitudes)
        return np.where(size > 0, size, size.max(initial=0.0) or 1.0) / scale

    def objective(self, positions: Floats, amplitudes: Floats) -> float:
        """E_dist + R; it means something at equilibrium only."""
        return self.distance(positions) + self.sparsity(amplitudes)

    def group_weights(self, amplitudes: Floats) -> Floats:
        """Reweighting weights w_g = k_sparse c_g w(|s_g|), (m,)."""
        costs, slopes = self.strength * self.supports.weights, self.penalty.weight(sizes(amplitudes))
        # a support that costs nothing has no slope, though a counting penalty's is infinite at zero
        return np.multiply(costs, slopes, out=np.zeros_like(costs), where=costs > 0)

    @cached_property
    def translations(self) -> Translations | None:
        """Those of the parts without a fixed vertex, which the forces leave to E_dist; None where there is no such part."""
        parts = self.membrane.floating
        return translations(parts, self.metric) if parts else None

    @cached_property
    def resultants(self) -> Resultants | None:
        """What the support forces of those parts must add up to: minus their loads."""
        parts = self.membrane.floating
        if not parts:
            return None
        label = np.full(len(self.membrane.free), -1)
        for index, vertices in enumerate(parts):
            label[vertices] = index
        return Resultants(label[self.supports.vertices], -np.array([self.loads[vertices].sum(axis=0) for vertices in parts]))

    def placed(self, positions: Floats) -> Floats:
        """Positions (V, 3) with each part without a fixed vertex moved as a whole to where E_dist is least."""
        if self.translations is None:
            return positions
        placed = positions.copy()
        offset = self.translations.left_out(self.offset(positions).ravel()).reshape(-1, 3)
        placed[self.membrane.free] = self.scene.target[self.membrane.free] + offset
        return placed

    def balanced(self, amplitudes: Floats) -> Floats | None:
        """Amplitudes (m, c) that a part without a fixed vertex can rest under, near these; None where there are none."""
        return amplitudes if self.resultants is None else self.resultants.repaired(amplitudes)

    def levelled(self, field: Floats, amplitudes: Floats, share: float = 1.0) -> Floats:
        """A dual field (n, 3) with the multiplier of each such part's balance, as the standing amplitudes (m, c) tell it.

        `share` of R counts: 0 where it is dropped.
        """
        if self.resultants is None:
            return field
        levelled = field.copy()
        multiplier = self._multiplier(self.supports.duals(field), amplitudes, share)
        for vertices, vector in zip(self.membrane.floating, multiplier, strict=True):
            levelled[vertices] += vector
        return levelled

    def levelled_duals(self, dual: Floats, amplitudes: Floats) -> Floats:
        """The same of the groups' duals (m, c), all of R counted."""
        if self.resultants is None:
            return dual
        return dual + self.resultants.spread(self._multiplier(dual, amplitudes, 1.0))

    def _multiplier(self, dual: Floats, amplitudes: Floats, share: float) -> Floats:
        """Of the balance of each part without a fixed vertex (q, 3)."""
        assert self.resultants is not None
        size = sizes(amplitudes)
        slope = share * self.strength * self.supports.weights * self.penalty.slope(size)
        gradient = dual + (slope / np.where(size > 0, size, 1.0))[:, None] * amplitudes
        return self.resultants.multiplier(gradient, self.standing(amplitudes))

    def factor_at(self, positions: Floats) -> Factor:
        """A factorisation of K at `positions`; off the translations of parts without a fixed vertex."""
        return self._linear_factor if self.membrane.linear else self.floating(self.membrane.factor_at(positions))

    @cached_property
    def _linear_factor(self) -> Factor:
        return self.floating(self.membrane.factor_at(self.scene.start))

    def floating(self, factor: Factor) -> Factor:
        """A factorisation that the membrane made, with translations chosen by E_dist where parts have no fixed vertex."""
        if self.translations is None or isinstance(factor, FloatingFactor):
            return factor
        return FloatingFactor(factor, self.membrane.grounding, self.translations)

    def dual(self, positions: Floats, factor: Factor) -> Floats:
        """Lam = 2 K^-1 M (x - xhat) on the free vertices (n, 3): minus the gradient that a support force would feel."""
        return factor.solve(2 * (self.metric @ self.offset(positions).ravel())).reshape(-1, 3)

    def curvature(self, positions: Floats, dual: Floats) -> csc_array:
        """M - T/2 (3n, 3n), half the Hessian of E_dist between K^-1 and K^-1, at `positions` with their dual (n, 3)."""
        if self.membrane.linear:
            return self.metric
        return csc_array(self.metric - self.membrane.stiffness_turn(positions, dual) / 2)

    def linearised(self, positions: Floats, factor: Factor, weights: Floats) -> Subproblem:
        """The convex step at `positions` under `weights` (m,)."""
        unbalanced = self.membrane.forces(positions) + self.loads
        offset, supports = self.offset(positions).ravel(), self.supports
        load, resultants = unbalanced.ravel(), self.resultants
        return Subproblem(factor, self.metric, offset, load, supports.rows, weights, supports.reach, resultants=resultants)

    @property
    def strength(self) -> float:
        """k_sparse as a number; raises InputError while it is given as a fraction only."""
        if self.weight is None:
            raise InputError("penalty.weight_fraction: the weight is not resolved yet; use relax.resolve_weight(problem) first")
        return self.weight
