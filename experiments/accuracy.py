"""Accuracy: how many digits an answer has, beside references by hand and in 50 digits.

Question: is every figure right to the last digits that double precision allows, and if not, where are they lost?

    python experiments/accuracy.py               half a minute
    python experiments/accuracy.py --size small  some seconds

`by hand`: one spring under a load; a hanging chain by the recursion of its tensions (two equations, the pull at its end); the
square pyramid, 6/5 N at 3/4 m. `50 digits`: equilibrium, and the conditions of the inverse problem, on the numbers of the scene
as the doubles that they are (experiments/extended.py; mpmath). `error` is the largest of the vector, relative to its largest
entry. `condition` is what double precision must lose, in units of its epsilon: the round-off of each equation's own terms,
carried to the unknowns by the inverse of the Jacobian. `lost` is error / (epsilon times condition): below 1 every digit is right
that can be. Exit status 1 above LIMIT.

Finding: of 34 figures 31 have every digit that double precision can give, most of them to a tenth of the bound; forces that
were planted come back to 2e-15. The rest: a noisy tent loses three times the bound, forces 2e-14, as Newton on the support ends
at a stationarity of 1e-12, which one more step would undercut at the price of new columns; the pyramid's force loses 1.3 times.
Where form-finding ended at its residual of 1e-13 without a last solve, joints, heights and planted forces lost ten to twenty
times the bound.
"""

import sys
from collections.abc import Iterator
from typing import Any

import mpmath
import numpy as np
from extended import EPSILON, Array, Extended, Reference, exact, solved
from rows import Row, measured
from stress.scenes import ONE, TWO, built, hilly, planted

import relax
from relax.membrane.formers import form_find
from relax.membrane.membrane import Membrane
from relax.membrane.springs import Hookean

SIDES = {"small": (5,), "full": (5, 7)}
LINKS = {"small": (2, 10), "full": (2, 10, 50)}
LIMIT = 4  # round-off of some sums in a row, of which `condition` counts each term once


def row(case: str, quantity: str, reference: str, found: Any, wanted: Any, condition: float) -> Row:
    """One row: the error of `found` beside `wanted`, relative to its largest entry, as `condition` is."""
    right, mine = (exact(np.atleast_1d(np.asarray(each, dtype=object))).ravel() for each in (wanted, found))
    error = float(max(abs(mine - right)) / max(abs(right)))
    digits = -float(np.log10(max(error, EPSILON / 10)))
    figures = {"error": error, "digits": digits, "condition": condition, "lost": error / EPSILON / condition}
    return {"case": case, "quantity": quantity, "reference": reference, **figures}


def condition_of(reference: Reference, part: slice) -> float:
    """What double precision must lose of a part of the unknowns, in epsilons, relative to its largest entry."""
    return float(reference.attainable[part].max() / max(abs(reference.unknowns[part])) / EPSILON)


def chain(links: int) -> Iterator[Row]:
    """Equal springs in a row between two points, a weight at each joint: the discrete catenary, and one spring that hangs."""
    rest, constant, span, weight = 0.125, 3.0, 0.0625 * links + 0.25, 0.0625
    count = links + 1
    fixed = np.isin(np.arange(count), [0, links])
    edges = np.column_stack([np.arange(links), np.arange(1, count)])
    membrane = Membrane(edges, np.full(links, rest), np.full(links, constant), Hookean(), fixed)
    start = np.zeros((count, 3))
    start[:, 0] = np.linspace(0, span, count)
    start[1:-1, 2] = -0.25
    applied = np.tile([0.0, 0.0, -weight], (links - 1, 1))
    found = form_find(membrane, start, applied).positions

    def places(pull: Any, lift: Any) -> Any:
        """Joints (x, z) with the first spring pulling (pull, lift): each next one pulls a weight less upwards."""
        x, z, joints = mpmath.mpf(0), mpmath.mpf(0), []
        for index in range(links):
            up = lift - index * mpmath.mpf(weight)
            tension = mpmath.sqrt(pull**2 + up**2)
            long = rest + tension / constant
            x, z = x + long * pull / tension, z - long * up / tension
            joints.append((x, z))
        return joints

    def ends(pull: Any, lift: Any) -> Any:
        x, z = places(pull, lift)[-1]
        return [x - mpmath.mpf(float(start[-1, 0])), z]

    tension = (found[1] - found[0]) * constant * (1 - rest / np.linalg.norm(found[1] - found[0]))
    pull, lift = mpmath.findroot(ends, (tension[0], -tension[2]))
    wanted = np.array([(x, mpmath.mpf(0), z) for x, z in places(pull, lift)[:-1]], dtype=object)
    yield row(f"chain of {links}", "joints", "by hand", found[1:-1], wanted, chain_condition(membrane, found, applied))


def chain_condition(membrane: Membrane, positions: Array, applied: Array) -> float:
    """What round-off of the springs' terms does to the joints, in epsilons, relative."""
    inverse = np.linalg.inv(membrane.stiffness(positions).toarray())
    state = membrane.edge_state(positions)
    size = (membrane.spring_constant * (state.length + membrane.rest_length))[:, None] * abs(state.direction)
    terms = np.zeros_like(positions)
    for end in membrane.edges.T:
        np.add.at(terms, end, size)
    place = positions[membrane.free]
    moved = abs(inverse) @ (terms[membrane.free] + abs(applied)).ravel() + abs(place).ravel()
    return float(moved.max() / abs(place).max())


