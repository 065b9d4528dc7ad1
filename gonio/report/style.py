"""How do the figures look?  One palette, one set of sizes, and the few marks every figure shares.

Colours are those of Okabe and Ito (2008), told apart with every common colour vision deficiency and in
grey by their markers or dashes, which always accompany them.  Figures are plain
`matplotlib.figure.Figure` objects on the Agg canvas: no pyplot, no window system, no state left behind.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gonio.overlap import block_starts

FloatArray = NDArray[np.float64]
Dashes = str | tuple[float, tuple[float, ...]]
"""A line style of matplotlib: a name such as ``-`` or ``--``, or (offset, on-off lengths)."""

BLACK = "#1a1a1a"
GREY = "#8c8c8c"
LIGHT = "#e4e4e4"
ORANGE = "#e69f00"
SKY = "#56b4e9"
GREEN = "#009e73"
YELLOW = "#f0e442"
BLUE = "#0072b2"
VERMILLION = "#d55e00"
PURPLE = "#cc79a7"

CYCLE = (BLUE, ORANGE, GREEN, PURPLE, VERMILLION, SKY)
MARKERS = ("o", "s", "^", "D", "v", "P")
PNG_DPI = 160
SPARSE = 40  # so few wavelengths are marked, since the line between them is no measurement

_RC: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # ships with matplotlib: the same page on every machine
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.labelsize": 9.0,
    "axes.edgecolor": "#4d4d4d",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LIGHT,
    "grid.linewidth": 0.6,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "xtick.direction": "out",
    "ytick.direction": "out",
    "lines.linewidth": 1.4,
    "lines.markersize": 3.4,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 1.8,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "path",  # readable where the font is missing
    "svg.hashsalt": "gonio",  # the same data give the same bytes
    "path.simplify": True,
}

_LOCK = threading.RLock()


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style while figures are built and saved; the process's own settings come back afterwards."""
    with _LOCK, matplotlib.rc_context(_RC):
        yield


@dataclass(frozen=True, slots=True)
class Drawing:
    """One finished figure: its file's stem, its heading on the page, what to see in it, the figure."""

    name: str
    title: str
    caption: str
    figure: Figure


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure on an Agg canvas; `place` lays it out.

    Matplotlib's own layouts would find room for anything, but take as long as drawing.
    """
    figure = Figure(figsize=(width_in, height_in), dpi=PNG_DPI)
    FigureCanvasAgg(figure)
    return figure


def place(
    figure: Figure,
    *,
    left_in: float = 0.72,
    right_in: float = 0.12,
    bottom_in: float = 0.48,
    top_in: float = 0.30,
    gap_x_in: float = 0.2,
    gap_y_in: float = 0.15,
) -> None:
    """Put the grid of panels inside these margins, with these gaps between them, inches."""
    width, height = figure.get_size_inches()
    grid = figure.axes[0].get_gridspec()
    rows, columns = (grid.nrows, grid.ncols) if grid is not None else (1, 1)
    panel_x = (width - left_in - right_in - gap_x_in * (columns - 1)) / columns
    panel_y = (height - bottom_in - top_in - gap_y_in * (rows - 1)) / rows
    figure.subplots_adjust(
        left=left_in / width,
        right=1.0 - right_in / width,
        bottom=bottom_in / height,
        top=1.0 - top_in / height,
        wspace=gap_x_in / panel_x,
        hspace=gap_y_in / panel_y,
    )
    for axes in figure.axes:
        if axes.get_ylabel():
            axes.yaxis.set_label_coords(
                -0.74 * left_in / panel_x, 0.5
            )  # one column, however wide the numbers


def colour_bar(
    figure: Figure, mesh: ScalarMappable, beside: Axes, label: str, *, extend: str = "neither"
) -> None:
    """Add a colour bar right of a column of panels, as high as all of them; needs 0.85 inches there."""
    width = figure.get_figwidth()
    right = beside.get_position(original=True).x1
    low, high = figure.subplotpars.bottom, figure.subplotpars.top
    axes = figure.add_axes((right + 0.12 / width, low, 0.17 / width, high - low))
    bar = figure.colorbar(mesh, cax=axes, extend=extend)
    bar.set_label(label)
    bar.outline.set_visible(False)


def png_bytes(figure: Figure) -> bytes:
    """Return the figure as PNG at 160 dots per inch."""
    buffer = io.BytesIO()
    # the canvas itself, since `savefig` would draw everything once more to find a layout
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 3})  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def svg_bytes(figure: Figure) -> bytes:
    """Return the figure as SVG with the text as outlines; images inside it at 160 dots per inch."""
    buffer = io.BytesIO()
    canvas = FigureCanvasSVG(figure)
    canvas.print_svg(buffer, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def plain(text: str) -> str:
    """Return text from a file so that matplotlib draws it as it is: a dollar sign would begin a formula."""
    return text.replace("$", r"\$")


def colours(count: int) -> list[Any]:
    """Return `count` distinct colours, ordered; more than the palette's six come from a uniform map."""
    if count <= len(CYCLE):
        return list(CYCLE[:count])
    return list(matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, count)))


