"""After the paper's Figure 7: the raw readings r(theta_o) as polar curves, S and P side by side.

Convention of the drawing: the sample's surface is the horizontal line, its normal points up, the specular
side is to the right, so a reading r at theta_o lies at ``x = r sin(theta_o), y = r cos(theta_o)``.  The
incident beam of incidence theta_i arrives from the left, at theta_o = -theta_i.  The half-disc is drawn
on ordinary axes of equal scale: it fills its panel, which matplotlib's own polar axes do not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from gonio.report import choose, style
from gonio.report.content import Content

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RIM = 1.045  # where the rings of blind zones begin, in units of the outer radius
RING = 0.030  # their spacing
GRID_DEG = np.arange(-75, 76, 15)


def draw_polar(content: Content, column: int) -> style.Drawing:
    """Draw r in % over theta_o for every incidence at one wavelength; `column` is the wavelength's index."""
    scan = content.scan
    wavelength_nm = float(scan.wavelength_nm[column])
    present = choose.polarizations(scan)
    angles = choose.incidences(scan)
    palette = style.colours(len(angles))
    blind_deg = content.blind_zone_deg
    figure = style.new_figure(9.8 if len(present) > 1 else 5.8, 3.75)
    left_out = int(np.count_nonzero(~scan.usable[:, column]))

    for number, polarization in enumerate(present):
        axes = figure.add_subplot(1, len(present), number + 1)
        curves = [choose.curve(scan, choose.sweep(scan, a, polarization), column)[:2] for a in angles]
        peak = max((float(np.nanmax(r, initial=0.0)) for _, r in curves if r.size), default=0.0)
        radius = _round_up(100.0 * peak) if peak > 0 else 1.0
        outside = RIM + RING * len(angles) if blind_deg > 0 else RIM
        _draw_grid(axes, radius, outside)
        axes.set_title(f"{choose.name_of(polarization)} (outer circle: {radius:g} %)")
        for i, (theta_o_deg, r) in enumerate(curves):
            x, y = _place(theta_o_deg, 100.0 * r)
            (line,) = axes.plot(
                x,
                y,
                color=palette[i],
                marker=style.marker(i),
                markersize=2.8,
                linewidth=1.1,
                label=f"{angles[i]:.4g}°",
                zorder=3,
            )
            line.set_gid("curve")
            _draw_incident_beam(axes, angles[i], radius, palette[i])
            if blind_deg > 0:
                _draw_blind_zone(axes, angles[i], blind_deg, radius * (RIM + RING * i), palette[i])
    _draw_legend(figure, angles, palette, blind=blind_deg > 0)

    blind = (
        f" Arcs outside the circle: the blind zone of each incidence, ±{blind_deg:g}° around the incident "
        "beam (arrow), where the detector would shadow the source."
        if blind_deg > 0
        else " The arrows show the incident beams; the rig file states no blind zone."
    )
    missing = (
        f" {left_out} readings at this wavelength are missing or flagged and leave gaps." if left_out else ""
    )
    return style.Drawing(
        name=f"polar_{wavelength_nm:.0f}nm",
        title=f"Raw readings at {wavelength_nm:g} nm (after the paper's Figure 7)",
        caption=(
            "Reflected power caught by the aperture, r, in percent of the incident power, against the "
            f"observation angle θₒ at {wavelength_nm:g} nm. The normal of the sample points up and the "
            "specular side is to the right, so the mirror direction of each incidence lies as far right "
            "of the normal as its arrow lies left. The round part is diffuse reflection, the peaks are "
            "the specular lobe; after Fresnel they grow with incidence in S and shrink in P up to the "
            f"Brewster angle. The two panels have their own radial scales.{blind}{missing} Drawn from "
            "<code>/entry/data/r</code>, points joined by straight lines, nothing smoothed."
        ),
        figure=figure,
    )


