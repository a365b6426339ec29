"""relax: inverse form-finding of tensile structures, from the shape that is wanted to the few masts that hold it."""

from importlib import import_module
from typing import Any

_HOMES = {
    "relax.design.form": ("form",),
    "relax.design.assurance": ("Assurance", "assurance"),
    "relax.design.compare": ("Row", "compare", "ranked"),
    "relax.design.explain": ("Explanation", "SupportValue", "explain"),
    "relax.design.mast_values": ("MastValues", "mast_values"),
    "relax.design.methods.sequential": ("Sequential",),
    "relax.design.optimality": ("Certificate", "judge"),
    "relax.design.path": ("largest_weight", "path"),
    "relax.design.problem": ("Problem",),
    "relax.design.solve": ("Design", "solve"),
    "relax.design.starts": ("resolve_weight",),
    "relax.design.trade_off": ("TradeOff", "choose", "trade_off"),
    "relax.errors": ("BackendError", "EquilibriumError", "InputError", "RelaxError", "StopRun"),
    "relax.files.draft": ("draft_scene",),
    "relax.files.from_arrays": ("scene_from_arrays", "scene_from_heights"),
    "relax.files.network": ("export",),
    "relax.files": ("StoredResult", "load_result", "load_scene", "write_result"),
    "relax.membrane.mesh": ("Mesh", "grid_mesh", "mesh_from_faces"),
    "relax.membrane.scene": ("Scene", "build_scene"),
    "relax.plots.curve": ("draw_trade_off",),
    "relax.plots.field": ("draw_field", "draw_values"),
    "relax.plots.page": ("draw_page",),
    "relax.plots.picture": ("draw_picture",),
    "relax.plots.rounding": ("draw_rounding",),
    "relax.plots.tensions": ("draw_tensions",),
    "relax.plots.trace": ("draw_trace",),
    "relax.sparsity.checks": ("Check", "check_penalty"),
    "relax.sparsity.penalties": ("MCP", "SCAD", "Count", "GroupLasso", "LogSum", "Power", "group_prox"),
    "relax.sparsity.surrogates": ("REWEIGHTED_L1", "REWEIGHTED_L2", "Continuation"),
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
