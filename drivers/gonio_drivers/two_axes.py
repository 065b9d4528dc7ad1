"""How does a line with two drives become a stage: what the opening of every motor stage has in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from gonio.rig import Context
from gonio_drivers.axis import MotorAxis
from gonio_drivers.drive import Drive
from gonio_drivers.lines import Line, connecting
from gonio_drivers.stage import MotorStage, SharedLine


class DescribedDrive(Drive, Protocol):
    """A drive that can say what it is."""

    def describe(self) -> str:
        """Return model and serial number, or what else is known of it."""
        ...


def open_two_axes(
    config: Any,
    context: Context,
    line: Line,
    make: Callable[[str, Any], DescribedDrive],
    *,
    shared: SharedLine | None = None,
) -> MotorStage:
    """Make both drives and their axes, and home those that have no reference.

    Parameters
    ----------
    config
        The table of the stage, whose ``theta_i`` and ``theta_mes`` are `gonio_drivers.drive.MotorConfig`.
    line
        Where the drives are; closed if anything goes wrong.
    make
        Called with the name and the table of each axis.
    shared
        What the stage renews and closes, if it is not the line itself but a protocol around it.

    Raises
    ------
    ConnectionFailed
        A drive gives no sensible reply.
    DeviceError
        A drive refuses something, or does not find its reference.
    """
    tables = {"theta_i": config.theta_i, "theta_mes": config.theta_mes}
    with connecting(line):
        drives = {name: make(name, table) for name, table in tables.items()}
        axes = {name: MotorAxis(name, tables[name], drive, context) for name, drive in drives.items()}
        stage = MotorStage(
            axes["theta_i"],
            axes["theta_mes"],
            line=shared or line,
            descriptions={name: drive.describe() for name, drive in drives.items()},
        )
        stage.home_where_needed()
    return stage