def hanging() -> Iterator[Row]:
    """One spring, and a load straight down from where it is fixed: x = L + P / k."""
    membrane = Membrane(np.array([[0, 1]]), np.array([0.7]), np.array([3.0]), Hookean(), np.array([True, False]))
    found = form_find(membrane, np.array([[0.0, 0, 0], [0, 0, -0.9]]), np.array([[0.0, 0.0, -1.1]])).positions
    wanted = -(mpmath.mpf(0.7) + mpmath.mpf(1.1) / mpmath.mpf(3.0))
    condition = chain_condition(membrane, found, np.array([[0.0, 0.0, -1.1]]))
    yield row("one spring", "end", "by hand", found[1], [0, 0, wanted], condition)


def pyramid(**changes: Any) -> relax.Problem:
    """Four spokes of plan length 1, rest length 3/4 and k = 1 from held corners to a top at 3/4: 6/5 N hold it."""
    target = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 0.75]])
    mesh = relax.mesh_from_faces(5, np.array([[0, 1, 4, -1], [1, 2, 4, -1], [2, 3, 4, -1], [3, 0, 4, -1]]))
    return built(mesh, target, membrane__rest_scale=0.75, **changes)[0]


def by_hand_pyramid() -> Iterator[Row]:
    """Height under 6/5 N, and the force that is found for the height."""
    problem = pyramid(rounding__refit="debiased", penalty__weight=1e-3)
    force = np.zeros((5, 3))
    force[4, 2] = 1.2
    formed, design = relax.form(problem, force), relax.solve(problem)
    reference = solved(Extended(problem).optimum(np.array([4])), unknowns_of(problem, design))
    exactly = [mpmath.mpf(0), mpmath.mpf(0), mpmath.mpf(3) / 4]
    yield row("pyramid", "height", "by hand", formed.positions[4], exactly, condition_of(reference, slice(3)))
    wanted = [mpmath.mpf(0), mpmath.mpf(0), mpmath.mpf(6) / 5]
    yield row("pyramid", "force", "by hand", design.forces[4], wanted, condition_of(reference, slice(6, 9)))


def unknowns_of(problem: relax.Problem, design: relax.Design) -> Array:
    """Positions, duals and forces of a design, as a first guess."""
    free, stands = problem.membrane.free, design.forces.any(axis=1)
    dual = problem.dual(design.positions, problem.factor_at(design.positions))
    return np.concatenate([each.ravel() for each in (design.positions[free], dual, design.forces[stands])])


def forward(case: str, problem: relax.Problem, forces: Array) -> Iterator[Row]:
    """The shape found under given forces."""
    found = relax.form(problem, forces).positions[problem.membrane.free]
    reference = solved(Extended(problem).equilibrium(forces), found.ravel())
    yield row(case, "positions", "50 digits", found, reference.unknowns, condition_of(reference, slice(None)))


def inverse(case: str, problem: relax.Problem, truth: Array | None) -> Iterator[Row]:
    """Positions, forces and objective of a whole inverse run; beside planted forces, where they should be found again."""
    design = relax.solve(problem)
    stands = np.flatnonzero(design.forces.any(axis=1))
    scene, count = Extended(problem), 3 * len(problem.membrane.free)
    guess = unknowns_of(problem, design)
    reference = solved(scene.optimum(stands), guess)
    z = reference.unknowns
    for name, part in (("positions", slice(count)), ("forces", slice(2 * count, None))):
        yield row(case, name, "50 digits", guess[part], z[part], condition_of(reference, part))
    if truth is not None:
        part = slice(2 * count, None)
        yield row(case, "forces", "planted", guess[part], truth[stands], condition_of(reference, part))
    if not scene.penalised:
        return  # R is no part of what was minimised
    p, offset = z[2 * count :].reshape(-1, 3), (scene.at(z[:count]) - scene.target)[scene.free]
    cost = ((p**2).sum(axis=1) + scene.eps) ** (scene.alpha / 2) - scene.eps ** (scene.alpha / 2)
    value = (offset * (scene.metric[scene.free] * offset[:, None, :]).sum(axis=2)).sum() + (scene.weight[stands] * cost).sum()
    # at a stationary point the value does not feel the error of the unknowns: that of its own offsets is left
    felt = float(2 * (abs(offset) * abs(scene.target[scene.free])).sum() / value) + 1
    yield row(case, "objective", "50 digits", design.certificate.objective, value, felt)


def all_rows(size: str) -> list[Row]:
    """Every row of one size."""
    rows = [*hanging(), *(each for links in LINKS[size] for each in chain(links)), *by_hand_pyramid()]
    for side in SIDES[size]:
        linear = {"membrane__springs": "force-density", "membrane__stiffness": 0.3, "membrane__loads": [0.1, 0.0, -1.0]}
        net, _ = built(*hilly(side), **linear, penalty__weight=0.02)
        rows += forward(f"linear net, {side}", net, np.zeros_like(net.scene.target))
        tent, forces = planted(side, ONE, penalty__weight=1e-3)
        rows += forward(f"tent, {side}", tent, forces)
        exactly, forces = planted(side, TWO, penalty__weight=1e-3, rounding__refit="debiased")
        rows += inverse(f"planted, debiased, {side}", exactly, forces)
        rows += inverse(f"planted, {side}", planted(side, TWO, penalty__weight=1e-3)[0], None)
        noisy = planted(side, TWO, 0.01, penalty__weight=0.01)[0]
        rows += inverse(f"noisy, {side}", noisy, None)
        rows += inverse(f"linear net, {side}", net, None)
    return rows


def main() -> int:
    """Measure and print."""
    rows = measured(__doc__ or "", SIDES, all_rows)
    return 1 if any(not row["lost"] <= LIMIT for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
