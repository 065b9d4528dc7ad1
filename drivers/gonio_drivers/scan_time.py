"""How long a pass of monochromator and lock-in takes, from their configuration alone.

Counted in instrument seconds: the drive from wavelength to wavelength, changes of grating, filter, detector
and shutter, settling and averaging, and the searches for an amplifier range: one at the first reading of
sample and dark with each detector, and `range_changes_per_pass` more in a pass over the sample, whose
brightness nobody knows before.  Exchanges are counted by role; what one costs is the rig file's
``[latency]``.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.devices import Beam, FloatArray
from gonio.latency import PassTime

if TYPE_CHECKING:
    from gonio_drivers.scanning import ScanningConfig

_SET = 2  # exchanges to change something and read it back


def pass_time(
    config: ScanningConfig,
    wavelength_nm: FloatArray,
    detector_index: NDArray[np.uint8],
    averages: int | NDArray[np.integer],
    *,
    beam: Beam,
    after: tuple[float, int] | None,
    first: bool,
) -> PassTime:
    """Return what a pass takes; see `gonio.rig.SpectrometerConfig.pass_time`."""
    mono, lockin = config.monochromator, config.lockin
    exchanges: Counter[str] = Counter()
    wavelengths = np.asarray(wavelength_nm, dtype=np.float64).tolist()
    detectors = np.asarray(detector_index).tolist()
    if not wavelengths:
        return PassTime(0.0)
    counts = np.broadcast_to(averages, len(wavelengths)).tolist()
    settle_s, jump_settle_s, spacing_s = lockin.settle_s(), lockin.jump_settle_s(), lockin.spacing_s()
    total_s = sum((count - 1) * spacing_s for count in counts)
    per_drive = 1 if mono.pipelined else 2
    previous = (wavelengths[0], detectors[0]) if after is None else after
    for i, here in enumerate(zip(wavelengths, detectors, strict=True)):
        change_s = 0.0
        if mono.grating_for(previous[0]) != mono.grating_for(here[0]):
            change_s += mono.grating_change_s
            exchanges["monochromator"] += _SET
        filters = mono.filter_for(previous[0]), mono.filter_for(here[0])
        if filters[0] is not None and filters[1] is not None and filters[0] != filters[1]:
            change_s += mono.filter_step_s * abs(filters[1] - filters[0])
            exchanges["monochromator"] += _SET
        if config.port_of(previous[1]) != config.port_of(here[1]):
            change_s += mono.port_change_s
            exchanges["monochromator"] += _SET
        drive_nm = abs(here[0] - previous[0])
        drive_s = mono.drive_start_s + drive_nm / mono.drive_nm_s if drive_nm > 0.0 else 0.0
        total_s += change_s + drive_s + (jump_settle_s if change_s or i == 0 else settle_s)
        exchanges["monochromator"] += per_drive
        exchanges["lockin"] += counts[i]
        previous = here
    searches = config.range_changes_per_pass if beam == "sample" else 0.0
    if first and beam != "direct":  # a search begins at the largest range, which suits the direct beam
        seen = dict(zip(reversed(detectors), reversed(counts), strict=True))
        searches += len(seen)
        total_s += sum((count - 1) * spacing_s for count in seen.values())
        exchanges["lockin"] += sum(seen.values())
    total_s += searches * jump_settle_s
    # at the end everything that was set is asked for once more: grating, port, shutter, filter; the amplifier
    exchanges["monochromator"] += 3 + bool(mono.filters)
    exchanges["lockin"] += 1
    exchanges["lockin"] += round(_SET * searches)
    return PassTime(total_s, dict(exchanges))
