"""relax: inverse form-finding of tensile structures, from the shape that is wanted to the few masts that hold it."""

from relax.design.optimality import Certificate, judge
from relax.design.problem import Problem
from relax.design.solve import Design, form, solve
from relax.errors import BackendError, EquilibriumError, InputError, RelaxError
from relax.membrane.scene import Scene, build_scene
from relax.sparsity.penalties import GroupLasso, Power

__all__ = [
    "BackendError",
    "Certificate",
    "Design",
    "EquilibriumError",
    "GroupLasso",
    "InputError",
    "Power",
    "Problem",
    "RelaxError",
    "Scene",
    "build_scene",
    "form",
    "judge",
    "solve",
]
