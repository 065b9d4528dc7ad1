"""What does each kind of light contribute to the mean of a receiver?  Stacked bars with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from gonio.report import style
from gonio.report.maps import COLOURS, CONTRIBUTIONS, HATCHES, LABELS, estimate_text

if TYPE_CHECKING:
    from gonio.facade import Receiver

BARS_PER_FIGURE = 24
_THICKNESS = 0.62


def draw_contributions(receivers: Sequence[Receiver], *, first: int = 0) -> style.Drawing:
    """Draw the means of up to 24 receivers, counted from `first`, each bar stacked from its contributions.

    The standard error of each contribution is drawn at the end of its segment, one below the other, so that
    they can be told apart where segments are short; the total's stands at the end of the bar.
    """
    shown = receivers[first : first + BARS_PER_FIGURE]
    figure = style.new_figure(8.6, 1.25 + 0.62 * max(len(shown), 2))
    axes = figure.add_subplot()
    axes.grid(visible=False, axis="y")
    at = np.arange(len(shown), dtype=np.float64)
    left: style.FloatArray = np.zeros(len(shown))
    for number, name in enumerate(CONTRIBUTIONS):
        values = np.nan_to_num([float(r.mean_contributions[name].value) for r in shown])
        errors = np.nan_to_num([float(r.mean_contributions[name].standard_error) for r in shown])
        axes.barh(
            at,
            values,
            left=left,
            height=_THICKNESS,
            color=COLOURS[name],
            hatch=HATCHES[name],
            edgecolor="white",
            linewidth=0,
            label=LABELS[name],
        )
        left = np.asarray(left + values)
        y = at + _THICKNESS * ((number + 1.0) / (len(CONTRIBUTIONS) + 1.0) - 0.5)
        _error_bars(axes, left, y, errors, f"errors_{name}")
    totals = np.nan_to_num([float(r.mean.value) for r in shown])
    errors = np.nan_to_num([float(r.mean.standard_error) for r in shown])
    largest = float(np.max(totals + errors, initial=0.0))
    for height, total, error, receiver in zip(at, totals, errors, shown, strict=True):
        axes.annotate(
            estimate_text(receiver.mean),
            (total + error, height),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.0,
        )
    names = [style.plain(r.name) for r in shown]
    axes.set_yticks(at, names)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.2 * largest if largest > 0 else 1.0)
    axes.set_xlabel("mean irradiance on the receiver / (W/m²)")
    style.legend_above(axes)
    longest = max((len(name) for name in names), default=0)
    style.place(figure, left_in=min(0.25 + 0.075 * longest, 4.0))
    part = f"_{first // BARS_PER_FIGURE + 1}" if len(receivers) > BARS_PER_FIGURE else ""
    return style.Drawing(
        name=f"facade_contributions{part}",
        title="What each kind of light contributes",
        caption=(
            "Mean irradiance of each receiver, split by the light's last history: direct sun, sky seen "
            "directly, light reflected by diffuse reflections only, and light that a specular lobe "
            "reflected at least once. The four parts are disjoint and add up to the total at the end of "
            "the bar. The short lines at the end of each part are one standard error of that part, the "
            "± that of the total; shorter than the line is wide, an error shows as a tick."
        ),
        figure=figure,
    )


def _error_bars(
    axes: Axes, x: style.FloatArray, y: style.FloatArray, errors: style.FloatArray, gid: str
) -> None:
    drawn = axes.errorbar(
        x, y, xerr=errors, fmt="none", ecolor=style.BLACK, elinewidth=1.1, capsize=2.2, capthick=0.9, zorder=3
    )
    drawn.lines[2][0].set_gid(gid)
