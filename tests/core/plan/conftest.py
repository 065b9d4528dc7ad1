"""A rig described by hand: one second per reading, two detectors, axes as fast as those of the simulated
ARTA.
"""

from __future__ import annotations

import pytest

from gonio.rig import (
    ApertureConfig,
    AxisConfig,
    DetectorConfig,
    PolarizerConfig,
    RigConfig,
    SpectrometerConfig,
    StageConfig,
)


@pytest.fixture
def a_rig() -> RigConfig:
    return RigConfig(
        name="bench",
        aperture=ApertureConfig(width_mm=26.0, height_mm=18.0, distance_mm=95.0),
        stage=StageConfig(
            driver="none",
            theta_i=AxisConfig(limits_deg=(0.0, 95.0), backlash_deg=0.5),
            theta_mes=AxisConfig(limits_deg=(15.0, 180.0), blind_zone_deg=15.0, backlash_deg=0.5),
        ),
        polarizer=PolarizerConfig(driver="none", s_deg=0.0, p_deg=90.0),
        spectrometer=SpectrometerConfig(
            driver="none",
            detectors=(
                DetectorConfig(name="pmt", type="PMT", range_nm=(300.0, 860.0)),
                DetectorConfig(name="ingaas", type="InGaAs", range_nm=(860.0, 1600.0)),
            ),
        ),
    )
