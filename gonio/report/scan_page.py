"""The page of a scan: what was measured, where it stands, every figure, and where it all comes from."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from gonio import __version__
from gonio.devices import Quality
from gonio.report import choose, style
from gonio.report.agreement import compare, uncertain
from gonio.report.bands import band_table, summary_tiles
from gonio.report.content import Content, file_facts
from gonio.report.curves import describe, draw_curves
from gonio.report.diagnostics import draw_references, draw_residuals
from gonio.report.model import model_of
from gonio.report.page import (
    Block,
    Details,
    List,
    Page,
    Section,
    Table,
    Text,
    Tile,
    number,
    save_picture,
)
from gonio.report.polar import draw_polar
from gonio.report.spectra import draw_coefficients, draw_coefficients_alone, draw_index, draw_parameters
from gonio.sphere import SphereComparison
from gonio.sphere.text import verdicts

if TYPE_CHECKING:
    from gonio.fitting import FitResult

MOST_EVENTS = 200
MOST_NOTES = 40


def scan_page(content: Content, figures: Path, further: Sequence[Section] = ()) -> Page:
    """Draw all figures into the folder and return the page; `further` stands before the diagnostics."""
    scan, fit = content.scan, content.main_fit()
    columns = choose.shown_wavelengths(scan)
    comparison = compare(content, fit) if fit is not None else None
    model = model_of(scan, fit) if fit is not None else None

    def drawn(drawing: style.Drawing) -> Block:
        return save_picture(drawing, figures)

    sections = [
        Section("agreement", "Against the integrating sphere", _agreement(content, comparison)),
    ]
    if fit is not None:
        sections.append(Section("bands", "Results by wavelength band", band_table(content, fit)))
    sections.append(Section("readings", "Raw readings", [drawn(draw_polar(content, c)) for c in columns]))
    if fit is not None and model is not None:
        spectra: list[Block] = [drawn(draw_coefficients(content, fit))]
        alone = [f for f in (content.fit_of("s"), content.fit_of("p")) if f is not None and f is not fit]
        if alone:
            spectra.append(drawn(draw_coefficients_alone(content, alone)))
        spectra += [drawn(draw_index(content, fit)), drawn(draw_parameters(content, fit))]
        sections += [
            Section("fit", "Fit over data", [drawn(draw_curves(content, model, c)) for c in columns]),
            Section("spectra", "Coefficients over wavelength", spectra),
        ]
    sections += further
    diagnostics: list[Block] = []
    if model is not None:
        diagnostics.append(drawn(draw_residuals(content, model)))
    if content.references is not None:
        diagnostics.append(drawn(draw_references(content, content.references)))
    sections += [
        Section("diagnostics", "Diagnostics", diagnostics),
        Section("notes", "What the fit does not determine", _notes(fit)),
        Section("events", "Events of the scan", _events(content)),
        Section("provenance", "Instrument and provenance", _provenance(content, fit)),
    ]
    return Page(
        title=scan.title or scan.sample_name or scan.path.name,
        lead=_lead(content),
        caveats=_caveats(content),
        warnings=_warnings(content, fit),
        tiles=_tiles(content, fit, comparison),
        sections=sections,
        footer=f"Written by gonio {__version__} from {scan.path.name}.",
    )


# -- the head of the page
# ---------------------------------------------------------------------------------------------


def _lead(content: Content) -> str:
    scan = content.scan
    angles = ", ".join(f"{a:.4g}°" for a in choose.incidences(scan))
    wavelength = _wavelengths(scan.wavelength_nm.tolist())
    present = " and ".join(p.upper() for p in choose.polarizations(scan))
    sample = f"{scan.sample_name}: " if scan.sample_name and scan.sample_name != scan.title else ""
    date = f", measured {scan.start_time[:16].replace('T', ' ')}" if scan.start_time else ""
    return (
        f"{sample}{scan.r.shape[0]} positions at incidence {angles}, {present} polarization, "
        f"{wavelength}{date}."
    )


def _wavelengths(wavelength_nm: Sequence[float]) -> str:
    if len(wavelength_nm) == 1:
        return f"one wavelength, {wavelength_nm[0]:g} nm"
    once = set(wavelength_nm)
    twice = len(wavelength_nm) - len(once)
    text = f"{len(once)} wavelengths from {min(once):g} to {max(once):g} nm"
    return text + (f", {twice} of them with two detectors" if twice else "")


def _caveats(content: Content) -> list[str]:
    if not content.simulated:
        return []
    return [
        "These data come from the simulated bench, not from a real sample: its optics, noise and drift "
        "are computed, its truth is known, and it stands in for measurements that are not public. What "
        "agrees here shows that the chain from the wire to this page is consistent, not that a real "
        "instrument would agree as well."
    ]


def _warnings(content: Content, fit: FitResult | None) -> list[str | Markup]:
    scan = content.scan
    texts: list[str | Markup] = []
    if not scan.finished:
        texts.append(
            f"The scan is not finished: {scan.r.shape[0]} of {scan.n_planned} positions are measured. "
            f"gonio scan --resume {scan.path.name} continues it."
        )
    if fit is None:
        texts.append(
            "No fit is stored in this file, so only the raw readings are shown. gonio fit "
            f"{scan.path.name} makes one and stores it beside the data; then write the report again."
        )
    elif not np.any(np.isfinite(fit.value)):
        texts.append("The stored fit has no value at any wavelength; see what it notes below.")
    unusable = int(np.count_nonzero(~scan.usable))
    if unusable:
        over = int(np.count_nonzero(scan.quality & int(Quality.OVER_RANGE)))
        texts.append(
            f"{unusable} of {scan.r.size} readings are missing or flagged ({over} over range); they are "
            "drawn as gaps and take no part in the fit."
        )
    texts += list(content.problems)
    return texts


def _tiles(content: Content, fit: FitResult | None, comparison: SphereComparison | None) -> list[Tile]:
    if fit is None:
        return []
    tiles = summary_tiles(fit)
    parts = comparison.parts() if comparison is not None else ()
    judged = sum(part.judged for part in parts)
    if judged:
        within = sum(part.within for part in parts)
        tiles.append(
            Tile(f"{within} of {judged}", Markup("wavelengths agree with the sphere, |E<sub>n</sub>| ≤ 1"))
        )
    return tiles


# -- sections
# ---------------------------------------------------------------------------------------------------------


def _agreement(content: Content, comparison: SphereComparison | None) -> list[Block]:
    if comparison is None:
        return []
    parts, sphere = comparison.parts(), comparison.sphere
    if not parts:
        return [Text("The fit and the sphere have no wavelength in common.")]
    rows = [
        (
            f"{part.detector}, {part.low_nm:g}–{part.high_nm:g} nm",
            number(100 * part.reference),
            _signed(100 * part.difference),
            _signed(100 * part.relative),
            _e_n(part.e_n),
            _e_n(part.worst_e_n),
            _counted(part.within, part.judged) if part.judged else "–",
        )
        for part in parts
    ]
    head = (
        "detector",
        "sphere, mean / %",
        "fit − sphere, mean / % (absolute)",
        "relative to sphere / %",
        Markup("E<sub>n</sub> of the mean"),
        Markup("largest E<sub>n</sub>"),
        Markup("|E<sub>n</sub>| ≤ 1 at"),
    )
    modes = ", ".join(comparison.mode_names)
    common = (
        Markup("U<sub>common</sub>: {}").format(modes)
        if modes
        else Markup(
            "U<sub>common</sub>: none is stated with the fit, so aperture size and distance, alignment and "
            "the "
            "model's own shape are not in it"
        )
    )
    note = Markup(
        "E<sub>n</sub> = (k<sub>{}</sub> − k<sub>sphere</sub>) / √(U²<sub>fit</sub> + U²<sub>common</sub> + "
        "U²<sub>sphere</sub>), all U at 95 %. U<sub>fit</sub>: half of the fit's 95 % interval (noise, "
        "baseline and "
        "dark readings), averaging out over wavelengths. {}. U<sub>sphere</sub>: {}, common to all "
        "wavelengths. "
        "Assumed: no correlation between the two. Both refer to {:g}° incidence, hemispherical, specular "
        "beam {}, "
        "mean of S and P."
    ).format(
        comparison.coefficient[-1],
        common,
        sphere.uncertainty,
        sphere.geometry.theta_i_deg,
        sphere.geometry.specular,
    )
    blocks: list[Block] = [Table(head, rows, note)]
    blocks += [Text(text) for text in _verdict(comparison)]
    return blocks


def _verdict(comparison: SphereComparison) -> list[str]:
    """Return what fit and sphere say of each other, and what may cause a disagreement."""
    if not uncertain(comparison.sphere):
        return [
            "No uncertainty of the sphere is stated, so nothing can be said of agreement; bring it in again "
            "with "
            "gonio fit --sphere FILE --sphere-u, such as '1 % relative, k=2'."
        ]
    said = [line.strip() for line in verdicts(comparison)]
    return [" ".join(line[0].upper() + line[1:] + ("" if line.endswith(":") else ".") for line in said)]


def _e_n(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−") if np.isfinite(value) else "–"


def _signed(value: float) -> str:
    return f"{value:+.2g}".replace("-", "−") if np.isfinite(value) else "–"


def _counted(within: int, count: int) -> str | Markup:
    """Return the count, marked where it is less than 95 % by more than chance (2.6 standard deviations)."""
    text = f"{within} of {count}"
    expected, spread = 0.95 * count, (0.95 * 0.05 * count) ** 0.5
    if within >= expected - 2.6 * spread:
        return text
    return Markup('<span class="bad">{}</span>').format(text)


def _notes(fit: FitResult | None) -> list[Block]:
    """Return the fit's remarks, each kind once with an example and the wavelengths it concerns."""
    if fit is None:
        return []
    kinds: dict[str, tuple[str, list[float]]] = {}
    for wavelength_nm, note in zip(fit.wavelength_nm.tolist(), fit.notes, strict=False):
        for part in filter(None, note.split("; ")):
            kind = re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", part)  # the same remark with other numbers
            kinds.setdefault(kind, (part, []))[1].append(wavelength_nm)
    if not kinds:
        return [Text("The fit has nothing to remark: every parameter is determined at every wavelength.")]
    once_nm = np.unique(fit.wavelength_nm)
    step = float(np.min(np.diff(once_nm))) if once_nm.size > 1 else 0.0
    items = [
        f"{_ranges(at, step)}: {part}" + (f" (at {at[0]:g} nm)" if len(at) > 1 and "#" in kind else "")
        for kind, (part, at) in sorted(kinds.items(), key=lambda item: -len(item[1][1]))
    ][:MOST_NOTES]
    if len(kinds) > MOST_NOTES:
        items.append(f"… and {len(kinds) - MOST_NOTES} further remarks, stored with the fit")
    return [List(items)]


