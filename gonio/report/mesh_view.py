"""A mesh receiver seen from two sides: every face in the colour of its irradiance, and of its error.

Parallel projection with the far faces drawn first, which needs no 3-D axes and shows flat shading only: the
colour is the value, nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize

from gonio.report import style
from gonio.report.maps import FloatArray, common_norm

if TYPE_CHECKING:
    from gonio.facade import Receiver

VIEWS = ((135.0, 30.0), (315.0, 30.0))
"""Azimuth and elevation of the viewer, deg: from the south-east and from the north-west, from above."""

_COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
_BACK = "#bfbfbf"


def draw_mesh(receiver: Receiver, number: int = 0) -> style.Drawing:
    """Draw a mesh receiver: total irradiance above, its standard error below, from two sides."""
    figure = style.new_figure(9.8, 7.0)
    panels = figure.subplots(2, 2, squeeze=False)
    style.place(figure, left_in=0.15, right_in=1.0, bottom_in=0.15, top_in=0.35, gap_x_in=0.2, gap_y_in=0.45)
    rows = (
        ("total irradiance", "viridis", receiver.value),
        ("standard error", "cividis", receiver.standard_error),
    )
    for row, (heading, colour_map, values) in enumerate(rows):
        norm = common_norm([values])
        drawn = None
        for column, (azimuth_deg, elevation_deg) in enumerate(VIEWS):
            axes = panels[row, column]
            drawn = _draw_view(axes, receiver, values, colour_map, norm, azimuth_deg, elevation_deg)
            side = _COMPASS[round(azimuth_deg / 45.0) % 8]
            axes.set_title(style.plain(f"{receiver.name}: {heading}, seen from the {side}"))
        _colour_bar(figure, drawn, panels[row, 1], f"{heading} / (W/m²)")
    return style.Drawing(
        name=f"facade_mesh_{number + 1}" if number else "facade_mesh",
        title=style.plain(f"Irradiance on {receiver.name}"),
        caption=(
            f"Each of the {len(receiver.value)} faces in the colour of its irradiance (above) and of its "
            f"standard error (below), in parallel projection from {VIEWS[0][1]:g}° above the horizon. Light "
            "grey: faces seen from behind, which carry no value."
        ),
        figure=figure,
    )


def projected(vertices_m: FloatArray, azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """Return (k, 3), m: right, up and towards a viewer at an azimuth (from north) and elevation."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    towards = np.array(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    right = np.array([-np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.cross(towards, right)
    return np.asarray(vertices_m @ np.stack([right, up, towards], axis=1))


def _draw_view(
    axes: Axes,
    receiver: Receiver,
    values: FloatArray,
    colour_map: str,
    norm: Normalize,
    azimuth_deg: float,
    elevation_deg: float,
) -> PolyCollection:
    assert receiver.vertices_m is not None
    assert receiver.faces is not None
    seen = projected(receiver.vertices_m, azimuth_deg, elevation_deg)
    corners = seen[receiver.faces]  # (f, 3, 3)
    a, b, c = np.moveaxis(corners[:, :, :2], 1, 0)
    facing = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] > 0.0
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    shown = np.ma.masked_invalid(np.where(facing, values, np.nan)[order])
    faces = PolyCollection(
        list(corners[order][:, :, :2]),
        cmap=matplotlib.colormaps[colour_map].with_extremes(bad=_BACK),
        norm=norm,
        edgecolors="face",
        linewidths=0.3,
    )
    faces.set_array(shown)
    faces.set_rasterized(True)
    axes.add_collection(faces)
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    pad = 0.03 * float(np.max(high - low)) or 1.0
    axes.set_xlim(low[0] - pad, high[0] + pad)
    axes.set_ylim(low[1] - pad, high[1] + pad)
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_axis_off()
    _scale_bar(axes, float(high[0] - low[0]))
    return faces


def _scale_bar(axes: Axes, width_m: float) -> None:
    """Draw a length that can be read, since a projection has no axis: about a fifth of the width."""
    if not width_m > 0.0:
        return
    power = 10.0 ** np.floor(np.log10(width_m / 5.0))
    length = float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= width_m / 4.0))
    x, y = axes.get_xlim()[0], axes.get_ylim()[0]
    axes.plot([x, x + length], [y, y], color=style.BLACK, linewidth=2.0, solid_capstyle="butt", clip_on=False)
    axes.annotate(
        f"{length:g} m", (x + 0.5 * length, y), xytext=(0, 3), textcoords="offset points", ha="center"
    )


def _colour_bar(figure: Any, drawn: Any, beside: Axes, label: str) -> None:
    width = figure.get_figwidth()
    place = beside.get_position(original=True)
    axes = figure.add_axes((place.x1 + 0.12 / width, place.y0, 0.17 / width, place.height))
    bar = figure.colorbar(drawn, cax=axes)
    bar.set_label(label)
    bar.outline.set_visible(False)
