"""What are the results, in a few numbers?  Averages over wavelength bands, beside the sphere and the truth.

The bands and the rule are those of the table that `gonio fit` prints: the plain mean of a band's
wavelengths, and half the 95 % interval of that mean (`gonio.fitting.means`).  The
sphere and E_n are those of `gonio.sphere.compare`.  A band that would span a detector change is split there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gonio.fitting.means import Column, columns_of
from gonio.fitting.ratios import detector_ratios
from gonio.fitting.table import BANDS
from gonio.report.agreement import SPHERE_THETA_I_DEG, compare
from gonio.report.content import Content
from gonio.report.page import MISSING, Block, Table, Text, Tile, number, with_uncertainty

if TYPE_CHECKING:
    from gonio.fitting import FitResult

FloatArray = NDArray[np.float64]

VISIBLE_NM = (380.0, 740.0)
HEADS = {
    "rho_s": "ρ<sub>s</sub>",
    "alpha": "α",
    "n2": "n<sub>2</sub>",
    "k_d": "k<sub>d</sub> = ρ<sub>d</sub> / %",
    "k_s": "k<sub>s</sub> / %",
    "k_g": "k<sub>g</sub> / %",
}


def bands(wavelength_nm: FloatArray, changes_nm: tuple[float, ...]) -> list[NDArray[np.intp]]:
    """Return the indices of the wavelengths in each band, none across a detector change."""
    edges = [low for low, _ in BANDS] + [np.nextafter(BANDS[-1][1], np.inf)]  # the last band includes its end
    number_of_band = np.searchsorted(edges, wavelength_nm, side="right")
    number_of_detector = np.searchsorted(
        np.asarray(changes_nm, dtype=np.float64), wavelength_nm, side="right"
    )
    keys = sorted(set(zip(number_of_band.tolist(), number_of_detector.tolist(), strict=True)))
    return [np.flatnonzero((number_of_band == b) & (number_of_detector == d)) for b, d in keys]


def band_table(content: Content, fit: FitResult) -> list[Block]:
    """Return the table of all parameters and coefficients by band."""
    ratios = detector_ratios(fit)
    fit = fit.only(fit.home)
    wavelength_nm = np.asarray(fit.wavelength_nm, dtype=np.float64)
    columns = _columns(fit)
    comparison = compare(content, fit)
    head: list[str | Markup] = ["band / nm", *(Markup(HEADS[name]) for name in columns)]
    if comparison is not None:
        head += ["sphere / %", Markup("E<sub>n</sub>")]
    rows = []
    for inside in bands(wavelength_nm, content.scan.detector_change_nm):
        low, high = wavelength_nm[inside[0]], wavelength_nm[inside[-1]]
        row: list[str | Markup] = [f"{low:g}–{high:g}" if high > low else f"{low:g}"]
        for name, column in columns.items():
            text = _entry(name, column, inside)
            true = _true(content, name, wavelength_nm[inside])
            row.append(Markup("{}<br><small>true {}</small>").format(text, true) if true else text)
        if comparison is not None:
            use = np.zeros(wavelength_nm.size, bool)
            use[inside] = True
            part = comparison.over(use)
            if part is None:
                row += [MISSING, MISSING]
            else:
                row += [with_uncertainty(100.0 * part.reference, 100.0 * part.u_sphere), _e_n(part.e_n)]
        rows.append(row)
    note = Markup(
        "Each entry: plain mean over the wavelengths of the band ± half the 95 % interval of that mean: "
        "noise of readings, baseline and dark, independent from wavelength to wavelength; {}. The sphere's "
        "uncertainty is taken as common to them. No band spans a detector change. k at "
        "{:g}° incidence, mean of S and P, lobe above the horizon."
    ).format(
        "and what wavelengths share: " + ", ".join(fit.mode_names)
        if fit.mode_names
        else "what they share, such as the aperture's distance or the alignment, is not in it (gonio fit "
        "--budget)",
        SPHERE_THETA_I_DEG,
    )
    blocks: list[Block] = [Table(head, rows, note)]
    if ratios:
        names = content.scan.detector_names
        blocks.append(
            Text(
                "Where two detectors measured the same wavelengths, each has its own fit, and a band counts "
                "the one on whose side of the change a wavelength lies. "
                + "; ".join(r.text(names) for r in ratios)
                + ". A ratio off 1 beyond its interval is a gain that does not cancel between sample and "
                "baseline."
            )
        )
    return blocks


def _true(content: Content, name: str, wavelength_nm: FloatArray) -> str:
    """Return the mean of the simulated bench's truth in a band, empty if it is not known."""
    if content.truth is None:
        return ""
    mean = float(np.mean(content.truth.at(wavelength_nm, name)))
    return number(100.0 * mean if name.startswith("k_") else mean) if np.isfinite(mean) else ""


def _e_n(value: float) -> str:
    return f"{value:.2f}".replace("-", "−") if np.isfinite(value) else MISSING


def summary_tiles(fit: FitResult) -> list[Tile]:
    """Return k_d, k_s, k_g and n2 averaged over the visible, or over everything if nothing is visible."""
    fit = fit.only(fit.home)
    wavelength_nm = np.asarray(fit.wavelength_nm, dtype=np.float64)
    inside = np.flatnonzero((wavelength_nm >= VISIBLE_NM[0]) & (wavelength_nm <= VISIBLE_NM[1]))
    where = f"{VISIBLE_NM[0]:g}–{VISIBLE_NM[1]:g} nm"
    if inside.size == 0:
        inside, where = np.arange(wavelength_nm.size), "all wavelengths"
    columns = _columns(fit)
    tiles = []
    for name, meaning in (("k_d", "diffuse"), ("k_s", "specular"), ("k_g", "global")):
        text = _entry(name, columns[name], inside)
        label = Markup("k<sub>{}</sub>, {} reflectance at 8°, {}").format(name[-1], meaning, where)
        tiles.append(Tile(text if text == MISSING else f"{text} %", label))
    tiles.append(
        Tile(_entry("n2", columns["n2"], inside), Markup("refractive index n<sub>2</sub>, {}").format(where))
    )
    return tiles


def _columns(fit: FitResult) -> dict[str, Column]:
    """Return everything in the table; rho_d is k_d."""
    found = columns_of(fit, SPHERE_THETA_I_DEG)
    return {name: found[name] for name in HEADS if name in found}


def _entry(name: str, column: Column, inside: NDArray[np.intp]) -> str:
    """Return the mean over a band ± half its 95 % interval; k in percent."""
    mean, half = column.mean(inside)
    scale = 100.0 if name.startswith("k_") else 1.0
    return with_uncertainty(scale * mean, scale * half)
