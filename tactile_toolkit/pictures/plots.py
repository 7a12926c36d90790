"""Plots of figures in one style: matplotlib's canvas without a window, and nothing of its global state.

Every function needs matplotlib (extra ``pictures``) and gives pixels.
"""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import needs_extra
from tactile_toolkit.pictures.sheets import ACCENTS, INK, MUTED, hex_of

_DPI = 144
_MOST_BINS = 40
_TITLE_PT, _LEAST_TITLE_PT = 13.0, 9.0
_LETTER_EM = 0.66  # of the font, most letters are narrower
_TITLE_LEFT = 0.012
_STYLE = {
    "axes.edgecolor": hex_of(MUTED),
    "axes.labelcolor": hex_of(INK),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.unicode_minus": False,
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.color": hex_of(INK),
    # Names of data sets and classes may hold dollars.
    "text.parse_math": False,
    "xtick.color": hex_of(MUTED),
    "ytick.color": hex_of(MUTED),
}


@dataclass(frozen=True, slots=True)
class Bars:
    """Counts of one panel: a name for each bar, what the groups are (below the axis), what is counted."""

    title: str
    names: tuple[str, ...]
    counts: tuple[int, ...]
    label: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Values of one panel: name, unit ("" of counts), values of each group, shape (n,), what has them."""

    title: str
    unit: str
    groups: tuple[tuple[str, NDArray[Any]], ...]
    things: str  # what has the values, such as "digits"
    limit: tuple[float, str] | None = None  # a line at a value, and its name


def require_plots(what: str) -> None:
    """Refuse to plot where matplotlib is missing, with a MissingExtraError about ``what``."""
    with needs_extra(what, "matplotlib", "pictures"):
        import matplotlib.figure  # noqa: F401


def plot_bars(panels: Sequence[Bars], title: str) -> NDArray[np.uint8]:
    """Draw counts as bars with their numbers above them, one panel each; colours of shape (H, W, 3)."""
    return _plotted(panels, _fill_bars, (4.4, 2.9, 0.4), title)


def plot_spreads(panels: Sequence[Spread], title: str) -> NDArray[np.uint8]:
    """Draw how values spread, one panel each: the share of each group per bin, and its median; (H, W, 3)."""
    names = [name for name, _ in panels[0].groups]
    return _plotted(panels, _fill_spread, (4.6, 3.0, 0.6), title, names if len(names) > 1 else ())


def _fill_bars(axes: Any, panel: Bars) -> None:
    bars = axes.bar(panel.names, panel.counts, color=hex_of(ACCENTS[0]), width=0.72)
    axes.bar_label(bars, [f"{count:,}" for count in panel.counts], fontsize=8, padding=2)
    axes.set_title(panel.title)
    axes.set_xlabel(panel.label)
    axes.set_ylabel(panel.unit)
    axes.set_ylim(0, 1.12 * max([*panel.counts, 1]))
    axes.yaxis.get_major_locator().set_params(integer=True)
    axes.tick_params(axis="x", length=0)


def _fill_spread(axes: Any, panel: Spread) -> None:
    values = np.concatenate([group for _, group in panel.groups])
    edges = _bin_edges(values)
    for number, (name, group) in enumerate(panel.groups):
        colour = hex_of(ACCENTS[number % len(ACCENTS)])
        shares = 100.0 * np.histogram(group, edges)[0] / max(len(group), 1)
        axes.stairs(shares, edges, color=colour, linewidth=1.6, label=name)
        if len(panel.groups) == 1:
            axes.stairs(shares, edges, color=colour, alpha=0.25, fill=True)
        if len(group):
            axes.plot(
                [np.median(group)] * 2,
                [0, -0.02],
                color=colour,
                linewidth=3,
                clip_on=False,
                transform=axes.get_xaxis_transform(),
                solid_capstyle="butt",
            )
    median = np.median(values) if len(values) else math.nan
    whose = " of all" if len(panel.groups) > 1 else ""
    unit = f" {panel.unit}" if panel.unit else ""
    axes.set_title(f"{panel.title}: median {median:,.4g}{unit}{whose}")
    axes.set_xlabel(f"{panel.title}, {panel.unit}" if panel.unit else panel.title)
    axes.set_ylabel(f"% of {panel.things}")
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_formatter("{x:,.6g}")
    if panel.limit is not None:
        axes.axvline(panel.limit[0], color=hex_of(ACCENTS[3]), linestyle="--", linewidth=1.2)
        axes.annotate(
            panel.limit[1],
            (panel.limit[0], 0.80),
            xycoords=("data", "axes fraction"),
            xytext=(4, 0),
            textcoords="offset points",
            color=hex_of(ACCENTS[3]),
            fontsize=8,
        )


def _bin_edges(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return edges of bins of one width: as many as the number of values carries."""
    if not len(values):
        return np.array([0.0, 1.0])
    low, high = float(values.min()), float(values.max())
    if high <= low:
        return np.array([low - 0.5, low + 0.5])
    return np.linspace(low, high, min(_MOST_BINS, max(6, round(2 * len(values) ** (1 / 2)))) + 1)


def _plotted(
    panels: Sequence[Any],
    fill: Callable[[Any, Any], None],
    size_in: tuple[float, float, float],
    title: str,
    legend: Sequence[str] = (),
) -> NDArray[np.uint8]:
    """Draw panels side by side, with the names of the first curves of each below all of them.

    ``size_in`` is width and height of a panel, and the height of what is written around them, inches.
    """
    require_plots("a plot")
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = {1: 1, 2: 2, 4: 2}.get(len(panels), 3)
    rows = -(-len(panels) // columns)
    # Our own style, whatever a matplotlibrc of this machine says.
    with matplotlib.style.context(["default", _STYLE]), warnings.catch_warnings():
        size = (size_in[0] * columns, size_in[1] * rows + size_in[2])
        figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        # For letters that the font does not have it draws boxes, with a warning on stderr.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        # A long heading is smaller, then in several lines.
        room_pt = 72 * size[0] / _LETTER_EM
        title_pt = min(_TITLE_PT, max(_LEAST_TITLE_PT, room_pt / max(len(title), 1)))
        lines = textwrap.fill(title, int(room_pt / title_pt))
        figure.suptitle(lines, x=_TITLE_LEFT, ha="left", fontsize=title_pt)
        for number, panel in enumerate(panels, start=1):
            fill(figure.add_subplot(rows, columns, number), panel)
        if legend:
            curves = figure.axes[0].get_legend_handles_labels()[0][: len(legend)]
            figure.legend(curves, legend, loc="outside lower center", ncols=len(legend), frameon=False)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
