"""The ledger of a run: what its scene did not need, a sentence each, with a count where there is one.

Each sentence has its row in experiments/ablation.py: the same answer without that skip, and what it saves. The one of starts.py
on heavy starts has none: where the membrane does not stand without supports, there are no such starts.
"""

from relax.design.problem import Problem
from relax.design.trace import Journal, Tally


def sentences(problem: Problem, journal: Journal, factorizations: int) -> tuple[str, ...]:
    """What was skipped in a run that spent so many factorisations, each thing once."""
    found = [*journal.skipped, _fixed(problem), _candidates(journal.tally), _sideways(problem, journal.tally)]
    if problem.membrane.linear:
        found.append("all factorisations of K but one: it is the same at every shape, and x, y and z share a scalar one")
    else:
        found += [_factorisations(journal.tally), _analysis(journal.tally, factorizations)]
    found += [_columns(journal.tally), _trials(journal.tally)]
    return tuple(dict.fromkeys(filter(None, found)))


def _fixed(problem: Problem) -> str:
    fixed = int(problem.scene.fixed.sum())
    return f"{3 * fixed:,} unknowns: those of the {fixed:,} fixed vertices are eliminated" if fixed else ""


def _candidates(tally: Tally) -> str:
    left, count = int((~tally.looked).sum()), len(tally.looked)
    return f"columns of K^-1 for {left:,} of {count:,} candidates: they were never looked at" if left else ""


def _sideways(problem: Problem, tally: Tally) -> str:
    spared = (3 - problem.supports.width) * int(tally.looked.sum())
    return f"{spared:,} columns of K^-1: supports are vertical, so each candidate needs one, not three" if spared else ""


def _factorisations(tally: Tally) -> str:
    if not tally.reused:
        return ""
    return f"a factorisation in {tally.reused} of {tally.compared} steps: one from nearby served (chord steps, refinement)"


def _analysis(tally: Tally, factorizations: int) -> str:
    if factorizations <= tally.patterns:
        return ""
    of = "mesh" if tally.patterns == 1 else "part"
    return f"the analysis of the sparsity pattern: once a {of}, for {factorizations} factorisations"


def _trials(tally: Tally) -> str:
    if not tally.broken:
        return ""
    trials = "one trial" if tally.broken == 1 else f"{tally.broken} trials"
    return f"the rest of {trials}: broken off, the objective lay above what pays and hardly moved"


def _columns(tally: Tally) -> str:
    if not tally.kept:
        return ""
    return f"columns and curvature in {tally.kept} of the Newton steps on a support: those of an earlier step served"
