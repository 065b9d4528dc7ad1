"""The drivers against recorded and documented bytes: whole scans, and what manuals and users show.

The scans were recorded from our own bench (`record_logs.py`); the other logs were written by hand from the
bytes of vendors' manuals and of users' reports, which no simulator of ours has made.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gonio.clock import Clock
from gonio.errors import DeviceError
from gonio.rig import Context, load_rig, open_rig, with_addresses
from gonio.wirelog import read_log
from gonio_drivers.cs260 import CS260, BandConfig, CS260Config
from gonio_drivers.elliptec import ElliptecConfig, ElliptecRotator
from gonio_drivers.modbus import ModbusLine
from gonio_drivers.sr830 import SR830, SR830Config
from gonio_drivers.zaber_protocol import ZaberLine

from .conftest import STAGES, rig_text
from .record_logs import CLOCK_SPEED, SCANS, measure, recorded
from .replaying import LOGS, replay, replayed_line

# -- recorded scans -----------------------------------------------------------------------------------------


AGAIN = (
    "if the drivers ask other things, or in another order, on purpose, record the logs again: "
    "python -m tests.drivers.record_logs"
)


@pytest.mark.parametrize("hurry", [5.0, 1.0], ids=["polled as recorded", "polled five times as often"])
@pytest.mark.parametrize("name", list(SCANS))
def test_a_recorded_scan_gives_the_same_readings(name: str, hurry: float, tmp_path: Path):
    log = LOGS / f"scan-{name}.log"
    kind, _ = SCANS[name]
    rig_file = tmp_path / "rig.toml"
    # The bench's clock is five times as fast as it was; the replies come as much sooner, or as late as then.
    rig_file.write_text(rig_text(stage=STAGES[kind], clock_speed=5.0 * CLOCK_SPEED), encoding="utf-8")
    with replay(log, "--speed", str(hurry)) as device:
        try:
            with open_rig(with_addresses(load_rig(rig_file), device.addresses)) as rig:
                result = measure(rig)
        except DeviceError as error:
            _, report = device.end()
            pytest.fail(f"{error}\n{report}\n{AGAIN}")
        code, report = device.end()
    assert (code, "commands of the log not given" in report) == (0, False), f"{report}\n{AGAIN}"
    assert result == recorded(log), AGAIN


@pytest.mark.parametrize("name", list(SCANS))
def test_recorded_scans_are_small_and_name_no_machine(name: str):
    log = LOGS / f"scan-{name}.log"
    assert log.stat().st_size < 150_000
    session = read_log(log).sessions[-1]
    assert {role: line.protocol for role, line in session.lines.items()} == {
        "stage": SCANS[name][0],
        "polarizer": "elliptec",
        "monochromator": "cs260",
        "lockin": "sr830",
    }
    for line in session.lines.values():
        assert re.fullmatch(r"socket://127\.0\.0\.1:\d+", line.opening.address)


# -- documented bytes ---------------------------------------------------------------------------------------


@pytest.fixture
def context() -> Context:
    return Context("test", Clock(speed=1e6))


@pytest.mark.parametrize("checksums", [True, False])
def test_zaber_exchanges_of_the_manual(checksums: bool):
    with replayed_line("zaber-manual.log") as line:
        chain = ZaberLine(line, checksums=checksums)
        assert chain.query(1, 1, "get pos").flag == "WR"
        home = chain.command(1, 1, "home")
        assert (home.busy, home.flag) == (True, "WR")
        assert chain.query(1, 1, "").busy
        idle = chain.query(1, 1, "")
        assert (idle.busy, idle.flag) == (False, "--")
        assert chain.command(1, 1, "move abs 20000").busy
        assert chain.query(1, 1, "").busy
        assert chain.command(1, 1, "stop").flag == "NI"
        assert chain.query(1, 1, "warnings").data == "01 NI"
        chain.command(1, 1, "warnings clear")
        assert chain.query(1, 1, "warnings").data == "00"
        with pytest.raises(DeviceError, match=r"refused the value.*move abs -5.*BADDATA"):
            chain.command(1, 1, "move abs -5")
        with pytest.raises(DeviceError, match=r"does not know this command.*foo"):
            chain.command(1, 0, "foo")
        assert chain.command(1, 0, "help").data == "0"
        assert line.statistics.timeouts == line.statistics.damaged == 0


@pytest.mark.parametrize("checksums", [True, False])
def test_zaber_checksum_of_the_manual(checksums: bool):
    with replayed_line("zaber-checksums.log") as line:
        assert ZaberLine(line, checksums=checksums).query(1, 1, "get pos").data == "30000"


def test_zaber_a_stage_that_stalled():
    with replayed_line("zaber-stalled.log") as line:
        chain = ZaberLine(line)
        reply = chain.query(1, 0, "get pos")
        assert (reply.busy, reply.flag, reply.data) == (False, "FS", "500")
        assert chain.query(1, 0, "warnings").data == "02 FS WR"


def test_applied_motion_frames_of_the_manual():
    with replayed_line("applied-motion-manual.log") as line:
        drive = ModbusLine(line, "rtu", "big")
        assert drive.read(1, 0x01, 1) == [0x4001]
        drive.write(1, 0x1B, [600, 600, 240, *drive.from_s32(200_000)])
        drive.write_one(1, 0x7C, 0x67)
        drive.write_one(1, 0x7C, 0xE1)
        with pytest.raises(DeviceError, match="does not have this register"):
            drive.read(1, 0x40, 1)
        assert line.statistics.timeouts == line.statistics.damaged == 0


def test_modbus_a_late_reply_is_not_the_next_answer():
    """However fast the replay, what was late when it was recorded is late."""
    with replayed_line("modbus-late.log", speed=1000.0, reply_timeout_s=0.2) as line:
        drive = ModbusLine(line, "rtu", "big")
        assert drive.read(1, 0x01, 1) == [0x4001]
        assert (line.statistics.timeouts, line.statistics.stale_bytes) == (1, 7)


def test_elliptec_of_a_real_bus(context: Context):
    config = ElliptecConfig(driver="elliptec", device="2", s_deg=0.0, p_deg=90.0)
    with replayed_line("elliptec-bench.log") as line:
        rotator = ElliptecRotator(config, context, line)
        assert rotator.identify() == "Thorlabs ELL14, serial 11400517, firmware 1.7"
        assert rotator.select("s") == pytest.approx(-0.0025, abs=1e-4)
        assert rotator.select("p") == pytest.approx(90.0025, abs=1e-4)
        assert line.statistics.timeouts == line.statistics.damaged == 0


def test_cornerstone_on_rs232(context: Context):
    config = CS260Config(
        driver="cs260",
        gratings=(BandConfig(number=1, range_nm=(200.0, 1600.0)),),
        filters=(BandConfig(number=1, range_nm=(200.0, 1600.0)),),
    )
    with replayed_line("cornerstone-rs232.log") as line:
        monochromator = CS260(config, context, line)
        assert "CORNERSTONE 260" in monochromator.identify()
        assert monochromator.go_to(500.0) == 500.010
        assert not monochromator.select_bands(500.0)  # they stand already
        assert not monochromator.set_shutter(False)
        assert line.statistics.timeouts == line.statistics.damaged == 0


def test_sr830_on_rs232(context: Context):
    with replayed_line("sr830-rs232.log") as line:
        lockin = SR830(SR830Config(driver="sr830", time_constant_s=0.1), context, line)
        assert lockin.identify().startswith("Stanford_Research_Systems,SR830,s/n46117,ver1.07")
        assert lockin.range_index == 26
        reading = lockin.read()
        assert (reading.x_v, reading.y_v, reading.overload) == (0.951359, -1.49012e-08, False)
        lockin.set_range(24)
        assert [lockin.read().overload for _ in range(2)] == [True, False]
        assert line.statistics.timeouts == line.statistics.damaged == 0
