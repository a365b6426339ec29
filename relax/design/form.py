"""Forward form-finding: the shape under given support forces, from the scene's flat start, judged like any design."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from relax.arrays import Floats
from relax.design.problem import Problem
from relax.design.race import Outcome, last_refit
from relax.design.shape import Shape
from relax.design.solve import Design, as_design
from relax.design.starts import resolve_weight
from relax.design.trace import Callback, Journal
from relax.errors import InputError, StopRun
from relax.iterate import Stop
from relax.membrane.formers import FORMERS
from relax.membrane.rest import Balance

NOTES = {
    "newton": "Newton on the stiffness matrix",
    "dynamic-relaxation": "dynamic relaxation with kinetic damping",
    "force-density": "multi-step force density",
}


def form(problem: Problem, forces: Floats, method: str = "newton", callback: Callback | None = None) -> Design:
    """Forward form-finding from the scene's flat start under given support forces.

    Parameters
    ----------
    problem : Problem
    forces : (V, 3) newtons
        Support forces, zero where nothing stands.
    method : str
        "newton" (dynamic relaxation takes over where it is lost), "dynamic-relaxation" or "force-density". Where a membrane
        has one stable shape they agree; a slack one may have several.
    callback : function, optional
        Called with the shape found, as in `relax.solve`.

    Returns
    -------
    Design
        Its certificate says whether the shape found is in equilibrium and stands; `stop` says why where it is not. The
        trace's note names the methods that ran.

    Raises
    ------
    InputError
        A method that there is not, a force at a vertex that is no candidate, or forces that do not balance on a part without a
        fixed vertex.

    Notes
    -----
    Forces do not say where a part without a fixed vertex lies: it is moved to where E_dist is least, as `relax.solve` does.
    """
    if method not in FORMERS:
        raise InputError(f"method {method!r} is no way of form-finding: give one of {', '.join(FORMERS)}")
    forces = np.asarray(forces, dtype=np.float64)
    stray = np.flatnonzero(forces.any(axis=1) & ~problem.scene.candidates)
    if stray.size:
        raise InputError(
            f"forces: a support force acts at vertex {stray[0]}, where the scene allows none: take it out, or make the vertex a "
            "candidate (supports.candidates, supports.never)"
        )
    with threadpool_limits(1, "blas"):
        problem = resolve_weight(problem)
        journal = Journal(problem, callback)
        nodal = forces[problem.membrane.free]
        _refuse_unbalanced(problem, nodal + problem.loads)
        found = FORMERS[method](problem.membrane, problem.scene.start, nodal + problem.loads)
        shape = Shape(problem.placed(found.positions), problem.supports.amplitudes(nodal), None, found.factorizations)
        outcome = Outcome(problem, shape, shape, last_refit(problem))
        certificate = outcome.certificate
        journal.stage = "form-finding"
        note = ", then ".join(NOTES[name] for name in found.ran)
        with suppress(StopRun):  # there is nothing left to stop
            journal({"shape": shape, "objective": certificate.objective, "supports": certificate.supports, "note": note})
        stop = Stop.UNSTABLE if found.found and not certificate.stable else found.stop
        return replace(as_design(problem, outcome, journal, stop.value), iterations=found.iterations)


def _refuse_unbalanced(problem: Problem, applied: Floats) -> None:
    """Raise InputError where forces on a part without a fixed vertex do not add up to nothing: it finds no rest."""
    vertex = Balance(problem.membrane, applied, problem.scene.start).adrift
    if vertex is not None:
        raise InputError(
            f"forces: the part of the membrane that holds vertex {vertex} has no fixed vertex, and its support forces and loads "
            "do not add up to nothing, so it rests nowhere: give forces that balance"
        )
