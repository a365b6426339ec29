"""The one visual language of all pictures: sizes as they are printed, fonts, colours, marks, and how a figure becomes a file."""

from bisect import bisect
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, Stroke, withStroke
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator

from relax.arrays import Floats
from relax.errors import InputError

COLUMN, PAGE = 3.5, 7.0  # inches: one column of a journal's page, and both; figures are drawn as large as they are printed
DOTS = 300  # per inch, what printers ask of pictures
TINY, SMALL, LARGE = 6.5, 7.0, 8.0  # points in print: numbers, words, headline; journals ask for 6 or more

# told apart by every kind of colour vision (Okabe and Ito), and by their marks without colour
MAST, TIE_DOWN, STAY = to_rgba("#1a1a1a"), to_rgba("#d55e00"), to_rgba("#cc4499")
LINE, BEST, SLACK, OTHERS = to_rgba("#0072b2"), to_rgba("#d55e00"), to_rgba("#0072b2"), to_rgba("#999999")
INK, FAINT_INK, WANTED, HELD = to_rgba("#1a1a1a"), to_rgba("#555555"), to_rgba("#333333", 0.45), to_rgba("#5a4632")
CABLE, CABLE_CORE = to_rgba("#1a1a1a"), to_rgba("#f0e442")  # a rope: light inside a dark outline
GROUND, GRID, NOWHERE = to_rgba("#f1f0ec"), to_rgba("#d5d3cc"), to_rgba("#e3e1db")


def _part(name: str, low: float, high: float) -> LinearSegmentedColormap:
    return LinearSegmentedColormap.from_list(name, colormaps[name](np.linspace(low, high, 256)))


# one hue a quantity, light to dark, from a part of the map that stands out from white paper and leaves black struts readable
ERROR, TENSION, WORTH = _part("YlGnBu", 0.12, 0.85), _part("YlOrBr", 0.22, 1.0), _part("Purples", 0.12, 0.95)

TICK: Any = {"fontsize": TINY, "color": FAINT_INK}
WORDS: Any = {"fontsize": SMALL, "color": INK}
POINT: Any = {"linestyle": "", "marker": "o", "markersize": 1.8, "color": HELD}
CORNER: Any = {
    "fontsize": SMALL,
    "frameon": False,
    "loc": "upper left",
    "bbox_to_anchor": (0.0, 0.955),
}  # a legend below the headline
STILL: Any = {"autolim": False}  # limits are set by hand
SHAPES = 5000  # more than these in one layer go into a vector file as pixels: it would be slow to open
FORMATS = ("png", "pdf", "svg")
FEW = 1.6  # decades: a narrower axis shows marks between the powers of ten
BETWEEN = ((0.6, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)), (FEW, (1.0, 2.0, 5.0)))  # up to so many decades, these


def new_figure(width: float, height: float) -> Figure:
    """A white figure of `width` x `height` inches that pyplot knows nothing of."""
    figure = Figure(figsize=(width, height), dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure in the format that the ending of `path` names; the same figure gives the same bytes.

    Raises
    ------
    InputError
        Another ending than .png, .pdf or .svg.
    """
    kind = path.suffix[1:].lower()
    if kind not in FORMATS:
        raise InputError(f"{path.name}: a picture is a {', '.join('.' + name for name in FORMATS)} file: give it such a name")
    undated: Any = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    # fonts go in as fonts, so that print shops can handle them and words stay words
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": "relax"}):
        figure.savefig(path, dpi=DOTS, format=kind, metadata=undated.get(kind))


def headline(figure: Figure, title: str, figures: str = "") -> None:
    """Write `title` and `figures` at the top left in one line; a title too long for it is cut, never the figures."""
    room = 0.98 * figure.bbox.width
    said = figure.text(0.012, 1.0 - 0.06 / figure.get_figheight(), "", fontsize=LARGE, color=INK, va="top")
    rest = f": {figures}" if figures else ""

    def too_long(length: int) -> bool:
        said.set_text((title if length == len(title) else title[:length].rstrip(" ,;:") + "\N{HORIZONTAL ELLIPSIS}") + rest)
        return bool(said.get_window_extent().x1 > room)

    if title and too_long(len(title)):
        too_long(max(bisect(range(len(title)), 0, key=too_long) - 1, 0))


def plain_ticks(axis: Axis, count: int = 5) -> None:
    """Set few, plain numbers: the exponents that matplotlib splits off would hang in the wrong place."""
    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10]))
    axis.set_major_formatter(lambda value, _: number_text(value))
    axis.set_tick_params(labelsize=TINY)


def plain_marks(axis: Axis, values: Floats) -> None:
    """Mark a short logarithmic axis at plain numbers; matplotlib's powers of ten would run into each other."""
    decades = np.log10(values.max() / values.min())
    for most, marks in BETWEEN:
        if decades < most:
            axis.set_major_locator(LogLocator(subs=marks))
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            break
    axis.set_minor_formatter(lambda *_: "")


def ticks(low: float, high: float, count: int) -> Floats:
    """Round numbers from `low` to `high`."""
    values = np.asarray(MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low, high))
    room = 1e-9 * (high - low)
    return values[(values >= low - room) & (values <= high + room)]


