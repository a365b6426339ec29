"""Form-finding by force densities: one linear solve for given ones, several for a spring law or for prescribed tensions.

Linkwitz and Schek (1971), Schek (1974); multi-step: Sanchez, Serna and Morer (2007). MATHEMATICS.md, "Form-finding".
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array

from relax.arrays import Floats
from relax.errors import InputError
from relax.factor import Factor, Symbolic
from relax.iterate import Stop, iterate
from relax.membrane.membrane import LIFT, Membrane
from relax.membrane.rest import FOUND, Balance, Equilibrium, differences, stiffness_bound

AIM = 1e-11  # relative residual: convergence is linear, and a digit beyond what a result needs is a tenth of the way
FLOOR = 0.1  # of the axial stiffness: smaller force densities, slack and pushing edges' too, count as this in the steps
CHANGE = 1.5  # largest factor by which a force density may move before the step is made with new ones
FLAT = 0.1  # of the slope: what a search along a step may leave of it
TRIALS = 30  # doublings and interpolations along a step; beyond them no lower place is seen
SETTLED = 20  # steps without a smaller residual, once it is found: round-off
COLLAPSED = 1e-7  # of the mean length: an edge that shrinks without end, not a short one
LARGEST_LIMIT = 1000


def solve_force_densities(membrane: Membrane, positions: Floats, applied: Floats, density: Floats) -> Floats:
    """The shape (V, 3) of a net with given force densities: (C^T Q C) x = applied - C^T Q C_fixed x_fixed, one solve.

    Parameters
    ----------
    membrane : Membrane
        Its edges and fixed vertices alone matter.
    positions : (V, 3) metres
        Those of the fixed vertices are used.
    applied : (n, 3) newtons
        On the free vertices.
    density : (E,) newtons per metre
        Tension over length; negative where an edge pushes.

    Raises
    ------
    EquilibriumError
        The densities hold some part of the net nowhere: the matrix is singular.
    """
    free, fixed = differences(membrane)
    factor = Factor(_laplacian(free, density), Symbolic(1, membrane.engine))
    vector = fixed @ positions[membrane.fixed]
    shape = positions.copy()
    shape[membrane.free] = factor.solve(applied - free.T @ (density[:, None] * vector))
    return shape


def _laplacian(differences: csr_array, density: Floats) -> csc_array:
    """C^T Q C (n, n), the same pattern for all densities."""
    matrix = csc_array(differences.T @ (density[:, None] * differences))
    matrix.sort_indices()
    return matrix


@dataclass(frozen=True)
class ConstantTension:
    """The law of an edge that pulls with the same force at every length, e = t l; `constant` is t in newtons.

    Its energy is convex, and the force-density step on it is Weiszfeld's (1937) for the point of least total distance.
    """

    name: str = "constant-tension"

    def energy(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant * length

    def tension(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return constant + 0.0 * length

    def stiffness(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return np.zeros_like(length)

    def stiffness_slope(self, length: Floats, rest: Floats, constant: Floats) -> Floats:
        return np.zeros_like(length)


@dataclass(frozen=True)
class _State:
    positions: Floats
    unbalanced: Floats  # (n, 3)
    residual: float
    density: Floats | None = None  # (E,) those that `factor` was made of
    factor: Factor | None = None
    last: tuple[Floats, Floats, Floats] | None = None  # direction, force-density step and unbalanced force of the step here
    length: float = 1.0  # of the last step, in units of its direction
    factorizations: int = 0
    best: float = np.inf
    idle: int = 0
    stop: Stop | None = None


@dataclass(frozen=True)
class _MultiStep:
    """Linear solves with the force densities of the present shape; their steps conjugate, their lengths by the forces' slope."""

    balance: Balance

    @cached_property
    def _differences(self) -> csr_array:
        return differences(self.balance.membrane)[0]

    @cached_property
    def _symbolic(self) -> Symbolic:
        return Symbolic(1, self.balance.membrane.engine)

    def begin(self, positions: Floats) -> _State:
        return _State(positions, *self.balance.measure(positions))

    def _density(self, positions: Floats) -> Floats:
        """Force densities (E,) of the spring law at a shape, none so small or negative that the solve is not a descent."""
        membrane = self.balance.membrane
        return np.maximum(membrane.edge_state(positions).density, FLOOR * stiffness_bound(membrane, positions))

    def _with_factor(self, state: _State) -> _State:
        """The factorisation at hand, or a new one where the force densities have moved; then the steps begin anew."""
        density = self._density(state.positions)
        if state.density is not None and _near(density, state.density):
            return state
        matrix, count = _laplacian(self._differences, density), state.factorizations + 1
        factor = Factor(matrix, self._symbolic)
        if not factor.positive_definite:
            # some part is held nowhere: a weak spring to where it is lets it go, or rest where its forces balance
            lift = diags_array(np.full(matrix.shape[0], LIFT * density.mean()))
            factor, count = Factor(csc_array(matrix + lift), self._symbolic), count + 1
        return replace(state, factor=factor, density=density, factorizations=count, last=None)

    def step(self, state: _State) -> _State:
        if self.balance.membrane.linear:
            whole = self.balance.membrane.factor_at(state.positions)
            if not whole.singular:
                return replace(self._moved(state, whole.solve(state.unbalanced), 1.0), factorizations=1)
        state = self._with_factor(state)
        factor = state.factor
        assert factor is not None
        if factor.singular:
            return replace(state, stop=Stop.MECHANISM)
        linear = factor.solve(state.unbalanced)
        direction = linear
        if state.last is not None:
            # conjugate to the last step (Polak and Ribiere), unless that points uphill
            before, its_linear, removed = state.last
            share = float(np.vdot(linear, state.unbalanced - removed) / np.vdot(its_linear, removed))
            direction = linear + max(0.0, share) * before
            if np.vdot(direction, state.unbalanced) <= 0:
                direction = linear
        return replace(self._search(state, direction), last=(direction, linear, state.unbalanced))

    def _search(self, state: _State, direction: Floats) -> _State:
        """Go along a step until the unbalanced force has next to no part along it: the potential is lowest there."""
        low, high = 0.0, np.inf
        begin = slope = float(np.vdot(state.unbalanced, direction))
        beyond = 0.0
        length = 1.0 if state.last is None else state.length
        for _ in range(TRIALS):
            trial = self._moved(state, direction, length)
            here = float(np.vdot(trial.unbalanced, direction))
            if abs(here) <= FLAT * begin:
                return trial
            if here > 0:
                low, slope = length, here
            else:
                high, beyond = length, here
            share = 0.5 if np.isinf(high) else min(max(slope / (slope - beyond), 0.1), 0.9)
            length = 2 * low if np.isinf(high) else low + share * (high - low)
        return trial

    def _moved(self, state: _State, direction: Floats, length: float) -> _State:
        positions = self.balance.moved(state.positions, length * direction)
        unbalanced, residual = self.balance.measure(positions)
        best, idle = min(state.best, residual), 0 if residual < state.best else state.idle + 1
        return replace(state, positions=positions, unbalanced=unbalanced, residual=residual, length=length, best=best, idle=idle)

    def done(self, state: _State) -> Stop | None:
        if state.residual <= AIM or (state.residual <= FOUND and state.idle >= SETTLED):
            return Stop.CONVERGED
        if state.stop is not None:
            return state.stop
        if self.balance.lost(state.positions):
            return Stop.LOST_SUPPORT
        membrane = self.balance.membrane
        if isinstance(membrane.springs, ConstantTension):
            length = membrane.edge_state(state.positions).length
            if (length[membrane.spring_constant > 0] <= COLLAPSED * length.mean()).any():
                return Stop.COLLAPSED
        return None

    def record(self, state: _State) -> dict[str, float]:
        return {"residual": state.residual}


