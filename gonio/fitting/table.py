"""The printed table of a fit: one row per wavelength band, beside truth and sphere where known."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.means import Column, columns_of
from gonio.fitting.ratios import detector_ratios
from gonio.sphere.compare import SphereComparison, compare
from gonio.sphere.stored import sphere_of_columns

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]

_EDGES_NM = (300.0, 400.0, 550.0, 700.0, 860.0, 1100.0, 1300.0, 1500.0)
BANDS = tuple(itertools.pairwise(_EDGES_NM))
THETA_I_DEG = 8.0
"""Incidence of k_s and k_g in the table: the integrating sphere's."""

_WIDTH = 100
_DIGITS = {
    "rho_d": 4, "rho_s": 3, "alpha": 1, "n2": 3, "roughness": 4, "k_d": 4, "k_s": 4, "k_g": 4,
}  # fmt: skip


def digits_of(name: str) -> int:
    """Return the decimals of a parameter in tables; of ``rho_d[s]`` those of rho_d."""
    return _DIGITS[name.partition("[")[0]]


def band_table(
    fit: FitResult,
    bands: Sequence[tuple[float, float]] | None = None,
    *,
    truth: Mapping[str, FloatArray] | None = None,
    sphere: Mapping[str, FloatArray] | None = None,
    detector_names: Sequence[str] = (),
) -> str:
    """Return the table.

    Parameters
    ----------
    bands
        (low, high) in nm, low included, high excluded but for the last; None takes those of `BANDS` that the
        scan has.
    truth, sphere
        Columns over ``wavelength_nm``: `truth` any of the parameters and coefficients, `sphere` ``k_g`` and,
        if known, its standard uncertainty ``k_g_u``.  They are interpolated to the fit's wavelengths.
    detector_names
        For the comparison of detectors where two measured the same wavelengths, in the rig file's order.

    Notes
    -----
    An entry is the plain mean over the band's wavelengths ± half its 95 % interval: each has its own
    readings, baseline and dark, which average out; what wavelengths share does not
    (`gonio.fitting.means`).  The sphere and E_n are those of `gonio.sphere.compare`; a band that spans a
    detector change has no E_n.  A wavelength that two detectors measured counts once, with the detector on
    whose side of the change it lies; their ratio stands below the table.
    """
    whole, fit = fit, fit.only(fit.home)
    columns = columns_of(fit, THETA_I_DEG)
    rows = _rows(fit, BANDS if bands is None else bands)
    lines: list[str] = []
    for names in (fit.parameters, ("k_d", "k_s", "k_g")):  # side by side they are wider than a terminal
        of_sphere = sphere if sphere is not None and "k_g" in names and "k_g" in sphere else None
        lines += [*_block(fit, {name: columns[name] for name in names}, rows, truth, of_sphere), ""]
    lines.append(
        f"mean ± half its 95 % interval; k at {THETA_I_DEG:g} deg, S/P mean, lobe above the horizon;\n"
        f"model '{fit.model}', aperture '{fit.aperture}', polarization '{fit.polarization}'"
    )
    lines += textwrap.wrap(_covered(whole), _WIDTH)
    ratios = detector_ratios(whole)
    if ratios:
        lines += ["detectors where both measured:", *(f"  {ratio.text(detector_names)}" for ratio in ratios)]
    for remark in whole.remarks:
        lines += textwrap.wrap(remark, _WIDTH, initial_indent="  ", subsequent_indent="    ")
    lines.extend(_remarks(whole))
    return "\n".join(lines)


def _covered(fit: FitResult) -> str:
    """Say which causes the intervals know."""
    if fit.intervals == "nlparci":
        return "± holds the scatter of the residuals alone, as nlparci does"
    own = "± holds noise, dark and baseline of the scan"
    if fit.mode_names:
        return f"{own}, and what wavelengths share: {', '.join(fit.mode_names)}"
    return f"{own}; not the rig's [uncertainty] (aperture, alignment, ...), which --budget brings in"


