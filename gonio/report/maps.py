"""After the paper's Figure 13: irradiance on gridded receivers, and how well it is known, as maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gonio.report import style

if TYPE_CHECKING:
    from gonio.facade import Estimate, Receiver

FloatArray = NDArray[np.float64]

CONTRIBUTIONS = ("direct", "sky", "diffuse", "specular")
LABELS = {
    "direct": "direct sun",
    "sky": "sky seen directly",
    "diffuse": "reflected, diffuse only",
    "specular": "reflected, at least once by a lobe",
}
COLOURS = {
    "direct": style.ORANGE,
    "sky": style.SKY,
    "diffuse": style.GREEN,
    "specular": style.VERMILLION,
}
HATCHES = {"direct": "", "sky": "///", "diffuse": "...", "specular": "xxx"}
ROWS_PER_FIGURE = 4


@dataclass(frozen=True, slots=True)
class _Column:
    """One column of maps: what it shows, in which colours, and the values of every receiver."""

    heading: str
    colour_map: str
    values: Sequence[FloatArray]


def with_maps(receivers: Sequence[Receiver]) -> list[Receiver]:
    """Return the receivers that have a map: gridded, of more than one patch."""
    return [r for r in receivers if not r.is_mesh and r.value.size > 1]


def draw_maps(receivers: Sequence[Receiver], *, first: int = 0) -> style.Drawing:
    """Draw total irradiance and specular contribution of up to four receivers, counted from `first`."""
    columns = (
        _Column("total irradiance", "viridis", [r.value for r in receivers]),
        _Column("specular contribution", "magma", [r.contributions["specular"].value for r in receivers]),
    )
    worst = max((_relative_error(r) for r in _shown(receivers, first)), default=float("nan"))
    return style.Drawing(
        name=f"facade_maps{_part(receivers, first)}",
        title="Irradiance on the receiver surfaces (after the paper's Figure 13)",
        caption=(
            "Left: irradiance on each receiver patch, all paths of light together. Right: the part that "
            "a specular lobe reflected at least once, which a purely diffuse model of the facades would "
            "miss or misplace. One colour scale per column for all receivers; each cell is one patch of "
            "the grid, not interpolated: the median standard error of a "
            f"patch is at most {100 * worst:.2g} % of its value here."
        ),
        figure=_draw_columns(receivers, columns, first),
    )


def draw_errors(receivers: Sequence[Receiver], *, first: int = 0) -> style.Drawing:
    """Draw the standard errors of the same receivers: of the total, and of the specular contribution."""
    columns = (
        _Column("standard error of the total", "cividis", [r.standard_error for r in receivers]),
        _Column(
            "standard error of the specular part",
            "cividis",
            [r.contributions["specular"].standard_error for r in receivers],
        ),
    )
    return style.Drawing(
        name=f"facade_errors{_part(receivers, first)}",
        title="How well each patch is known",
        caption=(
            "One standard error of each patch of the maps above, left of the total, right of the specular "
            "part, from the scatter of independent randomisations. Only the sampling is in them: what was "
            "left out, and the finite size of the patches, have bounds of their own in the tables. One "
            "colour scale per column."
        ),
        figure=_draw_columns(receivers, columns, first),
    )


def _shown(receivers: Sequence[Receiver], first: int) -> Sequence[Receiver]:
    return receivers[first : first + ROWS_PER_FIGURE]


def _part(receivers: Sequence[Receiver], first: int) -> str:
    return f"_{first // ROWS_PER_FIGURE + 1}" if len(receivers) > ROWS_PER_FIGURE else ""


def _draw_columns(receivers: Sequence[Receiver], columns: Sequence[_Column], first: int) -> Figure:
    """Draw a row of maps for each receiver shown, one colour scale for each column."""
    shown = _shown(receivers, first)
    map_width_in = 3.9
    heights = [float(np.clip(map_width_in * _aspect(r), 0.7, 3.6)) for r in shown]
    figure = style.new_figure(9.8, sum(heights) + 0.78 * len(shown))
    panels = figure.subplots(len(shown), 2, squeeze=False, gridspec_kw={"height_ratios": heights})
    style.place(figure, left_in=0.68, right_in=0.85, gap_x_in=1.25, gap_y_in=0.78)
    for number, column in enumerate(columns):
        norm = common_norm(column.values)  # one scale for all receivers, so that they compare
        mesh = None
        for row, receiver in enumerate(shown):
            axes = panels[row, number]
            mesh = _draw_map(axes, receiver, column.values[first + row], column.colour_map, norm)
            axes.set_title(style.plain(f"{receiver.name}: {column.heading}"))
            if number == 0:
                axes.set_ylabel("height / m" if upright(receiver) else "across / m")
            axes.set_xlabel("along / m")
        if mesh is not None:
            style.colour_bar(figure, mesh, panels[0, number], f"{column.heading} / (W/m²)")
    return figure


def width_m(receiver: Receiver) -> float:
    """Return the extent along the columns, m."""
    return float(np.linalg.norm(receiver.u_m))


def height_m(receiver: Receiver) -> float:
    """Return the extent along the rows, m."""
    return float(np.linalg.norm(receiver.v_m))


def _aspect(receiver: Receiver) -> float:
    return height_m(receiver) / width_m(receiver)


def upright(receiver: Receiver) -> bool:
    """Say whether the rows of a receiver go up rather than across."""
    return abs(receiver.v_m[2]) > 0.5 * height_m(receiver)


def common_norm(maps: Sequence[FloatArray]) -> Normalize:
    """Return one colour scale for all values, from 0 (or the lowest, if negative) to the highest."""
    values = np.concatenate([np.ravel(m) for m in maps]) if maps else np.empty(0)
    values = values[np.isfinite(values)]
    top = float(values.max()) if values.size else 1.0
    low = float(values.min()) if values.size else 0.0
    return Normalize(min(0.0, low), top if top > 0 else 1.0)


def _draw_map(axes: Axes, receiver: Receiver, values: FloatArray, colour_map: str, norm: Normalize) -> Any:
    axes.grid(False)
    axes.set_facecolor("#bfbfbf")
    n_row, n_column = values.shape
    mesh = axes.pcolormesh(
        np.linspace(0.0, width_m(receiver), n_column + 1),
        np.linspace(0.0, height_m(receiver), n_row + 1),
        np.ma.masked_invalid(values),
        cmap=colour_map,
        norm=norm,
        rasterized=True,
    )
    if 0.15 <= _aspect(receiver) <= 1.5:  # true proportions where the panel's shape allows them
        axes.set_aspect("equal")
    return mesh


def _relative_error(receiver: Receiver) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = receiver.standard_error / receiver.value
    relative = relative[np.isfinite(relative)]
    return float(np.median(relative)) if relative.size else float("nan")


def value_text(value: float, error: float) -> str:
    """Return ``13.00 ± 0.15``; without a standard error the value alone."""
    if not np.isfinite(value):
        return "not known"
    if not np.isfinite(error) or error <= 0:
        return f"{value:.3g}"
    decimals = int(np.clip(1 - np.floor(np.log10(error)), 0, 6))
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def estimate_text(estimate: Estimate) -> str:
    """Return a single estimate as text, see `value_text`."""
    return value_text(float(estimate.value), float(estimate.standard_error))
