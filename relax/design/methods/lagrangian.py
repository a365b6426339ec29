"""The paper's own method (section 3.2): an augmented Lagrangian, then iterative rounding by the size of forces.

Multipliers and mu go by the textbook (Nocedal and Wright, Numerical Optimization, algorithm 17.4 without bounds); Newton-Raphson
on positions and forces at once is augmented.py's. A baseline: nothing of the sequential method's convexity or certificate is
used. Only the last digits, on the supports that were found, are those of Newton in the reduced form, as everywhere.
"""

from dataclasses import dataclass, replace

import numpy as np

from relax.arrays import Floats, Mask
from relax.design.methods.augmented import Lagrangian, Point, Terms, scales_of
from relax.design.methods.smooth import Smoothed, refuse_constraints
from relax.design.problem import Problem
from relax.design.refit import refit, stationary_dual
from relax.design.shape import Shape, figures, rest
from relax.design.starts import Start
from relax.design.trace import Journal
from relax.errors import EquilibriumError, InputError
from relax.iterate import Stop, iterate
from relax.sparsity.supports import sizes

KINK = 1e-4  # of the largest force: smoothing of a penalty that has none of its own; a tenth of what rounding drops
EXACT = 1e-9  # gradient at the end, relative: the digits after these are Newton's on the support
AT_REST = 1e-11  # infeasibility at the end, relative: where a target is reached, what is left of E_dist hangs on it
ROUND_OFF = 1e-14  # of c, relative, at least: the gradient holds mu times as much
ROUNDS = 50  # of rounding; each drops a force at least, and 1 to 4 were seen


@dataclass(frozen=True)
class _State:
    shape: Shape  # the membrane at rest under the forces found so far
    point: Point
    multipliers: Floats  # (n, 3)
    mu: float  # plain: in units of steepest slope / force
    gap: float  # infeasibility that the next multipliers ask for, relative
    tolerance: float  # residual that the next Newton asks for
    infeasibility: float = np.inf
    residual: float = np.inf
    note: str = ""


@dataclass(frozen=True)
class _Multipliers:
    """The outer loop: Newton on L, then new multipliers where c is small enough, else a larger mu."""

    terms: Terms
    settings: "AugmentedLagrangian"

    def begin(self, shape: Shape) -> _State:
        terms, mu = self.terms, self.settings.mu
        multipliers = np.zeros((terms.problem.supports.free, 3))
        point = self._lagrangian(multipliers, mu, 0.0).at(shape.positions, shape.amplitudes[terms.members])
        return _State(shape, point, multipliers, mu, mu**-0.1, 1 / mu)

    def without(self, state: _State, dropped: Mask) -> _State:
        """The state from which to solve again for the members that are left, multipliers and mu as they are."""
        newton = self._lagrangian(state.multipliers, state.mu, 0.0)
        point = newton.at(state.point.positions, state.point.amplitudes[~dropped], 0)
        return replace(state, point=point, gap=state.mu**-0.1, tolerance=1 / state.mu, infeasibility=np.inf)

    def _lagrangian(self, multipliers: Floats, mu: float, tolerance: float) -> Lagrangian:
        scales = self.terms.scales
        return Lagrangian(self.terms, multipliers, mu * scales.slope / scales.force, tolerance)

    def step(self, state: _State) -> _State:
        newton = self._lagrangian(state.multipliers, state.mu, state.tolerance)
        run = iterate(newton, newton.at(state.point.positions, state.point.amplitudes), self.settings.newton_steps)
        point = run.state
        infeasibility = float(sizes(point.gap).max()) / self.terms.scales.force
        note = f"mu {state.mu:.0e}, {run.steps} Newton steps, infeasibility {infeasibility:.1e}, gradient {point.residual:.1e}"
        moved = replace(
            state,
            shape=self._rested(state.shape, point),
            point=point,
            infeasibility=infeasibility,
            residual=point.residual,
            note=note,
        )
        mu = state.mu
        if infeasibility <= state.gap:
            gap, tolerance = state.gap / mu**0.9, state.tolerance / mu
            return replace(moved, multipliers=point.pull, gap=max(gap, AT_REST), tolerance=max(tolerance, self._least(mu)))
        mu *= self.settings.growth
        return replace(moved, mu=mu, gap=mu**-0.1, tolerance=max(1 / mu, self._least(mu)))

    def _rested(self, shape: Shape, point: Point) -> Shape:
        """The membrane at rest under the forces of a point, which is not quite; the shape before where it finds no rest."""
        problem = self.terms.problem
        amplitudes = np.zeros_like(shape.amplitudes)
        amplitudes[self.terms.members] = point.amplitudes
        spent = shape.factorizations + point.ran
        moved = rest(problem, Shape(point.positions, amplitudes, shape.factor, spent))
        return replace(shape, factorizations=spent) if moved is None else moved

    def done(self, state: _State) -> Stop | None:
        exact = state.infeasibility <= AT_REST and state.residual <= self._least(state.mu)
        return Stop.CONVERGED if exact else None

    def record(self, state: _State) -> dict[str, object]:
        return figures(self.terms.problem, state.shape, state.note, range(len(state.shape.amplitudes)))

    def _least(self, mu: float) -> float:
        """The residual below which Newton need or can not go."""
        return max(EXACT, max(ROUND_OFF, self.terms.scales.round_off) * mu)


