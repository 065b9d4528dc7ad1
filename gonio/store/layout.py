"""Which datasets `/entry/data` holds, and the unit and quantity that each of them declares.

NXdata of n positions (rows) and m wavelengths (columns).  Everything is chunked by rows and uncompressed, so
that the cost of a position is constant and a file tells by its size how much it can hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gonio.devices import Quality

Dimensions = Literal["nm", "n", "m"]


@dataclass(frozen=True, slots=True)
class Column:
    """One dataset of `/entry/data`: its dimensions, type, unit and what it is."""

    dims: Dimensions
    dtype: str
    units: str
    quantity: str
    fill: float = float("nan")

    def attributes(self) -> dict[str, str]:
        """Return the attributes every dataset carries; a dimensionless quantity has unit ``1``."""
        found = {"quantity": self.quantity}
        if self.units:
            found["units"] = self.units
        return found


COLUMNS: dict[str, Column] = {
    # corrected, in the sense of docs/architecture.md
    "r": Column("nm", "f8", "1", "r: reflected power in the aperture over incident power"),
    "r_errors": Column("nm", "f8", "1", "standard uncertainty of r, random part"),
    "gain_uncertainty": Column(
        "nm", "f8", "1", "relative standard uncertainty of r, common to one polarization (baseline)"
    ),
    "offset_uncertainty": Column(
        "nm", "f8", "1", "standard uncertainty of r, common to all positions (dark)"
    ),
    # as measured
    "raw_signal": Column("nm", "f8", "V", "raw signal"),
    "raw_signal_sd": Column("nm", "f8", "V", "standard deviation of a single reading of the raw signal"),
    "dark": Column(
        "nm", "f8", "V", "raw signal with the shutter closed, interpolated in time to the reading"
    ),
    "baseline": Column(
        "nm", "f8", "V", "raw signal of the direct beam (100 %), interpolated in time to the reading"
    ),
    "reading_time": Column("nm", "f8", "s", "instrument time since the scan began"),
    "wavelength_readback": Column("nm", "f8", "nm", "wavelength read back from the monochromator"),
    "averages": Column("nm", "u4", "1", "readings averaged in raw_signal", 0.0),
    "quality": Column(
        "nm", "u2", "1", "bits of gonio.devices.Quality, 0 is a good reading", float(Quality.NOT_MEASURED)
    ),
    # per position
    "theta_i": Column("n", "f8", "deg", "incidence angle from the sample normal, read back"),
    "theta_mes": Column("n", "f8", "deg", "detector angle from the incident beam, read back"),
    "theta_o": Column(
        "n", "f8", "deg", "observation angle from the sample normal, positive on the specular side"
    ),
    "theta_i_set": Column("n", "f8", "deg", "incidence angle from the sample normal, as planned"),
    "theta_mes_set": Column("n", "f8", "deg", "detector angle from the incident beam, as planned"),
    "position": Column("n", "i8", "1", "number of the position in the plan, from zero"),
    "time": Column("n", "f8", "s", "instrument time of the first reading since the scan began"),
    "polarization": Column("n", "str", "", "polarization of the incident beam, s or p"),
    "polarizer_angle": Column("n", "f8", "deg", "angle of the polarizer's rotator, read back"),
    # per wavelength
    "wavelength": Column("m", "f8", "nm", "wavelength, as set, ascending within each detector"),
    "detector_index": Column("m", "u1", "1", "index into detector_names"),
}

REFERENCE_COLUMNS: dict[str, Column] = {
    "averages": Column("n", "u4", "1", "readings averaged in signal"),
    "theta_i": Column("n", "f8", "deg", "sample angle, read back"),
    "theta_mes": Column("n", "f8", "deg", "detector angle, read back"),
    "time": Column("nm", "f8", "s", "instrument time since the scan began"),
    "signal": Column("nm", "f8", "V", "raw signal, mean of the repeats"),
    "signal_sd": Column("nm", "f8", "V", "standard deviation of a single reading"),
    "wavelength_readback": Column("nm", "f8", "nm", "wavelength read back from the monochromator"),
    "quality": Column("nm", "u2", "1", "bits of gonio.devices.Quality, 0 is a good reading"),
}
"""`/entry/references`: one row for each pass, columns as in `/entry/data`."""

REFERENCE_TEXTS = {
    "kind": "dark (shutter closed) or baseline (direct beam)",
    "when": "start, end, or before the position of this number",
    "polarization": "polarization of the beam, s or p; any for a dark",
}

EVENT_COLUMNS: dict[str, Column] = {
    "time": Column("n", "f8", "s", "instrument time since the scan began"),
}

EVENT_TEXTS = {
    "level": "info, warning or error",
    "source": "the device, or the part of the program",
    "message": "what happened",
}

QUALITY_BITS = ", ".join(f"{bit.value} {bit.name}" for bit in Quality if bit.name)

SPECTRUM_GROUPS = ("sphere", "simulated_truth")
"""Spectra brought in beside the scan; they survive a rebuild of the file."""


def chunk_rows(n_wavelength: int) -> int:
    """Return the rows of a chunk of about 16 KiB: cheap to rewrite at every position."""
    return int(np.clip(16384 // (8 * n_wavelength), 1, 256))


def sweep_name(theta_i_deg: float, polarization: str) -> str:
    """Return ``sweep_20_s``; NeXus names have no minus sign, so -20 deg reads ``m20``."""
    return f"sweep_{theta_i_deg:g}_{polarization}".replace("-", "m").replace("+", "")
