"""Which wavelengths a rig measures for a plan, with which detector, and how many readings it averages at
each.

Without overlap there is one column per wavelength, ascending.  With ``overlap_nm`` the wavelengths within
that distance of a detector change have two, one of either detector, so that their ratio can be seen.  Columns
are grouped by detector, ascending within each::

    wavelength_nm    ... 840 850 860 870 880 | 840 850 860 870 880 ...
    detector_index   ...   0   0   0   0   0 |   1   1   1   1   1 ...

A pass so changes the detector once, as without overlap, and whatever pools or joins neighbours of one
detector finds them side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray
from gonio.plan.model import Plan
from gonio.rig import RigConfig


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """The columns of a scan, in the order of an ascending pass.

    Attributes
    ----------
    wavelength_nm : (m,) float64
    detector_index : (m,) uint8, into the rig's detectors
    averages : (m,) uint32, readings averaged at a position; references have their own number
    """

    wavelength_nm: FloatArray
    detector_index: NDArray[np.uint8]
    averages: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.wavelength_nm)

    @property
    def averages_asked(self) -> int | NDArray[np.uint32]:
        """What `Spectrometer.measure_spectrum` is asked for: one number where all are equal."""
        first = int(self.averages[0])
        return first if np.all(self.averages == first) else self.averages


def channels(plan: Plan, rig: RigConfig) -> Channels:
    """Return the columns that `rig` measures for `plan`; `RefusedError` where no detector covers one."""
    asked_nm = plan.wavelength_nm
    own = rig.detector_for(asked_nm)
    averages = _averages(plan, rig)
    if plan.overlap_nm == 0.0:
        return Channels(asked_nm, own, averages)
    detectors = rig.spectrometer.detectors
    picked: list[NDArray[np.intp]] = []
    for index in range(len(detectors)):
        mine = own == index
        if index > 0:
            mine |= (own == index - 1) & (asked_nm >= detectors[index].range_nm[0] - plan.overlap_nm - 1e-9)
        if index + 1 < len(detectors):
            change_nm = detectors[index + 1].range_nm[0]
            mine |= (own == index + 1) & (asked_nm <= change_nm + plan.overlap_nm + 1e-9)
        picked.append(np.flatnonzero(mine))
    column = np.concatenate(picked)
    detector_index = np.repeat(np.arange(len(detectors), dtype=np.uint8), [len(part) for part in picked])
    return Channels(asked_nm[column], detector_index, averages[column])


def _averages(plan: Plan, rig: RigConfig) -> NDArray[np.uint32]:
    """Return the readings averaged at each wavelength asked for, (m,)."""
    parts: list[NDArray[np.uint32]] = []
    for entry in plan.wavelengths:
        count, integration_s = entry.averages, entry.integration_s
        if count is None and integration_s is None:
            count, integration_s = plan.reading.averages, plan.reading.integration_s
        if integration_s is not None:
            count = rig.spectrometer.averages_for(integration_s)
        parts.append(np.full(len(entry.values()), count, dtype=np.uint32))
    return np.concatenate(parts)
