"""relax: inverse form-finding of tensile structures, from the shape that is wanted to the few masts that hold it."""

from importlib import import_module
from typing import Any

_HOMES = {
    "relax.design.optimality": ("Certificate", "judge"),
    "relax.design.problem": ("Problem",),
    "relax.design.solve": ("Design", "form", "solve"),
    "relax.design.starts": ("resolve_weight",),
    "relax.errors": ("BackendError", "EquilibriumError", "InputError", "RelaxError"),
    "relax.files": ("StoredResult", "load_result", "load_scene", "write_result"),
    "relax.membrane.mesh": ("Mesh", "grid_mesh", "mesh_from_faces"),
    "relax.membrane.scene": ("Scene", "build_scene"),
    "relax.plots.picture": ("draw_picture",),
    "relax.sparsity.penalties": ("GroupLasso", "Power"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)  # noqa: PLE0605 - the one list of names is the table above


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used: the command line's --help needs none of them (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"relax has no {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """What `dir(relax)` and completion show."""
    return __all__