@dataclass(frozen=True)
class AugmentedLagrangian:
    """The method as a value: call it, or hand it to `relax.solve(problem, method=...)`.

    Parameters
    ----------
    threshold : float
        Rounding drops the forces up to this share of the largest one, and solves again with the others alone.
    mu : float
        First weight of the quadratic term, above 1, in units of the steepest slope of R over the largest force. A small one
        lets the first Newton move far, and lose supports.
    growth : float
        What mu is multiplied by where infeasibility did not fall enough.
    steps, newton_steps : int
        Largest number of multipliers, and of Newton steps for each.

    Notes
    -----
    The trace has, at each multiplier, the method's own forces and the membrane at rest under them, so that objectives can be
    compared; its own positions are not quite at rest before the end, and the note says by how much. A penalty with a kink at zero
    is smoothed as the paper smooths its own, over KINK of the largest force, all through but for the last Newton on the support.
    """

    threshold: float = 1e-3
    mu: float = 10.0
    growth: float = 10.0
    steps: int = 60
    newton_steps: int = 200

    def __post_init__(self) -> None:
        if not (0 <= self.threshold < 1 and self.mu > 1 and self.growth > 1):
            raise InputError(
                f"the augmented Lagrangian has threshold {self.threshold}, mu {self.mu} and growth {self.growth}: expected a "
                "threshold from 0 to below 1, and mu and growth above 1"
            )

    def __call__(self, problem: Problem, start: Start, journal: Journal) -> tuple[Shape, Shape]:
        """The shape after rounding and a last Newton on its supports, and the one before rounding.

        Raises
        ------
        InputError
            The problem asks for what this method cannot treat.
        EquilibriumError
            The augmented Lagrangian has no way down, or the membrane finds no rest under what it found.
        """
        refuse_constraints(problem, "lagrangian")
        scales = scales_of(problem, start.shape)
        kink = float(problem.penalty.slope(np.zeros(1))[0]) > 0
        terms = Terms(
            problem, np.arange(len(problem.supports.vertices)), Smoothed(problem.penalty, KINK * scales.force * kink), scales
        )
        outer = _Multipliers(terms, self)
        state = self._solved(outer, outer.begin(start.shape), journal)
        unrounded = state.shape
        journal.stage += ", rounding"
        for _ in range(ROUNDS):
            size = sizes(state.point.amplitudes)
            small = size <= self.threshold * size.max(initial=0.0)
            if not small.any():
                break
            outer = _Multipliers(replace(outer.terms, members=outer.terms.members[~small]), self)
            state = self._solved(outer, outer.without(state, small), journal)
        shape, _, residual = stationary_dual(problem, state.shape)
        journal.remark(f"; stationarity {residual:.1e} before the last Newton")
        return refit(problem, shape, "penalised", journal), unrounded

    def _solved(self, outer: _Multipliers, state: _State, journal: Journal) -> _State:
        """Multipliers until c vanishes, or a remark that it did not."""
        run = iterate(outer, state, self.steps, journal)
        if run.stop is not Stop.CONVERGED:
            journal.remark(f"; {run.stop.value}")
        if not np.array_equal(run.state.shape.amplitudes[outer.terms.members], run.state.point.amplitudes):
            raise EquilibriumError("the membrane finds no rest under the forces of the augmented Lagrangian: raise the prestress")
        return run.state


lagrangian = AugmentedLagrangian()
