"""What does the fit expect, at the readings and between them?  Computed once for all figures that need it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.report import choose

if TYPE_CHECKING:
    from gonio.fitting import FitResult
    from gonio.store import Scan

FloatArray = NDArray[np.float64]
STEP_DEG = 0.5  # of the curves: the edges of the aperture round everything off over several degrees


@dataclass(frozen=True, slots=True)
class Model:
    """Expected readings of a fit.

    Attributes
    ----------
    fit
        The fit.
    expected
        (n_position, n_wavelength) float64, expected r at each reading's own read-back angles; NaN for a
        polarization that was not fitted and where the fit has no result.
    sigma
        (n_position, n_wavelength) float64, standard deviation that the fit found for each reading; where it
        has none, that of the reading itself.
    curves
        By (theta_i_deg, polarization): theta_o in degrees (k,) and expected r (k, n_wavelength), over the
        range of the sweep.
    """

    fit: FitResult
    expected: FloatArray
    sigma: FloatArray
    curves: Mapping[tuple[float, str], tuple[FloatArray, FloatArray]]


def model_of(scan: Scan, fit: FitResult) -> Model:
    """Return what the fit expects of the scan it was made from."""
    fitted = [p for p in choose.polarizations(scan) if fit.polarization in ("joint", p)]
    rows = np.flatnonzero(np.isin(scan.polarization, fitted))
    expected = np.full(scan.r.shape, np.nan)
    expected[rows] = fit.predict(scan.theta_i_deg[rows], scan.theta_o_deg[rows], scan.polarization[rows])

    sigma = _sigma(scan, fit)
    keys: list[tuple[float, str]] = []
    dense: list[FloatArray] = []
    for polarization in fitted:
        for theta_i_deg in choose.incidences(scan):
            theta_o_deg = scan.theta_o_deg[choose.sweep(scan, theta_i_deg, polarization)]
            if theta_o_deg.size:
                low, high = float(theta_o_deg.min()), float(theta_o_deg.max())
                keys.append((theta_i_deg, polarization))
                dense.append(np.linspace(low, high, max(2, round((high - low) / STEP_DEG) + 1)))
    if not keys:
        return Model(fit, expected, sigma, {})
    lengths = [d.size for d in dense]
    r = fit.predict(  # one call: tabulating the lobe costs more per call than per angle
        np.repeat([k[0] for k in keys], lengths),
        np.concatenate(dense),
        np.repeat([k[1] for k in keys], lengths),
    )
    parts = np.split(r, np.cumsum(lengths)[:-1])
    return Model(fit, expected, sigma, {k: (d, p) for k, d, p in zip(keys, dense, parts, strict=True)})


def _sigma(scan: Scan, fit: FitResult) -> FloatArray:
    """Return the standard deviation of each reading; positions are matched by angles and polarization."""
    found = np.array(scan.r_sd, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = fit.sigma * np.sqrt(fit.chi2 / fit.dof)
    rows = {key: i for i, key in enumerate(_keys(fit.theta_i_deg, fit.theta_o_deg, fit.polarization_of))}
    for i, key in enumerate(_keys(scan.theta_i_deg, scan.theta_o_deg, scan.polarization)):
        if key in rows:
            found[i] = scaled[rows[key]]
    return found


def _keys(
    theta_i_deg: FloatArray, theta_o_deg: FloatArray, polarization: NDArray[np.str_]
) -> list[tuple[float, float, str]]:
    return list(zip(theta_i_deg.tolist(), theta_o_deg.tolist(), polarization.tolist(), strict=True))
