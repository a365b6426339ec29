"""Methods by name: each leads from a start to rounded supports, and the judge ranks them alike.

A method is a function of a problem, a start and the journal of the run, to which it hands every step (`journal(record)`, where
`refit.figures` makes the record). It gives the shape after rounding and the one before. Adding one: a file here, a line below.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from relax.design.problem import Problem
    from relax.design.shape import Shape
    from relax.design.starts import Start
    from relax.design.trace import Journal

METHODS: dict[str, str] = {  # name in scene files: where the function is, imported when it is used; the default first
    "sequential": "relax.design.methods.sequential:SEQUENTIAL",
    "reweighted-l1": "relax.design.methods.sequential:REWEIGHTED_L1",
    "irls": "relax.design.methods.irls:irls",
    "lagrangian": "relax.design.methods.lagrangian:lagrangian",
    "greedy": "relax.design.methods.greedy:greedy",
    "exact": "relax.design.methods.exact:exact",
}


class Method(Protocol):
    """A function of three."""

    def __call__(self, problem: "Problem", start: "Start", journal: "Journal") -> "tuple[Shape, Shape]":
        """The shape after rounding, and the one before it."""
        ...


def method_by_name(name: str) -> Method:
    """The function that a scene's solver.method names."""
    module, function = METHODS[name].split(":")
    found: Method = getattr(import_module(module), function)
    return found
