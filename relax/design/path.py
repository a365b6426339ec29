"""The path of designs from "nothing stands" down: one design a weight, heaviest first, until enough supports stand or it fits.

The problem is not convex, so each weight is solved twice, from the design before it and afresh, and the lower one is kept
(MATHEMATICS.md, "Path and count").
"""

import copy
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from relax.arrays import Floats
from relax.design.optimality import EQUILIBRIUM
from relax.design.problem import Problem
from relax.design.solve import Design, solve
from relax.design.starts import is_planted, unsupported
from relax.design.starts import largest_weight as largest_lasso_weight
from relax.design.trace import Callback
from relax.errors import InputError, RelaxError
from relax.sparsity.penalties import is_convex, steepest

Begin = tuple[Floats, Floats]  # positions and forces (V, 3)

RATIO = 0.6  # of neighbouring weights: on the scenes of data/ the number of supports then rarely more than doubles
DOUBLINGS = (
    20  # of the first weight, until nothing stands: 1 to 2 were seen with the smoothing of data/, 8 with a millionth of it
)
BISECTIONS = 6  # between two neighbouring weights: to 0.8 % of the weight
# supports: with more, to start from the design before takes 3 to 10 times as long as afresh and was mostly no lower (bumps,
# pavilion); so it is done only where afresh ends above that design
MANY = 40
# weights, down to 8e-4 of the first; and the share of the candidates with which nothing is sparse any more and only time is lost
STEPS, MOST = 15, 0.25
LONGEST, DENSEST = 28, 0.5  # the same where a count or a distance is asked for: down to 1e-6 of the first


def largest_weight(problem: Problem) -> float:
    """The smallest k_sparse at which no support passes the dual test at the unsupported equilibrium, length^2 / force^alpha.

        max over g of |P_C(-lam_g)| / (c_g w(0)),     w(0): the steepest slope of the penalty

    Raises
    ------
    EquilibriumError
        The membrane without supports finds no rest, or does not stand.

    Notes
    -----
    From this weight on the judge accepts the membrane without supports. It is where no support passes the test, not where none
    pays. The group lasso costs every newton alike, and on data/ nothing was found to stand above this weight. A concave
    penalty costs a large force less than its first newton, so the less is smoothed the farther the two are apart: with alpha =
    0.5 and the smoothing of each scene nothing stands from 1.0 (pavilion), 2.4 to 3.9 (the others) and 10 (terrain) times
    this weight on, with eps = 1e-6 from 85 and 209 times on (pavilion, five-masts). With eps -> 0, as for the count, w(0) is
    infinite and this weight 0, though supports pay. `path` finds by trial where nothing stands.
    """
    return largest_lasso_weight(problem, unsupported(problem)) / steepest(problem.penalty)


def path(
    problem: Problem,
    weights: Iterable[float] | None = None,
    count: int | None = None,
    rms: float | None = None,
    callback: Callback | None = None,
) -> Iterator[Design]:
    """Designs of one problem, the heaviest weight first, each solved when it is asked for.

    Parameters
    ----------
    problem : Problem
        Its own weight plays no part.
    weights : numbers above 0, optional
        k_sparse; default: from a weight at which nothing stands down, each 0.6 times the one before.
    count : int, optional
        At most so many supports: the path ends at the lightest weight that it finds with no more, by bisection.
    rms : float, optional
        Metres: the path ends at the heaviest weight that it finds with an rms distance of no more, by bisection.
    callback : function, optional
        As for `solve`, which hears of every run.

    Returns
    -------
    iterator of Design
        The last one is the answer to `count` or `rms`; its `stop` says so where that is not reached. Its iterations,
        factorisations and seconds count both runs of its weight.

    Raises
    ------
    InputError
        At once: both a count and a distance, or a weight, count or distance out of its range; without `weights`, a part of
        the membrane without a fixed vertex. With the first design: the membrane without supports already lies on the target,
        so no weight is useful.
    EquilibriumError
        With the first design: without `weights`, the membrane does not stand without supports.

    Notes
    -----
    The first of the default weights is `largest_weight`, doubled until nothing stands. They end after 15 (28 with a count or a
    distance), or where a quarter (half) of the candidates stand. An interrupted design is the last.
    """
    if count is not None and rms is not None:
        raise InputError("path: both a number of supports and an rms distance are asked for: ask for one of them")
    if count is not None and count < 0:
        raise InputError(f"count is {count}: give a whole number of 0 or above")
    if rms is not None and not (np.isfinite(rms) and rms > 0):
        raise InputError(f"rms is {rms}: give a distance above 0, metres")
    series = None if weights is None else sorted({float(weight) for weight in weights}, reverse=True)
    if series is not None and not (series and np.isfinite(series).all() and series[-1] > 0):
        raise InputError(f"weights are {series}: give at least one, all of them positive numbers")
    if series is None and problem.membrane.floating:
        raise InputError(
            "path: it begins where nothing stands, and a part of the membrane has no fixed vertex, so without supports it is "
            "nowhere at rest: give weights (in Python), or fix a vertex"
        )
    steps, most = (STEPS, MOST) if count is None and rms is None else (LONGEST, DENSEST)
    way = _Way(_weight_by_number(problem), series, steps, most, callback)
    if count is not None:
        return _at_most(way, count)
    return way.designs() if rms is None else _as_near_as(way, rms)


def _weight_by_number(problem: Problem) -> Problem:
    """The problem without the fraction that its scene may give for the weight: results would carry it along."""
    if problem.scene.settings["penalty"].get("weight_fraction") is None:
        return problem
    settings: dict[str, Any] = copy.deepcopy(dict(problem.scene.settings))
    settings["penalty"]["weight_fraction"] = None
    return problem.replace(scene=replace(problem.scene, settings=settings))


