"""The settings of an X-RST rotary stage: which exist, which may be written, in which range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

RESOLUTION = 64  # microsteps per full step
STEPS_PER_REVOLUTION = 1_536_000  # 360 deg of an X-RST at the default resolution
MAX_SPEED = RESOLUTION * 16384  # firmware's ceiling of maxspeed
MAX_ACCELERATION = 32767
DEVICE_ID = 50952  # stands for an X-RST; the vendor's table of ids is online only and could not be consulted
PACKET_SIZE = 80  # longest command line, terminator included
COMMAND_PACKETS = 8  # lines of one command; the real number is not known
FIRMWARE = "7.35"
STORED_POSITIONS = 16

LOWEST, HIGHEST = -(2**31), 2**31 - 1


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting of the device (axis 0) or of its axis."""

    read: Callable[[], object]
    write: Callable[[int], None] | None = None
    low: int = 0
    high: int = HIGHEST
    of_device: bool = False


class Stored:
    """A setting that is only stored: on this bench nothing hangs on it."""

    def __init__(self, value: int) -> None:
        self._default = self._value = value

    def read(self) -> int:
        """Return the value."""
        return self._value

    def write(self, value: int) -> None:
        """Set the value."""
        self._value = value

    def restore(self) -> None:
        """Go back to the default."""
        self._value = self._default

    def setting(self, low: int, high: int, *, of_device: bool = False) -> Setting:
        """Return the setting with its range."""
        return Setting(self.read, self.write, low, high, of_device)


def identity_settings(serial: int) -> dict[str, Setting]:
    """Return the device's read-only settings; voltage and temperatures are typical values."""
    device: dict[str, object] = {
        "deviceid": DEVICE_ID,
        "device.id": DEVICE_ID,
        "device.hw.modified": 0,
        "system.serial": serial,
        "version": FIRMWARE,
        "version.build": 16151,
        "system.axiscount": 1,
        "system.access": 1,
        "system.voltage": "48.0",
        "system.temperature": "31.4",
        "comm.packet.size.max": PACKET_SIZE,
        "comm.word.size.max": 50,
        "comm.command.packets.max": COMMAND_PACKETS,
        "comm.protocol": 2,
    }
    settings = {name: Setting(_constant(value), of_device=True) for name, value in device.items()}
    for name, of_axis in (
        ("resolution", RESOLUTION),
        ("limit.cycle.dist", STEPS_PER_REVOLUTION),
        ("limit.home.pos", 0),
        ("driver.temperature", "33.8"),
    ):
        settings[name] = Setting(_constant(of_axis))
    return settings


def stored_settings() -> dict[str, tuple[Stored, Setting]]:
    """Return the settings that a client may set and read back, of the knob, the lights and the like."""
    stored = {}
    for name, default, low, high, of_device in (
        ("knob.enable", 1, 0, 1, False),
        ("knob.mode", 0, 0, 1, False),
        ("knob.dir", 0, 0, 1, False),
        ("knob.speedprofile", 1, 1, 3, False),
        ("knob.distance", 4267, 1, HIGHEST, False),
        ("motion.index.dist", 0, 0, HIGHEST, False),
        ("system.led.enable", 1, 0, 1, True),
    ):
        value = Stored(default)
        stored[name] = (value, value.setting(low, high, of_device=of_device))
    return stored


def _constant(value: object) -> Callable[[], object]:
    return lambda: value
