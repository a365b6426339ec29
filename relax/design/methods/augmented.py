"""The augmented Lagrangian of equation 1 of the paper, and Newton-Raphson on it in positions and forces at once (section 3.2).

    L(x, s) = |x - xhat|_M^2 + R(s) + y . c + mu/2 |c|^2,     c = f(x) + g + B s

The multipliers y and mu are lagrangian.py's (MATHEMATICS.md, "Other methods").
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csc_array

from relax.arrays import Floats, Ints
from relax.design.methods.smooth import Smoothed, steepest_slope
from relax.design.problem import Problem
from relax.design.shape import Shape
from relax.errors import EquilibriumError
from relax.factor import Factor, Symbolic
from relax.iterate import Stop
from relax.sparsity.supports import sizes

HALVINGS = 40
DESCENT = 1e-4  # Armijo's share of the promised fall
FLAT = 1e-3  # of the curvature across the force: one along it that is less is taken for none, and the parabola's instead
NOISE = 1e-13  # of the value: a promised fall that round-off hides
FASTER = 0.5  # of the gradient: a step whose fall is hidden is Newton's at its quadratic end, or chance among the last digits


@dataclass(frozen=True)
class Scales:
    """What makes mu, the gradient and the infeasibility plain numbers.

    Parameters
    ----------
    force : float
        Largest tension or support force at the start, newtons.
    slope : float
        Steepest slope of R, square metres per newton: the size of a multiplier.
    stiffness : float
        Mean diagonal entry of K at the start, newtons per metre.
    round_off : float
        What is left of the gradient, as a plain number and of a plain mu, when c vanishes to the last digit.

    Notes
    -----
    A spring of stiffness k pulls with k (l - L), so c is known to k |x| times the last digit; K carries it into the gradient.
    """

    force: float
    slope: float
    stiffness: float
    round_off: float


def scales_of(problem: Problem, shape: Shape) -> Scales:
    """The scales at a shape; 1 where there is nothing to measure."""
    tension = np.abs(problem.membrane.tension(shape.positions)).max()
    force = float(max(tension, sizes(shape.amplitudes).max(initial=0.0)))
    force = force or 1.0
    diagonal = np.abs(problem.membrane.stiffness(shape.positions).diagonal())
    stiffness, largest = float(diagonal.mean()) or 1.0, float(diagonal.max())
    last_digit = np.finfo(float).eps * largest * float(np.abs(shape.positions).max()) / force
    return Scales(force, steepest_slope(problem) or 1.0, stiffness, last_digit * largest / stiffness)


@dataclass(frozen=True)
class Point:
    """Positions (V, 3), amplitudes (k, c) of the members, and the augmented Lagrangian there.

    `gap` is c (n, 3) newtons; `pull` = y + mu c (n, 3) is what the multiplier would become; `slope` (3n,) and `thrust` (k, c)
    are the gradients with respect to positions and amplitudes, `residual` the larger of them as a plain number.
    """

    positions: Floats
    amplitudes: Floats
    value: float
    gap: Floats
    pull: Floats
    stiffness: csc_array
    slope: Floats
    thrust: Floats
    residual: float
    ran: int = 0  # factorisations
    stuck: bool = False


@dataclass(frozen=True)
class Terms:
    """What the augmented Lagrangian is made of, whatever its multipliers.

    Parameters
    ----------
    problem : Problem
    members : (k,) int
        Candidates that may carry a force.
    profile : Smoothed
        The penalty, flat at zero.
    scales : Scales
    """

    problem: Problem
    members: Ints
    profile: Smoothed
    scales: Scales

    @cached_property
    def costs(self) -> Floats:
        """k_sparse c_g of the members (k,)."""
        return self.problem.strength * self.problem.supports.weights[self.members]

    @cached_property
    def rows(self) -> Ints:
        """Row of each member's amplitudes among the 3n of K (k, c)."""
        return self.problem.supports.rows[self.members]

    @cached_property
    def _symbolic(self) -> Symbolic:
        return Symbolic(3, self.problem.membrane.engine)

    @cached_property
    def _places(self) -> csc_array:
        """Next to nothing wherever K K can have an entry: added, it keeps the places of those that cancel."""
        pointer, column = self.problem.membrane.neighbours
        ones = bsr_array((np.ones((len(column), 3, 3)), column, pointer))
        twice = csc_array(ones @ ones)
        return csc_array((np.full(twice.nnz, np.finfo(float).tiny), twice.indices, twice.indptr), shape=twice.shape)

    def reduced(self, stiffness: csc_array, block: csc_array, mixed: Floats) -> Factor:
        """A factorisation of `block` + K W K (3n, 3n), W the blocks `mixed` (n, 3, 3)."""
        count = len(mixed)
        weight = csc_array(bsr_array((mixed, np.arange(count), np.arange(count + 1))))
        whole = csc_array(stiffness @ (weight @ stiffness) + block + self._places)
        whole.sort_indices()
        return Factor(whole, self._symbolic)


