"""A bench in memory: devices of `gonio.devices` whose signal is a closed form of angles, wavelength and time.

    r    = ((1000 theta_i + theta_mes) + (0.5 if p)) * 1e-6 * (1 + wavelength / 1000)
    D(t) = dark + dark_drift t,  F(t) = full (1 + gain_drift t),  V = D + r F,  baseline = D + F

so that every value of a scan tells which position it belongs to, and linear interpolation in time is exact.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gonio.devices import Quality, SpectrumReading
from gonio.errors import DeviceError, MotionError, ScanStopped
from gonio.rig import (
    ApertureConfig,
    AxisConfig,
    DetectorConfig,
    PolarizerConfig,
    Rig,
    RigConfig,
    SpectrometerConfig,
    StageConfig,
)


def config(**changes: Any) -> RigConfig:
    axes = {"limits_deg": (-95.0, 180.0), "backlash_deg": 0.5}
    base = {
        "name": "memory",
        "aperture": ApertureConfig(width_mm=26.0, height_mm=18.0, distance_mm=95.2353),
        "stage": StageConfig(
            driver="memory",
            theta_i=AxisConfig(limits_deg=(-95.0, 95.0), backlash_deg=0.5),
            theta_mes=AxisConfig(**axes, blind_zone_deg=15.0),
        ),
        "polarizer": PolarizerConfig(driver="memory", s_deg=0.0, p_deg=90.0),
        "spectrometer": SpectrometerConfig(
            driver="memory",
            detectors=(
                DetectorConfig(name="pmt", type="PMT", range_nm=(200.0, 860.0)),
                DetectorConfig(name="ingaas", type="InGaAs", range_nm=(860.0, 1600.0)),
            ),
        ),
        "text": '# the rig file, kept as it is\nname = "memory"\n',
    }
    return RigConfig(**{**base, **changes})


def true_r(theta_i_deg: Any, theta_mes_deg: Any, polarization: Any, wavelength_nm: Any) -> Any:
    p = np.where(np.asarray(polarization) == "p", 0.5, 0.0)
    code = 1000.0 * np.asarray(theta_i_deg) + np.asarray(theta_mes_deg) + p
    return code[..., None] * 1e-6 * (1.0 + np.asarray(wavelength_nm) / 1000.0)


@dataclass
class ManualClock:
    """Instrument time that passes only when something is done."""

    speed: float = 1000.0
    t_s: float = 0.0

    def now_s(self) -> float:
        return self.t_s

    def sleep(self, duration_s: float) -> None:
        self.t_s += duration_s


@dataclass
class World:
    clock: ManualClock = field(default_factory=ManualClock)
    dark_v: float = 2e-4
    dark_drift_v_s: float = 0.0
    gain_drift_s: float = 0.0
    noise_dark_v: float = 0.0
    noise_full: float = 0.0  # relative standard deviation of a reading of the full beam, of photons
    shutter_open: bool = False
    polarization: str | None = None
    log: list[str] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))
    real_delay_s: float = 0.0
    fail: dict[str, Exception] = field(default_factory=dict)  # raised once by the named action

    def did(self, action: str) -> None:
        self.log.append(action)
        error = self.fail.pop(action.split(" ")[0], None)
        if error is not None:
            raise error

    def dark(self, wavelength_nm: float, t_s: float) -> float:
        sign = 1.0 if wavelength_nm < 860.0 else -0.5
        return sign * self.dark_v + self.dark_drift_v_s * t_s

    def full(self, wavelength_nm: float, t_s: float) -> float:
        spectrum = 0.9 if wavelength_nm < 860.0 else 0.7
        return spectrum * (1.0 - 0.2 * wavelength_nm / 1600.0) * (1.0 + self.gain_drift_s * t_s)


@dataclass
class MemoryAxis:
    world: World
    name: str
    where_deg: float
    target_deg: float = 0.0
    parent: None = None
    offset_deg: float = 0.002  # the encoder is never exactly where it was sent
    stopped: bool = False

    def position_deg(self) -> float:
        return self.where_deg

    def start(self, target_deg: float) -> None:
        self.world.did(f"start {self.name} {target_deg:g}")
        self.stopped = False
        self.target_deg = target_deg

    def wait(self) -> float:
        if self.stopped:
            raise MotionError(self.name, "was stopped on its way", "start the move again")
        self.world.clock.sleep(0.1 * abs(self.target_deg - self.where_deg))
        self.where_deg = self.target_deg + self.offset_deg
        return self.where_deg

    def home(self) -> None:
        self.where_deg = 0.0

    def stop(self, *, success: bool = False) -> None:
        self.stopped = True


@dataclass
class MemoryStage:
    theta_i: MemoryAxis
    theta_mes: MemoryAxis
    world: World

    def identify(self) -> str:
        self.world.did("identify")
        return "stage in memory"

    def stop(self) -> None:
        self.world.log.append("stage.stop")
        self.theta_i.stop()
        self.theta_mes.stop()

    def recover(self) -> str:
        self.world.did("recover")
        self.stop()
        return "homed"

    def verify_still(self, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
        for axis, expected_deg in ((self.theta_i, theta_i_deg), (self.theta_mes, theta_mes_deg)):
            if axis.where_deg != expected_deg:
                raise MotionError(axis.name, f"is at {axis.where_deg:g} deg, not {expected_deg:g}", "repeat")
        return self.theta_i.where_deg, self.theta_mes.where_deg

    def close(self) -> None:
        self.world.log.append("stage.close")


@dataclass
class MemoryPolarizer:
    world: World
    name: str = "polarizer"

    def select(self, polarization: str) -> float:
        self.world.did(f"select {polarization}")
        self.world.polarization = polarization
        return 0.01 if polarization == "s" else 90.01

    def identify(self) -> str:
        return "polarizer in memory"

    def stop(self) -> None:
        self.world.log.append("polarizer.stop")

    def close(self) -> None:
        self.world.log.append("polarizer.close")


@dataclass
class MemorySpectrometer:
    world: World
    stage: MemoryStage
    name: str = "spectrometer"
    stop_event: threading.Event = field(default_factory=threading.Event)
    over_range: set[tuple[str, float]] = field(default_factory=set)

    def measure_spectrum(
        self,
        wavelength_nm: Any,
        detector_index: Any,
        *,
        beam: str = "sample",
        averages: Any = 1,
        on_reading: Any = None,
    ) -> SpectrumReading:
        world = self.world
        world.did(f"measure {beam} {world.polarization}")
        world.shutter_open = beam != "dark"
        self.stop_event.clear()
        m = len(wavelength_nm)
        signal, sd, time_s = np.empty(m), np.full(m, np.nan), np.empty(m)
        quality = np.zeros(m, dtype=np.uint16)
        theta_i, theta_mes = self.stage.theta_i.where_deg, self.stage.theta_mes.where_deg
        r = true_r(theta_i, theta_mes, world.polarization or "s", wavelength_nm)
        counts = np.broadcast_to(averages, m).tolist()
        for i, (w, count) in enumerate(zip(np.asarray(wavelength_nm).tolist(), counts, strict=True)):
            if self.stop_event.is_set():
                raise ScanStopped("stopped")
            world.clock.sleep(0.01 * count)
            if world.real_delay_s:
                time.sleep(world.real_delay_s)
            t = world.clock.now_s()
            fraction = {"sample": float(r[i]), "direct": 1.0, "dark": 0.0}[beam]
            mean = world.dark(w, t) + fraction * world.full(w, t)
            noise = np.sqrt(world.noise_dark_v**2 + fraction * (world.noise_full * world.full(w, t)) ** 2)
            readings = mean + noise * world.rng.standard_normal(count)
            signal[i], time_s[i] = readings.mean(), t
            if count > 1:
                sd[i] = readings.std(ddof=1)
            if (beam, w) in self.over_range:
                quality[i] = Quality.OVER_RANGE
            if on_reading is not None:
                on_reading(i)
        return SpectrumReading(np.asarray(wavelength_nm) + 0.01, signal, sd, averages, time_s, quality)

    def close_shutter(self) -> None:
        self.world.did("shutter")
        self.world.shutter_open = False

    def identify(self) -> dict[str, str]:
        return {"monochromator": "monochromator in memory", "lockin": "lock-in in memory"}

    def stop(self) -> None:
        self.world.log.append("spectrometer.stop")
        self.stop_event.set()

    def close(self) -> None:
        self.world.log.append("spectrometer.close")


def rig(world: World | None = None, **changes: Any) -> Rig:
    world = world or World()
    stage = MemoryStage(
        MemoryAxis(world, "theta_i", 0.0), MemoryAxis(world, "theta_mes", 90.0, offset_deg=-0.003), world
    )
    return Rig(
        config(**changes),
        stage,  # type: ignore[arg-type]
        MemoryPolarizer(world),
        MemorySpectrometer(world, stage),
        clock=world.clock,  # type: ignore[arg-type]
    )


PLAN_TOML = """
title = "Test scan"
[sample]
name = "coded sample"
[[wavelengths]]
start_nm = 840.0
stop_nm = 880.0
step_nm = 10.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [15.0, 30.0, 40.0]
[[sweeps]]
theta_i_deg = 45.0
theta_mes_deg = { start = 30.0, stop = 90.0, step = 60.0 }
"""

__all__ = ["PLAN_TOML", "DeviceError", "World", "config", "rig", "true_r"]
