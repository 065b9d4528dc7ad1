"""After the paper's Figure 9: the fitted model over the readings, with the residuals beneath."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gonio.report import choose, style
from gonio.report.content import Content
from gonio.report.model import Model

if TYPE_CHECKING:
    from gonio.fitting import FitResult

COVERAGE = 2.0  # of the error bars


def draw_curves(content: Content, model: Model, column: int) -> style.Drawing:
    """Draw readings with error bars, fitted curves and residuals of all incidences at one wavelength."""
    scan = content.scan
    wavelength_nm = float(scan.wavelength_nm[column])
    present = choose.polarizations(scan)
    angles = choose.incidences(scan)
    palette = style.colours(len(angles))
    figure = style.new_figure(9.8 if len(present) > 1 else 6.0, 5.0)
    panels = figure.subplots(
        2, len(present), squeeze=False, sharex=True, sharey="row", gridspec_kw={"height_ratios": [2.6, 1.0]}
    )
    worst = 0.0
    for number, polarization in enumerate(present):
        upper, lower = panels[0, number], panels[1, number]
        upper.set_title(choose.name_of(polarization))
        lower.axhline(0.0, color=style.BLACK, linewidth=0.8, zorder=1.5)
        for i, theta_i_deg in enumerate(angles):
            rows = choose.sweep(scan, theta_i_deg, polarization)
            if rows.size == 0:
                continue
            theta_o_deg, r, u = choose.curve(scan, rows, column)
            points = {
                "fmt": style.marker(i),
                "color": palette[i],
                "markersize": 3.0,
                "elinewidth": 0.8,
                "label": f"θᵢ = {theta_i_deg:.4g}°",
            }
            bars = np.where(np.isfinite(u), COVERAGE * u, 0.0)
            upper.errorbar(theta_o_deg, 100.0 * r, yerr=100.0 * bars, zorder=2.5, **points)
            if (theta_i_deg, polarization) not in model.curves:
                continue
            dense_deg, smooth = model.curves[theta_i_deg, polarization]
            (line,) = upper.plot(
                dense_deg,
                100.0 * smooth[:, column],
                color=palette[i],
                linewidth=1.1,
                zorder=2.2,
                label="_fit",
            )
            line.set_gid("fit")
            expected, _ = choose.with_gaps(scan, rows, model.expected[rows, column])
            lower.errorbar(theta_o_deg, 100.0 * (r - expected), yerr=100.0 * bars, **points)
            worst = max(worst, 100.0 * float(np.nanmax(np.abs(r - expected), initial=0.0)))
        lower.set_xlabel("observation angle θₒ / °")
    panels[0, 0].set_ylabel("r / % of incident power")
    panels[1, 0].set_ylabel("data − fit / %")
    for axes in panels.flat:
        axes.margins(x=0.02)
    panels[0, 0].set_ylim(bottom=min(0.0, panels[0, 0].get_ylim()[0]))
    panels[0, 0].legend(loc="upper left")
    style.place(figure)
    return style.Drawing(
        name=f"fit_{wavelength_nm:.0f}nm",
        title=f"Fit over data at {wavelength_nm:g} nm (after the paper's Figure 9)",
        caption=(
            f"Points: readings at {wavelength_nm:g} nm with ±2 standard uncertainties (random part only, "
            f"often smaller than the marker). Lines: the fitted model ({describe(model.fit)}) seen "
            f"through the aperture; lower panels: data minus fit, at most {worst:.2g} % of the incident "
            "power here. A pattern common to all incidences in the residuals points to the model or the "
            "alignment, scatter within the bars to noise alone."
        ),
        figure=figure,
    )


def describe(fit: FitResult) -> str:
    """Return how a fit was made, in words."""
    which = {"joint": "S and P jointly", "s": "S alone", "p": "P alone"}.get(
        fit.polarization, fit.polarization
    )
    aperture = {
        "exact": "exact two-dimensional aperture",
        "eq22": "in-plane average of Eq. 22",
        "point": "point aperture of Eq. 18",
        "published": "the paper's ±13° aperture",
    }.get(fit.aperture, fit.aperture)
    return f"{which}, {aperture}"
