"""A street unfolded: left facade, ground and right facade side by side, on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from gonio.report import style
from gonio.report.maps import COLOURS, CONTRIBUTIONS, HATCHES, LABELS, common_norm, height_m, upright, width_m

if TYPE_CHECKING:
    from gonio.facade import Receiver

_NAMES = ("left", "ground", "right")


class Street(NamedTuple):
    """The three gridded receivers of a street."""

    left: Receiver
    ground: Receiver
    right: Receiver


def street_of(receivers: Sequence[Receiver]) -> Street | None:
    """Return the street among the receivers: left, ground and right, as long as each other; else None."""
    found = {r.name: r for r in receivers if not r.is_mesh}
    if not all(name in found for name in _NAMES):
        return None
    street = Street(*(found[name] for name in _NAMES))
    along = np.array([r.u_m for r in street])
    same = np.allclose(along, along[0], atol=1e-9 * max(width_m(street.left), 1e-9))
    standing = upright(street.left) and upright(street.right) and not upright(street.ground)
    return street if same and standing else None


def draw_street(street: Street) -> style.Drawing:
    """Draw the means along the street, by contribution, over the maps of the three surfaces."""
    mapped = any(r.value.shape[1] > 1 for r in street)
    widths = np.array([height_m(r) for r in street])
    shares = np.maximum(widths / widths.max(), 0.3)
    length = width_m(street.left)
    map_in = float(np.clip(8.0 * length / widths.sum(), 1.6, 3.8)) if mapped else 0.0
    heights = [2.3, map_in] if mapped else [2.3]
    figure = style.new_figure(9.8, sum(heights) + (0.95 if mapped else 0.55) + 0.62)
    panels = figure.subplots(
        len(heights), 3, squeeze=False, sharey="row",
        gridspec_kw={"height_ratios": heights, "width_ratios": shares},
    )  # fmt: skip
    style.place(
        figure, left_in=0.72, right_in=0.95 if mapped else 0.15, top_in=0.62, gap_x_in=0.1, gap_y_in=0.45
    )
    norm = common_norm([r.value for r in street])
    top = 0.0
    mesh: Any = None
    for column, receiver in enumerate(street):
        top = max(top, _draw_profile(panels[0, column], receiver))
        if mapped:
            mesh = _draw_map(panels[1, column], receiver, norm)
        for axes in panels[:, column]:
            _scale(axes, receiver, turned=column == 0)
        panels[-1, column].set_xlabel("across / m" if column == 1 else "height / m")
        title = ("left facade", "ground", "right facade")[column]
        panels[0, column].set_title(title)
    panels[0, 0].set_ylim(0.0, 1.05 * top if top > 0.0 else 1.0)
    panels[0, 0].set_ylabel("mean along the street / (W/m²)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper left", ncols=len(labels), bbox_to_anchor=(0.72 / 9.8, 1.0),
        borderaxespad=0.2, columnspacing=1.4,
    )  # fmt: skip
    if mapped:
        panels[1, 0].set_ylabel("along / m")
        _bar_beside(figure, mesh, panels[1, 2])
    return style.Drawing(
        name="facade_street",
        title="The street unfolded",
        caption=(
            "Both facades folded down to the level of the ground, so that neighbours stand side by side: the "
            "foot of each facade meets the edge of the ground. Above: mean along the street, stacked by "
            "contribution; the grey band is one standard error of the total, at most (the mean of the "
            "patches' errors)."
            + (" Below: irradiance of each patch, one colour scale for all three." if mapped else "")
        ),
        figure=figure,
    )


def _draw_profile(axes: Axes, receiver: Receiver) -> float:
    """Draw the means over the columns against the distance from the foot; return the highest value."""
    rows = receiver.value.shape[0]
    edges = np.linspace(0.0, height_m(receiver), rows + 1)
    base = np.zeros(rows)
    for name in CONTRIBUTIONS:
        value = np.nan_to_num(receiver.contributions[name].value).mean(axis=1)
        axes.stairs(
            base + value, edges, baseline=base, fill=True, color=COLOURS[name], hatch=HATCHES[name],
            edgecolor="white", linewidth=0.0, label=LABELS[name],
        )  # fmt: skip
        base = base + value
    error = np.nan_to_num(receiver.standard_error).mean(axis=1)
    axes.stairs(
        base + error, edges, baseline=base - error, fill=True, color="#444444", alpha=0.45, linewidth=0.0
    )
    total = axes.stairs(base, edges, color=style.BLACK, linewidth=1.1, label="total", baseline=None)
    total.set_gid("total")
    return float(np.max(base + error, initial=0.0))


def _draw_map(axes: Axes, receiver: Receiver, norm: Any) -> Any:
    axes.grid(False)
    axes.set_facecolor("#bfbfbf")
    rows, columns = receiver.value.shape
    return axes.pcolormesh(
        np.linspace(0.0, height_m(receiver), rows + 1),
        np.linspace(0.0, width_m(receiver), columns + 1),
        np.ma.masked_invalid(receiver.value.T),
        cmap="viridis",
        norm=norm,
        rasterized=True,
    )


def _scale(axes: Axes, receiver: Receiver, *, turned: bool) -> None:
    """Let a facade stand on the edge of the ground: the left one's height grows to the left."""
    high = height_m(receiver)
    axes.set_xlim((high, 0.0) if turned else (0.0, high))
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    if not turned:
        axes.tick_params(axis="y", length=0)
    for spine in ("left", "right"):
        axes.spines[spine].set_visible(True)


def _bar_beside(figure: Any, mesh: Any, beside: Axes) -> None:
    width = figure.get_figwidth()
    place = beside.get_position(original=True)
    axes = figure.add_axes((place.x1 + 0.12 / width, place.y0, 0.17 / width, place.height))
    bar = figure.colorbar(mesh, cax=axes)
    bar.set_label("total irradiance / (W/m²)")
    bar.outline.set_visible(False)
