"""After the paper's Figures 10 to 12: what the fit found, over wavelength, with 95 % bands.

Nothing is joined across a detector change, and a wavelength without a value is a gap.  The sphere's curve
is broken there as well: it may have been measured in the same spectrometer.  The truth of the simulated
bench is not.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from gonio.report import choose, style
from gonio.report.agreement import SPHERE_THETA_I_DEG, compare, sphere_of
from gonio.report.content import Content
from gonio.report.curves import describe
from gonio.sphere import SphereComparison
from gonio.sphere.uncertainty import COVERAGE

if TYPE_CHECKING:
    from gonio.fitting import FitResult

FloatArray = NDArray[np.float64]

TRUTH = "truth of the simulated bench"
K_G, K_D, K_S = r"$k_\mathrm{g}$", r"$k_\mathrm{d}$", r"$k_\mathrm{s}$"
WHICH = {"joint": "both polarizations", "s": "S polarization alone", "p": "P polarization alone"}


def draw_coefficients(content: Content, fit: FitResult) -> style.Drawing:
    """Draw k_d, k_s, k_g at 8 deg against the sphere and the truth, and the deviation from the sphere."""
    comparison = compare(content, fit)
    changes = content.scan.detector_change_nm
    figure = style.new_figure(8.6, 7.2 if comparison is not None else 5.4)
    ratios = [2.3, 1.1, 1.1] if comparison is not None else [2.2, 1.1]
    panels = list(figure.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios}))
    _draw_reflectances(panels[0], panels[1], content, fit)
    panels[0].set_ylabel("reflectance at 8° / %")
    panels[1].set_ylabel(f"{K_S} at 8° / %")
    for axes in panels[:2]:
        style.legend_above(axes)
    if comparison is not None:
        _draw_deviation(panels[2], comparison, changes)
    style.mark_changes(panels[0], changes, choose.change_texts(content.scan))
    style.wavelength_axis(panels[-1], fit.wavelength_nm)
    style.place(figure, gap_y_in=0.34)
    return style.Drawing(
        name="coefficients",
        title=f"Hemispherical reflectance at 8°, {WHICH[fit.polarization]} (after the paper's Figure 11)",
        caption=_caption(content, fit, comparison),
        figure=figure,
    )


def draw_coefficients_alone(content: Content, fits: Sequence[FitResult]) -> style.Drawing:
    """Draw k_d, k_s, k_g at 8 deg of the fits of one polarization alone, side by side."""
    changes = content.scan.detector_change_nm
    figure = style.new_figure(9.8 if len(fits) > 1 else 6.0, 4.6)
    panels = figure.subplots(
        2, len(fits), squeeze=False, sharex=True, sharey="row", gridspec_kw={"height_ratios": [2.0, 1.0]}
    )
    found: list[list[tuple[float, float] | None]] = [[], []]
    for column, fit in enumerate(fits):
        upper, lower = panels[:, column]
        for row, pair in enumerate(_draw_reflectances(upper, lower, content, fit)):
            found[row].append(pair)
        upper.set_title(WHICH[fit.polarization])
        style.mark_changes(upper, changes, choose.change_texts(content.scan) if column == 0 else ())
        style.wavelength_axis(lower, fit.wavelength_nm)
    for row, pairs in enumerate(found):
        known = [p for p in pairs if p is not None]
        if known:
            panels[row, 0].set_ylim(min(p[0] for p in known), max(p[1] for p in known))
    panels[0, 0].set_ylabel("reflectance at 8° / %")
    panels[1, 0].set_ylabel(f"{K_S} at 8° / %")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="lower center", ncols=5)
    style.place(figure, bottom_in=0.78)
    sources = " and ".join(f"<code>/entry/fit_{f.aperture}_{f.polarization}</code>" for f in fits)
    return style.Drawing(
        name="coefficients_alone",
        title="Hemispherical reflectance at 8° by polarization (after the paper's Figure 10)",
        caption=(
            "As the figure before, but from the fits of one polarization alone, each with its own "
            "n<sub>2</sub>; k is the mean over S and P that each of them predicts, and the sphere "
            "measures that mean. Where the two panels differ by more than their 95 % bands, model or "
            f"alignment do not treat the polarizations alike. Drawn from {sources}."
        ),
        figure=figure,
    )


def draw_parameters(content: Content, fit: FitResult) -> style.Drawing:
    """Draw rho_d, rho_s and alpha over wavelength, one above the other."""
    changes = content.scan.detector_change_nm
    figure = style.new_figure(8.6, 5.8)
    panels = list(figure.subplots(3, 1, sharex=True))
    rows = (
        ("rho_d", r"$\rho_\mathrm{d}$ / 1", style.ORANGE),
        ("rho_s", r"$\rho_\mathrm{s}$ / 1", style.VERMILLION),
        ("alpha", "lobe exponent α / 1", style.PURPLE),
    )
    for axes, (name, label, colour) in zip(panels, rows, strict=True):
        value, lower, upper = parameter(fit, name)
        style.draw_spectrum(
            axes, fit.wavelength_nm, value, lower=lower, upper=upper, changes_nm=changes, colour=colour,
            label="fit with 95 % band",
        )  # fmt: skip
        shown = [value, *_draw_truth(axes, content, fit.wavelength_nm, name, 1.0)]
        axes.set_ylabel(label)
        _finish(axes, shown, [lower, upper], changes)
        style.legend_above(axes)
    style.mark_changes(panels[0], changes, choose.change_texts(content.scan))
    style.wavelength_axis(panels[-1], fit.wavelength_nm)
    style.place(figure, gap_y_in=0.34)
    return style.Drawing(
        name="parameters",
        title="Parameters of the reflection model",
        caption=(
            "The diffuse albedo ρ<sub>d</sub>, the specular factor ρ<sub>s</sub> and the exponent α of "
            f"the lobe cos<sup>α</sup>, fitted at each wavelength by itself ({describe(fit)}). Bands: 95 "
            "% intervals. A band that leaves the axis has no useful bound: ρ<sub>s</sub> and "
            "n<sub>2</sub> trade against each other, and a lobe narrower than the aperture says little "
            "about α from above."
        ),
        figure=figure,
    )


def draw_index(content: Content, fit: FitResult) -> style.Drawing:
    """Draw n2 of the main fit and, where stored, of S alone and P alone."""
    changes = content.scan.detector_change_nm
    figure = style.new_figure(8.6, 3.5)
    axes = figure.add_subplot()
    alone = [content.fit_of(p) for p in ("s", "p")]
    curves = [fit, *(f for f in alone if f is not None and f is not fit)]
    looks: dict[str, tuple[str, style.Dashes]] = {
        "joint": (style.BLUE, "-"),
        "s": (style.VERMILLION, "-."),
        "p": (style.GREEN, (0, (3, 1))),
    }
    shown: list[FloatArray] = []
    bands: list[FloatArray] = []
    for one in curves:
        value, lower, upper = parameter(one, "n2")
        colour, dashes = looks[one.polarization]
        style.draw_spectrum(
            axes, one.wavelength_nm, value, lower=lower, upper=upper, changes_nm=changes, colour=colour,
            dashes=dashes, band_alpha=0.16,
            label={"joint": "S and P jointly, 95 % band", "s": "S alone", "p": "P alone"}[one.polarization],
        )  # fmt: skip
        shown.append(value)
        bands += [lower, upper]
    shown += _draw_truth(axes, content, fit.wavelength_nm, "n2", 1.0)
    axes.set_ylabel("refractive index n₂ / 1")
    _finish(axes, shown, bands, changes)
    style.mark_changes(axes, changes, choose.change_texts(content.scan))
    style.legend_above(axes)
    style.wavelength_axis(axes, fit.wavelength_nm)
    style.place(figure)
    absent = [p.upper() for p, f in zip("sp", alone, strict=True) if f is None and fit.polarization != p]
    hint = (
        f" Fits of {' and '.join(absent)} alone are not stored in this file; "
        "<code>gonio fit FILE.h5 --polarization s</code> (and <code>p</code>) adds them to this figure."
        if absent
        else ""
    )
    return style.Drawing(
        name="index",
        title="Refractive index of the surface (after the paper's Figure 12)",
        caption=(
            "The index n<sub>2</sub> that the Fresnel reflectance needs to follow the lobe over the "
            "incidences, with 95 % bands. One polarization alone separates n<sub>2</sub> from "
            "ρ<sub>s</sub> by the angular trend only, both together by the contrast of S and P as well; "
            f"curves that lie apart tell of the model.{hint}"
        ),
        figure=figure,
    )


def _caption(content: Content, fit: FitResult, comparison: SphereComparison | None) -> str:
    text = [
        "Directional-hemispherical reflectance at 8° incidence, mean of S and P, from the fit "
        f"({describe(fit)}); bands: 95 % intervals, propagated from the parameters with their full "
        "covariance, k<sub>s</sub> integrated above the horizon."
    ]
    sphere = sphere_of(content)
    if sphere is not None:
        text.append(
            f"Green: the integrating sphere, {html.escape(sphere.uncertainty)}. Lowest panel: the fit's "
            f"{sphere.geometry.coefficient} minus the sphere's; outside the grey band the two disagree by "
            "more than both claim."
        )
    else:
        text.append("No sphere measurement is stored in this file to compare with.")
    if content.truth is not None:
        text.append("Dashed: what is true on the simulated bench.")
    if content.scan.detector_change_nm:
        where = ", ".join(choose.change_texts(content.scan))
        text.append(
            f"No curve is joined across the detector change ({where}): a step there is a difference of gain."
        )
    judged = [part for part in comparison.parts() if part.judged] if comparison is not None else []
    if judged:
        worst = max(judged, key=lambda part: abs(part.worst_e_n))
        text.append(
            f"The largest disagreement is E<sub>n</sub> = {worst.worst_e_n:.2f}, on detector "
            f"{html.escape(worst.detector)}."
        )
    return " ".join(text)


def parameter(fit: FitResult, name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return value, lower and upper 95 % limit of a parameter, each (n_wavelength,)."""
    column = list(fit.parameters).index(name)
    return fit.value[:, column], fit.lower[:, column], fit.upper[:, column]