@dataclass(frozen=True)
class Lagrangian:
    """L at fixed multipliers and mu, and Newton-Raphson on it: an algorithm for `iterate`.

    Parameters
    ----------
    terms : Terms
    multipliers : (n, 3)
        y.
    mu : float
        Square metres per square newton.
    tolerance : float
        Residual at which Newton stops.
    """

    terms: Terms
    multipliers: Floats
    mu: float
    tolerance: float

    def gap(self, positions: Floats, amplitudes: Floats) -> Floats:
        """C = f + g + B s (n, 3) newtons."""
        gap = (self.terms.problem.membrane.forces(positions) + self.terms.problem.loads).ravel()
        gap[self.terms.rows] += amplitudes
        return gap.reshape(-1, 3)

    def value(self, positions: Floats, amplitudes: Floats, gap: Floats) -> float:
        """L."""
        sparsity = float(self.terms.costs @ self.terms.profile.value(sizes(amplitudes)))
        multiplied = float(np.vdot(self.multipliers + self.mu / 2 * gap, gap))
        return self.terms.problem.distance(positions) + sparsity + multiplied

    def at(self, positions: Floats, amplitudes: Floats, ran: int = 0) -> Point:
        """L and its gradient at a point."""
        problem = self.terms.problem
        gap = self.gap(positions, amplitudes)
        pull = self.multipliers + self.mu * gap
        stiffness = problem.membrane.stiffness(positions)
        slope = 2 * (problem.metric @ problem.offset(positions).ravel()) - stiffness @ pull.ravel()
        across = self.terms.costs * self.terms.profile.across(sizes(amplitudes))
        thrust = across[:, None] * amplitudes + pull.ravel()[self.terms.rows]
        steep = float(sizes(slope.reshape(-1, 3)).max()) / self.terms.scales.stiffness
        residual = max(steep, float(sizes(thrust).max(initial=0.0))) / self.terms.scales.slope
        value = self.value(positions, amplitudes, gap)
        return Point(positions, amplitudes, value, gap, pull, stiffness, slope, thrust, residual, ran)

    def step(self, point: Point) -> Point:
        """A Newton step, its Hessian made definite where it is not, as long as L falls enough."""
        shift, change, ran = self._newton(point)
        promised = float(point.slope @ shift + np.vdot(point.thrust, change))
        hidden = -promised <= NOISE * abs(point.value)
        free = self.terms.problem.membrane.free
        length = 1.0
        for _ in range(HALVINGS):
            positions = point.positions.copy()
            positions[free] += length * shift.reshape(-1, 3)
            amplitudes = point.amplitudes + length * change
            value = self.value(positions, amplitudes, self.gap(positions, amplitudes))
            if value <= point.value + DESCENT * length * promised or hidden:
                moved = self.at(positions, amplitudes, point.ran + ran)
                if not hidden or moved.residual <= FASTER * point.residual:
                    return moved
                break
            length *= 0.5
        return replace(point, ran=point.ran + ran, stuck=True)

    def _newton(self, point: Point) -> tuple[Floats, Floats, int]:
        """Newton's step in positions (3n,) and amplitudes (k, c), and the factorisations it took.

        The block of the amplitudes is block-diagonal and is eliminated; what is left is 2 M - T + K W K. It is taken as is where
        it is definite; else with R's parabolas for its own curvature, which put W between 0 and mu; else also without T.
        """
        turn = self.terms.problem.membrane.stiffness_turn(point.positions, point.pull)
        metric = 2 * self.terms.problem.metric
        ran = 0
        for curved, block in ((True, metric - turn), (False, metric - turn), (False, metric)):
            ran += 1
            inverse, mixed = self._amplitude_blocks(point.amplitudes, curved=curved)
            factor = self.terms.reduced(point.stiffness, csc_array(block), mixed)
            if factor.positive_definite:
                break
        else:
            raise EquilibriumError(
                "the augmented Lagrangian has no direction to go down: raise the prestress (lower membrane.rest_scale)"
            )
        eased = np.einsum("gij,gj->gi", inverse, point.thrust)
        pressed = np.zeros(len(point.slope))
        pressed[self.terms.rows] = self.mu * eased
        shift = factor.solve(-point.slope - point.stiffness @ pressed)
        bent = (point.stiffness @ shift)[self.terms.rows]
        change = np.einsum("gij,gj->gi", inverse, self.mu * bent - point.thrust)
        return shift, change, ran

    def _amplitude_blocks(self, amplitudes: Floats, *, curved: bool) -> tuple[Floats, Floats]:
        """(R'' + mu)^-1 of the members (k, c, c), and W (n, 3, 3): mu, where a member stands mu R'' (R'' + mu)^-1.

        Where R bends down along a force more than mu holds up, or at all if not `curved`, the parabola that touches R from above
        takes its place.
        """
        size = sizes(amplitudes)
        unit = amplitudes / np.where(size > 0, size, 1.0)[:, None]
        across, along = self.terms.costs * self.terms.profile.across(size), self.terms.costs * self.terms.profile.along(size)
        least = FLAT * (across + self.mu) - self.mu if curved else 0.0
        along = np.where(along > least, along, across)
        outer = unit[:, :, None] * unit[:, None, :]
        identity = np.eye(self.terms.rows.shape[1])

        def blocks(of: Floats, other: Floats) -> Floats:
            return other[:, None, None] * identity + (of - other)[:, None, None] * outer

        inverse = blocks(1 / (along + self.mu), 1 / (across + self.mu))
        mixed = np.tile(self.mu * np.eye(3), (self.terms.problem.supports.free, 1, 1))
        axes = np.array(self.terms.problem.supports.reach.axes)
        at = self.terms.problem.supports.vertices[self.terms.members, None, None]
        mixed[at, axes[:, None], axes] = blocks(self.mu * along / (along + self.mu), self.mu * across / (across + self.mu))
        return inverse, mixed

    def done(self, point: Point) -> Stop | None:
        """The tolerance, or no step that lowers L."""
        if point.residual <= self.tolerance:
            return Stop.CONVERGED
        return Stop.STALLED if point.stuck else None

    def record(self, point: Point) -> dict[str, object]:
        """Figures of a Newton step."""
        return {"value": point.value, "residual": point.residual}
