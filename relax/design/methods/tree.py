"""Branch and bound over the segments in which each force lies, by SCIP, with cuts from the relaxation of each node.

SCIP sees a linear program: a binary for each group and segment, and a value eta above every cut. At each node the relaxation on
the segments that are left gives one more cut, which is valid everywhere. Nothing that SCIP reports as a bound rests on how well
the cuts were found (Bertsimas, Pauphilet and Van Parys 2021; perspective: Frangioni and Gentile 2006).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from relax.arrays import Floats, Mask
from relax.design.methods.relaxation import FINE, ROUGH, Cut, Relaxation
from relax.errors import InputError

SAME = 1e-6  # relative: a value within this of the best is the same
CLOSE = 1e-3  # the same where the pieces lie below the penalty: the tree cannot tell more, and would not end for trying
FEASIBLE = 1e-7  # of SCIP's rows: below all of these
GRAIN = 1e-8  # coefficients are rounded down to this: next to nothing lost for each, and no row holds round-off
NEW = 1e-4  # by which a node's cut must rise above those before: rows that nearly repeat each other spoil the linear program
ENOUGH = 1.1  # of the known value: a cut that reaches it need not go higher


@dataclass(frozen=True)
class Explored:
    """What a tree came to: a lower bound of every point, better forces (m, c) than before if any, nodes, and whether it ended."""

    bound: float
    amplitudes: Floats | None
    nodes: int
    finished: bool


def explore(relaxation: Relaxation, best: float, candidate: Callable[[Floats], tuple[float, Floats]], seconds: float) -> Explored:
    """Search for a value below `best`.

    Parameters
    ----------
    relaxation : Relaxation
        For points of value at most `best`.
    best : float
        Value of a point that is known.
    candidate : function of forces (m, c)
        Gives the value and forces of a true point near them.
    seconds : float
        When to stop.

    Raises
    ------
    InputError
        pyscipopt is not installed.
    """
    try:
        import pyscipopt
    except ImportError:
        raise InputError('pyscipopt is not installed: pip install "relax-tensile[exact]" or pip install pyscipopt') from None
    begin = time.perf_counter()
    master = _Master(pyscipopt, relaxation, best, candidate)
    point, allowed = relaxation.quadratic.fitted, relaxation.everywhere
    cut, master.point = relaxation.tightest(allowed, point, best)
    master.add(cut)
    root = cut.bound(allowed)
    master.offer(allowed)
    left = max(seconds - (time.perf_counter() - begin), 0.0)
    bound, nodes, finished = master.optimize(left)
    bound = min(max(bound, root), master.best)
    return Explored(bound, master.forces, nodes, finished)


class _Master:
    """The linear program that SCIP branches on, and what its callbacks do; values are in units of the best known."""

    def __init__(
        self, scip: Any, relaxation: Relaxation, best: float, candidate: Callable[[Floats], tuple[float, Floats]]
    ) -> None:
        self.relaxation, self.best, self.candidate, self.unit = relaxation, best, candidate, best
        self.close = SAME if relaxation.exact else CLOSE
        self.point = relaxation.quadratic.fitted
        self.forces: Floats | None = None
        self.seen: set[bytes] = set()
        self.box = b""
        self.scip, self.model = scip, scip.Model()
        self.model.hideOutput()
        # the linear program is small and the callbacks see it as it was written
        self.model.setPresolve(scip.SCIP_PARAMSETTING.OFF)
        self.model.setHeuristics(scip.SCIP_PARAMSETTING.OFF)
        self.model.setSeparating(scip.SCIP_PARAMSETTING.OFF)
        self.eta = self.model.addVar("eta", lb=0.0)
        self.model.setObjective(self.eta)
        self.model.setObjlimit(1 - self.close)
        self.model.setParam("numerics/feastol", FEASIBLE)  # else a cut just added can still be missed by what asked for it
        self.binary: list[list[Any]] = []
        for g, reachable in enumerate(relaxation.everywhere):
            row = [self.model.addVar(f"z_{g}_{j}", vtype="B", ub=float(yes)) for j, yes in enumerate(reachable)]
            self.model.addCons(scip.quicksum(row) == 1)
            self.binary.append(row)
        handler = _handler(scip, self)
        self.model.includeConshdlr(
            handler,
            "relaxation",
            "cuts of the relaxation",
            sepapriority=1,
            enfopriority=-1,
            chckpriority=-1,
            sepafreq=1,
            eagerfreq=-1,
            needscons=False,
        )

    def add(self, cut: Cut) -> None:
        """A row for a cut, less high where it is above what matters: lowering a coefficient keeps a cut valid."""
        reachable = self.relaxation.everywhere
        least = np.where(reachable, cut.values, np.inf).min(axis=1, keepdims=True)
        # a segment with which the value is beyond the known one is out; by how much only spoils the linear program
        room = max(ENOUGH * self.unit - cut.bound(reachable), 0.0)
        values = np.where(reachable, np.minimum(cut.values, least + room), least) / self.unit
        values = np.floor(values / GRAIN) * GRAIN
        total = [
            float(value) * variable
            for row, variables in zip(values, self.binary, strict=True)
            for value, variable in zip(row, variables, strict=True)
        ]
        self.model.addCons(self.eta - self.scip.quicksum(total) >= cut.constant / self.unit)

    def left(self) -> Mask:
        """Segments (m, J) that the present node leaves."""
        upper = [[self.model.getTransformedVar(z).getUbLocal() for z in row] for row in self.binary]
        return np.array(upper) > 0.5

    def solution(self, solution: Any) -> tuple[Floats, float]:
        """The choice (m, J) and eta of a solution of the linear program."""
        chosen = [[self.model.getSolVal(solution, z) for z in row] for row in self.binary]
        return np.array(chosen), float(self.model.getSolVal(solution, self.eta))

    def tighten(self, allowed: Mask, chosen: Floats, eta: float, smoothings: tuple[float, ...], least: float) -> bool:
        """Add the cut of the relaxation over the allowed segments if the present solution is below it."""
        cut, self.point = self.relaxation.tightest(allowed, self.point, self.unit, smoothings)
        below = (cut.constant + float((cut.values * chosen).sum())) / self.unit
        if below <= eta + least:
            return False
        self.add(cut)
        return True

    def separate(self) -> bool:
        """At a node: the relaxation there, once."""
        allowed = self.left()
        chosen, eta = self.solution(None)
        if allowed.tobytes() == self.box:
            return False
        self.box = allowed.tobytes()
        cut = self.tighten(allowed, chosen, eta, ROUGH, NEW)
        self.offer(allowed, chosen)
        return cut

    def settle(self, solution: Any) -> bool:
        """Whether a choice of one segment each is worth what it claims; a cut if not."""
        chosen, eta = self.solution(solution)
        cut = self.tighten(chosen > 0.5, chosen, eta, FINE, max(SAME, 0.1 * self.close))
        self.offer(chosen > 0.5, chosen)
        return not cut

    def offer(self, allowed: Mask, chosen: Floats | None = None) -> None:
        """True points, kept if they are the best so far: the relaxation's own forces, and its point where `chosen` stands."""
        found = [self.relaxation.forces(allowed, self.point)]
        if chosen is not None:
            stands = (chosen[:, 0] < 0.5) | ~self.relaxation.chosen
            found.append(np.where(stands[:, None], self.point, 0.0))
        for each in found:
            key = each.any(axis=1).tobytes()
            if key in self.seen:
                continue
            self.seen.add(key)
            value, forces = self.candidate(each)
            if value < self.best:
                self.best, self.forces = value, forces

    def holds(self, solution: Any) -> bool:
        """Whether a solution's eta is no lower than its own relaxation."""
        chosen, eta = self.solution(solution)
        allowed = chosen > 0.5
        cut, _ = self.relaxation.tightest(allowed, self.point, self.unit)
        return bool(cut.bound(allowed) / self.unit <= eta + max(SAME, 0.1 * self.close) + FEASIBLE)

    def optimize(self, seconds: float) -> tuple[float, int, bool]:
        """Lower bound, nodes, and whether the tree was searched to its end."""
        self.model.setParam("limits/time", seconds)
        try:
            self.model.optimize()
        except Exception as error:  # pyscipopt raises nothing narrower where a linear program fails
            if "SCIP" not in str(error):
                raise
            return 0.0, int(self.model.getNNodes()), False
        status = self.model.getStatus()
        if status == "userinterrupt":  # SCIP catches Ctrl-C itself
            raise KeyboardInterrupt
        finished = status in ("optimal", "infeasible")
        limit = 1 - self.close
        bound = limit if status == "infeasible" else min(float(self.model.getDualbound()), limit)
        return bound * self.unit, int(self.model.getNNodes()), finished


def _handler(scip: Any, master: _Master) -> Any:
    """SCIP's callbacks: it asks at each node, and for each choice that it would accept."""
    result = scip.SCIP_RESULT

    class Handler(scip.Conshdlr):  # type: ignore[misc]  # SCIP has no types
        def conssepalp(self, *_: Any) -> dict[str, Any]:
            return {"result": result.CONSADDED if master.separate() else result.DIDNOTFIND}

        def consenfolp(self, *_: Any) -> dict[str, Any]:
            return {"result": result.FEASIBLE if master.settle(None) else result.CONSADDED}

        def consenfops(self, *_: Any) -> dict[str, Any]:
            return {"result": result.SOLVELP}

        def conscheck(self, _: Any, solution: Any, *__: Any) -> dict[str, Any]:
            return {"result": result.FEASIBLE if master.holds(solution) else result.INFEASIBLE}

        def conslock(self, _: Any, locktype: Any, up: int, down: int) -> None:
            self.model.addVarLocksType(master.eta, locktype, up, down)
            for row in master.binary:
                for variable in row:
                    self.model.addVarLocksType(variable, locktype, up + down, up + down)

    return Handler()