def _place(theta_o_deg: Any, radius: Any) -> tuple[Any, Any]:
    angle = np.radians(theta_o_deg)
    return radius * np.sin(angle), radius * np.cos(angle)


def _draw_grid(axes: Axes, radius: float, outside: float) -> None:
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_xlim(-(outside + 0.13) * radius, 1.14 * radius)
    axes.set_ylim(-0.10 * radius, (outside + 0.09) * radius)
    axes.set_yticks([])
    axes.set_xticks([])
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlabel("observation angle θₒ / °, radius r / %")
    arc = np.linspace(-90.0, 90.0, 181)
    ticks = _radial_ticks(radius)
    for tick in ticks:
        last = tick >= radius * (1 - 1e-9)
        x, y = _place(arc, tick)
        axes.plot(x, y, color="#4d4d4d" if last else style.LIGHT, linewidth=0.8, zorder=1, label="_grid")
    for tick in [0.0, *ticks]:
        for side in (-1, 1) if tick else (1,):
            axes.annotate(
                f"{tick:g}", (side * tick, 0.0), xytext=(0, -3), textcoords="offset points",
                ha="center", va="top", fontsize=7.0, color="#555555",
            )  # fmt: skip
    for angle in GRID_DEG:
        x, y = _place(float(angle), np.array([0.0, radius]))
        axes.plot(x, y, color=style.LIGHT, linewidth=0.6, zorder=0.9, label="_grid")
    for angle in (-90, *GRID_DEG, 90):
        # negative angles make room for the rings of blind zones
        x, y = _place(float(angle), radius * (outside + 0.055 if -75 <= angle < 0 else RIM + 0.025))
        axes.text(
            x, y, f"{angle:d}°".replace("-", "−"), ha="center", va="center", fontsize=7.5, color="#333333"
        )
    axes.plot([-radius, radius], [0.0, 0.0], color="#4d4d4d", linewidth=1.2, zorder=2, label="_surface")


def _draw_incident_beam(axes: Axes, theta_i_deg: float, radius: float, colour: Any) -> None:
    axes.annotate(
        "",
        xy=_place(-theta_i_deg, 0.82 * radius),
        xytext=_place(-theta_i_deg, radius),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0},
    )


def _draw_blind_zone(axes: Axes, theta_i_deg: float, half_deg: float, at: float, colour: Any) -> None:
    low, high = max(-90.0, -theta_i_deg - half_deg), min(90.0, -theta_i_deg + half_deg)
    x, y = _place(np.linspace(low, high, 61), at)
    (line,) = axes.plot(x, y, color=colour, linewidth=2.2, solid_capstyle="butt", label="_blind")
    line.set_gid("blind-zone")


def _draw_legend(figure: Figure, angles: list[float], palette: list[Any], *, blind: bool) -> None:
    handles = [
        Line2D([], [], color=palette[i], marker=style.marker(i), label=f"θᵢ = {a:.4g}°")
        for i, a in enumerate(angles)
    ]
    if blind:
        handles.append(Line2D([], [], color="#666666", linewidth=2.4, label="blind zone of that incidence"))
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 6))
    rows = -(-len(handles) // 6)
    style.place(figure, left_in=0.05, right_in=0.05, bottom_in=0.35 + 0.2 * rows, top_in=0.28, gap_x_in=0.1)


def _round_up(value: float) -> float:
    """Return the next of 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    steps = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])
    return float(power * steps[np.searchsorted(steps, value / power - 1e-9)])


def _radial_ticks(radius: float) -> list[float]:
    power = 10.0 ** np.floor(np.log10(radius) + 1e-9)
    lead = round(radius / power, 6)
    step = {1.0: 0.25, 1.5: 0.5, 2.0: 0.5, 2.5: 0.5, 6.0: 2.0, 8.0: 2.0}.get(lead, 1.0)
    return [float(t) for t in np.arange(step, lead + 1e-9, step) * power]
