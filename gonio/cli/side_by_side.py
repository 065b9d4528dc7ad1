"""`gonio fit --compare` and `--models`, and what each part of the instrument function is worth."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gonio.aperture import IncidentBeam, InstrumentFunction
from gonio.aperture.leaving_out import leaving_out
from gonio.errors import ConfigError
from gonio.fitting.compare import compare_apertures
from gonio.fitting.identifiability import identifiability
from gonio.fitting.model_comparison import compare_models

if TYPE_CHECKING:
    from gonio.cli.fit_options import FitRequest
    from gonio.devices import FloatArray
    from gonio.fitting import FitResult, PolarizationChoice
    from gonio.store import Scan

_WIDTH = 105


def apertures_text(scan: Scan, request: FitRequest, truth: Mapping[str, FloatArray] | None) -> str:
    """Return the paper's aperture models and the exact integral side by side.

    `ConfigError` for a model that is not the paper's.
    """
    if request.model != "published" or request.polarization == "shared_n2":
        raise ConfigError(
            "--compare shows what the paper's aperture models do to its own lobe; leave --model and "
            "--polarization shared_n2 out"
        )
    polarization: PolarizationChoice = request.polarization  # type: ignore[assignment]
    return compare_apertures(scan, polarization=polarization, truth=truth).table()


def models_text(scan: Scan, request: FitRequest) -> str:
    """Return all scattering models side by side, by AICc and the runs of their residuals.

    `ConfigError` with surfaces of their own for S and P, which not all models can have.
    """
    if request.polarization == "shared_n2":
        raise ConfigError("--models compares surfaces that S and P share; leave --polarization shared_n2 out")
    polarization: PolarizationChoice = request.polarization  # type: ignore[assignment]
    return compare_models(scan, polarization=polarization).table()


def instrument_text(result: FitResult) -> str:
    """Return what leaving out each part of the instrument function would do to these readings.

    The largest change over the fitted positions, at the smallest, the middle and the largest alpha found; in
    r it is that of the strongest diffuse part and the strongest lobe.  Empty for an approximate aperture, or
    where no lobe was found.
    """
    alpha = result.value[:, result.of("alpha")]
    if result.aperture != "exact" or not np.any(np.isfinite(alpha)):
        return ""
    alphas = np.nanquantile(alpha, [0.0, 0.5, 1.0])
    beam = result.beam if result.beam is not None else IncidentBeam()
    parts = leaving_out(
        InstrumentFunction(result.instrument, beam), alphas, result.theta_i_deg, result.theta_o_deg
    )
    rho_d = float(np.nanmax(result.value[:, result.of("rho_d")]))
    # at most all of the lobe is in one polarization
    lobe = 2.0 * float(np.nanmax(result.hemispherical(result.incidences_deg[-1]).k_s_published.value))
    lines = [
        f"instrument function, alpha {alphas[0]:.3g}...{alphas[2]:.3g}; leaving a part out changes a reading "
        "by at most"
    ]
    lines += [
        f"  {part.part:<24}{100.0 * part.relative_lobe:>9.2g} % of the lobe's largest, "
        f"{part.reading(rho_d, lobe):.1e} in r"
        for part in parts
    ]
    if result.beam is None:
        lines.append(
            "  the beam's size is not known: it is taken as a line of light; state [beam] in the rig file"
        )
    return "\n".join(lines)


def identifiability_text(result: FitResult) -> str:
    """Return what the data tell least, at the wavelength where parameters are hardest to tell apart."""
    found = identifiability(result)
    told = np.array([bool(text) for text in found.text]) & np.isfinite(found.condition)
    if not np.any(told):
        return ""
    k = int(np.argmax(np.where(told, found.condition, -1.0)))
    sentence = f"identifiability, worst at {result.wavelength_nm[k]:g} nm: {found.text[k]}"
    return "\n".join(textwrap.wrap(sentence, _WIDTH, subsequent_indent="  "))