def _near(one: Floats, other: Floats) -> bool:
    """Whether no entry differs by more than the factor CHANGE."""
    return bool((one <= CHANGE * other).all() and (other <= CHANGE * one).all())


def find_by_force_density(membrane: Membrane, positions: Floats, applied: Floats, limit: int | None = None) -> Equilibrium:
    """Bring the membrane to rest under `applied` forces by the multi-step force density method.

    Each step solves the linear net whose force densities are those of the present shape, q = tension / length, one scalar
    factorisation for x, y and z. Taken as it is (Sanchez, Serna and Morer 2007) that step overshoots where the springs are
    stiffer than their force densities; so steps are made conjugate and as long as the unbalanced force says.

    Parameters
    ----------
    membrane : Membrane
        A linear one (springs "force-density") needs one step.
    positions : (V, 3) metres
        Where to start; fixed vertices stay there.
    applied : (n, 3) newtons
        Loads and support forces on the free vertices.
    limit : int, optional
        Largest number of steps; default 1000.

    Returns
    -------
    Equilibrium
        Never raises for a membrane that finds no rest: `stop` says why, `found` is False, and the residual is that of the
        true spring law. An iteration is one linear solve.

    Notes
    -----
    The number of steps grows with the root of axial stiffness over force density, not with the mesh. Force densities of slack
    and pushing edges are raised to a tenth of the axial stiffness, in the steps alone, so that each descends.
    """
    method = _MultiStep(Balance(membrane, applied, positions))
    run = iterate(method, method.begin(positions), LARGEST_LIMIT if limit is None else limit)
    state = run.state
    stop = Stop.CONVERGED if state.residual <= FOUND else run.stop
    shape = membrane.kept_centroids(state.positions, positions)
    return Equilibrium(shape, state.residual, stop, run.steps, state.factorizations, None, ("force-density",))


def prescribed_tensions(
    membrane: Membrane, positions: Floats, applied: Floats, tensions: Floats, limit: int | None = None
) -> Equilibrium:
    """The shape in which every edge pulls with a prescribed tension: force densities t_e / l_e, step by step.

    Parameters
    ----------
    membrane : Membrane
        Its edges and fixed vertices alone matter.
    positions : (V, 3) metres
        Where to start; no edge may have length 0. Fixed vertices stay there.
    applied : (n, 3) newtons
        Loads and support forces on the free vertices.
    tensions : (E,) newtons
        Zero or positive.
    limit : int, optional
        Largest number of steps; default 1000.

    Returns
    -------
    Equilibrium
        `found` is False and `stop` says why where the steps end at no net of these tensions.

    Raises
    ------
    InputError
        A tension is missing, negative or not finite.

    Notes
    -----
    Such a shape is a minimum of the sum of t_e l_e minus the work of the applied forces, a convex function. So uniform
    tensions on a net give the least total length of edges, much like a minimal surface; how vertices lie along a line of
    edges that runs straight is then left to the start. There need be no such net: edges shrink to a point where the others
    pull harder than they can hold (as three cables meet at a pole if it stands in an angle above 120 degrees), and the net
    moves away without bound under forces beyond what the tensions carry. `rest_length` and `spring_constant` of the
    membrane play no part; cut the edges to l_e - t_e / k_e to build it.
    """
    edges = len(membrane.edges)
    if tensions.shape != (edges,) or not np.isfinite(tensions).all() or (tensions < 0).any():
        raise InputError(f"tensions: expected a number of newtons, zero or positive, for each of the {edges} edges")
    pulled = replace(membrane, springs=ConstantTension(), spring_constant=tensions)
    return find_by_force_density(pulled, positions, applied, limit)
