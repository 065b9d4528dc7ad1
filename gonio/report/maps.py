"""After the paper's Figure 13: irradiance on the receivers, and what each kind of light contributes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
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


def draw_maps(receivers: Sequence[Receiver], *, first: int = 0) -> style.Drawing:
    """Draw total irradiance and specular contribution of up to four receivers, counted from `first`."""
    shown = receivers[first : first + ROWS_PER_FIGURE]
    aspects = [_aspect(r) for r in shown]
    map_width_in = 3.9
    heights = [float(np.clip(map_width_in * a, 0.7, 3.6)) for a in aspects]
    figure = style.new_figure(9.8, sum(heights) + 0.78 * len(shown))
    panels = figure.subplots(len(shown), 2, squeeze=False, gridspec_kw={"height_ratios": heights})
    style.place(figure, left_in=0.55, right_in=0.85, gap_x_in=1.25, gap_y_in=0.78)
    columns = (
        ("total irradiance", "viridis", [r.value for r in receivers]),
        ("specular contribution", "magma", [r.contributions["specular"].value for r in receivers]),
    )
    for column, (heading, colour_map, every) in enumerate(columns):
        norm = _norm(every)  # one scale for all receivers, so that they compare
        mesh = None
        for row, receiver in enumerate(shown):
            axes = panels[row, column]
            mesh = _draw_map(axes, receiver, every[first + row], colour_map, norm)
            axes.set_title(style.plain(f"{receiver.name}: {heading}"))
            if column == 0:
                axes.set_ylabel("height / m" if _upright(receiver) else "across / m")
            axes.set_xlabel("along / m")
        if mesh is not None:
            style.colour_bar(figure, mesh, panels[0, column], f"{heading} / (W/m²)")
    worst = max((_relative_error(r) for r in shown), default=float("nan"))
    part = f"_{first // ROWS_PER_FIGURE + 1}" if len(receivers) > ROWS_PER_FIGURE else ""
    return style.Drawing(
        name=f"facade_maps{part}",
        title="Irradiance on the receiver surfaces (after the paper's Figure 13)",
        caption=(
            "Left: irradiance on each receiver patch, all paths of light together. Right: the part that "
            "a specular lobe reflected at least once, which a purely diffuse model of the facades would "
            "miss or misplace. One colour scale per column for all receivers; each cell is one patch of "
            "the grid, not interpolated, so grain is the Monte Carlo's: the median standard error of a "
            f"patch is at most {100 * worst:.2g} % of its value here."
        ),
        figure=figure,
    )


def draw_contributions(receivers: Sequence[Receiver]) -> style.Drawing:
    """Draw the mean of each contribution on each receiver as bars with their standard errors."""
    thickness = 0.19
    figure = style.new_figure(8.6, 1.3 + 1.05 * len(receivers))
    axes = figure.add_subplot()
    axes.grid(visible=False, axis="y")
    largest = 0.0
    for number, contribution in enumerate(CONTRIBUTIONS):
        at = np.arange(len(receivers)) + (number - 1.5) * (thickness + 0.02)
        means = [r.mean_contributions[contribution] for r in receivers]
        values = np.array([float(e.value) for e in means])
        errors = np.array([float(e.standard_error) for e in means])
        axes.barh(
            at,
            np.nan_to_num(values),
            height=thickness,
            xerr=np.nan_to_num(errors),
            color=COLOURS[contribution],
            hatch=HATCHES[contribution],
            edgecolor="white",
            linewidth=0,
            label=LABELS[contribution],
            error_kw={"elinewidth": 1.0, "capsize": 2.0, "ecolor": style.BLACK},
        )
        largest = max(largest, float(np.nanmax(values + np.nan_to_num(errors), initial=0.0)))
        for y, value, error in zip(at, values, errors, strict=True):
            axes.annotate(
                value_text(value, error),
                (np.nan_to_num(value) + np.nan_to_num(error), y),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
            )
    names = [f"{r.name}\ntotal {estimate_text(r.mean)}" for r in receivers]
    axes.set_yticks(np.arange(len(receivers)), [style.plain(name) for name in names])
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.18 * largest if largest > 0 else 1.0)
    axes.set_xlabel("mean irradiance on the receiver / (W/m²)")
    style.legend_above(axes)
    longest = max(len(line) for name in names for line in name.split("\n"))
    style.place(figure, left_in=min(0.2 + 0.075 * longest, 4.0))
    return style.Drawing(
        name="facade_contributions",
        title="What each kind of light contributes",
        caption=(
            "Mean irradiance of each receiver, split by the light's last history: direct sun, sky seen "
            "directly, light reflected by diffuse reflections only, and light that a specular lobe "
            "reflected at least once. Lines at the bars' ends and the ± are one standard error of the "
            "Monte Carlo estimate. The four parts are disjoint and add up to the total under each "
            "receiver's name."
        ),
        figure=figure,
    )


def width_m(receiver: Receiver) -> float:
    """Return the extent along the columns, m."""
    return float(np.linalg.norm(receiver.u_m))


def height_m(receiver: Receiver) -> float:
    """Return the extent along the rows, m."""
    return float(np.linalg.norm(receiver.v_m))


def _aspect(receiver: Receiver) -> float:
    return height_m(receiver) / width_m(receiver)


def _upright(receiver: Receiver) -> bool:
    return abs(receiver.v_m[2]) > 0.5 * height_m(receiver)


def _norm(maps: Sequence[FloatArray]) -> Normalize:
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
