"""The scanning spectrometer: exchanges per reading, overloads, stops, and what the estimate counts."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from gonio.devices import Quality
from gonio.errors import ConfigError, DeviceError, RefusedError, ReplyError, ScanStopped
from gonio.rig import default_rig_text, parse_rig
from gonio_drivers.cs260 import CS260
from gonio_drivers.scanning import ScanningSpectrometer
from gonio_drivers.sr830 import SR830

from .test_cs260 import INFO, says
from .test_sr830 import AS_BEFORE, CONNECT, GUARDED, READ, without_magnitude

CONFIG = parse_rig(default_rig_text().replace("pipelined = true", "pipelined = false")).spectrometer


def read(x_v: float, overload: int = 0) -> tuple[bytes, bytes]:
    return READ, f"{x_v:g},0\r{overload}\r".encode()


TURNED = b"LIAS?;SNAP? 1,2\r"


def in_turns(lockin):
    """Turn every second reading round, as the driver does to know one reply from the one before."""
    turned = False
    for request, reply in lockin:
        if request == READ and turned:
            outputs, status = reply.split(b"\r")[:2] if reply else (b"", b"")
            yield TURNED, reply and status + b"\r" + outputs + b"\r"
            turned = False
            continue
        turned ^= request in (READ, TURNED)
        yield request, reply


def sens(index: int) -> tuple[bytes, bytes]:
    return f"SENS {index};SENS?\r".encode(), f"{index}\r".encode()


def drive(wavelength_nm: float) -> list[tuple[bytes, bytes]]:
    return [says(f"GOWAVE {wavelength_nm:.3f}"), says("WAVE?", f"{wavelength_nm:.3f}")]


OPEN_AT_500 = [
    says("GRAT?", "1,1200,VIS"),
    says("FILTER?", "2"),
    says("OUTPORT?", "1"),
    says("SHUTTER?", "C"),
    says("SHUTTER O"),
    says("SHUTTER?", "O"),
]


@pytest.fixture
def spectrometer(scripted, context):
    def make(mono, lockin, *, verifies: bool = False):
        monochromator = CS260(CONFIG.monochromator, context, scripted(INFO, *mono, role="monochromator"))
        line = scripted(*CONNECT, *in_turns(lockin), role="lockin")
        amplifier = without_magnitude(SR830(CONFIG.lockin, context, line))
        if not verifies:
            monochromator.verify = amplifier.verify = lambda: None
        return ScanningSpectrometer(CONFIG, context, monochromator, amplifier)

    return make


def measure(device, *wavelength_nm: float, **options):
    wavelengths = np.array(wavelength_nm)
    return device.measure_spectrum(wavelengths, (wavelengths >= 860).astype(np.uint8), **options)


def test_three_exchanges_per_reading_when_nothing_else_changes(spectrometer):
    device = spectrometer(
        [*OPEN_AT_500, *itertools.chain.from_iterable(drive(w) for w in (500, 510, 520))],
        [read(0.5), read(0.6), read(0.7)],
    )
    calls = []
    reading = measure(device, 500, 510, 520, beam="direct", on_reading=calls.append)
    assert calls == [0, 1, 2]
    assert reading.signal_v.tolist() == [0.5, 0.6, 0.7]
    assert reading.wavelength_nm.tolist() == [500, 510, 520]
    assert np.isnan(reading.signal_sd_v).all()
    assert (reading.quality == 0).all()
    assert (np.diff(reading.time_s) > 0).all()


SETTINGS = b"OFLT?;OFSL?;SENS?" + GUARDED


def test_at_the_end_of_a_pass_everything_is_still_as_it_was_set(spectrometer):
    asked = [says("GRAT?", "1"), says("FILTER?", "2"), says("OUTPORT?", "1"), says("SHUTTER?", "O")]
    device = spectrometer(
        [*OPEN_AT_500, *drive(500), *asked], [read(0.5), (SETTINGS, b"8\r0\r26\r" + AS_BEFORE)], verifies=True
    )
    assert measure(device, 500, beam="direct").signal_v.tolist() == [0.5]


def test_a_monochromator_that_forgot_its_settings_spoils_the_pass(spectrometer):
    """Switched off and on in the middle: the shutter is closed, the first grating and filter are in."""
    device = spectrometer(
        [*OPEN_AT_500, *drive(500), says("GRAT?", "1"), says("FILTER?", "1")], [read(0.5)], verifies=True
    )
    with pytest.raises(DeviceError, match=r"monochromator .* answers FILTER\? with 1, although 2 was set"):
        measure(device, 500, beam="direct")


def test_a_lockin_set_at_its_panel_spoils_the_pass(spectrometer):
    asked = [says("GRAT?", "1"), says("FILTER?", "2"), says("OUTPORT?", "1"), says("SHUTTER?", "O")]
    device = spectrometer(
        [*OPEN_AT_500, *drive(500), *asked],
        [read(0.5), (SETTINGS, b"10\r0\r26\r" + AS_BEFORE)],
        verifies=True,
    )
    with pytest.raises(DeviceError, match=r"lockin .* with 10, 0, 26, although 8, 0, 26 was set"):
        measure(device, 500, beam="direct")


def test_a_reply_that_comes_twice_is_not_the_next_reading(spectrometer):
    from .test_sr830 import IDN

    device = spectrometer(
        [*OPEN_AT_500, *drive(500), *drive(510)],
        [read(0.5), (TURNED, b"0.5,0\r0\r0\r0.6,0\r"), IDN, read(0.6)],
    )
    reading = measure(device, 500, 510, beam="direct")
    assert reading.signal_v.tolist() == [0.5, 0.6]
    assert reading.quality.tolist() == [0, Quality.RETRIED]


def test_the_detector_change_sets_the_port_and_only_that(spectrometer):
    device = spectrometer(
        [
            says("GRAT?", "2,600,NIR"),
            says("FILTER?", "3"),
            says("OUTPORT?", "1"),
            says("SHUTTER?", "O"),
            *drive(850),
            says("OUTPORT 2"),
            says("OUTPORT?", "2"),
            *drive(860),
        ],
        [read(0.5), read(0.4)],
    )
    assert measure(device, 850, 860, beam="direct").signal_v.tolist() == [0.5, 0.4]


def test_dark_closes_the_shutter(spectrometer):
    mono = [says("GRAT?", "1"), says("FILTER?", "2"), says("OUTPORT?", "1"), says("SHUTTER?", "O")]
    mono += [says("SHUTTER C"), says("SHUTTER?", "C"), *drive(500)]
    device = spectrometer(mono, [read(0.06)])
    assert measure(device, 500, beam="dark").signal_v.tolist() == [0.06]


def test_a_weak_signal_gets_a_finer_range_which_is_remembered(spectrometer):
    """0.01 V in the 1 V range has a resolution of 0.3 %; 2.5 x 0.01 V asks for the 50 mV range."""
    device = spectrometer(
        [*OPEN_AT_500, *drive(500), *drive(510), *drive(500)],
        [read(0.01), sens(22), read(0.0101), read(0.0102), sens(26), read(0.5)],
    )
    reading = measure(device, 500, 510)
    assert reading.signal_v.tolist() == [0.0101, 0.0102]
    assert reading.quality.tolist() == [Quality.RANGE_CHANGED, 0]
    assert measure(device, 500, beam="direct").quality.tolist() == [0]  # the direct beam has its own


def test_overload_takes_a_coarser_range_and_is_flagged(spectrometer):
    device = spectrometer(
        [*OPEN_AT_500, *drive(500), *drive(510)],
        [read(0.01), sens(22), read(0.01), read(0.0545, 4), read(0.0545, 4), sens(24), read(0.08)],
    )
    reading = measure(device, 500, 510)
    assert reading.signal_v.tolist() == [0.01, 0.08]
    assert reading.quality.tolist() == [Quality.RANGE_CHANGED, Quality.RANGE_CHANGED]


def test_an_overload_of_the_past_is_forgiven(spectrometer):
    """The bits are latched: light swept past while the grating turned, the settled signal is fine."""
    device = spectrometer([*OPEN_AT_500, *drive(500)], [read(0.4, 4), read(0.5)])
    reading = measure(device, 500, beam="direct")
    assert reading.signal_v.tolist() == [0.5]
    assert reading.quality.tolist() == [0]


def test_saturation_of_the_largest_range_is_flagged_not_hidden(spectrometer):
    device = spectrometer([*OPEN_AT_500, *drive(500)], [read(1.09, 4)] * 6)
    reading = measure(device, 500, beam="direct")
    assert reading.quality.tolist() == [Quality.OVER_RANGE]
    assert reading.signal_v.tolist() == [1.09]


def test_a_detector_that_was_blinded_for_a_moment_is_read_when_it_is_back(spectrometer):
    device = spectrometer([*OPEN_AT_500, *drive(500)], [*[read(1.09, 4)] * 4, read(0.5)])
    reading = measure(device, 500, beam="direct")
    assert reading.quality.tolist() == [0]
    assert reading.signal_v.tolist() == [0.5]


def test_mean_and_sample_standard_deviation(spectrometer):
    device = spectrometer([*OPEN_AT_500, *drive(500)], [read(x) for x in (0.5, 0.6, 0.7, 0.8)])
    reading = measure(device, 500, beam="direct", averages=4)
    assert reading.averages == 4
    assert reading.signal_v[0] == pytest.approx(0.65)
    assert reading.signal_sd_v[0] == pytest.approx(math.sqrt(0.05 / 3))


def test_an_overload_within_the_average_repeats_all_of_it(spectrometer):
    device = spectrometer(
        [*OPEN_AT_500, *drive(500)],
        [
            *(read(0.01), read(0.01)),
            sens(22),
            *(read(0.01), read(0.0545, 4), read(0.0545, 4)),
            sens(24),
            *(read(0.011), read(0.013)),
        ],
    )
    reading = measure(device, 500, averages=2)
    assert reading.signal_v[0] == pytest.approx(0.012)
    assert reading.quality.tolist() == [Quality.RANGE_CHANGED]


def test_a_repeated_exchange_is_flagged(spectrometer):
    from .test_sr830 import IDN

    device = spectrometer([*OPEN_AT_500, *drive(500)], [(READ, []), IDN, read(0.5)])
    reading = measure(device, 500, beam="direct")
    assert reading.signal_v.tolist() == [0.5]
    assert reading.quality.tolist() == [Quality.RETRIED]


def test_stop_ends_the_pass_at_the_next_reading_and_the_next_pass_runs(spectrometer):
    device = spectrometer([*OPEN_AT_500, *drive(500), *drive(500)], [read(0.5), read(0.5)])
    with pytest.raises(ScanStopped, match="after 1 of 3 readings"):
        measure(device, 500, 510, 520, beam="direct", on_reading=lambda i: device.stop())
    assert measure(device, 500, beam="direct").signal_v.tolist() == [0.5]


def test_what_on_reading_raises_ends_the_pass(spectrometer):
    class Enough(Exception):
        pass

    def enough(i: int) -> None:
        raise Enough

    device = spectrometer([*OPEN_AT_500, *drive(500)], [read(0.5)])
    with pytest.raises(Enough):
        measure(device, 500, 510, beam="direct", on_reading=enough)


@pytest.mark.parametrize(
    ("wavelengths", "detectors", "averages", "words"),
    [
        ([500.0, 1700.0], [0, 1], 1, "covered by no grating"),
        ([500.0], [2], 1, "detector 2 does not exist"),
        ([500.0], [0], 0, "averages = 0"),
    ],
)
def test_refused_passes_send_nothing(spectrometer, wavelengths, detectors, averages, words):
    device = spectrometer([], [])
    with pytest.raises(RefusedError, match=words):
        device.measure_spectrum(np.array(wavelengths), np.array(detectors, np.uint8), averages=averages)


def test_closing_closes_the_shutter_and_both_lines(spectrometer):
    device = spectrometer([says("SHUTTER C"), says("SHUTTER?", "C")], [])
    device.close()
    assert device._monochromator.line.port.closed
    assert device._lockin.line.port.closed


def test_closing_releases_both_lines_though_the_monochromator_is_dead(spectrometer):
    device = spectrometer([(b"SHUTTER C\r\n", []), (b"STB?\r\n", [])], [])
    device.close()
    assert device._monochromator.line.port.closed
    assert device._lockin.line.port.closed


def test_a_dead_monochromator_is_told_by_close_shutter(spectrometer):
    device = spectrometer([(b"SHUTTER C\r\n", []), (b"STB?\r\n", [])], [])
    with pytest.raises(ReplyError, match="monochromator at scripted"):
        device.close_shutter()


# -- the rig file --------------------------------------------------------------------


def test_addresses_by_role():
    assert CONFIG.addresses() == {"monochromator": "simulated", "lockin": "simulated"}


def test_a_detector_beyond_the_gratings_is_a_mistake_in_the_rig_file():
    text = default_rig_text().replace("range_nm = [860.0, 1600.0]", "range_nm = [860.0, 1700.0]")
    with pytest.raises(
        ConfigError, match=r"detector 'ingaas': wavelength = 1700 nm is covered by no grating"
    ):
        parse_rig(text)


def test_the_estimate_by_hand():
    """Settling 0.5 s each, 0.7 s more at first and after each change, 175 nm/s after a start of 0.02 s,
    changes as configured.
    """
    few = np.array([600.0, 610.0])
    drive_s = 2 * 0.02 + 20 / 175
    assert CONFIG.reading_duration_s(few, 1) == pytest.approx(2 * 0.5 + 0.7 + drive_s)
    assert CONFIG.reading_duration_s(few, 3) == pytest.approx(2 * 0.5 + 0.7 + drive_s + 2 * 2 * 0.3)
    assert CONFIG.reading_duration_s(few, np.array([1, 3])) == pytest.approx(1.7 + drive_s + 2 * 0.3)
    over_all = np.array([600.0, 900.0])  # one grating, filter and port there and back
    assert CONFIG.reading_duration_s(over_all, 1) == pytest.approx(
        2 * 0.5 + 2 * 0.7 + 2 * 0.02 + 600 / 175 + 2 * (5.0 + 0.8 + 1.0)
    )
    assert CONFIG.reading_duration_s(np.array([]), 1) == 0.0
