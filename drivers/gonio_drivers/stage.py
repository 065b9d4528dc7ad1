"""The goniometer: two axes on one line that are homed, stopped and closed together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from gonio_drivers.axis import MotorAxis


class Closable(Protocol):
    """The line that both drives share."""

    def close(self) -> None:
        """Release it."""
        ...


class MotorStage:
    """The goniometer's two axes; satisfies `gonio.devices.Stage`."""

    def __init__(
        self, theta_i: MotorAxis, theta_mes: MotorAxis, *, line: Closable, descriptions: Mapping[str, str]
    ) -> None:
        self.theta_i = theta_i
        self.theta_mes = theta_mes
        self._line = line
        self._descriptions = descriptions
        for axis in (theta_i, theta_mes):
            axis.join((theta_i, theta_mes))

    def home_where_needed(self) -> None:
        """Home the axes that have no reference, both at once."""
        axes = [axis for axis in (self.theta_i, self.theta_mes) if axis.needs_home()]
        try:
            for axis in axes:
                axis.start_home()
            for axis in axes:
                axis.wait()
        except BaseException:
            self.stop()
            raise

    def identify(self) -> str:
        """Return what both drives say of themselves."""
        return "; ".join(f"{name}: {text}" for name, text in self._descriptions.items())

    def stop(self) -> None:
        """Stop both axes, the second even if the first cannot be reached; any thread, any time."""
        try:
            self.theta_i.stop()
        finally:
            self.theta_mes.stop()

    def close(self) -> None:
        """Release the line; motors keep standing, powered or not as their drives are configured."""
        self._line.close()
