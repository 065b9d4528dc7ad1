"""The comparison with the sphere as a person reads it: a table, verdicts, what may cause a disagreement."""

from __future__ import annotations

import math

import numpy as np

from gonio.sphere.compare import Part, SphereComparison

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
    lines += ["  " + line for line in _notes(comparison)]
    lines += verdicts(comparison, parts)
    return "\n".join(lines)


def _rows(comparison: SphereComparison, parts: tuple[Part, ...], bands: tuple[Part, ...]) -> list[str]:
    k = comparison.coefficient
    head = (
        f"{'nm':<12}{'detector':<12}{k + ' fit':>9}{'sphere':>9}{'fit - sphere':>21}"
        f"{'U_fit':>9}{'U_common':>10}{'U_sphere':>10}{'E_n':>8}  |E_n|<=1"
    )
    lines = [head, "-" * len(head)]
    for part in parts:
        lines.append(_row(part, ""))
        own = [b for b in bands if part.low_nm <= b.low_nm and b.high_nm <= part.high_nm
               and b.detector == part.detector]  # fmt: skip
        if len(own) > 1:
            lines += [_row(band, "  ") for band in own]
    return lines


def _row(part: Part, indent: str) -> str:
    where = f"{indent}{part.low_nm:g}-{part.high_nm:g}" if part.count > 1 else f"{indent}{part.low_nm:g}"
    relative = f"{100 * part.relative:+.1f} %" if math.isfinite(part.relative) else "-"
    within = f"{part.within}/{part.judged}" if part.judged else "-"
    return (
        f"{where:<12}{'' if indent else part.detector:<12}{part.value:>9.4f}{part.reference:>9.4f}"
        f"{100 * part.difference:>+9.2f} %R{relative:>9}"
        f"{_u(part.u_fit):>9}{_u(part.u_common):>10}{_u(part.u_sphere):>10}{_e_n(part.e_n):>8}{within:>10}"
    )


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
        else "U_common: the fit states none (distance, size and alignment of the aperture are not in)"
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
            f"the sphere was measured with a polarizer at {sphere.facts['header_polarizer_deg']} deg; the "
            "fit's k is the mean of S and P"
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
    lines = []
    for part in off:
        # k = pi r / Omega for a diffuse sample: what a reading is off by when k is off by `difference`
        offset = 100 * part.difference * comparison.solid_angle_sr / math.pi
        where = f"{part.low_nm:g}-{part.high_nm:g} nm"
        line = f"{where}: a zero offset of {offset:+.2g} %R in each reading (dark, stray light)"
        if math.isfinite(part.relative) and part.relative > -1.0:
            line += (
                f", or a gain of {100 * part.relative:+.2g} % that does not cancel between sample and "
                "baseline "
                "(nonlinearity of the detector: a baseline is some 80 times brighter than a white sample)"
            )
        lines.append(line)
    if len({part.detector for part in parts}) > 1:
        alike = all(_alike(part, off[0]) for part in parts)
        if alike and math.isfinite(off[0].relative):
            distance = 100 * (math.sqrt(1.0 / (1.0 + off[0].relative)) - 1.0)
            lines.append(
                f"all detectors deviate alike: the aperture's distance ({distance:+.2g} % would do; k goes "
                "with its square), its size, the alignment, or the sphere's own standard"
            )
        else:
            lines.append(
                "the detectors deviate differently, and distance, aperture, alignment and the sphere's "
                "standard would shift them alike: look at the detector's zero and linearity"
            )
    elif math.isfinite(off[0].relative) and off[0].relative > -1.0:
        distance = 100 * (math.sqrt(1.0 / (1.0 + off[0].relative)) - 1.0)
        lines.append(
            f"or the aperture's distance ({distance:+.2g} % would do; k goes with its square), its size, the "
            "alignment, the sphere's own standard"
        )
    return lines


def _alike(one: Part, other: Part) -> bool:
    """Say whether two parts deviate by the same factor, within what is not common to them."""
    own = math.hypot(one.u_fit / one.reference, other.u_fit / other.reference) / 2.0
    return abs(one.relative - other.relative) <= max(_ALIKE * own, 0.1 * abs(other.relative))
