"""Zaber stages as other firmware, other controllers and other chains answer."""

from __future__ import annotations

import pytest

from gonio.clock import Clock
from gonio.errors import DeviceError
from gonio.rig import Context
from gonio_drivers.zaber import ZaberAxisConfig, ZaberDrive, open_stage
from gonio_drivers.zaber_protocol import ZaberLine, checksum

from .bench import ForeignBench
from .rigs import ZABER_STAGE, foreign_rig
from .wires import served
from .zaber_controller import ZaberController

NOWHERE = dict.fromkeys(("polarizer", "monochromator", "lockin"), "/dev/null")
CONFIG = ZaberAxisConfig(
    device=1, steps_per_deg=1000.0, limits_deg=(0.0, 90.0), speed_deg_s=20.0, acceleration_deg_s2=100.0
)


@pytest.fixture
def controller():
    return ZaberController(ForeignBench())


@pytest.fixture
def connect():
    def make(address: str):
        return open_stage(
            foreign_rig(ZABER_STAGE, {**NOWHERE, "stage": address}).stage, Context("f", Clock())
        )

    return make


# -- exact bytes ------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", [b"\r\n", b"\n", b"\r", b"\n\r"])
def test_any_end_of_line(scripted, end):
    line = scripted(
        (b"/1 1 01 get pos\n", [b"@01 1 01 OK IDLE -- 5" + end[:1], end[1:]]),
        (b"/1 1 02 get pos\n", b"@01 1 02 OK IDLE -- 6" + end),
    )
    zaber = ZaberLine(line, checksums=False)
    assert [zaber.query(1, 1, "get pos").data for _ in range(2)] == ["5", "6"]
    assert line.statistics.retries == 0


def test_replies_without_checksum_to_requests_with_one(scripted):
    request = b"1 1 01 get pos"
    line = scripted((b"/" + request + b":%02X\n" % checksum(request), b"@01 1 01 OK IDLE -- 5\r\n"))
    assert ZaberLine(line).query(1, 1, "get pos").data == "5"


def test_an_adapter_that_hears_itself(scripted):
    request = b"/1 1 01 get pos\n"
    line = scripted((request, request + b"@01 1 01 OK IDLE -- 5\r\n"))
    assert ZaberLine(line, checksums=False).query(1, 1, "get pos").data == "5"


def test_each_device_of_a_chain_has_its_own_habit(scripted):
    body = b"01 1 01 OK IDLE -- 5"
    line = scripted(
        (b"/1 1 01 get pos\n", b"@" + body + b":%02x\r\n" % checksum(body)),
        (b"/2 1 02 get pos\n", b"@02 1 02 OK IDLE -- 6\r\n"),
    )
    zaber = ZaberLine(line, checksums=False)
    assert zaber.query(1, 1, "get pos").data == "5"
    assert zaber.query(2, 1, "get pos").data == "6"


@pytest.mark.parametrize("number", [b"", b"-- "])
def test_without_numbers_a_failed_reply_is_followed_by_an_echo(scripted, number):
    """The echo is what no late position can be taken for."""
    line = scripted(
        (b"/1 1 01 get pos\n", b"@01 1 " + number + b"OK IDLE -- 5\r\n"),
        (b"/1 1 get pos\n", []),
        (
            b"/1 0 tools echo gonio03\n",
            b"@01 1 " + number + b"OK IDLE -- 111\r\n@01 0 " + number + b"OK IDLE -- gonio03\r\n",
        ),
        (b"/1 1 get pos\n", b"@01 1 " + number + b"OK IDLE -- 222\r\n"),
    )
    zaber = ZaberLine(line, checksums=False)
    assert zaber.query(1, 1, "get pos").data == "5"
    assert zaber.query(1, 1, "get pos").data == "222"


def test_firmware_that_takes_the_number_for_a_command_is_asked_without(scripted):
    line = scripted(
        (b"/1 1 01 move abs 5\n", b"@01 1 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 1 move abs 5\n", b"@01 1 OK BUSY -- 0\r\n"),
    )
    assert ZaberLine(line, checksums=False).command(1, 1, "move abs 5").busy


def test_a_reply_without_number_is_nobodys_once_the_device_has_numbered_one(scripted):
    line = scripted(
        (b"/1 1 01 get pos\n", b"@01 1 01 OK IDLE -- 5\r\n"),
        (b"/1 1 02 get pos\n", b"@01 1 OK IDLE -- 7\r\n@01 1 02 OK IDLE -- 6\r\n"),
    )
    zaber = ZaberLine(line, checksums=False)
    assert [zaber.query(1, 1, "get pos").data for _ in range(2)] == ["5", "6"]