def _draw_reflectances(
    upper: Axes, lower: Axes, content: Content, fit: FitResult
) -> list[tuple[float, float] | None]:
    """Draw k_g and k_d into one panel, k_s into the other; return the limits that show the curves."""
    changes = content.scan.detector_change_nm
    hemispherical = fit.hemispherical(theta_i_deg=SPHERE_THETA_I_DEG)
    panels = (
        (
            upper,
            (
                ("k_g", f"{K_G} = {K_D} + {K_S} of the fit", style.BLUE),
                ("k_d", f"{K_D} of the fit", style.ORANGE),
            ),
        ),
        (lower, (("k_s", f"{K_S} of the fit", style.VERMILLION),)),
    )
    found = []
    for axes, rows in panels:
        shown: list[FloatArray] = []
        bands: list[FloatArray] = []
        for name, label, colour in rows:
            coefficient = getattr(hemispherical, name)
            value, low, high = (100.0 * getattr(coefficient, n) for n in ("value", "lower", "upper"))
            style.draw_spectrum(
                axes,
                fit.wavelength_nm,
                value,
                lower=low,
                upper=high,
                changes_nm=changes,
                colour=colour,
                label=label,
            )
            shown.append(value)
            bands += [low, high]
            once = TRUTH if name in ("k_g", "k_s") else "_truth"
            shown += _draw_truth(axes, content, fit.wavelength_nm, name, 100.0, label=once)
        if axes is upper:
            shown += _draw_sphere(axes, content, changes)
        found.append(_finish(axes, shown, bands, changes))
    return found


