"""The goniometer: two axes on one line that are homed, stopped and closed together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from gonio_drivers.axis import MotorAxis


class SharedLine(Protocol):
    """The line that both drives share."""

    def renew(self) -> bool:
        """Open it anew if it was lost or is in doubt; say whether it was."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class MotorStage:
    """The goniometer's two axes; satisfies `gonio.devices.Stage`."""

    def __init__(
        self, theta_i: MotorAxis, theta_mes: MotorAxis, *, line: SharedLine, descriptions: Mapping[str, str]
    ) -> None:
        self.theta_i = theta_i
        self.theta_mes = theta_mes
        self._line = line
        self._descriptions = descriptions
        for axis in (theta_i, theta_mes):
            axis.join((theta_i, theta_mes))

    def home_where_needed(self) -> None:
        """Home the axes that have no reference, both at once."""
        self._home([axis for axis in (self.theta_i, self.theta_mes) if axis.needs_home()])

    def verify_still(self, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
        """Return both read-backs if both axes stand where they stood; raises as `MotorAxis.verify_still`."""
        return self.theta_i.verify_still(theta_i_deg), self.theta_mes.verify_still(theta_mes_deg)

    def recover(self) -> str:
        """Come back to a known state after a failure, whatever it was; say what had to be done for it.

        The line is opened anew if it was lost, both axes are stopped, both drives are set up again as on
        connecting, and an axis whose count cannot be trusted is homed.

        Raises
        ------
        ConnectionFailed
            The line cannot be opened (yet).
        DeviceError
            A drive does not answer, is another one, or keeps its fault.
        """
        done = ["connection opened anew"] if self._line.renew() else []
        reasons = {axis.name: axis.recover() for axis in (self.theta_i, self.theta_mes)}
        lost = [axis for axis in (self.theta_i, self.theta_mes) if reasons[axis.name] is not None]
        self._home(lost)
        done += [f"{axis.name} homed since {reasons[axis.name]}" for axis in lost]
        return ", ".join(done)

    def _home(self, axes: Sequence[MotorAxis]) -> None:
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
