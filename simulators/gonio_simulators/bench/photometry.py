"""From lamp to volts: the colour of lamp, grating, filter and detector, the lamp's drift, and the noise.

The curves are smooth stand-ins with the right trends, not those of a certain device:

- lamp: a tungsten-halogen lamp with a deuterium lamp's help, a bell over log(wavelength) about 900 nm;
- detectors: a bell over log(wavelength) by type, with the long-wave edge of the semiconductors;
- a detector's `full_beam_v` is what the 100 % beam gives at the best wavelength of its range, with grating
  and filter as
  they are meant to be, S or P whichever the lamp favours, and the slits at their nominal width;
- a grating beyond its range loses light as a bell of 15 % of the border's wavelength;
- filters are long-pass: they cut on 5 % below the start of their range, over a hundredth of the cut-on;
- with the grating set to a wavelength, a tenth as much light of half that wavelength comes along in second
  order unless
  the filter stops it.
"""

from __future__ import annotations

import math

import numpy as np

from gonio_simulators.bench.config import DetectorTable, DetectorTruth, NoiseTable
from gonio_simulators.bench.lockin import DetectorSignal
from gonio_simulators.bench.monochromator import NOMINAL_SLIT_UM

LAMP_NM, LAMP_WIDTH = 900.0, 0.9  # centre, and width in log(wavelength)

RESPONSES: dict[str, tuple[float, float, float]] = {  # centre nm, width in log(wavelength), long-wave edge nm
    "pmt": (420.0, 0.45, math.inf),
    "si": (850.0, 0.40, 1100.0),
    "ingaas": (1250.0, 0.30, 1680.0),
    "pbs": (2000.0, 0.60, 3000.0),
}
EDGE_NM = 20.0

GRATING_FALL = 0.15
FILTER_CUT_ON = 0.95
FILTER_SLOPE = 0.005
SECOND_ORDER = 0.1

DRIFT_PERIODS_H = (1.9, 3.7, 7.1)


def _bell(wavelength_nm: float, centre_nm: float, width: float) -> float:
    return math.exp(-0.5 * (math.log(wavelength_nm / centre_nm) / width) ** 2)


def grating_efficiency(wavelength_nm: float, range_nm: tuple[float, float]) -> float:
    """Return the efficiency relative to that within the grating's range."""
    low, high = range_nm
    if wavelength_nm < low:
        return math.exp(-(((low - wavelength_nm) / (GRATING_FALL * low)) ** 2))
    if wavelength_nm > high:
        return math.exp(-(((wavelength_nm - high) / (GRATING_FALL * high)) ** 2))
    return 1.0


def filter_transmittance(wavelength_nm: float, range_nm: tuple[float, float]) -> float:
    """Return the transmittance of the long-pass filter that is meant for a range."""
    cut_on = FILTER_CUT_ON * range_nm[0]
    x = (wavelength_nm - cut_on) / (FILTER_SLOPE * cut_on)
    return 1.0 / (1.0 + math.exp(-x)) if x > -700.0 else 0.0


class Detector:
    """One detector and the lamp as it sees it."""

    def __init__(self, table: DetectorTable, truth: DetectorTruth, noise: NoiseTable) -> None:
        self.name = table.name
        self.truth = truth
        self._noise = noise
        low, high = table.range_nm
        key = table.type.lower()
        self._response = RESPONSES.get(key, (math.sqrt(low * high), 0.6, math.inf))
        self._best = 1.0
        self._best = max(self.colour(w) for w in np.linspace(low, high, 501).tolist())

    def colour(self, wavelength_nm: float) -> float:
        """Return lamp times detector, 1 at the best wavelength of the detector's range."""
        centre, width, edge = self._response
        value = _bell(wavelength_nm, LAMP_NM, LAMP_WIDTH) * _bell(wavelength_nm, centre, width)
        if math.isfinite(edge):
            value /= 1.0 + math.exp(min((wavelength_nm - edge) / EDGE_NM, 700.0))
        return value / self._best

    def signal(self, light: float) -> DetectorSignal:
        """Return the detector's output for light in units of the best 100 % beam.

        Flicker is a fraction of the light, shot noise goes with its square root, the floor is always there.
        """
        full, noise = self.truth.full_beam_v, self._noise
        floor = full * noise.floor
        flicker = full * noise.flicker * light
        shot = full * noise.shot_at_full * math.sqrt(abs(light))
        return DetectorSignal(
            self.truth.dark_v + full * light, math.hypot(flicker, shot, floor), math.hypot(shot, floor)
        )


class Lamp:
    """The lamp's slow and smooth drift: three sines whose slope has the stated root mean square.

    ``1 + sum_k a_k (sin(2 pi t/T_k + phi_k) - sin(phi_k))`` with seeded phases, 1 when the bench's clock
    starts.
    """

    def __init__(self, drift_per_hour: float, rng: np.random.Generator) -> None:
        phases = rng.uniform(0.0, 2.0 * math.pi, len(DRIFT_PERIODS_H)).tolist()
        each = drift_per_hour * math.sqrt(2.0 / len(DRIFT_PERIODS_H))
        self._terms = [
            (each * period / (2.0 * math.pi), 2.0 * math.pi / (3600.0 * period), phase)
            for period, phase in zip(DRIFT_PERIODS_H, phases, strict=True)
        ]
        self._start = 1.0 - sum(a * math.sin(p) for a, _, p in self._terms)

    def power(self, time_s: float) -> float:
        """Return the lamp's power relative to that at bench time 0."""
        power = self._start
        for amplitude, rate, phase in self._terms:
            power += amplitude * math.sin(rate * time_s + phase)
        return power


def throughput(
    wavelength_nm: float,
    grating_nm: tuple[float, float],
    filter_nm: tuple[float, float],
    slit_um: float,
) -> tuple[float, float]:
    """Return how much of the set wavelength and of its half (second order) leaves the monochromator.

    The signal goes with the square of the slit width, as entrance and exit slit turn together.
    """
    slit = (slit_um / NOMINAL_SLIT_UM) ** 2
    first = grating_efficiency(wavelength_nm, grating_nm)
    second = SECOND_ORDER * first
    return (
        slit * first * filter_transmittance(wavelength_nm, filter_nm),
        slit * second * filter_transmittance(0.5 * wavelength_nm, filter_nm),
    )