def number_text(value: float) -> str:
    """A number as an axis shows it."""
    return f"{value:.6g}".replace("-", "\N{MINUS SIGN}")


def prefix(value: float, largest: int = 6) -> tuple[float, str]:
    """The power of 1000 in which `value` is shown without zeros, at most 10^`largest`, and the letter before the unit."""
    for power, letter in ((6, "M"), (3, "k"), (0, ""), (-3, "m"), (-6, "\N{MICRO SIGN}"), (-9, "n")):
        # half a digit below, or 999.7 N would become 1e+03 N
        if power <= largest and value >= 0.9995 * 10.0**power:
            return 10.0**power, letter
    return 1.0, ""


def newtons(value: float) -> str:
    """A force of any size in three digits and its unit."""
    factor, letter = prefix(value)
    return f"{value / factor:.3g} {letter}N"


def metres(value: float) -> str:
    """A length of any size in three digits and its unit; kilometres are metres, as everywhere in a scene."""
    factor, letter = prefix(value, 0)
    three = float(f"{value / factor:.3g}")  # 3590, not 3.59e+03
    return f"{number_text(three)} {letter}m"


def colour_bar(
    figure: Figure, scale: ScalarMappable, place: tuple[float, float, float, float], words: str, unit: str = ""
) -> None:
    """A bar that says in `words` what the colours of `scale` are; thousandths of `unit` where that reads better."""
    bar = figure.colorbar(scale, cax=figure.add_axes(place), orientation="horizontal")
    top = float(scale.get_clim()[1] or 1.0)
    factor, letter = prefix(top, 0 if unit == "m" else 6) if unit else (1.0, "")
    bar.set_label(f"{words}, {letter}{unit}" if unit else words, **WORDS)
    # round numbers of what is shown, not of what is measured
    bar.ax.xaxis.set_major_locator(FixedLocator(list(factor * ticks(0.0, top / factor, 5))))
    bar.ax.xaxis.set_major_formatter(lambda value, _: number_text(value / factor))
    bar.ax.tick_params(length=2.0, width=0.5, pad=2.0, labelsize=TINY)
    bar.outline.set_visible(False)


def quiet_axes(axes: Any) -> None:
    """Thin marks and a pale grid behind what is drawn; no frame on the right and at the top."""
    axes.tick_params(labelsize=TINY, length=2.5, width=0.5, pad=2.0)
    axes.tick_params(which="minor", length=1.5, width=0.4)
    axes.grid(visible=True, color=GRID, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_linewidth(0.5)


def rope(label: str) -> Line2D:
    """A cable in a legend."""
    casing = [Stroke(linewidth=1.8, foreground=CABLE), Normal()]
    return Line2D([], [], color=CABLE_CORE, linewidth=0.8, path_effects=casing, label=label)


def halo(width: float = 1.4) -> list[Any]:
    """A white rim around words and marks that lie on colours."""
    return [withStroke(linewidth=width, foreground="white")]
