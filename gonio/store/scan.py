"""What a measured scan is, once it is off the disk: plain arrays, named with their units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray, Quality
from gonio.overlap import changes_nm, home

if TYPE_CHECKING:
    import xarray

    from gonio.aperture import Aperture, IncidentBeam

UNUSABLE = Quality.OVER_RANGE | Quality.REFUSED | Quality.NOT_MEASURED
"""A reading with one of these bits is not a measurement of r."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A scan of n positions and m wavelengths, as `gonio.load` returns it.

    Only positions that were measured are here, in measuring order; an unfinished scan has fewer of them than
    its plan (`finished` is false).  NaN in `r` means that there is no value; `quality` says why.

    Attributes
    ----------
    wavelength_nm : (m,) float64, set wavelength, ascending within each detector; about a detector change a
        wavelength may be there twice, once for each detector (`home` keeps one of them)
    detector_index : (m,) uint8, index into `detector_names`
    theta_i_deg, theta_mes_deg, theta_o_deg : (n,) float64, read back from the axes;
        theta_o = theta_mes - theta_i
    polarization : (n,) str, ``"s"`` or ``"p"``
    r : (n, m) float64, power caught by the aperture over incident power
    r_sd : (n, m) float64, standard uncertainty of `r` from the noise of its own reading, independent from
        reading to reading; NaN if the references were not repeated, so that nothing is known of the noise
    raw_signal_v, dark_v, baseline_v : (n, m) float64, volts; dark and baseline interpolated in time to the
        reading
    gain_u : (n, m) float64, relative standard uncertainty of `r` from the 100 % baseline, an error that all
        positions of one polarization share
    offset_u : (n, m) float64, standard uncertainty of `r` from the dark reading, an error that all positions
    share,
        S and P alike: the dark is read once for both
    quality : (n, m) uint16, bits of `gonio.devices.Quality`
    time_s : (n,) float64, time of the first reading of each position since the scan began, instrument seconds
    position : (n,) int64, number of the position in the plan, from zero
    n_planned : number of positions of the plan
    beam : the beam on the sample; None if the rig file did not say
    """

    path: Path
    title: str
    sample_name: str
    wavelength_nm: FloatArray
    detector_index: NDArray[np.uint8]
    detector_names: tuple[str, ...]
    theta_i_deg: FloatArray
    theta_mes_deg: FloatArray
    theta_o_deg: FloatArray
    polarization: NDArray[np.str_]
    r: FloatArray
    r_sd: FloatArray
    raw_signal_v: FloatArray
    dark_v: FloatArray
    baseline_v: FloatArray
    gain_u: FloatArray
    offset_u: FloatArray
    quality: NDArray[np.uint16]
    time_s: FloatArray
    aperture: Aperture
    position: NDArray[np.int64]
    n_planned: int
    finished: bool
    plan_text: str = ""
    rig_text: str = ""
    start_time: str = ""
    beam: IncidentBeam | None = None

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask (n, m) of the readings that are finite and carry no flag that forbids their use."""
        mask: NDArray[np.bool_] = np.isfinite(self.r) & ((self.quality & np.uint16(UNUSABLE)) == 0)
        return mask

    @property
    def detector_change_nm(self) -> tuple[float, ...]:
        """Wavelengths at which the detector changes: halfway between neighbours, or the middle of the
        overlap.
        """
        return changes_nm(self.wavelength_nm, self.detector_index)

    @property
    def home(self) -> NDArray[np.bool_]:
        """Mask (m,) that keeps each wavelength once where two detectors measured it; see `gonio.overlap`."""
        return home(self.wavelength_nm, self.detector_index)

    def to_xarray(self) -> xarray.Dataset:
        """Return an `xarray.Dataset` of dimensions (position, wavelength) with ``units`` and ``quantity``."""
        import xarray  # half a second to import, and few need it

        from gonio.store.layout import COLUMNS

        both, along, across = ("position", "wavelength"), ("position",), ("wavelength",)

        def variable(
            dims: tuple[str, ...], values: NDArray[np.generic], column: str
        ) -> tuple[tuple[str, ...], NDArray[np.generic], dict[str, str]]:
            return dims, values, COLUMNS[column].attributes()

        return xarray.Dataset(
            data_vars={
                "r": variable(both, self.r, "r"),
                "r_sd": variable(both, self.r_sd, "r_errors"),
                "raw_signal": variable(both, self.raw_signal_v, "raw_signal"),
                "dark": variable(both, self.dark_v, "dark"),
                "baseline": variable(both, self.baseline_v, "baseline"),
                "gain_u": variable(both, self.gain_u, "gain_uncertainty"),
                "offset_u": variable(both, self.offset_u, "offset_uncertainty"),
                "quality": variable(both, self.quality, "quality"),
            },
            coords={
                "position": variable(along, self.position, "position"),
                "wavelength": variable(across, self.wavelength_nm, "wavelength"),
                "theta_i": variable(along, self.theta_i_deg, "theta_i"),
                "theta_mes": variable(along, self.theta_mes_deg, "theta_mes"),
                "theta_o": variable(along, self.theta_o_deg, "theta_o"),
                "polarization": variable(along, self.polarization, "polarization"),
                "time": variable(along, self.time_s, "time"),
                "detector": (
                    across,
                    np.asarray(self.detector_names, dtype=np.str_)[self.detector_index],
                    {"quantity": "detector name"},
                ),
            },
            attrs={
                "title": self.title,
                "sample": self.sample_name,
                "path": str(self.path),
                "start_time": self.start_time,
                "finished": int(self.finished),
                "aperture_width_mm": self.aperture.width_mm,
                "aperture_height_mm": self.aperture.height_mm,
                "aperture_distance_mm": self.aperture.distance_mm,
            },
        )
