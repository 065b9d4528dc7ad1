"""The drivers against the simulated bench: real sockets, real bytes, in a process of its own."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from gonio.devices import Quality
from gonio.errors import ConnectionFailed, MotionError, RefusedError, ScanStopped
from gonio_drivers.lines import Line

from .conftest import STAGES, rig_text, running_bench


@pytest.fixture
def rig(bench):
    with bench.open() as rig:
        yield rig


def replies(rig) -> int:
    line = rig.stage._line
    return (line if isinstance(line, Line) else line.line).statistics.replies


def test_identities(any_stage_bench):
    with any_stage_bench.open() as rig:
        assert rig.stage.identify().startswith("theta_i: ")
        assert "; theta_mes: " in rig.stage.identify()
        assert rig.polarizer.identify().startswith("Thorlabs ELL14, serial ")
        identities = rig.spectrometer.identify()
        assert "Stanford_Research_Systems,SR830" in identities["lockin"]
        assert "260" in identities["monochromator"]


def test_moves_end_at_their_targets(any_stage_bench):
    with any_stage_bench.open() as rig:
        for theta_i, theta_mes in [
            (20.0, 15.0),
            (20.0, 18.0),
            (55.0, 141.0),
            (0.0, 15.3),
            (90.0, 180.0),
            (95.0, 15.0),
        ]:
            got = rig.move_to(theta_i, theta_mes)
            assert got == pytest.approx((theta_i, theta_mes), abs=1.0 / 4266)
            assert (rig.stage.theta_i.position_deg(), rig.stage.theta_mes.position_deg()) == got


def test_refused_positions_send_nothing(any_stage_bench):
    with any_stage_bench.open() as rig:
        before = replies(rig)
        for theta_i, theta_mes, words in [
            (20.0, 14.9, "blind zone"),
            (20.0, -20.0, "outside the limits"),
            (20.0, 0.0, "blind zone"),
            (-1.0, 20.0, "outside the limits"),
            (20.0, 181.0, "outside the limits"),
        ]:
            with pytest.raises(RefusedError, match=words):
                rig.move_to(theta_i, theta_mes)
        assert replies(rig) == before


def test_the_limit_switch_at_the_blind_zone_ends_a_move_with_an_error(any_stage_bench):
    """A rig file that knows no blind zone: the switch stops the arm, and nobody calls that an arrival."""
    config = any_stage_bench.config
    careless = config.stage.theta_mes.model_copy(update={"blind_zone_deg": 0.0, "limits_deg": (5.0, 180.0)})
    config = config.model_copy(update={"stage": config.stage.model_copy(update={"theta_mes": careless})})
    with any_stage_bench.open(config) as rig:
        rig.move_to(20.0, 30.0)
        with pytest.raises(
            MotionError, match=r"theta_mes .*limit switch.* on its way to 6 deg; check limits_deg"
        ):
            rig.move_to(20.0, 6.0)
        assert rig.stage.theta_mes.position_deg() == pytest.approx(14.7, abs=0.1)
        with pytest.raises(MotionError, match=r"may have lost count .*limit switch.*home it"):
            rig.move_to(20.0, 30.0)
        assert "theta_mes homed since" in rig.stage.recover()
        assert rig.move_to(20.0, 30.0)[1] == pytest.approx(30.0, abs=0.01)


def test_stop_from_another_thread_in_the_middle_of_a_move(tmp_path, any_stage_bench):
    """On a clock slow enough to be interrupted: 90 deg take 4.7 s of the bench, 0.24 s of ours."""
    with (
        running_bench(
            tmp_path, any_stage_bench.text.replace("clock_speed = 2000.0", "clock_speed = 20.0")
        ) as bench,
        bench.open() as rig,
    ):
        rig.move_to(0.0, 180.0)
        outcome: list[BaseException] = []
        axis = rig.stage.theta_i

        def move() -> None:
            try:
                rig.move_to(90.0, 90.0)
            except MotionError as error:
                outcome.append(error)

        thread = threading.Thread(target=move)
        thread.start()
        while axis.position_deg() < 10.0:
            time.sleep(0.001)
        rig.stop()
        rig.stop()
        thread.join(10)
        assert not thread.is_alive()
        assert "was stopped on request" in str(outcome[0])
        assert 10.0 <= axis.position_deg() < 80.0
        assert rig.stage.theta_mes.position_deg() > 95.0
        assert rig.move_to(90.0, 90.0) == pytest.approx((90.0, 90.0), abs=0.01)


def test_a_stall_is_not_an_arrival(tmp_path):
    text = rig_text(extra="\n[simulation.theta_mes]\nobstacle_deg = 60.0\n")
    with running_bench(tmp_path, text) as bench, bench.open() as rig:
        with pytest.raises(
            MotionError, match=r"theta_mes .*stalled.*stands at .* on its way to 40 deg; remove"
        ):
            rig.move_to(20.0, 40.0)
        assert rig.stage.theta_mes.position_deg() > 55.0


def test_polarizer(rig):
    for polarization, angle_deg in (("s", 0.0), ("p", 90.0), ("p", 90.0), ("s", 0.0)):
        assert rig.polarizer.select(polarization) == pytest.approx(angle_deg, abs=0.01)


def test_spectrum_over_the_detector_change(rig):
    wavelengths = np.arange(800.0, 921.0, 20.0)
    detectors = rig.config.detector_for(wavelengths)
    assert detectors.tolist() == [0, 0, 0, 1, 1, 1, 1]
    rig.move_to(90.0, 180.0)
    direct = rig.spectrometer.measure_spectrum(wavelengths, detectors, beam="direct", averages=3)
    dark = rig.spectrometer.measure_spectrum(wavelengths, detectors, beam="dark")
    rig.move_to(20.0, 60.0)
    sample = rig.spectrometer.measure_spectrum(wavelengths, detectors)
    again = rig.spectrometer.measure_spectrum(wavelengths, detectors)
    assert direct.wavelength_nm == pytest.approx(wavelengths, abs=0.1)
    assert (direct.signal_v > 0.1).all()
    assert (np.abs(dark.signal_v) < 2e-3).all()
    assert (direct.signal_sd_v < 0.01 * direct.signal_v).all()
    r = (sample.signal_v - dark.signal_v) / (direct.signal_v - dark.signal_v)
    assert ((r > 1e-3) & (r < 0.1)).all()
    assert sample.quality.any()  # found its range
    assert set(np.unique(sample.quality)) <= {0, Quality.RANGE_CHANGED}
    assert not again.quality.any()  # and remembered it
    assert (np.diff(sample.time_s) >= 0.5).all()  # five time constants


def test_stopping_a_pass(rig):
    wavelengths = np.arange(400.0, 500.0, 1.0)
    with pytest.raises(ScanStopped):
        rig.spectrometer.measure_spectrum(
            wavelengths, rig.config.detector_for(wavelengths), on_reading=lambda i: i == 3 and rig.stop()
        )


def test_closing_the_rig_closes_the_shutter(bench):
    wavelengths = np.array([500.0])
    with bench.open() as rig:
        rig.spectrometer.measure_spectrum(wavelengths, rig.config.detector_for(wavelengths), beam="direct")
    with bench.open() as rig:
        assert rig.spectrometer._monochromator.query("SHUTTER?") == "C"


def test_wire_log_of_a_whole_rig(bench, tmp_path):
    log = tmp_path / "wire.log"
    with bench.open(wire_log=log) as rig:
        rig.move_to(21.0, 61.0)
    records = [line.split(" ", 3) for line in log.read_text().splitlines()]
    assert {role for _, role, _, _ in records} == {"stage", "polarizer", "monochromator", "lockin"}
    assert any(
        "move abs" in text for _, role, direction, text in records if (role, direction) == ("stage", ">")
    )
    times = [float(seconds) for seconds, _, _, _ in records]
    assert times == sorted(times)


def test_a_port_where_nobody_listens_is_one_message(bench):
    config = bench.config
    config = config.model_copy(
        update={"polarizer": config.polarizer.model_copy(update={"address": "socket://127.0.0.1:9"})}
    )
    with pytest.raises(
        ConnectionFailed, match=r"^polarizer at socket://127\.0\.0\.1:9: the connection was refused"
    ):
        bench.open(config)


def test_the_wrong_device_at_an_address_is_one_message(bench):
    config = bench.config
    lockin = config.spectrometer.lockin.model_copy(
        update={"address": config.spectrometer.monochromator.address}
    )
    config = config.model_copy(
        update={"spectrometer": config.spectrometer.model_copy(update={"lockin": lockin})}
    )
    with pytest.raises(ConnectionFailed, match="lockin at"):
        bench.open(config)


def test_modbus_rtu_over_a_pseudo_terminal(tmp_path):
    pytest.importorskip("pty", reason="no pseudo terminals on this system")
    with running_bench(tmp_path, rig_text(stage=STAGES["modbus-rtu"]), "--pty") as bench:
        stage = bench.config.stage.model_copy(update={"address": bench.ptys["stage"]})
        with bench.open(bench.config.model_copy(update={"stage": stage})) as rig:
            assert rig.move_to(20.0, 40.0) == pytest.approx((20.0, 40.0), abs=0.001)


def test_over_pseudo_terminals(tmp_path):
    pytest.importorskip("pty", reason="no pseudo terminals on this system")
    with running_bench(tmp_path, rig_text(), "--pty") as bench:
        assert set(bench.ptys) == {"stage", "polarizer", "monochromator", "lockin"}
        config = bench.config
        spectrometer = config.spectrometer
        config = config.model_copy(
            update={
                "stage": config.stage.model_copy(update={"address": bench.ptys["stage"]}),
                "polarizer": config.polarizer.model_copy(update={"address": bench.ptys["polarizer"]}),
                "spectrometer": spectrometer.model_copy(
                    update={
                        "monochromator": spectrometer.monochromator.model_copy(
                            update={"address": bench.ptys["monochromator"]}
                        ),
                        "lockin": spectrometer.lockin.model_copy(update={"address": bench.ptys["lockin"]}),
                    }
                ),
            }
        )
        with bench.open(config) as rig:
            assert rig.move_to(20.0, 40.0) == pytest.approx((20.0, 40.0), abs=0.001)
            assert rig.polarizer.select("p") == pytest.approx(90.0)
            wavelengths = np.array([850.0, 870.0])
            reading = rig.spectrometer.measure_spectrum(wavelengths, rig.config.detector_for(wavelengths))
            assert np.isfinite(reading.signal_v).all()
