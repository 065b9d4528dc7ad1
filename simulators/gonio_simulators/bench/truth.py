"""What is true of the sample, and what an integrating sphere says of it."""

from __future__ import annotations

import csv
import math
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio_simulators.bench.config import BenchConfig, TruthTable
from gonio_simulators.bench.fresnel import reflectances

FloatArray = NDArray[np.float64]

HEMISPHERE_NODES = 160
TRUTH_THETA_I_DEG = 8.0
COLUMNS = ("wavelength_nm", "rho_d", "rho_s", "alpha", "n2", "k_d", "k_s", "k_g")


class Truth:
    """The four parameters of the differential scattering function over wavelength."""

    def __init__(self, table: TruthTable) -> None:
        self._curves = [
            (np.array(c.wavelength_nm), np.array(c.value))
            for c in (table.rho_d, table.rho_s, table.alpha, table.n2)
        ]
        self.alpha_range = min(table.alpha.value), max(table.alpha.value)
        self._known: dict[float, tuple[float, float, float, float]] = {}

    def at(self, wavelength_nm: float) -> tuple[float, float, float, float]:
        """Return (rho_d, rho_s, alpha, n2); a table's end values hold beyond its ends."""
        found = self._known.get(wavelength_nm)
        if found is None:
            rho_d, rho_s, alpha, n2 = (float(np.interp(wavelength_nm, x, y)) for x, y in self._curves)
            found = rho_d, rho_s, alpha, n2
            if len(self._known) > 100_000:  # wavelengths passed while the grating turned
                self._known.clear()
            self._known[wavelength_nm] = found
        return found


def default_wavelengths(config: BenchConfig) -> FloatArray:
    """Return the bench's 10 nm grid over its detectors' ranges."""
    detectors = config.spectrometer.detectors
    low = min(d.range_nm[0] for d in detectors)
    high = max(d.range_nm[1] for d in detectors)
    return 10.0 * np.arange(math.ceil(low / 10.0), math.floor(high / 10.0) + 1, dtype=np.float64)


def lobe_above_horizon(theta_i_deg: float, alpha: float) -> float:
    """Return the part of the lobe (alpha + 1)/(2 pi) cos_+^alpha about the mirror direction that lies above
    the sample.

    By quadrature over the angle from the mirror direction: whole rings up to 90 deg - theta_i, beyond it the
    part ``acos(-cot(theta) cot(theta_i))/pi`` of each ring.
    """
    theta_i = math.radians(abs(theta_i_deg))
    whole = float(1.0 - math.sin(theta_i) ** (alpha + 1.0))
    if theta_i == 0:
        return 1.0
    y, w = _unit_rule()
    # nodes crowd at both ends: a square root at the first whole ring, cos^alpha at the last
    share = y**4 * (35.0 - 84.0 * y + 70.0 * y**2 - 20.0 * y**3)
    slope = 140.0 * (y * (1.0 - y)) ** 3
    theta = 0.5 * math.pi - theta_i + theta_i * share
    with np.errstate(divide="ignore"):
        part = np.arccos(np.clip(-1.0 / (np.tan(theta) * math.tan(theta_i)), -1.0, 1.0)) / math.pi
    ring = (alpha + 1.0) * np.sin(theta) * np.maximum(np.cos(theta), 0.0) ** alpha
    return whole + float(np.sum(w * slope * theta_i * ring * part))


@lru_cache(maxsize=1)
def _unit_rule() -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on 0...1."""
    x, w = np.polynomial.legendre.leggauss(HEMISPHERE_NODES)
    return 0.5 * (1.0 + x), 0.5 * w


def hemispherical(
    config: BenchConfig, wavelength_nm: FloatArray, theta_i_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Return the true (k_d, k_s) of unpolarized light, each (n_wavelength,): the integral above the horizon.

    The share of the lobe that points under the surface (nothing for narrow lobes at small angles) is lost.
    """
    truth = Truth(config.simulation.truth)
    cos_i = math.cos(math.radians(theta_i_deg))
    k_d, k_s = np.empty(len(wavelength_nm)), np.empty(len(wavelength_nm))
    for i, wavelength in enumerate(wavelength_nm.tolist()):
        rho_d, rho_s, alpha, n2 = truth.at(wavelength)
        r_s, r_p = reflectances(cos_i, n2)
        k_d[i] = rho_d
        k_s[i] = rho_s * 0.5 * (r_s + r_p) * lobe_above_horizon(theta_i_deg, alpha)
    return k_d, k_s


def truth_table(config: BenchConfig, wavelength_nm: FloatArray | None = None) -> dict[str, FloatArray]:
    """Return the columns of `COLUMNS`, each (n_wavelength,); k_d, k_s, k_g at 8 deg incidence, mean of S and
    P.

    Parameters
    ----------
    config
        The bench.
    wavelength_nm
        Any wavelengths; by default every 10 nm that a detector covers.
    """
    grid = (
        default_wavelengths(config) if wavelength_nm is None else np.asarray(wavelength_nm, dtype=np.float64)
    )
    truth = Truth(config.simulation.truth)
    rows = np.array([truth.at(w) for w in grid.tolist()], dtype=np.float64).reshape(-1, 4)
    k_d, k_s = hemispherical(config, grid, TRUTH_THETA_I_DEG)
    columns = (grid, *rows.T, k_d, k_s, k_d + k_s)
    return dict(zip(COLUMNS, columns, strict=True))


def sphere_spectrum(config: BenchConfig, wavelength_nm: FloatArray | None = None) -> FloatArray:
    """Return what the simulated integrating sphere reads, (n_wavelength,): the true k_g at its angle, with
    its error.

    Its stated relative uncertainty U has coverage factor 2.  Half of the variance is a scale error common to
    all wavelengths, half is independent from wavelength to wavelength: each with standard deviation ``U / 2 /
    sqrt(2)``. The error at a wavelength depends on the seed and that wavelength alone, not on the grid.
    """
    grid = (
        default_wavelengths(config) if wavelength_nm is None else np.asarray(wavelength_nm, dtype=np.float64)
    )
    sphere, seed = config.simulation.sphere, config.simulation.seed
    k_d, k_s = hemispherical(config, grid, sphere.theta_i_deg)
    sigma = 0.5 * sphere.uncertainty / math.sqrt(2.0)
    common = np.random.default_rng([seed, _SPHERE]).standard_normal()
    own = [np.random.default_rng([seed, _SPHERE, round(w * 1000.0)]).standard_normal() for w in grid.tolist()]
    return np.asarray((k_d + k_s) * (1.0 + sigma * (common + np.array(own))), dtype=np.float64)


_SPHERE = 0x5F  # separates the sphere's random numbers from the bench's


def write_truth(path: Path, config: BenchConfig, wavelength_nm: FloatArray | None = None) -> None:
    """Write `truth_table` as CSV with a header line."""
    table = truth_table(config, wavelength_nm)
    _write(path, table)


def write_sphere(path: Path, config: BenchConfig, wavelength_nm: FloatArray | None = None) -> None:
    """Write `sphere_spectrum` as CSV: wavelength, k_g, and its standard uncertainty (coverage factor 1)."""
    grid = (
        default_wavelengths(config) if wavelength_nm is None else np.asarray(wavelength_nm, dtype=np.float64)
    )
    k_g = sphere_spectrum(config, grid)
    _write(
        path, {"wavelength_nm": grid, "k_g": k_g, "k_g_u": 0.5 * config.simulation.sphere.uncertainty * k_g}
    )


def _write(path: Path, columns: dict[str, FloatArray]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{v:.12g}" for v in row] for row in zip(*columns.values(), strict=True))
