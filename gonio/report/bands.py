"""What are the results, in a few numbers?  Averages over wavelength bands, beside the sphere and the truth.

A band's value is the plain mean of its wavelengths.  Its uncertainty is the mean of their half 95 %
intervals, not divided by their number: the baseline, the dark reading and the alignment err for all
wavelengths alike, and a mean over wavelengths does not take that away.  The standard error of the mean
would be smaller and would claim too much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gonio.report.agreement import SPHERE_THETA_I_DEG, sphere_of
from gonio.report.content import Content
from gonio.report.page import MISSING, Block, Table, Tile, number, with_uncertainty

if TYPE_CHECKING:
    from gonio.fitting import FitResult

FloatArray = NDArray[np.float64]

VISIBLE_NM = (380.0, 740.0)
MOST_BANDS = 12
HEADS = {
    "rho_d": "ρ<sub>d</sub>",
    "rho_s": "ρ<sub>s</sub>",
    "alpha": "α",
    "n2": "n<sub>2</sub>",
    "k_d": "k<sub>d</sub> / %",
    "k_s": "k<sub>s</sub> / %",
    "k_g": "k<sub>g</sub> / %",
}


def bands(wavelength_nm: FloatArray, changes_nm: tuple[float, ...]) -> list[NDArray[np.intp]]:
    """Return the indices of the wavelengths in bands of 100 nm or more, none across a detector change."""
    width = 100.0
    while np.ptp(wavelength_nm) / width > MOST_BANDS:
        width *= 2.0
    number_of_band = np.floor(wavelength_nm / width)
    number_of_detector = np.searchsorted(np.asarray(changes_nm, dtype=np.float64), wavelength_nm)
    keys = sorted(set(zip(number_of_detector.tolist(), number_of_band.tolist(), strict=True)))
    return [np.flatnonzero((number_of_detector == d) & (number_of_band == b)) for d, b in keys]


def band_table(content: Content, fit: FitResult) -> list[Block]:
    """Return the table of all parameters and coefficients by band."""
    wavelength_nm = np.asarray(fit.wavelength_nm, dtype=np.float64)
    columns = _columns(fit)
    sphere = sphere_of(content)
    head: list[str | Markup] = ["band / nm", *(Markup(HEADS[name]) for name in columns)]
    reference = None
    if sphere is not None:
        reference = 100.0 * np.interp(
            wavelength_nm, sphere.wavelength_nm, sphere.value, left=np.nan, right=np.nan
        )
        expanded = 100.0 * np.interp(wavelength_nm, sphere.wavelength_nm, sphere.expanded)
        head.append("sphere / %")
    truth = {
        name: (100.0 if name in ("k_g", "k_s") else 1.0) * content.truth.at(wavelength_nm, name)
        for name in ("k_g", "k_s")
        if content.truth is not None and content.truth.column(name) is not None
    }
    head += [Markup(HEADS[name].replace(" / %", "") + ", true / %") for name in truth]
    rows = []
    for inside in bands(wavelength_nm, content.scan.detector_change_nm):
        low, high = wavelength_nm[inside[0]], wavelength_nm[inside[-1]]
        row: list[str | Markup] = [f"{low:g}–{high:g}" if high > low else f"{low:g}"]
        row += [with_uncertainty(*_mean(value[inside], half[inside])) for value, half in columns.values()]
        if reference is not None:
            row.append(with_uncertainty(*_mean(reference[inside], expanded[inside])))
        row += [number(_mean(values[inside], values[inside])[0]) for values in truth.values()]
        rows.append(row)
    note = Markup(
        "Each entry: mean over the wavelengths of the band ± mean half-width of their 95 % intervals. "
        "The half-width is not divided by the number of wavelengths, since baseline, dark reading and "
        "alignment err for all of them alike. No band spans a detector change. k at {:g}° incidence, "
        "mean of S and P."
    ).format(SPHERE_THETA_I_DEG)
    return [Table(head, rows, note)]


def summary_tiles(fit: FitResult) -> list[Tile]:
    """Return k_d, k_s, k_g and n2 averaged over the visible, or over everything if nothing is visible."""
    wavelength_nm = np.asarray(fit.wavelength_nm, dtype=np.float64)
    inside = np.flatnonzero((wavelength_nm >= VISIBLE_NM[0]) & (wavelength_nm <= VISIBLE_NM[1]))
    where = f"{VISIBLE_NM[0]:g}–{VISIBLE_NM[1]:g} nm"
    if inside.size == 0:
        inside, where = np.arange(wavelength_nm.size), "all wavelengths"
    columns = _columns(fit)
    tiles = []
    for name, meaning in (("k_d", "diffuse"), ("k_s", "specular"), ("k_g", "global")):
        value, half = _mean(columns[name][0][inside], columns[name][1][inside])
        text = with_uncertainty(value, half)
        label = Markup("k<sub>{}</sub>, {} reflectance at 8°, {}").format(name[-1], meaning, where)
        tiles.append(Tile(text if text == MISSING else f"{text} %", label))
    value, half = _mean(columns["n2"][0][inside], columns["n2"][1][inside])
    tiles.append(
        Tile(with_uncertainty(value, half), Markup("refractive index n<sub>2</sub>, {}").format(where))
    )
    return tiles


def _columns(fit: FitResult) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return value and half 95 % interval of everything in the table, each (n_wavelength,); k in percent."""
    found = {
        name: (fit.value[:, i], 0.5 * (fit.upper[:, i] - fit.lower[:, i]))
        for i, name in enumerate(fit.parameters)
    }
    hemispherical = fit.hemispherical(theta_i_deg=SPHERE_THETA_I_DEG)
    for name in ("k_d", "k_s", "k_g"):
        k = getattr(hemispherical, name)
        found[name] = (100.0 * k.value, 50.0 * (k.upper - k.lower))
    return found


def _mean(value: FloatArray, half: FloatArray) -> tuple[float, float]:
    """Return the means over the wavelengths with a value; one unbounded interval unbounds the mean."""
    known = np.isfinite(value)
    if not np.any(known):
        return float("nan"), float("nan")
    return float(np.mean(value[known])), float(np.mean(half[known]))
