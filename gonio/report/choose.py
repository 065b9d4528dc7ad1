"""Which wavelengths, curves and readings does a figure show?  The choices all figures share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gonio.store import Scan

FloatArray = NDArray[np.float64]

VISIBLE_NM = 550.0
INFRARED_NM = 1200.0
INFRARED_FROM_NM = 780.0


def shown_wavelengths(scan: Scan) -> list[int]:
    """Return the indices of the wavelengths to draw: nearest 550 nm and, if measured, one in the infrared.

    Only wavelengths with at least one usable reading are taken; the list is empty if there is none.
    """
    with_data = np.flatnonzero(scan.usable.any(axis=0))
    if with_data.size == 0:
        return []
    wavelength_nm = scan.wavelength_nm[with_data]
    first = int(with_data[np.argmin(np.abs(wavelength_nm - VISIBLE_NM))])
    second = int(with_data[np.argmin(np.abs(wavelength_nm - INFRARED_NM))])
    if second == first or scan.wavelength_nm[second] < INFRARED_FROM_NM:
        return [first]
    return [first, second]


def incidences(scan: Scan) -> list[float]:
    """Return the incidence angles of the scan in ascending order, deg, read-backs merged to 0.5 deg."""
    merged: list[float] = []
    for angle in np.sort(np.asarray(scan.theta_i_deg, dtype=np.float64)):
        if np.isfinite(angle) and (not merged or angle - merged[-1] > 0.5):
            merged.append(float(angle))
    return merged


def polarizations(scan: Scan) -> list[str]:
    """Return the polarizations measured, S first."""
    present = {str(p) for p in scan.polarization}
    return [p for p in ("s", "p") if p in present] + sorted(present - {"s", "p"})


def sweep(scan: Scan, theta_i_deg: float, polarization: str) -> NDArray[np.intp]:
    """Return the positions of one incidence and polarization in ascending theta_o."""
    near = np.abs(np.asarray(scan.theta_i_deg) - theta_i_deg) <= 0.5
    same = np.array([str(p) == polarization for p in scan.polarization], dtype=bool)
    rows = np.flatnonzero(near & same & np.isfinite(scan.theta_o_deg))
    return rows[np.argsort(scan.theta_o_deg[rows], kind="stable")]


def curve(scan: Scan, rows: NDArray[np.intp], column: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return theta_o (deg), r and its standard uncertainty of one sweep at one wavelength, each 1-D.

    Unusable readings are NaN.  A NaN is put where the sweep jumps over the incident beam (theta_o =
    -theta_i), so that no line crosses the blind zone.
    """
    usable = scan.usable[rows, column]
    r, theta_o_deg = with_gaps(scan, rows, np.where(usable, scan.r[rows, column], np.nan))
    u, _ = with_gaps(scan, rows, np.where(usable, scan.r_sd[rows, column], np.nan))
    return theta_o_deg, r, u


def with_gaps(scan: Scan, rows: NDArray[np.intp], value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return values of a sweep and their theta_o, deg, with a NaN where the sweep jumps over the beam."""
    theta_mes_deg, theta_o_deg = scan.theta_mes_deg[rows], scan.theta_o_deg[rows]
    jump = np.flatnonzero((theta_mes_deg[:-1] < 0) & (theta_mes_deg[1:] > 0)) + 1
    beam_deg = -scan.theta_i_deg[rows][jump - 1]
    return np.insert(value, jump, np.nan), np.insert(theta_o_deg, jump, beam_deg)


def change_texts(scan: Scan) -> list[str]:
    """Return the wavelengths on either side of each detector change, or of the overlap, as ``850–860 nm``."""
    last = np.flatnonzero(np.diff(scan.detector_index.astype(np.int16)) != 0)
    sides = [sorted(scan.wavelength_nm[i : i + 2].tolist()) for i in last]
    return [f"{low:g}–{high:g} nm" for low, high in sides]


def name_of(polarization: str) -> str:
    """Return how a polarization is written in a title."""
    return {"s": "S polarization", "p": "P polarization"}.get(polarization, polarization)