@pytest.mark.parametrize(
    ("reason", "remedy"),
    [("DRIVERDISABLED", "driver enable"), ("PARKED", "parking unpark"), ("STATUSBUSY", "stop what else")],
)
def test_a_rejected_search_for_home_says_what_to_do(scripted, reason, remedy):
    line = scripted((b"/1 1 01 home\n", f"@01 1 01 RJ IDLE -- {reason}\r\n".encode()))
    with pytest.raises(DeviceError, match=rf"command 'home', {reason}.*{remedy}"):
        ZaberLine(line, checksums=False).command(1, 1, "home")


def drive(scripted, *exchanges) -> ZaberDrive:
    made = ZaberDrive.__new__(ZaberDrive)
    made._line, made._device, made._axis = ZaberLine(scripted(*exchanges), checksums=False), 1, 1
    made._config, made.device = CONFIG, "theta_i"
    return made


@pytest.mark.parametrize(
    ("flag", "words"),
    [(note, None) for note in ("ND", "NJ", "NR", "NT", "NU", "WS", "WT", "WV")]
    + [("FT", "twisted"), ("FB", "stream"), ("FP", "path"), ("FA", "encoder"), ("FR", "overdrive")]
    + [("WL", "limit switch"), ("WP", "calibration"), ("NC", "manual control")],
)
def test_notes_are_no_faults(scripted, flag, words):
    fault = drive(
        scripted,
        (b"/1 1 01 get pos\n", f"@01 1 01 OK IDLE {flag} 12345.00\r\n".encode()),
        (b"/1 1 02 warnings\n", f"@01 1 02 OK IDLE {flag} 01 {flag}\r\n".encode()),
    ).state()
    assert fault.position_steps == 12345
    assert (fault.fault is None) if words is None else (words in fault.fault)


@pytest.mark.parametrize("listed", ["01 WR", "1 WR", "WR", "00", ""])
def test_forms_of_the_list_of_warnings(scripted, listed):
    """Also one that has gone between the two replies still counts."""
    state = drive(
        scripted,
        (b"/1 1 01 get pos\n", b"@01 1 01 OK IDLE WR 0\r\n"),
        (b"/1 1 02 warnings\n", f"@01 1 02 OK IDLE WR {listed}\r\n".encode()),
    ).state()
    assert not state.referenced
    assert state.fault is None


# -- a controller with two axes, over a socket ------------------------------------------------------------


@pytest.mark.parametrize(
    "options", [{}, {"numbers": False}, {"ends": b"\r"}, {"ends": b"\n", "chatter": False}]
)
def test_both_axes_of_one_controller(connect, options):
    bench = ForeignBench()
    foreign = ZaberController(bench, **options)
    with served(foreign, chunk=5) as address:
        stage = connect(address)
        for axis, target_deg in ((stage.theta_i, 33.0), (stage.theta_mes, 100.0)):
            axis.start(target_deg)
            assert axis.wait() == pytest.approx(target_deg, abs=0.01)
        assert (bench.theta_i_deg(), bench.theta_mes_deg()) == pytest.approx((33.0, 100.0))
        assert "firmware 6.28" in stage.identify()
        stage.close()
    assert foreign.axes[1].settings["maxspeed"] == 655360 - 655360 % 16
    assert foreign.axes[2].settings["motion.decelonly"] == 16384


def test_another_scale_than_the_stages_is_refused(controller, connect):
    controller.axes[2].settings.update({"limit.cycle.dist": 720000, "resolution": 128})
    with (
        served(controller) as address,
        pytest.raises(
            DeviceError,
            match=r"theta_mes .*turns once in 720000 microsteps at a resolution of 128, the rig file says "
            r"360000 .*steps_per_deg = \+-2000",
        ),
    ):
        connect(address)
    assert not any(request.endswith(b"home") for request in controller.requests)


def test_narrower_travel_than_the_rig_files_is_refused(controller, connect):
    controller.axes[2].settings["limit.max"] = 150000
    with (
        served(controller) as address,
        pytest.raises(
            DeviceError, match=r"travels from 30 to 180 deg .*less than limits_deg = \[15, 180\]; narrow"
        ),
    ):
        connect(address)


def test_firmware_without_these_settings_is_taken_as_it_is(controller, connect):
    for axis in controller.axes.values():
        for setting in ("limit.cycle.dist", "limit.min"):
            del axis.settings[setting]
    with served(controller) as address:
        connect(address).close()


def test_a_parked_axis_is_not_homed(controller, connect):
    controller.refused["home"] = "PARKED"
    with served(controller) as address, pytest.raises(DeviceError, match=r"is parked .*tools parking unpark"):
        connect(address)