def _ranges(wavelength_nm: Sequence[float], step_nm: float) -> str:
    """Return ``300–340, 500 nm`` for wavelengths on a grid."""
    runs: list[list[float]] = []
    for w in sorted(set(wavelength_nm)):
        if runs and w - runs[-1][1] <= 1.5 * step_nm:
            runs[-1][1] = w
        else:
            runs.append([w, w])
    texts = [f"{low:g}" if low == high else f"{low:g}–{high:g}" for low, high in runs]
    if len(texts) > 8:
        return f"{len(wavelength_nm)} wavelengths between {wavelength_nm[0]:g} and {wavelength_nm[-1]:g} nm"
    return ", ".join(texts) + " nm"


def _events(content: Content) -> list[Block]:
    if not content.events:
        return [Text("No event was recorded: no retry, no fault, no pause.")]
    many = len(content.events) > MOST_EVENTS
    shown = [e for e in content.events if not many or e.level != "info"][:MOST_EVENTS]
    rows = [
        (f"{e.time_s:.0f}" if np.isfinite(e.time_s) else "–", e.level, e.source, e.message) for e in shown
    ]
    left_out = len(content.events) - len(shown)
    note = f"{left_out} further events are in /entry/events." if left_out else ""
    return [Table(("instrument time / s", "level", "source", "message"), rows, note, textual=True)]


