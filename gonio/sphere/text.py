"""The comparison with the sphere as a person reads it: a table, verdicts, what may cause a disagreement."""

from __future__ import annotations

import math
import textwrap

import numpy as np

from gonio.sphere.compare import Part, SphereComparison
from gonio.sphere.uncertainty import COVERAGE

_WIDTH = 110
_FEWEST, _VARIED = 5, 0.1
"""Wavelengths, and relative variation of the reflectance, that tell an offset from a gain."""
_ALIKE = 2.0
"""Two detectors deviate alike if they differ by less than this many standard uncertainties."""


def comparison_text(comparison: SphereComparison) -> str:
    """Return the table, its notes and the verdicts, in lines of at most 110 characters."""
    from gonio.fitting.table import BANDS

    sphere, k = comparison.sphere, comparison.coefficient
    parts = comparison.parts()
    title = f"against the integrating sphere ({sphere.name}): {k} at {sphere.geometry.theta_i_deg:g} deg"
    if not parts:
        return f"{title}\n  fit and sphere have no wavelength in common{_ranges(comparison)}"
    lines = [title, *_rows(comparison, parts, comparison.bands(BANDS))]
    for line in _notes(comparison):
        lines += textwrap.wrap(
            line,
            _WIDTH,
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    for line in verdicts(comparison, parts):
        further = " " * (len(line) - len(line.lstrip()) + 2)
        lines += textwrap.wrap(
            line, _WIDTH, subsequent_indent=further, break_long_words=False, break_on_hyphens=False
        )
    return "\n".join(lines)


def _rows(comparison: SphereComparison, parts: tuple[Part, ...], bands: tuple[Part, ...]) -> list[str]:
    has_common = bool(comparison.mode_names)
    cells = [["nm", "detector", f"{comparison.coefficient} fit", "sphere", "fit - sphere", "", "U_fit",
              "U_common", "U_sphere", "E_n", "|E_n|<=1"]]  # fmt: skip
    for part in parts:
        cells.append(_cells(part, "", has_common))
        own = [b for b in bands if part.low_nm <= b.low_nm and b.high_nm <= part.high_nm
               and b.detector == part.detector]  # fmt: skip
        if len(own) > 1:
            cells += [_cells(band, "  ", has_common) for band in own]
    width = [max(map(len, column)) + 2 for column in zip(*cells, strict=True)]
    lines = [
        "".join(
            f"{cell:<{w}}" if k < 2 else f"{cell:>{w}}"
            for k, (cell, w) in enumerate(zip(row, width, strict=True))
        )
        for row in cells
    ]
    return [lines[0], "-" * len(lines[0]), *lines[1:]]


def _cells(part: Part, indent: str, has_common: bool) -> list[str]:
    return [
        f"{indent}{part.low_nm:g}-{part.high_nm:g}" if part.count > 1 else f"{indent}{part.low_nm:g}",
        "" if indent else part.detector,
        f"{part.value:.4f}",
        f"{part.reference:.4f}",
        f"{100 * part.difference:+.2f} %R",
        f"{100 * part.relative:+.1f} %" if math.isfinite(part.relative) else "-",
        _u(part.u_fit),
        _u(part.u_common) if has_common else "-",
        _u(part.u_sphere),
        _e_n(part.e_n),
        f"{part.within}/{part.judged}" if part.judged else "-",
    ]


def _u(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "?"


def _e_n(value: float) -> str:
    return f"{value:+.2f}" if math.isfinite(value) else "?"


def _notes(comparison: SphereComparison) -> list[str]:
    sphere = comparison.sphere
    modes = ", ".join(comparison.mode_names)
    common = (
        f"U_common: {modes}"
        if modes
        else "U_common: none is in the fit (distance, size, alignment: gonio fit --budget)"
    )
    gap = _longest_gap(comparison)
    lines = [
        "means over the wavelengths; U at 95 %. U_fit: noise, dark and baseline, averaging out;",
        f"{common}, not averaging out;",
        f"U_sphere: {sphere.uncertainty}, common to all wavelengths. fit - sphere in %R (absolute) and "
        "relative to the sphere.",
        f"sphere: {sphere.geometry.describe()}"
        + (f"; interpolated between wavelengths up to {gap:g} nm apart" if gap else ""),
    ]
    if sphere.detector_change_nm:
        changes = ", ".join(f"{w:g}" for w in sphere.detector_change_nm)
        lines.append(
            f"the sphere's spectrometer changed its detector at {changes} nm; nothing is joined there"
        )
    if "header_polarizer_deg" in sphere.facts:
        lines.append(
            f"its header names a polarizer at {sphere.facts['header_polarizer_deg']} deg; if it was in the "
            "beam, mind that the fit's k is the mean of S and P"
        )
    if sphere.geometry.specular == "excluded":
        lines.append(
            "a gloss trap takes only the light near the mirror direction; of a wide lobe the sphere still "
            "sees a part, and lies between k_d and k_g"
        )
    if "remarks" in sphere.facts:
        lines.append(f"of the file: {sphere.facts['remarks']}")
    return lines


def _longest_gap(comparison: SphereComparison) -> float:
    """Return the longest distance between wavelengths of the sphere across which it was interpolated, nm."""
    w, at = comparison.sphere.wavelength_nm, comparison.wavelength_nm[np.isfinite(comparison.reference)]
    between = at[~np.isin(at, w)]
    right = np.searchsorted(w, between)
    return float(np.max(w[right] - w[right - 1])) if between.size else 0.0


def _ranges(comparison: SphereComparison) -> str:
    w, at = comparison.sphere.wavelength_nm, comparison.wavelength_nm
    if not (w.size and at.size and np.all(np.isfinite(at))):
        return ""
    return f" (fit {at.min():g}-{at.max():g} nm, sphere {w.min():g}-{w.max():g} nm)"


def verdicts(comparison: SphereComparison, parts: tuple[Part, ...] | None = None) -> list[str]:
    """Return a sentence for each part, and below what may cause a disagreement."""
    parts = comparison.parts() if parts is None else parts
    lines = [verdict(part) for part in parts]
    off = [part for part in parts if abs(part.e_n) > 1.0]
    if off:
        lines += ["what may cause it:", *("  " + line for line in _causes(comparison, parts, off))]
    return lines


def verdict(part: Part) -> str:
    """Return one sentence: do fit and sphere agree, and if not, by how much and to which side."""
    where = f"over {part.low_nm:g}-{part.high_nm:g} nm ({part.detector})"
    if not math.isfinite(part.e_n):
        return (
            f"the fit is {_off(part)} {where}; without a stated uncertainty nothing can be said of "
            "agreement: state it with --sphere-u"
        )
    share = f"|E_n| <= 1 at {part.within} of {part.judged} wavelengths"
    if abs(part.e_n) <= 1.0:
        return f"fit and sphere agree {where}: {_off(part)}, E_n = {part.e_n:+.2f}, {share}"
    return f"the fit is {_off(part)} {where}, beyond both uncertainties: E_n = {part.e_n:+.2f}, {share}"


def _off(part: Part) -> str:
    side = "low" if part.difference < 0 else "high"
    relative = f"{100 * abs(part.relative):.2g} % (relative) {side}" if math.isfinite(part.relative) else side
    return f"{relative}, {100 * part.difference:+.2g} %R"


def _causes(comparison: SphereComparison, parts: tuple[Part, ...], off: list[Part]) -> list[str]:
    """Return what would explain the disagreement, in numbers, and what speaks against it."""
    lines = [_cause_at_the_detector(comparison, part) for part in off]
    distance = _distance(off[0])
    if len({part.detector for part in parts}) == 1:
        lines.append(f"or what detectors share: {distance}its size, the alignment, the sphere's own standard")
    elif all(_alike(part, off[0]) for part in parts):
        lines.append(
            f"all detectors deviate alike: {distance}its size, the alignment, or the sphere's own standard"
        )
    else:
        lines.append(
            "the detectors deviate differently, and distance, aperture, alignment and the sphere's standard "
            "would shift them alike: look at the detector's zero and linearity"
        )
    return lines


def _cause_at_the_detector(comparison: SphereComparison, part: Part) -> str:
    # a diffuse sample of coefficient k gives r = k Omega / pi of the baseline
    ratio = comparison.solid_angle_sr / math.pi
    line = (
        f"{part.low_nm:g}-{part.high_nm:g} nm: a zero offset of {100 * part.difference * ratio:+.2g} %R in "
        "each "
        "reading (dark, stray light)"
    )
    if not math.isfinite(part.relative):
        return line
    line += (
        f", or a gain of {100 * part.relative:+.2g} % that does not cancel between sample and baseline "
        f"(nonlinearity of the detector: the baseline is some {1.0 / (ratio * part.reference):.2g} times "
        "brighter "
        "than the sample)"
    )
    return line + _shape(comparison, part)


def _shape(comparison: SphereComparison, part: Part) -> str:
    """Say whether the difference goes with the reflectance, where that varies enough to tell."""
    at = comparison.wavelength_nm
    use = (at >= part.low_nm) & (at <= part.high_nm) & np.isfinite(comparison.difference)
    difference, reference = comparison.difference[use], comparison.reference[use]
    if part.count < _FEWEST or np.std(reference) < _VARIED * np.mean(reference):
        return ""
    gain = np.sum(difference * reference) / np.sum(reference**2)
    of_gain = float(np.sqrt(np.mean((difference - gain * reference) ** 2)))
    of_offset = float(np.std(difference))
    if of_gain < 0.5 * of_offset:
        return "; the difference goes with the reflectance, as a gain's does and an offset's does not"
    if of_offset < 0.5 * of_gain:
        return "; the difference is the same for dark and bright, as an offset's is and a gain's is not"
    return ""


def _distance(part: Part) -> str:
    """Return which error of the aperture's distance would do; k goes with its square."""
    if not (math.isfinite(part.relative) and part.relative > -1.0):
        return "the aperture's distance, "
    needed = 100 * (math.sqrt(1.0 / (1.0 + part.relative)) - 1.0)
    return f"the aperture's distance ({needed:+.2g} % would do, since k goes with its square), "


def _alike(one: Part, other: Part) -> bool:
    """Say whether two parts deviate by the same factor, within what is not common to them."""
    if not (math.isfinite(one.relative) and math.isfinite(other.relative)):
        return False
    own = math.hypot(one.u_fit / one.reference, other.u_fit / other.reference) / COVERAGE
    return abs(one.relative - other.relative) <= max(_ALIKE * own, 0.1 * abs(other.relative))
