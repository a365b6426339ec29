"""A small model of the whole problem: E_dist to second order in the forces of a few candidates, plus R as it is.

    E(s) = E0 + lam . (s - s0) + (s - s0)^T Q (s - s0),     Q = C^T (M - T/2) C,  C = K^-1 B on the members

(MATHEMATICS.md, "Reduced form"). The columns C cost solves; what is then looked for in the model costs next to nothing.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from relax.arrays import Floats, Ints
from relax.convex.reweighted import Reweighted
from relax.design.problem import Problem
from relax.design.shape import Shape, with_dual
from relax.factor import Factor


@dataclass(frozen=True)
class Model:
    """The model on its members, expanded at forces `origin`.

    Parameters
    ----------
    problem : Problem
    factor : Factor
        Of K at or near the shape.
    curvature : (3n, 3n) sparse
        M - T/2, or M alone.
    origin : (m, c) newtons
        s0 of all candidates; zero off the members.
    distance : float
        E0, square metres.
    dual : (m, c)
        lam at s0.
    members : (k,) int
        Candidates in the model.
    columns : (3n, ck)
        C.
    quadratic : (ck, ck)
        Q.
    """

    problem: Problem
    factor: Factor
    curvature: csc_array
    origin: Floats
    distance: float
    dual: Floats
    members: Ints
    columns: Floats
    quadratic: Floats

    def enlarged(self, entering: Ints) -> "Model":
        """The model with more members, itself where none enter."""
        if not entering.size:
            return self
        new = self.problem.columns(self.factor, entering)
        bent = self.curvature @ new
        across, own = self.columns.T @ bent, new.T @ bent
        quadratic = np.block([[self.quadratic, across], [across.T, 0.5 * (own + own.T)]])
        return replace(
            self,
            members=np.concatenate([self.members, entering]),
            columns=np.hstack([self.columns, new]),
            quadratic=quadratic,
        )

    @cached_property
    def small(self) -> Reweighted:
        """The model without its constant, Q made positive: where it bends down it bends up as much."""
        quadratic = self.quadratic
        try:
            np.linalg.cholesky(quadratic)
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(quadratic)
            quadratic = (vectors * np.abs(values)) @ vectors.T
        start = self.origin[self.members]
        linear = self.dual[self.members] / 2 - (quadratic @ start.ravel()).reshape(start.shape)
        costs = self.problem.strength * self.problem.supports.weights[self.members]
        resultants = self.problem.resultants
        conditions = None if resultants is None else resultants.of(self.members)
        return Reweighted(quadratic, linear, self.problem.penalty, costs, self.problem.supports.reach, conditions)

    @cached_property
    def _constant(self) -> float:
        start = self.origin[self.members]
        quadratic = float(start.ravel() @ (self.small.quadratic @ start.ravel()))
        return self.distance - float(np.vdot(self.dual[self.members], start)) + quadratic

    def value(self, s: Floats) -> float:
        """The model's E_dist + R at the members' forces (k, c)."""
        return self.small.value(s) + self._constant

    def dual_at(self, s: Floats) -> Floats:
        """The model's dual (m, c) at the members' forces (k, c): what a further force at each candidate would gain."""
        moved = self.curvature @ (self.columns @ (s - self.origin[self.members]).ravel())
        turned = self.factor.solve(2 * moved).reshape(-1, 3)
        dual: Floats = self.dual + self.problem.supports.duals(turned)
        return self.problem.levelled_duals(dual, self.whole(s))

    def whole(self, s: Floats) -> Floats:
        """The members' forces (k, c) among those of all candidates (m, c)."""
        amplitudes = np.zeros_like(self.origin)
        amplitudes[self.members] = s
        return amplitudes


def empty_model(problem: Problem, factor: Factor, curvature: csc_array, origin: Floats, distance: float, dual: Floats) -> Model:
    """A model without members yet; see Model."""
    none = np.zeros(0, dtype=np.int64)
    return Model(
        problem, factor, curvature, origin, distance, dual, none, np.zeros((factor.matrix.shape[0], 0)), np.zeros((0, 0))
    )


def model_at(problem: Problem, shape: Shape, factor: Factor, field: Floats) -> Model:
    """The model without members yet at a shape with its factorisation and its dual lam (n, 3)."""
    curvature, dual = problem.curvature(shape.positions, field), problem.supports.duals(field)
    return empty_model(problem, factor, curvature, shape.amplitudes, problem.distance(shape.positions), dual)


def model_on_supports(problem: Problem, shape: Shape) -> tuple[Shape, Model]:
    """The shape with a factorisation at or near it, and its model on the supports that stand."""
    shape, factor, field = with_dual(problem, shape)
    model = model_at(problem, shape, factor, field)
    return shape, model.enlarged(np.flatnonzero(problem.standing(shape.amplitudes)))