def _block(
    fit: FitResult,
    columns: Mapping[str, Column],
    rows: Sequence[tuple[str, NDArray[np.bool_]]],
    truth: Mapping[str, FloatArray] | None,
    sphere: Mapping[str, FloatArray] | None,
) -> list[str]:
    """Return the lines of the table of some columns."""
    names = list(columns)
    cells = [[_entry(column, use, digits_of(name)) for name, column in columns.items()] for _, use in rows]
    width = [
        3 + max(map(len, (name, *column)))
        for name, column in zip(names, zip(*cells, strict=True), strict=True)
    ]
    head = f"{'nm':<11}" + "".join(f"{name:>{w}}" for name, w in zip(names, width, strict=True))
    if sphere is not None:
        head += f"{'k_g sphere':>19}{'E_n':>7}"
    compared = compare(fit, sphere_of_columns(sphere)) if sphere is not None else None
    lines = [head, "-" * len(head)]
    for (label, use), entries in zip(rows, cells, strict=True):
        line = f"{label:<11}" + "".join(f"{entry:>{w}}" for entry, w in zip(entries, width, strict=True))
        if compared is not None:
            line += _sphere_entry(compared, use)
        lines.append(line)
        if truth is not None and not truth.keys().isdisjoint(columns):
            line = f"{'  true':<11}"
            for name, entry, w in zip(names, entries, width, strict=True):
                known = _interpolated(truth, name, fit.wavelength_nm[use])
                # under the value, not under its uncertainty
                text = "" if known is None else f"{np.mean(known):.{digits_of(name)}f}"
                line += f"{text + ' ' * max(len(entry) - entry.find(' ± '), 0):>{w}}"
            lines.append(line.rstrip())
    return lines


def _rows(fit: FitResult, bands: Sequence[tuple[float, float]]) -> list[tuple[str, NDArray[np.bool_]]]:
    at = fit.wavelength_nm
    if not np.all(np.isfinite(at)):
        return [("all", np.ones(len(at), bool))]
    rows = []
    for low, high in bands:
        use = (at >= low) & ((at < high) | ((high == bands[-1][1]) & (at == high)))
        if np.any(use):
            rows.append((f"{low:g}-{high:g}", use))
    return rows or [(f"{at.min():g}-{at.max():g}", np.ones(len(at), bool))]


def _entry(column: Column, use: NDArray[np.bool_], digits: int) -> str:
    mean, half = column.mean(use)
    if not np.isfinite(mean):
        return "undetermined" if digits < 4 else "-"
    if abs(mean) >= 1e4:  # an exponent that only the edges of the lobe tell: no decimals to speak of
        digits = 0
    if not np.isfinite(half):
        return f"{mean:.{digits}f} ± {'?':<{digits + 2}}"
    return f"{mean:.{digits}f} ± {half:.{digits}f}"


def _interpolated(columns: Mapping[str, FloatArray], name: str, at: FloatArray) -> FloatArray | None:
    if name not in columns or "wavelength_nm" not in columns:
        return None
    return np.interp(at, columns["wavelength_nm"], columns[name], left=np.nan, right=np.nan)


def _sphere_entry(compared: SphereComparison, use: NDArray[np.bool_]) -> str:
    """Return the sphere's mean k_g ± its expanded uncertainty, and E_n of the means."""
    part = compared.over(use)
    if part is None or not np.all(np.isfinite(compared.reference[use])):
        return f"{'-':>19}{'-':>7}"
    alone = len(np.unique(compared.side[use])) == 1  # means across a detector change prove nothing
    e_n = f"{part.e_n:.2f}" if alone and np.isfinite(part.e_n) else "-"
    if not np.isfinite(part.u_sphere):
        return f"{part.reference:>10.4f}         {e_n:>7}"
    return f"{f'{part.reference:.4f} ± {part.u_sphere:.4f}':>19}{e_n:>7}"


def _remarks(fit: FitResult) -> list[str]:
    """Return the notes, each once, with the wavelengths it holds for."""
    kinds: dict[str, list[int]] = {}
    for k, note in enumerate(fit.notes):
        for part in filter(None, note.split("; ")):
            kinds.setdefault(_kind(part), []).append(k)
    lines = []
    for kind, at in kinds.items():
        example = next(p for p in fit.notes[at[0]].split("; ") if _kind(p) == kind)
        nm = fit.wavelength_nm[at]
        where = (
            f"{nm[0]:g} nm"
            if len(at) == 1
            else f"{len(at)} wavelengths, {nm.min():g}-{nm.max():g} nm, the first"
        )
        lines.append(f"  {where}: {example}")
    return ["notes:", *lines] if lines else []


def _kind(part: str) -> str:
    """Return a note without its numbers, so that equal notes of many wavelengths are printed once."""
    return "".join("#" if c.isdigit() else c for c in part).replace("#", "").replace("-", "").replace(".", "")