def _draw_truth(
    axes: Axes, content: Content, wavelength_nm: FloatArray, name: str, scale: float, *, label: str = TRUTH
) -> list[FloatArray]:
    if content.truth is None:
        return []
    own_nm = content.truth.wavelength_nm  # finer than a scan of few wavelengths
    inside = (own_nm >= wavelength_nm.min()) & (own_nm <= wavelength_nm.max())
    shown_nm = np.union1d(own_nm[inside], wavelength_nm)
    true = scale * content.truth.at(shown_nm, name)
    if not np.any(np.isfinite(true)):
        return []
    style.draw_spectrum(
        axes, shown_nm, true, colour=style.BLACK, dashes=(0, (4, 2)), width=0.9, label=label, zorder=3.0
    )
    return [true]


def _draw_sphere(axes: Axes, content: Content, changes: Sequence[float]) -> list[FloatArray]:
    sphere = sphere_of(content)
    if sphere is None:
        return []
    value, expanded = 100.0 * sphere.value, 100.0 * COVERAGE * sphere.standard
    style.draw_spectrum(
        axes,
        sphere.wavelength_nm,
        value,
        lower=value - expanded,
        upper=value + expanded,
        changes_nm=changes,
        colour=style.GREEN,
        dashes=(0, (1, 1)),
        label="integrating sphere",
        zorder=2.2,
    )
    return [value]


def _draw_deviation(axes: Axes, comparison: SphereComparison, changes: Sequence[float]) -> None:
    deviation, expanded = 100.0 * comparison.difference, 100.0 * comparison.expanded
    axes.axhline(0.0, color=style.BLACK, linewidth=0.8, zorder=1.5)
    x, (low, high) = style.broken(comparison.wavelength_nm, -expanded, expanded, at=changes)
    axes.fill_between(
        x,
        low,
        high,
        color=style.GREY,
        alpha=0.25,
        linewidth=0,
        label="95 % of fit and sphere together (|Eₙ| ≤ 1)",
    )
    style.draw_spectrum(
        axes,
        comparison.wavelength_nm,
        deviation,
        changes_nm=changes,
        colour=style.BLUE,
        label=f"{K_G if comparison.coefficient == 'k_g' else K_D} of the fit − sphere",
    )
    axes.set_ylabel("difference / %")
    _finish(axes, [deviation], [-expanded, expanded], changes)
    style.legend_above(axes)


def _finish(
    axes: Axes,
    shown: Sequence[FloatArray],
    bands: Sequence[FloatArray],
    changes: Sequence[float],
) -> tuple[float, float] | None:
    """Set the limits so that the curves fill the panel, count what is outside, mark the detector changes."""
    found = style.limits(*shown, bands=bands)
    if found is not None:
        axes.set_ylim(*found)
        style.beyond(axes, *shown)
    style.mark_changes(axes, changes)
    return found
