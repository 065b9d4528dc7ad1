"""Can data and fit be trusted?  Residuals over wavelength and position, drift of the references."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import TwoSlopeNorm
from numpy.typing import NDArray

from gonio.report import choose, style
from gonio.report.content import Content, References
from gonio.report.model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = NDArray[np.float64]

POLARIZATION_COLOURS = {"s": style.BLUE, "p": style.VERMILLION, "any": style.BLACK}
REACH = 4.0  # of the colour scale, standard deviations
DASHES: tuple[style.Dashes, ...] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))


def draw_residuals(content: Content, model: Model) -> style.Drawing:
    """Draw (data - fit) / standard deviation as a map of position over wavelength by polarization."""
    scan = content.scan
    present = [p for p in choose.polarizations(scan) if model.fit.polarization in ("joint", p)]
    figure = style.new_figure(9.8 if len(present) > 1 else 6.0, 4.6)
    panels = figure.subplots(1, len(present), squeeze=False)[0]
    angles = choose.incidences(scan)
    maps = [normalised_residual(content, model, p, angles) for p in present]
    norm = TwoSlopeNorm(0.0, -REACH, REACH)
    mesh = None
    for axes, polarization, (rows, relative) in zip(panels, present, maps, strict=True):
        axes.grid(False)
        axes.set_facecolor("#bfbfbf")
        axes.set_title(choose.name_of(polarization))
        axes.set_xlabel("wavelength / nm")
        if rows.size == 0:
            continue
        # a blank column at each detector change, so that neither side's cell reaches across
        once = scan.home  # a map has one column per wavelength, also where two detectors measured it
        wavelength_nm, columns = style.broken(
            scan.wavelength_nm[once], *relative[:, once], at=scan.detector_change_nm
        )
        cells = np.array(columns)
        mesh = axes.pcolormesh(
            _edges(wavelength_nm),
            np.arange(len(rows) + 1),
            np.ma.masked_invalid(cells),
            cmap="RdBu_r",
            norm=norm,
            rasterized=True,
        )
        _mark_incidences(axes, scan.theta_i_deg[rows], scan.theta_o_deg[rows])
        style.mark_changes(axes, scan.detector_change_nm)
    panels[0].set_ylabel("incidence, within it θₒ upwards / °")
    style.place(figure, right_in=1.0, gap_x_in=0.45)
    if mesh is not None:
        style.colour_bar(figure, mesh, panels[-1], "(data − fit) / standard deviation / 1", extend="both")
    known = np.abs(np.concatenate([np.ravel(m[1]) for m in maps])) if maps else np.empty(0)
    known = known[np.isfinite(known)]
    shares = (
        f" Beyond ±2: {100 * np.mean(known > 2):.1f} % of the readings (Gaussian noise: 4.6 %), beyond ±3: "
        f"{100 * np.mean(known > 3):.2f} % (0.27 %)."
        if known.size
        else ""
    )
    return style.Drawing(
        name="residuals",
        title="Residuals of the fit, every reading",
        caption=(
            "Data minus fit over the standard deviation that the fit found for each reading, for every "
            "position and wavelength; grey is missing, flagged or a detector change. Within each "
            "incidence the observation angle grows upwards, the small triangles mark the mirror "
            f"directions.{shares} Noise looks like grain. Horizontal stripes at the mirror directions "
            "tell of the lobe's shape or of alignment, vertical ones of a wavelength or detector, a "
            "trend along the scan of drift."
        ),
        figure=figure,
    )


def normalised_residual(
    content: Content, model: Model, polarization: str, angles: list[float]
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the positions by incidence and theta_o, and (r - fit) / sigma, (n_row, n_wavelength)."""
    scan = content.scan
    rows = np.concatenate(
        [np.empty(0, dtype=np.intp), *(choose.sweep(scan, a, polarization) for a in angles)]
    )
    if rows.size == 0:
        return rows, np.empty((0, scan.wavelength_nm.size))
    r = np.where(scan.usable[rows], scan.r[rows], np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (r - model.expected[rows]) / model.sigma[rows]
    return rows, np.where(np.isfinite(z), z, np.nan)


def _edges(centres: FloatArray) -> FloatArray:
    if centres.size == 1:
        return np.array([centres[0] - 5.0, centres[0] + 5.0])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])


