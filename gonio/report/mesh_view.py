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

ELEVATION_DEG = 30.0
"""Of the viewer above the horizon."""

_OUTLINED = 400  # so few faces are told apart by a line around each
_COMPASS = (
    "north", "north-north-east", "north-east", "east-north-east",
    "east", "east-south-east", "south-east", "south-south-east",
    "south", "south-south-west", "south-west", "west-south-west",
    "west", "west-north-west", "north-west", "north-north-west",
)  # fmt: skip
_BACK = "#bfbfbf"


def draw_mesh(receiver: Receiver, number: int = 0) -> style.Drawing:
    """Draw a mesh receiver: total irradiance above, its standard error below, from two sides."""
    first_deg = view_deg(receiver)
    views = (first_deg, first_deg + 180.0)
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
        for column, azimuth_deg in enumerate(views):
            axes = panels[row, column]
            drawn = _draw_view(axes, receiver, values, colour_map, norm, azimuth_deg)
            side = _COMPASS[round(azimuth_deg / 22.5) % 16]
            axes.set_title(style.plain(f"{receiver.name}: {heading}, seen from the {side}"))
        _colour_bar(figure, drawn, panels[row, 1], f"{heading} / (W/m²)")
    return style.Drawing(
        name=f"facade_mesh_{number + 1}" if number else "facade_mesh",
        title=style.plain(f"Irradiance on {receiver.name}"),
        caption=(
            f"Each of the {len(receiver.value)} faces in the colour of its irradiance (above) and of its "
            f"standard error (below), in parallel projection from {ELEVATION_DEG:g}° above the horizon. "
            "Light grey: faces seen from behind, which carry no value."
        ),
        figure=figure,
    )


def view_deg(receiver: Receiver) -> float:
    """Return the azimuth, 90...180 deg, from which (and from opposite) most different faces are seen.

    The sum of ``area sqrt(|cosine|)`` over the faces is largest where the view is shared among them: a house
    is seen at its corner and not front on.
    """
    assert receiver.vertices_m is not None
    assert receiver.faces is not None
    a, b, c = np.moveaxis(receiver.vertices_m[receiver.faces], 1, 0)
    normal = np.cross(b - a, c - a)[:, :2]  # times twice the area; its horizontal part
    azimuths_deg = np.arange(90.0, 181.0, 15.0)
    towards = np.stack([np.sin(np.radians(azimuths_deg)), np.cos(np.radians(azimuths_deg))])
    seen = np.sqrt(np.linalg.norm(normal, axis=1)) @ np.sqrt(np.abs(normal @ towards))
    relative = seen / max(float(seen.max()), 1e-300)
    return float(azimuths_deg[int(np.argmax(np.round(relative, 9)))])


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
) -> PolyCollection:
    assert receiver.vertices_m is not None
    assert receiver.faces is not None
    seen = projected(receiver.vertices_m, azimuth_deg, ELEVATION_DEG)
    corners = seen[receiver.faces]  # (f, 3, 3)
    a, b, c = np.moveaxis(corners[:, :, :2], 1, 0)
    facing = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] > 0.0
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    shown = np.ma.masked_invalid(np.where(facing, values, np.nan)[order])
    faces = PolyCollection(
        list(corners[order][:, :, :2]),
        cmap=matplotlib.colormaps[colour_map].with_extremes(bad=_BACK),
        norm=norm,
        edgecolors="white" if len(values) <= _OUTLINED else "face",
        linewidths=0.4,
    )
    faces.set_array(shown)
    faces.set_rasterized(True)
    axes.add_collection(faces)
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    pad = 0.03 * float(np.max(high - low)) or 1.0
    axes.set_xlim(low[0] - pad, high[0] + pad)
    axes.set_ylim(low[1] - 3.0 * pad, high[1] + pad)  # the scale stands below
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
