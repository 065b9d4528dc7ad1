"""Are the readings given as a fit can take them?  Every refusal says which value, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.aperture import Aperture
from gonio.errors import FitError

FloatArray = NDArray[np.float64]

LEAST_R, LARGEST_R = 1e-30, 1e15
"""Readings beyond are in no unit of power over power, and their squares neared the ends of float64."""

_KNOWN = ("s", "p", "unpolarized")


@dataclass(frozen=True, slots=True)
class Given:
    """n positions, m wavelengths: checked arrays of a fit; readings NaN where there is none."""

    theta_i_deg: FloatArray  # (n,)
    theta_o_deg: FloatArray  # (n,)
    polarization: NDArray[np.str_]  # (n,)
    r: FloatArray  # (n, m)
    wavelength_nm: FloatArray  # (m,) NaN where unknown
    detector_index: NDArray[np.uint8]  # (m,)

    @classmethod
    def of(
        cls,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: ArrayLike,
        r: ArrayLike,
        wavelength_nm: ArrayLike | None,
        detector_index: ArrayLike | None,
        instrument: Aperture,
    ) -> Given:
        """Return arrays of the right type and shape; masked values are none.

        Raises
        ------
        FitError
            Something else than real numbers, shapes that do not belong together, angles that an instrument
            does not have, unknown polarizations, or readings beyond any unit.
        """
        readings = real(r, "r")
        if readings.ndim > 2:
            raise FitError(
                f"r has the shape {readings.shape}; give (positions, wavelengths), NaN where nothing was read"
            )
        readings = np.atleast_2d(readings)
        n, m = readings.shape
        which = np.asarray(polarization, np.str_)
        theta_i, theta_o = real(theta_i_deg, "theta_i_deg"), real(theta_o_deg, "theta_o_deg")
        if not theta_i.shape == theta_o.shape == which.shape == (n,):
            turned = " (r is (positions, wavelengths), is it turned round?)" if theta_i.shape == (m,) else ""
            raise FitError(
                f"the readings have {n} positions{turned}, but there are {_count(theta_i, 'theta_i')}, "
                f"{_count(theta_o, 'theta_o')} and {_count(which, 'polarizations')}; give one of each per "
                "position"
            )
        if not n:
            raise FitError("there are no positions; give at least as many readings as the fit has unknowns")
        _check_polarization(which)
        _check_angles(theta_i, theta_o, float(instrument.half_angles_deg[0]))
        _check_size(readings)
        wavelength = np.full(m, np.nan) if wavelength_nm is None else real(wavelength_nm, "wavelength_nm")
        detector = np.zeros(m) if detector_index is None else np.asarray(detector_index)
        if wavelength.shape != (m,) or detector.shape != (m,):
            raise FitError(
                f"the readings have {m} wavelengths, but wavelength_nm or detector_index do not; give "
                f"{m} each"
            )
        _check_wavelengths(wavelength)
        return cls(theta_i, theta_o, which, readings, wavelength, _detectors(detector))


def real(values: ArrayLike, name: str) -> FloatArray:
    """Return float64, NaN where masked.

    Raises
    ------
    FitError
        Text, complex numbers or anything else that is no real number.
    """
    try:
        array = values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
        if array.dtype.kind in "iufO":
            return np.asarray(np.ma.filled(array.astype(np.float64), np.nan), np.float64)
    except (TypeError, ValueError) as error:
        raise FitError(f"{name} is not an array of real numbers ({error}); correct it") from error
    raise FitError(f"{name} holds {array.dtype.name} values; give real numbers, NaN where there is none")


def uncertainty(values: ArrayLike | None, readings: FloatArray, name: str) -> FloatArray:
    """Return a standard uncertainty for every reading, (n, m), NaN where it is not known.

    Raises
    ------
    FitError
        It does not broadcast to the readings, or one of a reading is negative or infinite.
    """
    if values is None:
        return np.full(readings.shape, np.nan)
    array = real(values, name)
    try:
        array = np.broadcast_to(array, readings.shape)
    except ValueError:
        raise FitError(
            f"{name} has the shape {array.shape}, the readings {readings.shape}; give one number, or (n, 1), "
            "(m,) or (n, m) of them"
        ) from None
    array = np.where(np.isfinite(readings), array, np.nan)
    bad = np.argwhere((array < 0.0) | np.isinf(array))
    if bad.size:
        raise FitError(
            f"{name} = {array[tuple(bad[0])]:g} at position {bad[0][0]} is no standard uncertainty; give at "
            "least 0, or NaN where it is not known"
        )
    return array


def _count(array: FloatArray | NDArray[np.str_], what: str) -> str:
    return f"{array.size} {what}" if array.ndim == 1 else f"{what} of shape {array.shape}"


def _check_polarization(which: NDArray[np.str_]) -> None:
    wrong = np.flatnonzero(~np.isin(which, _KNOWN))
    if wrong.size:
        raise FitError(
            f"polarization {str(which[wrong[0]])!r} of position {wrong[0]} is not known; label every "
            "position 's' or 'p' ('unpolarized' is not fitted)"
        )


def _check_angles(theta_i: FloatArray, theta_o: FloatArray, half_angle_deg: float) -> None:
    for name, angle in (("theta_i", theta_i), ("theta_o", theta_o)):
        wrong = np.flatnonzero(~np.isfinite(angle))
        if wrong.size:
            raise FitError(
                f"{name} = {angle[wrong[0]]:g} at position {wrong[0]} is no angle; leave the position out"
            )
    wrong = np.flatnonzero((theta_i < 0.0) | (theta_i > 90.0))
    if wrong.size:
        raise FitError(
            f"theta_i = {theta_i[wrong[0]]:g} deg at position {wrong[0]} is outside 0...90 deg; turn the "
            "signs of theta_i and theta_o round, theta_o is positive on the specular side"
        )
    # up to there a part of the aperture looks above the sample's plane
    limit = 90.0 + half_angle_deg
    wrong = np.flatnonzero(np.abs(theta_o) > limit)
    if wrong.size:
        raise FitError(
            f"theta_o = {theta_o[wrong[0]]:g} deg at position {wrong[0]} is behind the sample (beyond "
            f"±{limit:.1f} deg nothing of it is in the aperture); is theta_o theta_mes - theta_i?"
        )


def _check_size(r: FloatArray) -> None:
    size = np.where(np.isfinite(r), np.abs(r), 0.0)
    if not size.size:
        return
    place = np.unravel_index(int(np.argmax(size)), size.shape)
    if size[place] > LARGEST_R:
        raise FitError(
            f"r = {r[place]:g} at position {place[0]}, wavelength number {place[1]}, is no reflected over "
            "incident power; leave the reading out (NaN), or correct the unit"
        )
    largest = np.max(size, axis=0)
    small = np.flatnonzero((largest > 0.0) & (largest < LEAST_R))
    if small.size:
        raise FitError(
            f"the largest r of wavelength number {small[0]} is {largest[small[0]]:g}, which is no reflected "
            "over incident power; correct the unit"
        )


def _check_wavelengths(wavelength_nm: FloatArray) -> None:
    wrong = np.flatnonzero((wavelength_nm <= 0.0) | np.isinf(wavelength_nm))
    if wrong.size:
        raise FitError(
            f"wavelength_nm = {wavelength_nm[wrong[0]]:g} (number {wrong[0]}) is no wavelength; give more "
            "than 0 nm, or NaN where it is not known"
        )


def _detectors(detector: NDArray[np.generic]) -> NDArray[np.uint8]:
    known = detector.dtype.kind in "biuf" and np.all(np.isin(detector, np.arange(256)))
    if not known:
        raise FitError("detector_index must hold whole numbers 0...255, one per wavelength; correct it")
    return detector.astype(np.uint8)
