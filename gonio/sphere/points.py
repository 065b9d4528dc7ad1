"""Is a list of points a reflectance spectrum?  Every file format ends here.

Nothing is sorted away, averaged, clipped or left out: what is not a spectrum is refused with its place.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import StoreError
from gonio.sphere.raw import MOST_POINTS

FloatArray = NDArray[np.float64]

MARGIN = 0.02
"""A sphere reads a little below 0 on black (noise, dark) and a little above 1 on its own white standard."""
SHORTEST_NM, LONGEST_NM = 150.0, 30_000.0
ONLY_OPTION = "--sphere-nm"


def spectrum_of(
    path: Path,
    wavelength_nm: FloatArray,
    value: FloatArray,
    factor: float,
    place: Callable[[int], str],
    only_nm: tuple[float, float] | None = None,
) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Return wavelengths ascending, nm, and the reflectance as a fraction, (k,) each, and their points (k,).

    Parameters
    ----------
    wavelength_nm, value
        (j,) as they stand in the file, in ascending or descending order.
    factor
        From `value` to a fraction.
    place
        Names the place of a point in the file, such as ``line 12``.
    only_nm
        Ends of the range to be used; what lies outside is not looked at.

    Raises
    ------
    StoreError
        A wavelength is none, stands twice or out of order; a value is none, or outside 0...1 by more than
        `MARGIN`; there are fewer than two points.
    """

    def wrong(i: int, what: str) -> StoreError:
        return StoreError(f"{path}, {place(i)}: {what}")

    if len(wavelength_nm) > MOST_POINTS:
        raise StoreError(
            f"{path}: holds {len(wavelength_nm)} points, more than {MOST_POINTS}, which no spectrum of a "
            "sphere has; check the file"
        )
    bad = ~((wavelength_nm >= SHORTEST_NM) & (wavelength_nm <= LONGEST_NM))  # NaN too
    if np.any(bad):
        i = int(np.argmax(bad))
        raise wrong(
            i,
            f"the wavelength is {wavelength_nm[i]:g} nm, not within {SHORTEST_NM:g}...{LONGEST_NM:g} nm; "
            "correct it, or the unit in the header",
        )
    step = np.diff(wavelength_nm)
    if len(step) and not (np.all(step > 0) or np.all(step < 0)):
        down = np.count_nonzero(step < 0) > np.count_nonzero(step > 0)
        i = int(np.argmax(step >= 0 if down else step <= 0)) + 1
        if step[i - 1] == 0 or wavelength_nm[i] in wavelength_nm[:i]:
            raise wrong(i, f"{wavelength_nm[i]:g} nm is there a second time; which value holds? remove one")
        order = "descend" if down else "ascend"
        raise wrong(
            i, f"{wavelength_nm[i]:g} nm does not {order} from {wavelength_nm[i - 1]:g} nm; sort the points"
        )
    index = np.arange(len(wavelength_nm))
    if only_nm is not None:
        index = index[(wavelength_nm >= only_nm[0]) & (wavelength_nm <= only_nm[1])]
    if len(index) < 2:
        within = "" if only_nm is None else f" within {only_nm[0]:g}...{only_nm[1]:g} nm"
        raise StoreError(
            f"{path}: holds {len(index)} point{'' if len(index) == 1 else 's'}{within}, and a spectrum has "
            "two or more; check the file"
        )
    reflectance = value * factor
    bad = ~np.isfinite(value[index])
    if np.any(bad):
        i = int(index[np.argmax(bad)])
        raise wrong(
            i,
            f"the value at {wavelength_nm[i]:g} nm is {value[i]}, not a number; remove that line, or leave "
            f"its wavelength out with {ONLY_OPTION}",
        )
    bad = (reflectance[index] < -MARGIN) | (reflectance[index] > 1.0 + MARGIN)
    if np.any(bad):
        i = int(index[np.argmax(bad)])
        unit = " %" if factor == 0.01 else ""
        low, high = -MARGIN / factor, (1.0 + MARGIN) / factor
        raise wrong(
            i,
            f"the value at {wavelength_nm[i]:g} nm is {value[i]:g}{unit}, no reflectance "
            f"({low:g}...{high:g}{unit}, {np.count_nonzero(bad)} of {len(index)} values are outside); check "
            f"the ordinate, or leave the noisy ends out with {ONLY_OPTION}, such as 300-1500",
        )
    if len(step) and step[0] < 0:
        index = index[::-1]
    return wavelength_nm[index], reflectance[index], index
