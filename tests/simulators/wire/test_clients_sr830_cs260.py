"""Other people's clients at the lock-in and the monochromator: PyMeasure, oriel-cornerstone-260, SweepMe."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest

from tests.simulators.wire.conftest import Simulator, running

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")


@pytest.fixture(scope="module")
def sim() -> Iterator[Simulator]:
    options = ["--clock-speed", "100"] + (["--pty"] if sys.platform != "win32" else [])
    with running(*options) as simulator:
        yield simulator


@pytest.mark.parametrize("line", ["socket", pytest.param("serial", marks=needs_pty)])
def test_pymeasure(sim: Simulator, line: str) -> None:
    from pymeasure.adapters import VISAAdapter
    from pymeasure.instruments.srs import SR830
    from pymeasure.instruments.srs.sr830 import ERRStatus, LIAStatus

    resource = (
        f"TCPIP::127.0.0.1::{sim.port('lockin')}::SOCKET"
        if line == "socket"
        else f"ASRL{sim.address('lockin', pty=True)}::INSTR"
    )
    adapter = VISAAdapter(
        resource, visa_library="@py", read_termination="\r", write_termination="\r", timeout=500
    )
    try:
        lockin = SR830(adapter)
        lockin.write("OUTX 0")
        lockin.reset()
        lockin.clear()
        assert lockin.id.startswith("Stanford_Research_Systems,SR830,")
        assert (lockin.sensitivity, lockin.time_constant, lockin.filter_slope) == (1, 0.1, 12)
        assert (lockin.reference_source, lockin.frequency, lockin.sine_voltage) == ("Internal", 1000.0, 1.0)
        assert (lockin.reserve, lockin.channel1, lockin.channel2) == ("Low Noise", [0.0, 0.0], [0.0, 0.0])
        lockin.sensitivity, lockin.filter_slope, lockin.phase, lockin.filter_synchronous = (
            0.01,
            24,
            10.0,
            True,
        )
        assert (lockin.sensitivity, lockin.filter_slope, lockin.phase) == (0.01, 24, 10.0)
        assert lockin.filter_synchronous is True
        x_v, y_v, r_v, theta_deg, aux_v, reference_hz = lockin.snap(
            "X", "Y", "R", "Theta", "Aux In 1", "Frequency"
        )
        assert r_v == pytest.approx(np.hypot(x_v, y_v), rel=1e-4)
        assert theta_deg == pytest.approx(np.degrees(np.arctan2(y_v, x_v)), abs=0.01)
        assert (aux_v, reference_hz, lockin.adc1) == (0.0, 1000.0, 0.0)
        lockin.write("OEXP 1,10.00,1")  # its own set_scaling sends 10 for the index 1, which is refused
        assert lockin.get_scaling("X") == (10.0, 10)
        lockin.auto_offset("Y")
        assert lockin.get_scaling("Y")[0] == pytest.approx(100.0 * y_v / 0.01, abs=1.0)
        lockin.save_setup(3)
        lockin.reset()
        lockin.load_setup(3)
        assert lockin.get_scaling("X") == (10.0, 10)
        lockin.write("OEXP 1,0,0;OEXP 2,0,0")
        lockin.quick_range()
        assert not lockin.is_out_of_range()
        assert lockin.lia_status == LIAStatus.NO_ERROR
        assert lockin.err_status == ERRStatus.NO_ERROR
        assert lockin.status == "3"
        lockin.sample_frequency = 32  # bench seconds are 100 times as fast
        lockin.reset_buffer()
        lockin.start_scan()
        lockin.wait_for_buffer(40)
        count = lockin.buffer_count
        assert count >= 40
        points = lockin.get_buffer(1)
        assert len(points) == count
        assert np.all(np.abs(points) < 1.09 * lockin.sensitivity)
        mean_v, sd_v, _, _ = lockin.buffer_measure(40)
        assert abs(mean_v) < 1.09 * lockin.sensitivity
        assert sd_v < abs(mean_v) + lockin.sensitivity
    finally:
        adapter.close()


@needs_pty
def test_oriel_cornerstone_260(sim: Simulator) -> None:
    from oriel_cornerstone_260 import Monochromator

    mono = Monochromator(sim.address("monochromator", pty=True))
    try:
        assert "CORNERSTONE" in mono.info.upper()
        assert mono.goto(623.5) == 623.5
        assert mono.grating["lines"] == 1200
        mono.set_grating(2)
        mono.set_filter(3)
        mono.set_outport(2)
        mono.shutter(close=False)
        assert (mono.grating["number"], mono.filter, mono.outport, mono.shuttered) == (2, 3, 2, False)
        mono.step(5)
        assert mono.position == pytest.approx(624.5)
        assert mono.slit_width(1, 300) == 300
        mono.abort()
        assert mono.query("stb").response == "00"
        mono.command("grat", 9)
        assert mono.query("stb").response == "20"
        assert mono.query("error").response == "2"
    finally:
        mono.disconnect()


def test_what_sweepme_s_driver_sends(sim: Simulator) -> None:
    """Its device class for the Cornerstone reads one line for the echo, then one for the response."""
    with sim.client("monochromator") as client:

        def write(statement: bytes) -> None:
            assert client.ask(statement + b"\r\n") == statement + b"\r\n"

        def query(statement: bytes) -> bytes:
            client.socket.sendall(statement + b"\r\n")
            echo, response, _ = client.read_until(b"\r\n", 2).split(b"\r\n")
            assert echo == statement
            return response

        assert query(b"STB?") == b"00"
        write(b"UNITS NM")
        for name, state in ((b"OUTPORT", b"1"), (b"SHUTTER", b"O"), (b"FILTER", b"2"), (b"GRAT", b"1")):
            write(name + b" " + state)
            assert query(name + b"?").split(b",")[0] == state
        write(b"SLIT1MICRONS 1500")
        assert int(query(b"SLIT1MICRONS?")) == 1500
        write(b"GOWAVE 532.125")
        assert float(query(b"WAVE?")) == 532.125
        write(b"SHUTTER C")
        write(b"ABORT")
