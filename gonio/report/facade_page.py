"""The part of a page that shows a facade result, and the page of such a result alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from gonio import __version__
from gonio.report.content import file_facts
from gonio.report.maps import (
    CONTRIBUTIONS,
    LABELS,
    ROWS_PER_FIGURE,
    draw_contributions,
    draw_maps,
    estimate_text,
)
from gonio.report.page import Block, Details, List, Page, Section, Table, Text, Tile, save_picture

if TYPE_CHECKING:
    from gonio.facade import Irradiance


def facade_sections(irradiance: Irradiance, figures: Path) -> list[Section]:
    """Draw the figures of a facade result into the folder and return what the page says of it."""
    receivers = irradiance.receivers
    blocks: list[Block] = [Text(_scene_text(irradiance)), _means(irradiance)]
    blocks += [
        save_picture(draw_maps(receivers, first=first), figures)
        for first in range(0, len(receivers), ROWS_PER_FIGURE)
    ]
    blocks.append(save_picture(draw_contributions(receivers), figures))
    if irradiance.notes:
        blocks.append(List(irradiance.notes))
    blocks += _energy(irradiance)
    if irradiance.scene_text:
        blocks.append(Details("The scene, as stored with the result", irradiance.scene_text))
    return [Section("facade", "Irradiance on facades", blocks)]


def facade_page(irradiance: Irradiance, path: Path, figures: Path) -> Page:
    """Return the page of a facade result alone."""
    warnings = []
    if not irradiance.converged:
        warnings.append(
            f"The tolerance asked for ({100 * irradiance.rel_tol:g} %) was not reached: the patches stand at "
            f"{100 * irradiance.relative_error:.2g} % (rms)."
        )
    return Page(
        title=irradiance.title or path.name,
        lead=f"Irradiance on {len(irradiance.receivers)} surfaces, by Monte Carlo.",
        warnings=warnings,
        tiles=[
            Tile(f"{estimate_text(r.mean)} W/m²", f"{r.name}, mean of the surface")
            for r in irradiance.receivers[:6]
        ],
        sections=[
            *facade_sections(irradiance, figures),
            Section("provenance", "Provenance", [Table((), _provenance(irradiance, path), textual=True)]),
        ],
        footer=f"Written by gonio {__version__} from {path.name}.",
    )


def _scene_text(irradiance: Irradiance) -> str:
    reached = "reached" if irradiance.converged else "not reached"
    title = f"{irradiance.title}. " if irradiance.title else ""
    return (
        f"{title}{irradiance.rays:.3g} rays, seed {irradiance.seed}: the standard errors of the patches are "
        f"{100 * irradiance.relative_error:.2g} % of the mean irradiance (root mean square, worst receiver; "
        f"{100 * irradiance.rel_tol:g} % was asked for and {reached}). They are the Monte Carlo's alone; the "
        "uncertainty of the materials and of sun and sky is not in them."
    )


def _means(irradiance: Irradiance) -> Table:
    parts = [f"{LABELS[c]} / (W/m²)" for c in CONTRIBUTIONS]
    head = ("receiver", "total / (W/m²)", *parts, "specular share / %")
    rows = []
    for r in irradiance.receivers:
        total, specular = float(r.mean.value), float(r.mean_contributions["specular"].value)
        share = f"{100 * specular / total:.2g}" if total > 0 else "–"
        parts = [estimate_text(r.mean_contributions[c]) for c in CONTRIBUTIONS]
        rows.append((r.name, estimate_text(r.mean), *parts, share))
    return Table(head, rows, "Means over each receiver ± one standard error.")


def _energy(irradiance: Irradiance) -> Sequence[Block]:
    energy = irradiance.energy
    if energy.emitted_w <= 0:
        return []
    created = f", {energy.created_w:.3g} W created by the published lobe" if energy.created_w > 0 else ""
    return [
        Text(
            f"Energy of the photons followed through lobes: {energy.emitted_w / 1e3:.4g} kW sent "
            f"out{created}, {energy.absorbed_w / 1e3:.4g} kW absorbed (of it {energy.under_horizon_w:.3g} "
            f"W sent below the horizon by the lobe), {energy.escaped_w / 1e3:.4g} kW escaped; the books "
            f"balance to {abs(energy.residual):.0e}."
        )
    ]


def _provenance(irradiance: Irradiance, path: Path) -> list[tuple[str, str | Markup]]:
    return [
        ("File", file_facts(path)),
        ("Rays", f"{irradiance.rays:.4g}"),
        ("Seed", str(irradiance.seed)),
        (
            "Tolerance asked",
            f"{100 * irradiance.rel_tol:g} %, standard error of the patches over the mean irradiance",
        ),
        ("Computing time", f"{irradiance.duration_s:.2f} s"),
    ]
