"""Equilibrium and its inverse problem in 50 digits: residuals written once for mpmath, solved by chord steps to the last of them.

The numbers of a scene are taken as the doubles that they are. A Jacobian by differences in 50 digits, inverted in double
precision, shrinks the error by some ten digits a step, so five steps end at the round-off of 50 digits; else it is an error.

`attainable` says what double precision can reach: each equation is only known up to the round-off of its own terms, and the
inverse of the Jacobian carries that to the unknowns, |J^-1| (eps |terms|) (Skeel 1979), beside the rounding of the answer itself.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mpmath
import numpy as np

import relax

mpmath.mp.dps = 50
EPSILON = float(np.finfo(float).eps)
STEP = mpmath.mpf(10) ** -25  # of the differences: half of the digits
ENDS = mpmath.mpf(10) ** -42  # residual beside its terms
root = np.frompyfunc(mpmath.sqrt, 1, 1)
exact = np.frompyfunc(mpmath.mpf, 1, 1)
Array = np.ndarray
System = Callable[[Array], tuple[Array, Array]]  # unknowns -> residual, sums of the sizes of its terms


@dataclass(frozen=True)
class Reference:
    """The unknowns in 50 digits, and the error of each that double precision cannot but make."""

    unknowns: Array
    attainable: Array


def solved(system: System, guess: Array) -> Reference:
    """The root near a guess in double precision."""
    z = exact(np.asarray(guess, dtype=object))
    columns = []
    for index in range(len(z)):
        ahead, behind = z.copy(), z.copy()
        ahead[index] += STEP
        behind[index] -= STEP
        columns.append((system(ahead)[0] - system(behind)[0]) / (2 * STEP))
    jacobian = np.array(columns).T.astype(float)
    scale = system(z)[1].astype(float)
    scale[scale == 0] = 1.0
    inverse = np.linalg.inv(jacobian / scale[:, None])
    for _ in range(12):
        residual = system(z)[0] / scale
        if max(abs(residual)) <= ENDS:
            return Reference(z, EPSILON * (abs(inverse).sum(axis=1) + abs(z.astype(float))))
        z = z - inverse @ residual
    raise ArithmeticError(f"the reference did not converge: residual {float(max(abs(residual))):.1e}")


class Extended:
    """Residuals of a scene: equilibrium alone, or with the conditions of the inverse problem on given supports."""

    def __init__(self, problem: relax.Problem) -> None:
        scene, said = problem.scene, problem.scene.settings["penalty"]
        self.linear = scene.settings["membrane"]["springs"] == "force-density"
        self.penalised = scene.settings["rounding"]["refit"] == "penalised"
        self.free, self.edges = np.flatnonzero(~scene.fixed), scene.mesh.edges
        self.held, self.target, self.loads = exact(scene.start), exact(scene.target), exact(scene.loads)
        self.rest, self.constant, self.metric = exact(scene.rest_length), exact(scene.spring_constant), exact(scene.metric)
        self.weight = exact(scene.support_weight) * mpmath.mpf(problem.weight)
        self.alpha, self.eps = mpmath.mpf(said["exponent"]), mpmath.mpf(said["smoothing"])

    def edgewise(self, x: Array, lam: Array) -> tuple[Array, Array, Array, Array]:
        """Internal forces f and K @ lam on every vertex (V, 3), each with the sizes of its terms, at positions x (V, 3)."""
        a, b = self.edges.T
        v, w, k = x[b] - x[a], lam[b] - lam[a], self.constant[:, None]
        long = root((v * v).sum(axis=1))[:, None]
        u = v / long
        density = k if self.linear else k - k * self.rest[:, None] / long
        bend = density * w + (k - density) * (u * w).sum(axis=1, keepdims=True) * u
        size = abs(k * v) + (0 if self.linear else abs(k * self.rest[:, None] * u))
        sums = [0 * x for _ in range(4)]
        for end, sign in ((a, 1), (b, -1)):
            for total, terms in zip(
                sums, (sign * density * v, size, -sign * bend, abs(k) * abs(w).sum(axis=1, keepdims=True)), strict=True
            ):
                np.add.at(total, end, terms)
        return sums[0], sums[1], sums[2], sums[3]

    def at(self, unknowns: Array) -> Array:
        """All positions (V, 3) with the free ones from the unknowns (3n,)."""
        x = self.held.copy()
        x[self.free] = unknowns.reshape(-1, 3)
        return x

    def equilibrium(self, forces: Array) -> System:
        """f(x) + g + p = 0 in the free positions (3n,), under given forces (V, 3)."""
        applied = exact(forces) + self.loads

        def system(z: Array) -> tuple[Array, Array]:
            x = self.at(z)
            force, size, _, _ = self.edgewise(x, 0 * x)
            return (force + applied)[self.free].ravel(), (size + abs(applied))[self.free].ravel()

        return system

    def optimum(self, supports: Array) -> System:
        """The conditions of a stationary point in free positions, duals (3n each) and forces at `supports` (m,), in this order.

        f(x) + g + p = 0,     2 M (x - xhat) - K lam = 0,     lam + R'(p) = 0 where a support stands.
        """
        count = 3 * len(self.free)

        def system(z: Array) -> tuple[Array, Array]:
            x, p, lam = self.at(z[:count]), 0 * self.held, 0 * self.held
            lam[self.free], p[supports] = z[count : 2 * count].reshape(-1, 3), z[2 * count :].reshape(-1, 3)
            force, force_size, bend, bend_size = self.edgewise(x, lam)
            pull = 2 * (self.metric * (x - self.target)[:, None, :]).sum(axis=2)
            pull_size = 2 * (abs(self.metric) * (abs(x) + abs(self.target))[:, None, :]).sum(axis=2)
            slope = 0 * p[supports]
            if self.penalised:
                size = (p[supports] ** 2).sum(axis=1) + self.eps
                slope = (self.weight[supports] * self.alpha * size ** (self.alpha / 2 - 1))[:, None] * p[supports]
            parts = ((force + p + self.loads)[self.free], (pull - bend)[self.free], lam[supports] + slope)
            terms = (
                (force_size + abs(p) + abs(self.loads))[self.free],
                (pull_size + bend_size)[self.free],
                abs(lam[supports]) + abs(slope),
            )
            return np.concatenate([part.ravel() for part in parts]), np.concatenate([term.ravel() for term in terms])

        return system