def marker(index: int) -> str:
    """Return the marker that goes with colour number `index`."""
    return MARKERS[index % len(MARKERS)]


# -- spectra with gaps
# ------------------------------------------------------------------------------------------------


def broken(
    x: FloatArray, *curves: FloatArray, at: Sequence[float] = ()
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return `x` ascending and the curves with a NaN inserted at every value of `at` inside the range.

    A line through the result stops before a detector change and starts again after it; NaN in a curve
    stays a gap.  Wavelengths that two detectors measured come once for each, grouped by detector: there the
    line stops at the last of one and starts again at the first of the next.
    """
    starts = block_starts(np.asarray(x, dtype=np.float64))
    if len(starts):
        middle = 0.5 * (x[starts - 1] + x[starts])
        return np.insert(x, starts, middle), tuple(
            np.insert(np.asarray(c, dtype=np.float64), starts, np.nan) for c in curves
        )
    order = np.argsort(x, kind="stable")
    x = np.asarray(x, dtype=np.float64)[order]
    sorted_curves = [np.asarray(c, dtype=np.float64)[order] for c in curves]
    inside = sorted(a for a in at if x.size and x[0] < a < x[-1])
    where = np.searchsorted(x, inside)
    x = np.insert(x, where, inside)
    return x, tuple(np.insert(c, where, np.nan) for c in sorted_curves)


def alone(y: FloatArray) -> NDArray[np.bool_]:
    """Say which values are finite between two that are not: a line cannot show them, a marker must."""
    finite = np.isfinite(y)
    before = np.concatenate([[False], finite[:-1]])
    after = np.concatenate([finite[1:], [False]])
    return np.asarray(finite & ~before & ~after)


def draw_spectrum(
    axes: Axes,
    wavelength_nm: FloatArray,
    value: FloatArray,
    *,
    lower: FloatArray | None = None,
    upper: FloatArray | None = None,
    changes_nm: Sequence[float] = (),
    colour: str = BLACK,
    label: str = "",
    dashes: Dashes = "-",
    marks: str = "",
    width: float = 1.4,
    band_alpha: float = 0.22,
    zorder: float = 2.5,
) -> None:
    """Draw one curve with its band, broken at the detector changes and at missing values.

    Unbounded limits (``inf``) fill to far beyond the axes; a band exists only where both limits are known.
    """
    nothing = np.full(np.shape(value), np.nan)
    if not marks and len(wavelength_nm) <= SPARSE:
        marks = "." if dashes == "-" else ""
    lower = nothing if lower is None else np.clip(lower, -1e6, 1e6)
    upper = nothing if upper is None else np.clip(upper, -1e6, 1e6)
    x, (y, low, high) = broken(wavelength_nm, value, lower, upper, at=changes_nm)
    if np.any(np.isfinite(low) & np.isfinite(high)):
        axes.fill_between(x, low, high, color=colour, alpha=band_alpha, linewidth=0, zorder=zorder - 0.5)
    (line,) = axes.plot(
        x,
        y,
        color=colour,
        linestyle=dashes,
        linewidth=width,
        marker=marks,
        label=label or "_spectrum",
        zorder=zorder,
    )
    line.set_gid("spectrum")
    single = alone(y)
    if np.any(single):
        known = np.isfinite(low) & np.isfinite(high)
        bars = np.zeros((2, int(single.sum())))
        bars[0] = np.where(known, y - low, 0.0)[single]
        bars[1] = np.where(known, high - y, 0.0)[single]
        axes.errorbar(
            x[single],
            y[single],
            yerr=np.maximum(bars, 0.0),
            fmt=marks or "o",
            color=colour,
            capsize=2.5,
            elinewidth=1.0,
            zorder=zorder + 0.1,
            label="_alone",
        )


def mark_changes(axes: Axes, changes_nm: Sequence[float], texts: Sequence[str] = ()) -> None:
    """Draw a dotted line at each detector change, and name it at the lower end where there is a text."""
    for change_nm in changes_nm:
        axes.axvline(change_nm, color=GREY, linestyle=(0, (1, 1.6)), linewidth=1.0, zorder=1.2)
    for change_nm, text in zip(changes_nm, texts, strict=False):
        axes.annotate(
            f"detector change\n{text}",
            (change_nm, 0.0),
            xycoords=("data", "axes fraction"),
            xytext=(4, 4),
            textcoords="offset points",
            va="bottom",
            fontsize=7.5,
            linespacing=1.15,
            color="#555555",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0},
        )


def wavelength_axis(axes: Axes, wavelength_nm: FloatArray) -> None:
    """Label and limit the wavelength axis, a single wavelength included."""
    low, high = float(np.nanmin(wavelength_nm)), float(np.nanmax(wavelength_nm))
    pad = 0.01 * (high - low) if high > low else 25.0
    axes.set_xlim(low - pad, high + pad)
    axes.set_xlabel("wavelength / nm")


def limits(*values: FloatArray, bands: Sequence[FloatArray] = ()) -> tuple[float, float] | None:
    """Return axis limits that show the curves, and their bands as far as these do not dwarf the curves.

    Values and bands further out than 3 times the 5 % to 95 % range are left out, so that one failed
    wavelength does not flatten all others; `beyond` counts what is left out.  ``None`` if nothing is
    finite.
    """
    curve = np.concatenate([np.ravel(v) for v in values]) if values else np.empty(0)
    curve = curve[np.isfinite(curve)]
    if curve.size == 0:
        return None
    low, high = _without_outliers(curve)
    middle = 0.5 * (low + high)
    span = max(high - low, 0.02 * abs(middle), 1e-12)
    for band in bands:
        known = np.ravel(band)[np.isfinite(np.ravel(band))]
        if known.size:
            lowest, highest = _without_outliers(known)
            low = min(low, max(lowest, middle - 2.0 * span))
            high = max(high, min(highest, middle + 2.0 * span))
    pad = 0.05 * max(high - low, span)
    return float(low - pad), float(high + pad)


def _without_outliers(values: FloatArray) -> tuple[float, float]:
    low, high = np.percentile(values, [5.0, 95.0])
    reach = 3.0 * (high - low)
    return max(float(values.min()), float(low - reach)), min(float(values.max()), float(high + reach))


def beyond(axes: Axes, *values: FloatArray) -> int:
    """Count the finite values outside the axis limits and say so in the figure; return the count."""
    low, high = axes.get_ylim()
    count = int(sum(np.count_nonzero(np.isfinite(v) & ((v < low) | (v > high))) for v in values))
    if count:
        axes.annotate(
            f"{count} value{'s' if count > 1 else ''} outside the axis",
            (1.0, 0.0),
            xycoords="axes fraction",
            xytext=(-3, 3),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize=7.0,
            color="#666666",
        )
    return count


def legend_above(axes: Axes, columns: int = 4) -> None:
    """Put the legend in one row above the panel, where it hides nothing."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.1, columnspacing=1.4
    )