def _mark_incidences(axes: Axes, theta_i_deg: FloatArray, theta_o_deg: FloatArray) -> None:
    """Separate the incidences by lines, name them, and point at the mirror direction of each."""
    starts = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(theta_i_deg)) > 0.5) + 1, [theta_i_deg.size]])
    ticks, labels = [], []
    for low, high in itertools.pairwise(starts):
        if low:
            axes.axhline(low, color=style.BLACK, linewidth=0.7)
        angle = float(theta_i_deg[low])
        ticks.append(0.5 * (low + high))
        labels.append(f"{angle:.4g}°")
        mirror = low + int(np.argmin(np.abs(theta_o_deg[low:high] - angle))) + 0.5
        if np.min(np.abs(theta_o_deg[low:high] - angle)) < 5.0:
            axes.annotate(
                "◂",
                (1.0, mirror),
                xycoords=("axes fraction", "data"),
                xytext=(1, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.0,
                annotation_clip=False,
            )
    axes.set_yticks(ticks, labels)
    axes.tick_params(axis="y", length=0)


def draw_references(content: Content, references: References) -> style.Drawing:
    """Draw how the 100 % baseline changed since the first one, and the dark signals relative to it."""
    scan = content.scan
    figure = style.new_figure(8.6, 4.6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    shown: dict[str, list[FloatArray]] = {"baseline": [], "dark": []}
    first: dict[str, FloatArray] = {}
    order = np.argsort(references.time_s, kind="stable")
    for row in order:
        if references.kind[row] == "baseline":
            first.setdefault(references.polarization[row], references.signal_v[row])
    seen: dict[tuple[str, str], int] = {}
    for row in order:
        kind, polarization = references.kind[row], references.polarization[row]
        number = seen.get((kind, polarization), 0)
        seen[kind, polarization] = number + 1
        base = first.get(polarization, next(iter(first.values()), None))
        if kind not in shown or base is None or (kind == "baseline" and number == 0):
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = references.signal_v[row] / base
        value = 100.0 * (ratio - 1.0) if kind == "baseline" else 1e6 * ratio
        value = np.where(np.isfinite(value), value, np.nan)
        style.draw_spectrum(
            upper if kind == "baseline" else lower,
            scan.wavelength_nm,
            value,
            changes_nm=scan.detector_change_nm,
            colour=POLARIZATION_COLOURS.get(polarization, style.BLACK),
            dashes=DASHES[number % len(DASHES)],
            width=1.0,
            label=_reference_label(polarization, references.time_s[row]),
        )
        shown[kind].append(value)
    for axes, kind in ((upper, "baseline"), (lower, "dark")):
        found = style.limits(*shown[kind], *([np.zeros(1)] if shown[kind] else []))
        if found is not None:
            axes.set_ylim(*found)
            style.beyond(axes, *shown[kind])
            style.legend_above(axes, columns=6)
        else:
            axes.text(
                0.5, 0.5, "no repeated reading", transform=axes.transAxes, ha="center", color=style.GREY
            )
        axes.axhline(0.0, color=style.BLACK, linewidth=0.8, zorder=1.5)
        style.mark_changes(axes, scan.detector_change_nm, choose.change_texts(scan) if axes is upper else ())
    level = np.abs(scan.r[scan.usable])
    typical = f"{1e6 * float(np.median(level)):,.0f}" if level.size else "an unknown level"
    upper.set_ylabel("baseline / first − 1 / %")
    lower.set_ylabel("dark / baseline / 10⁻⁶")
    style.wavelength_axis(lower, scan.wavelength_nm)
    style.place(figure, gap_y_in=0.34)
    return style.Drawing(
        name="references",
        title="Drift of the reference readings",
        caption=(
            "Upper panel: each later 100 % baseline relative to the first of its polarization, at the "
            "instrument time named; the readings in between are divided by the baseline interpolated "
            "linearly in time, so only the curvature of the drift remains in r. Lower panel: dark "
            "signals in millionths of the baseline, where half of all readings of the sample are below "
            f"{typical}; a change of the dark signal is an error of the diffuse part. From "
            "<code>/entry/references</code>."
        ),
        figure=figure,
    )


def _reference_label(polarization: str, time_s: float) -> str:
    who = "" if polarization == "any" else f"{polarization.upper()}, "
    return f"{who}{readable_time(time_s)}"


def readable_time(time_s: float) -> str:
    """Return an instrument time as hours and minutes since the scan began."""
    if not np.isfinite(time_s):
        return "time unknown"
    minutes = round(time_s / 60.0)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{time_s / 60.0:.2g} min"