def _provenance(content: Content, fit: FitResult | None) -> list[Block]:
    scan = content.scan
    aperture = scan.aperture
    rows: list[tuple[str, str]] = [("File", file_facts(scan.path)), *content.provenance.items()]
    rows += [
        ("Positions", f"{scan.r.shape[0]} measured of {scan.n_planned} planned"),
        ("Wavelengths", _wavelengths(scan.wavelength_nm.tolist())),
        (
            "Aperture",
            f"{aperture.width_mm:g} mm × {aperture.height_mm:g} mm at {aperture.distance_mm:g} mm, "
            f"{aperture.solid_angle_sr:.5f} sr",
        ),
        ("Detectors", _detectors(content)),
    ]
    if fit is not None:
        rows.append(("Fit shown", describe(fit)))
        rows.append(("Fits stored", ", ".join(f"/entry/{name}" for name in content.fits)))
    blocks: list[Block] = [Table((), rows, textual=True)]
    if scan.plan_text:
        blocks.append(Details("The plan, as stored with the data", scan.plan_text))
    if scan.rig_text:
        blocks.append(Details("The rig file, as stored with the data", scan.rig_text))
    return blocks


def _detectors(content: Content) -> str:
    scan = content.scan
    parts = []
    for index in np.unique(scan.detector_index):
        used_nm = scan.wavelength_nm[scan.detector_index == index]
        name = scan.detector_names[int(index)]
        parts.append(f"{name} {used_nm.min():g}–{used_nm.max():g} nm")
    change = ", ".join(choose.change_texts(scan))
    return "; ".join(parts) + (f"; change within {change}" if change else "")
