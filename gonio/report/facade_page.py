"""The part of a page that shows a facade result, and the page of such a result alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from gonio import __version__
from gonio.report.content import file_facts
from gonio.report.contributions import BARS_PER_FIGURE, draw_contributions
from gonio.report.maps import (
    CONTRIBUTIONS,
    LABELS,
    ROWS_PER_FIGURE,
    draw_errors,
    draw_maps,
    estimate_text,
    with_maps,
)
from gonio.report.mesh_view import draw_mesh
from gonio.report.page import Block, Details, List, Page, Section, Table, Text, Tile, number, save_picture
from gonio.report.unfolded import draw_street, street_of

if TYPE_CHECKING:
    from gonio.facade import Irradiance


MOST_MAPS = 12
MOST_MESHES = 4
METHODS = {
    "rows": "transport rows and a linear solve for diffuse light, photons for lobes",
    "paths": "backward paths for diffuse light, photons for lobes",
    "backward": "backward paths for all light",
}


def facade_sections(irradiance: Irradiance, figures: Path) -> list[Section]:
    """Draw the figures of a facade result into the folder and return what the page says of it."""
    receivers = irradiance.receivers
    blocks: list[Block] = [Text(_scene_text(irradiance)), _means(irradiance)]
    blocks += [
        save_picture(draw_contributions(receivers, first=first), figures)
        for first in range(0, len(receivers), BARS_PER_FIGURE)
    ]
    street = street_of(receivers)
    if street is not None:
        blocks.append(save_picture(draw_street(street), figures))
    blocks += _maps(irradiance, figures)
    blocks += _errors(irradiance)
    blocks += _bands(irradiance)
    if irradiance.notes:
        blocks.append(List(irradiance.notes))
    blocks += _accounts(irradiance)
    if irradiance.scene_text:
        blocks.append(Details("The scene, as stored with the result", irradiance.scene_text))
    return [Section("facade", "Irradiance on facades", blocks)]


def facade_page(irradiance: Irradiance, path: Path, figures: Path) -> Page:
    """Return the page of a facade result alone."""
    warnings = []
    if irradiance.interrupted:
        warnings.append(
            "The simulation was interrupted: these are the points so far. "
            f"gonio facade --resume {path.name} goes on from here."
        )
    if not irradiance.converged:
        warnings.append(
            f"The tolerance asked for ({100 * irradiance.rel_tol:g} %) was not reached: the patches stand at "
            f"{100 * irradiance.relative_error:.2g} % (rms)."
        )
    kinds = "receiver" if len(irradiance.receivers) == 1 else "receivers"
    return Page(
        title=irradiance.title or path.name,
        lead=f"Irradiance on {len(irradiance.receivers)} {kinds}: {_method(irradiance)}.",
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


def _method(irradiance: Irradiance) -> str:
    return METHODS.get(irradiance.method, irradiance.method)


def _scene_text(irradiance: Irradiance) -> str:
    reached = "reached" if irradiance.converged else "not reached"
    title = f"{irradiance.title}. " if irradiance.title else ""
    return (
        f"{title}{irradiance.rays:.3g} rays, seed {irradiance.seed}: the standard errors of the patches are "
        f"{100 * irradiance.relative_error:.2g} % of the mean irradiance (root mean square, worst receiver; "
        f"{100 * irradiance.rel_tol:g} % was asked for and {reached}). They are those of the sampling; the "
        "uncertainty of the materials and of sun and sky is not in them."
    )


def _maps(irradiance: Irradiance, figures: Path) -> list[Block]:
    """Draw the maps of gridded receivers, and the meshes; a text says how many are not drawn."""
    mapped = with_maps(irradiance.receivers)
    shown = mapped[:MOST_MAPS]
    starts = range(0, len(shown), ROWS_PER_FIGURE)
    blocks: list[Block] = [save_picture(draw_maps(shown, first=first), figures) for first in starts]
    blocks += [save_picture(draw_errors(shown, first=first), figures) for first in starts]
    meshes = [r for r in irradiance.receivers if r.is_mesh]
    blocks += [save_picture(draw_mesh(r, i), figures) for i, r in enumerate(meshes[:MOST_MESHES])]
    left_out = [r.name for r in (*mapped[MOST_MAPS:], *meshes[MOST_MESHES:])]
    if left_out:
        blocks.append(Text(f"Not drawn, but in the file and in the table of means: {', '.join(left_out)}."))
    return blocks


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


def _errors(irradiance: Irradiance) -> Sequence[Block]:
    """Show what was left out, with its bounds, and what the errors of each receiver add up to."""
    blocks: list[Block] = []
    if irradiance.levels:
        levels = ", ".join(f"{name}: {level}" for name, level in irradiance.levels.items())
        blocks.append(Text(f"Level of each material: {levels}."))
    if irradiance.omissions:
        left_out = [
            (o.what, o.receiver or "every", number(o.bound_w_m2, 3), number(o.bound_percent, 2))
            for o in irradiance.omissions
        ]
        titles = ("left out", "receiver", "at most / (W/m²)", "at most / % of its mean")
        blocks.append(Table(titles, left_out, "What the planner left out, and what it can change at most."))
    rows: list[tuple[str, ...]] = []
    for r in irradiance.receivers:
        e = irradiance.error_of(r.name)
        parts = (100 * e.statistical, 100 * e.omitted, 100 * e.total)
        rows.append((r.name, *(number(x, 2) for x in parts), number(r.discretisation_w_m2, 2)))
    head = ("receiver", "sampling / %", "left out / %", "together / %", "of it patch size / (W/m²)")
    note = (
        f"Errors relative to each mean; {100 * irradiance.rel_tol:g} % was asked for. Sampling: root mean "
        "square of the patches' standard errors. Left out: sum of all bounds, that of the finite patches "
        "among them. Together: the root of the sum of their squares."
    )
    return [*blocks, Table(head, rows, note)]


def _bands(irradiance: Irradiance) -> Sequence[Block]:
    if not irradiance.bands:
        return []
    names = [r.name for r in irradiance.receivers]
    head = ("band / nm", "DNI / (W/m²)", "DHI / (W/m²)", *(f"{name} / (W/m²)" for name in names))
    rows = [
        (
            f"{b.low_nm:g}–{b.high_nm:g}",
            number(b.dni_w_m2),
            number(b.dhi_w_m2),
            *(estimate_text(b.means[name]) for name in names),
        )
        for b in irradiance.bands
    ]
    return [Table(head, rows, "Means by band of wavelengths ± one standard error; they add up to the total.")]


def _accounts(irradiance: Irradiance) -> Sequence[Block]:
    blocks: list[Block] = []
    energy, exchange = irradiance.energy, irradiance.exchange
    if energy.emitted_w > 0:
        created = f", {energy.created_w:.3g} W created by the published lobe" if energy.created_w > 0 else ""
        handed = (
            f", {energy.handed_w / 1e3:.4g} kW handed to the diffuse exchange" if energy.handed_w > 0 else ""
        )
        blocks.append(
            Text(
                f"Energy of the photons followed through lobes: {energy.emitted_w / 1e3:.4g} kW sent "
                f"out{created}, {energy.absorbed_w / 1e3:.4g} kW absorbed (of it "
                f"{energy.under_horizon_w:.3g} W sent below the horizon by the lobe), "
                f"{energy.escaped_w / 1e3:.4g} kW escaped{handed}; the books balance to "
                f"{abs(energy.residual):.0e}."
            )
        )
    if exchange is not None:
        blocks.append(
            Text(
                f"Diffuse exchange: {exchange.emitted_w / 1e3:.5g} kW sent out, "
                f"{exchange.received_w / 1e3:.5g} kW received by surfaces, {exchange.escaped_w / 1e3:.5g} kW "
                f"escaped; difference {exchange.difference_w:.2g} ± {exchange.standard_error_w:.2g} W."
            )
        )
    return blocks


def _provenance(irradiance: Irradiance, path: Path) -> list[tuple[str, str | Markup]]:
    rows: list[tuple[str, str | Markup]] = [("File", file_facts(path))]
    if irradiance.date:
        rows.append(("Simulated", irradiance.date))
    rows += [
        ("Method", _method(irradiance)),
        ("Rays", f"{irradiance.rays:.4g}"),
        ("Seed", str(irradiance.seed)),
        ("Tolerance asked", f"{100 * irradiance.rel_tol:g} %, relative to the mean of each receiver"),
        ("Computing time", f"{irradiance.duration_s:.2f} s"),
    ]
    for label, mapping in (("Options", irradiance.options), ("Versions", irradiance.versions)):
        if mapping:
            rows.append((label, ", ".join(f"{key} {value}" for key, value in mapping.items())))
    return rows
