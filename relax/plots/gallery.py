"""Every picture of one design, by the name of its file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from relax.plots.field import draw_values
from relax.plots.picture import draw_picture
from relax.plots.rounding import draw_rounding
from relax.plots.tensions import draw_tensions
from relax.plots.trace import draw_trace

if TYPE_CHECKING:
    from relax.design.solve import Design

PICTURES: Mapping[str, Callable[["Design", Path], None]] = {
    "picture": draw_picture,
    "tensions": draw_tensions,
    "trace": draw_trace,
    "rounding": draw_rounding,
    "values": draw_values,
}
