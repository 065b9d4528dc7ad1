"""Errors that a user can act on.

Every message says what was asked, the value with its unit, the limit, and what to do.  The command line
prints the message of a `GonioError` and exits with code 1; any other exception is a defect of the program.
"""

from __future__ import annotations


class GonioError(Exception):
    """Base of all errors that carry a message for the user."""


class ConfigError(GonioError):
    """A file the user wrote (`plan.toml`, `rig.toml`, `scene.toml`) or an option cannot be used."""


class RefusedError(GonioError):
    """A position or wavelength that the rig must not or cannot go to; nothing was sent to the hardware."""


class DeviceError(GonioError):
    """A device failed; `device`, `fault` and `remedy` are also available separately."""

    def __init__(self, device: str, fault: str, remedy: str) -> None:
        super().__init__(f"{device}: {fault}; {remedy}")
        self.device = device
        self.fault = fault
        self.remedy = remedy


class ConnectionFailed(DeviceError):
    """The address could not be opened, or nobody answers there."""


class ReplyError(DeviceError):
    """A reply was late, missing, damaged, or not an answer to what was asked."""


class MotionError(DeviceError):
    """A move ended by a fault, or somewhere else than at its target."""


class ScanStopped(GonioError):
    """The scan was stopped on request; everything measured so far is on disk."""


class StoreError(GonioError):
    """A data file cannot be created, read or trusted."""


class FitError(GonioError):
    """The data do not determine what the fit was asked for."""


class SceneError(ConfigError):
    """A facade scene cannot be simulated as described."""