@dataclass(frozen=True)
class _Way:
    """Where a path begins, and how it goes on from one design to the next."""

    problem: Problem
    weights: list[float] | None
    steps: int
    most: float  # supports, a share of the candidates, beyond which it does not go on
    callback: Callback | None

    def designs(self) -> Iterator[Design]:
        """One a weight."""
        if self.weights is None:
            yield from self._downwards()
            return
        before = None
        for weight in self.weights:
            before = self.at(weight, before)
            yield before
            if before.interrupted:
                return

    def _downwards(self) -> Iterator[Design]:
        design = self._nothing_stands()
        yield design
        most = self.most * len(self.problem.supports.vertices)
        for _ in range(self.steps - 1):
            if design.interrupted or design.certificate.supports > most:
                return
            design = self.at(RATIO * design.problem.strength, design)
            yield design

    def _nothing_stands(self) -> Design:
        """The design at the first weight, doubled until no more stands than must."""
        problem = self.problem
        shape = unsupported(problem)
        if is_planted(problem, shape):
            raise InputError(
                "path: the membrane without supports already lies on the target, so no weight is useful: give another target"
            )
        positions, forces = shape.positions, problem.all_forces(shape.amplitudes)
        # with an infinite slope at 0: a support that costs more than the whole distance pays nowhere
        weight = largest_lasso_weight(problem, shape) / steepest(problem.penalty) or problem.distance(positions)
        design = None
        for _ in range(DOUBLINGS):
            design = self._lowest(weight, [(positions, forces), None])
            if design.interrupted or design.certificate.supports <= np.count_nonzero(problem.supports.always):
                break
            weight *= 2
        assert design is not None
        return design

    def at(self, weight: float, before: Design | None) -> Design:
        """The lower of the designs from the one before, which it can only improve on, and afresh."""
        if before is None:
            return self._lowest(weight, [None])
        warm = before.positions, before.forces
        # a convex problem has one minimum, wherever one starts
        if self.problem.membrane.linear and is_convex(self.problem.penalty):
            return self._lowest(weight, [warm])
        if before.certificate.supports <= MANY:
            return self._lowest(weight, [warm, None])
        return self._lowest(weight, [None, warm], self._worth(weight, before))

    def _worth(self, weight: float, design: Design) -> float:
        """The objective of a design under another weight."""
        problem = self.problem.replace(weight=weight)
        return problem.objective(design.positions, problem.supports.amplitudes(design.forces[problem.membrane.free]))

    def _lowest(self, weight: float, starts: "list[Begin | None]", enough: float = -np.inf) -> Design:
        """The best of the designs from several starts (None: those that the scene asks for); one that is low enough ends it."""
        problem = self.problem.replace(weight=weight)
        found: list[Design] = []
        for start in starts:
            try:
                found.append(solve(problem, start=start, callback=self.callback))
            except RelaxError:
                if not found and start is starts[-1]:
                    raise
                continue
            said = found[-1].certificate
            if found[-1].interrupted or (said.converged and said.objective <= enough):
                break
        best = min(found, key=_rank)
        return replace(
            best,
            iterations=sum(design.iterations for design in found),
            factorizations=sum(design.factorizations for design in found),
            seconds=sum(design.seconds for design in found),
            interrupted=found[-1].interrupted,
            stop=found[-1].stop if found[-1].interrupted else best.stop,
        )


def _rank(design: Design) -> tuple[bool, bool, float]:
    said = design.certificate
    return not said.converged, said.equilibrium > EQUILIBRIUM, said.objective


def _at_most(way: _Way, count: int) -> Iterator[Design]:
    """Designs with at most `count` supports, then ever lighter ones by bisection before the first with more."""
    heavy = light = None
    for design in way.designs():
        if design.certificate.supports > count and not design.interrupted:
            light = design
            break
        heavy = design
        yield design
    if light is None or (heavy is not None and heavy.interrupted):
        return
    if heavy is None:
        said = light.certificate.supports
        yield replace(light, stop=f"{light.stop}; the path has no design with at most {count} supports: it begins with {said}")
        return
    for _ in range(BISECTIONS):
        middle = way.at(_between(heavy, light), heavy)
        if middle.interrupted or middle.certificate.supports <= count:
            heavy = middle
            yield middle
        else:
            light = middle
        if middle.interrupted:
            return


def _as_near_as(way: _Way, rms: float) -> Iterator[Design]:
    """Designs that are farther than `rms`, ever lighter, and at last the heaviest found that is not."""
    heavy = light = None
    held: Design | None = None  # the last is known as such when there is no other
    for design in way.designs():
        if held is not None:
            yield held
            heavy = held
        held = None
        if design.interrupted:
            yield design
            return
        if design.certificate.rms_distance <= rms:
            light = design
            break
        held = design
    if light is None:
        assert held is not None
        yield replace(
            held,
            stop=f"{held.stop}; the path ends here, before the rms distance is as small as {rms:g} m",
        )
        return
    if heavy is not None:
        for _ in range(BISECTIONS):
            middle = way.at(_between(heavy, light), heavy)
            if middle.interrupted:
                yield middle
                return
            if middle.certificate.rms_distance <= rms:
                light = middle
            else:
                heavy = middle
                yield middle
    yield light


def _between(heavy: Design, light: Design) -> float:
    return float(np.sqrt(heavy.problem.strength * light.problem.strength))
