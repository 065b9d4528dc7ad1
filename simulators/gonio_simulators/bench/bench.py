"""The whole bench: axes, polarizer, monochromator, lamp, sample, detectors and lock-in, in one bench time.

Everything evolves when it is asked, on the thread that asks; callers on several threads must take turns.
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np

from gonio.errors import ConfigError
from gonio_simulators.bench.config import (
    HOME_OVERSHOOT_DEG,
    ZONE_MARGIN_DEG,
    AxisTable,
    AxisTruth,
    BenchConfig,
    DetectorTruth,
)
from gonio_simulators.bench.disturbance import LightDisturbance
from gonio_simulators.bench.lockin import DetectorSignal, Lockin
from gonio_simulators.bench.monochromator import LightPath, Monochromator
from gonio_simulators.bench.motor import Motor, MotorHardware
from gonio_simulators.bench.photometry import Detector, Lamp, throughput
from gonio_simulators.bench.scattering import Scattering
from gonio_simulators.clock import BenchClock

POLARIZER = MotorHardware(
    name="polarizer",
    steps_per_deg=143360.0 / 360.0,
    speed_deg_s=430.0,
    acceleration_deg_s2=4000.0,
    power_on_deg=23.0,
)
"""Thorlabs ELL14: 143360 pulses per turn, no limits."""

EDGE_ON_DEG = 1.0
"""The direct beam passes the sample when it stands edge-on to within this."""

NEGLIGIBLE_LIGHT = 1e-12

STATES_KEPT = 64


class Bench:
    """The simulated ARTA behind the wires.

    Parameters
    ----------
    config
        The rig and its truth.
    clock
        Bench time; by default a clock that runs at the configured speed from now on.
    """

    def __init__(self, config: BenchConfig, clock: BenchClock | None = None) -> None:
        simulation = config.simulation
        self.config = config
        self.clock = clock or BenchClock(simulation.clock_speed)
        self.scattering = Scattering(config)
        self.theta_i = Motor(
            axis_hardware("theta_i", config.stage.theta_i, simulation.theta_i), self.clock, self._catch_up
        )
        self.theta_mes = Motor(
            axis_hardware("theta_mes", config.stage.theta_mes, simulation.theta_mes),
            self.clock,
            self._catch_up,
        )
        self.polarizer = Motor(POLARIZER, self.clock, self._catch_up)
        self._detectors = {
            table.output_port or place: Detector(
                table, simulation.detectors.get(table.name, DetectorTruth()), simulation.noise
            )
            for place, table in enumerate(config.spectrometer.detectors, start=1)
        }
        self.monochromator = Monochromator(
            config.spectrometer.monochromator, tuple(self._detectors), self.clock, self._catch_up
        )
        lamp_rng, noise_rng = (np.random.default_rng([simulation.seed, k]) for k in (1, 2))
        self._lamp = Lamp(simulation.noise.lamp_drift_per_hour, lamp_rng)
        self.disturbance: LightDisturbance | None = None
        """What happens to lamp and detectors beside their drift and noise; None for nothing."""
        self._known_light: dict[tuple[object, ...], float] = {}
        self._lockin: Lockin | None = None
        self.lockin = self._lockin = Lockin(
            self.detector_signal,
            self._moving_between,
            self.clock,
            noise_rng,
            config.spectrometer.lockin.time_constant_s,
        )

    @classmethod
    def from_config(cls, config: BenchConfig, clock: BenchClock | None = None) -> Self:
        """Return the bench of a configuration, as when power comes on."""
        return cls(config, clock)

    def detector_signal(self, time_s: float) -> DetectorSignal:
        """Return what the selected detector gives the amplifier at a bench time since the last command."""
        path = self.monochromator.state_at(time_s)
        detector = self._detectors[path.output_port]
        light = self._light_at(time_s, path, detector)
        if self.disturbance is None:
            return detector.signal(light)
        light *= self.disturbance.lamp_power(time_s)
        return self.disturbance.seen_by(detector.name, detector.signal(light), time_s)

    @property
    def detector_names(self) -> tuple[str, ...]:
        """Names of the detectors, in the order of the rig file."""
        return tuple(detector.name for detector in self._detectors.values())

    @property
    def selected_detector(self) -> str:
        """The detector that has the light."""
        return self._detectors[self.monochromator.output_port].name

    def disturb_light(self) -> LightDisturbance:
        """Return the disturbance of lamp and detectors, with the past integrated up to now."""
        self._catch_up()
        if self.disturbance is None:
            self.disturbance = LightDisturbance()
        return self.disturbance

    def _light_at(self, time_s: float, path: LightPath, detector: Detector) -> float:
        """Light on a detector at a time, in units of its best 100 % beam."""
        if not path.shutter_open or path.blocked:
            return 0.0
        theta_i, theta_mes = self.theta_i.angle_at(time_s), self.theta_mes.angle_at(time_s)
        rotator = self.polarizer.angle_at(time_s)
        key = (path, theta_i, theta_mes, rotator)
        light = self._known_light.get(key)
        if light is None:
            flying = any(start <= time_s < end for start, end in self._motions())
            light = self._light(detector, path, theta_i, theta_mes, rotator, flying=flying)
            if not flying:
                self._remember(key, light)
        return light * self._lamp.power(time_s)

    def _remember(self, key: tuple[object, ...], light: float) -> None:
        """Keep the last few states that stood still, as a reading asks for the same one several times."""
        if len(self._known_light) >= STATES_KEPT:
            self._known_light.clear()
        self._known_light[key] = light

    def _light(
        self,
        detector: Detector,
        path: LightPath,
        theta_i: float,
        theta_mes: float,
        rotator: float,
        *,
        flying: bool,
    ) -> float:
        """Light on the detector, in units of its best 100 % beam, with a lamp that has not drifted."""
        s_fraction = self.s_fraction(rotator)
        lean = self.config.simulation.beam.polarization
        lamp = (1.0 + lean * (2.0 * s_fraction - 1.0)) / (1.0 + abs(lean))
        grating = self.monochromator.gratings[path.grating]
        band = self.monochromator.filters[path.filter]
        first, second = throughput(path.wavelength_nm, grating, band, path.slit_um)
        total = 0.0
        for part, wavelength in ((first, path.wavelength_nm), (second, 0.5 * path.wavelength_nm)):
            if part > NEGLIGIBLE_LIGHT:
                caught = self._caught(detector, theta_i, theta_mes, s_fraction, wavelength, flying=flying)
                total += part * detector.colour(wavelength) * caught
        return lamp * total

    def _caught(
        self,
        detector: Detector,
        theta_i: float,
        theta_mes: float,
        s_fraction: float,
        wavelength: float,
        *,
        flying: bool,
    ) -> float:
        """Light in the aperture over the light of the beam, as this detector weighs it."""
        if abs(theta_i - self.config.baseline.theta_i_deg) < EDGE_ON_DEG:
            return self.direct_fraction(theta_mes)
        r = self.scattering.r_at_centre if flying else self.scattering.r
        truth = detector.truth
        return (1.0 + truth.mismatch) * r(theta_i, theta_mes, s_fraction, wavelength) + truth.stray

    def s_fraction(self, rotator_deg: float) -> float:
        """Return the S part of the light behind the polarizer (Malus): 1 at `s_deg`, 0 at `p_deg`."""
        table = self.config.polarizer
        turned = 0.5 * math.pi * (rotator_deg - table.s_deg) / (table.p_deg - table.s_deg)
        return math.cos(turned) ** 2

    def direct_fraction(self, theta_mes_deg: float) -> float:
        """Return the part of the unobstructed beam that enters the aperture.

        The aperture's shadow along the beam is cut with the beam's cross-section, once for each direction of
        a divergent beam; 1.0 for a parallel beam smaller than the aperture, with the arm facing the source.
        """
        aperture, beam = self.config.aperture, self.config.simulation.beam
        off = math.radians(theta_mes_deg - 180.0)
        if math.cos(off) <= 0:
            return 0.0
        spread = math.radians(beam.divergence_deg)
        nodes, weights = np.polynomial.legendre.leggauss(7) if spread > 0 else (np.zeros(1), np.full(1, 2.0))
        tilts = [
            (0.5 * float(w), math.tan(0.5 * spread * float(x))) for x, w in zip(nodes, weights, strict=True)
        ]
        along = aperture.distance_mm * math.cos(off)
        side = aperture.distance_mm * math.sin(off)
        half_width = 0.5 * aperture.width_mm * math.cos(off)
        in_plane = sum(w * _overlap(along * t, beam.width_mm, side, half_width) for w, t in tilts)
        out_of_plane = sum(
            w * _overlap(along * t, beam.height_mm, 0.0, 0.5 * aperture.height_mm) for w, t in tilts
        )
        return in_plane * out_of_plane

    def _motions(self) -> list[tuple[float, float]]:
        return [motor.motion_s for motor in (self.theta_i, self.theta_mes, self.polarizer)]

    def _moving_between(self, start_s: float, end_s: float) -> list[tuple[float, float]]:
        motions = [m for m in self._motions() if m[1] > start_s and m[0] < end_s]
        changes = motions + self.monochromator.changes_between(start_s, end_s)
        return (
            changes
            if self.disturbance is None
            else changes + self.disturbance.changes_between(start_s, end_s)
        )

    def _catch_up(self) -> None:
        """Let the amplifier integrate the past before a command rewrites it."""
        if self._lockin is not None:
            self._lockin.advance()
            self.monochromator.forget_before(self.clock.now_s())


def _overlap(middle: float, length: float, other_middle: float, other_half: float) -> float:
    """Part of an interval that lies in another; a point counts as a whole."""
    if length == 0:
        return 1.0 if abs(middle - other_middle) <= other_half else 0.0
    low = max(middle - 0.5 * length, other_middle - other_half)
    high = min(middle + 0.5 * length, other_middle + other_half)
    return max(high - low, 0.0) / length


def axis_hardware(name: str, table: AxisTable, truth: AxisTruth) -> MotorHardware:
    """Return the mechanics of a stage axis; `ConfigError` if it could not stand where power comes on."""
    low, high = table.limits_deg
    margin = truth.limit_margin_deg + table.backlash_deg
    needed = truth.backlash_deg + HOME_OVERSHOOT_DEG
    if margin <= needed:
        raise ConfigError(
            f"simulation.{name}.limit_margin_deg = {truth.limit_margin_deg:g} deg leaves no room for the "
            f"home routine, which needs {needed:g} deg beyond the limits; raise it"
        )
    zone = table.blind_zone_deg - ZONE_MARGIN_DEG
    start = truth.power_on_deg
    if start is None:
        start = low + 0.6 * (high - low)
        if abs(start) < table.blind_zone_deg:
            start = high if high > table.blind_zone_deg else low
    if not low - margin <= start <= high + margin or abs(start) < zone:
        raise ConfigError(
            f"simulation.{name}.power_on_deg = {start:g} deg lies beyond a switch of the axis (limits "
            f"{low:g}...{high:g} deg, blind zone +-{table.blind_zone_deg:g} deg); choose an angle between"
        )
    return MotorHardware(
        name=name,
        steps_per_deg=table.steps_per_deg,
        zero_deg=table.zero_deg,
        limits_deg=(low - margin, high + margin),
        blind_zone_deg=table.blind_zone_deg,
        speed_deg_s=table.speed_deg_s,
        acceleration_deg_s2=table.acceleration_deg_s2,
        backlash_deg=truth.backlash_deg,
        power_on_deg=start,
        obstacle_deg=truth.obstacle_deg,
    )
