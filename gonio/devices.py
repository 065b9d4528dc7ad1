"""What a device is to the rest of the program: small protocols that drivers implement.

`Stage` turns the sample (theta_i) and the detector arm (theta_mes), `Polarizer` selects S or P,
`Spectrometer` turns a list of wavelengths into detector signals.  `gonio.rig.Rig` composes them.  Drivers
live in other packages and are found by the entry-point group ``gonio.drivers`` (see `gonio.rig`).

Devices also satisfy `bluesky.protocols` structurally (`name`, `parent`, `read`, `describe`, `set`,
`trigger`, `stop`), so bluesky's RunEngine can drive the same rig; bluesky itself is not imported.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Polarization = Literal["s", "p"]
FloatArray = NDArray[np.float64]

Beam = Literal["sample", "direct", "dark"]
"""What the detector looks at: light from the sample, the direct beam (100 % baseline), or nothing (shutter
closed).
"""


class Quality(enum.IntFlag):
    """Per-reading flags; zero is a good reading."""

    GOOD = 0
    OVER_RANGE = 1  # the detector or amplifier stayed saturated: the value is a lower bound
    RETRIED = 2  # the reading is good, after at least one repeated attempt
    REFUSED = 4  # the position or wavelength was refused; the value is NaN
    NOT_MEASURED = 8  # not measured yet; the value is NaN
    RANGE_CHANGED = 16  # the amplifier range was changed for this reading
    SKIPPED = 32  # a device failed here more often than the scan allows; the value is NaN


@dataclass(frozen=True, slots=True)
class SpectrumReading:
    """One pass over the wavelengths at one position; all arrays have shape (n_wavelength,)."""

    wavelength_nm: FloatArray  # read back from the monochromator
    signal_v: FloatArray  # mean raw signal, volts, NaN where `quality` says there is none
    signal_sd_v: FloatArray  # sample standard deviation of a single reading, volts; NaN where averages == 1
    averages: int | NDArray[np.integer]  # readings in each mean: one number for all, or (n_wavelength,)
    time_s: FloatArray  # instrument clock at each reading
    quality: NDArray[np.uint16]  # Quality bits


@runtime_checkable
class Recoverable(Protocol):
    """A stage, polarizer or spectrometer that can come back after a failure; a driver need not."""

    def recover(self) -> str:
        """Open a lost line anew, check that the same device answers, and bring it to a known state.

        Motors stand still and have a reference that can be trusted, the shutter is closed.  Returns what had
        to be done, for the scan's events; empty if nothing.  One attempt, which may raise `DeviceError`:
        the caller repeats it.
        """
        ...


@runtime_checkable
class StillStage(Protocol):
    """A stage that can be asked whether it stands where it stood; a driver need not have this."""

    def verify_still(self, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
        """Return both positions read back; `MotionError` if an axis moved, moves, or lost its reference."""
        ...


@runtime_checkable
class StillPolarizer(Protocol):
    """A polarizer that can be asked whether it stands where it stood; a driver need not have this."""

    def verify_still(self, expected_deg: float) -> float:
        """Return the position read back; `MotionError` if it moved."""
        ...


class Status(Protocol):
    """Progress of an action started by `set` or `trigger` (bluesky's Status)."""

    @property
    def done(self) -> bool:
        """Whether the action has ended."""
        ...

    @property
    def success(self) -> bool:
        """Whether it ended as it should."""
        ...

    def add_callback(self, callback: Callable[[Any], None]) -> None:
        """Call back when the action has ended."""
        ...

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return what it failed with, None if it did not."""
        ...

    def wait(self, timeout: float | None = None) -> None:
        """Block until it has ended; raise what it failed with."""
        ...


class Axis(Protocol):
    """A rotation axis.  Angles are degrees of the user's convention, never steps."""

    @property
    def name(self) -> str:
        """Name of the device in messages and documents."""
        ...

    @property
    def parent(self) -> None:
        """No device contains this one (bluesky)."""
        ...

    def position_deg(self) -> float:
        """Return the position read back from the hardware."""
        ...

    def start(self, target_deg: float) -> None:
        """Begin a move; `RefusedError` before a byte is sent if the target or the path to it is not
        allowed.
        """
        ...

    def wait(self) -> float:
        """Block until the move is verified and return the read-back.

        A move is done when the controller is idle without a fault and the read-back lies within the
        tolerance of the target; anything else is a `MotionError`.
        """
        ...

    def home(self) -> None:
        """Find the reference switch and wait for it."""
        ...

    def stop(self, *, success: bool = False) -> None:
        """Stop now; callable from any thread, at any time, any number of times."""
        ...

    # bluesky
    def set(self, value: float) -> Status:
        """Begin a move in the background (bluesky)."""
        ...

    def read(self) -> Mapping[str, Any]:
        """Return the position read back (bluesky)."""
        ...

    def describe(self) -> Mapping[str, Any]:
        """Describe what `read` returns (bluesky)."""
        ...


class Stage(Protocol):
    """The goniometer's two axes on their line."""

    @property
    def theta_i(self) -> Axis:
        """The axis that turns the sample."""
        ...

    @property
    def theta_mes(self) -> Axis:
        """The axis that turns the detector arm."""
        ...

    def identify(self) -> str:
        """Return what the device says of itself."""
        ...

    def stop(self) -> None:
        """Stop now; callable from any thread, at any time, any number of times."""
        ...

    def close(self) -> None:
        """Release the line; any number of times."""
        ...


class Polarizer(Protocol):
    """Selects the polarization of the incident beam."""

    @property
    def name(self) -> str:
        """Name of the device in messages and documents."""
        ...

    def select(self, polarization: Polarization) -> float:
        """Turn to S or P, verify, and return the read-back rotator angle in degrees."""
        ...

    def identify(self) -> str:
        """Return what the device says of itself."""
        ...

    def stop(self) -> None:
        """Stop now; callable from any thread, at any time, any number of times."""
        ...

    def close(self) -> None:
        """Release the line; any number of times."""
        ...


class Spectrometer(Protocol):
    """Wavelength selection, shutter and detectors."""

    @property
    def name(self) -> str:
        """Name of the device in messages and documents."""
        ...

    def measure_spectrum(
        self,
        wavelength_nm: FloatArray,
        detector_index: NDArray[np.uint8],
        *,
        beam: Beam = "sample",
        averages: int | NDArray[np.integer] = 1,
        on_reading: Callable[[int], None] | None = None,
    ) -> SpectrumReading:
        """Measure at each wavelength with the given detector, in the given order.

        `averages` readings are averaged, one number for all wavelengths or one for each.

        `on_reading(i)` is called after reading i, on the calling thread; an exception it raises ends the
        pass. The shutter is opened for ``sample`` and ``direct`` and closed for ``dark``.
        """
        ...

    def close_shutter(self) -> None:
        """Close the shutter, whatever is believed of it."""
        ...

    def identify(self) -> Mapping[str, str]:
        """Return what each connected part says of itself, by role."""
        ...

    def stop(self) -> None:
        """Stop now; callable from any thread, at any time, any number of times."""
        ...

    def close(self) -> None:
        """Release the line; any number of times."""
        ...
