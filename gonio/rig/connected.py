"""The devices of a rig, connected: moved, verified, recovered, stopped and closed together."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from gonio.clock import Clock
from gonio.devices import Polarizer, Recoverable, Spectrometer, Stage, StillPolarizer, StillStage
from gonio.errors import DeviceError
from gonio.rig.config import RigConfig
from gonio.rig.limits import check_path
from gonio.rig.loading import Context, find_driver


@dataclass
class Rig:
    """Connected devices; use as a context manager, which stops the motors and closes the shutter on every
    exit.  A rig that is forgotten, or alive when the program ends, does the same then.
    """

    config: RigConfig
    stage: Stage
    polarizer: Polarizer
    spectrometer: Spectrometer
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        self._closer = weakref.finalize(self, _close_all, self.stage, self.polarizer, self.spectrometer)

    def move_to(self, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
        """Move both axes at once and return their verified read-backs in degrees.

        `RefusedError` before a byte is sent if either target is not allowed, and before anything moves if a
        path is not; `MotionError` if a move does not end where it should.
        """
        self.begin_move(theta_i_deg, theta_mes_deg)
        return self.finish_move()

    def begin_move(self, theta_i_deg: float, theta_mes_deg: float) -> None:
        """Begin the motion of both axes; `finish_move` completes it.  Raises as `move_to`."""
        self.config.check_position(theta_i_deg, theta_mes_deg)
        arm = self.config.stage.theta_mes
        if arm.blind_zone_deg > 0 and arm.limits_deg[0] < 0 < arm.limits_deg[1]:
            # The sample must not turn for an arm that then may not: it could have to pass the zone.
            here_deg = self.stage.theta_mes.position_deg()
            check_path("theta_mes", arm, here_deg, theta_mes_deg, rig_name=self.config.name)
        try:
            self.stage.theta_i.start(theta_i_deg)
            self.stage.theta_mes.start(theta_mes_deg)
        except BaseException:
            self.stage.stop()
            raise

    def finish_move(self) -> tuple[float, float]:
        """Wait for both axes and return their verified read-backs in degrees."""
        try:
            return self.stage.theta_i.wait(), self.stage.theta_mes.wait()
        except BaseException:
            self.stage.stop()
            raise

    def verify_still(self, theta_i_deg: float, theta_mes_deg: float, polarizer_deg: float | None) -> None:
        """Make sure that nothing has turned since these read-backs; None leaves the polarizer out.

        A reading belongs to its angles only if they are still true at its end: a hand on a knob, or a drive
        that restarted, is found out here.  Devices that cannot say are believed.

        Raises
        ------
        MotionError
            An axis or the polarizer stands elsewhere than it did.
        """
        if isinstance(self.stage, StillStage):
            self.stage.verify_still(theta_i_deg, theta_mes_deg)
        if polarizer_deg is not None and isinstance(self.polarizer, StillPolarizer):
            self.polarizer.verify_still(polarizer_deg)

    def recover(self) -> list[str]:
        """Bring every device back to a known state after a failure; return what had to be done, for events.

        One attempt, in the order in which nothing can be hurt: shutter, motors, polarizer.  A device whose
        driver cannot recover is left as it is.

        Raises
        ------
        DeviceError
            A device does not answer (yet), is another one, or keeps its fault.
        """
        done = []
        for name, device in (
            ("spectrometer", self.spectrometer),
            ("stage", self.stage),
            ("polarizer", self.polarizer),
        ):
            if isinstance(device, Recoverable) and (what := device.recover()):
                done.append(f"{name}: {what}")
        return done

    def stop(self) -> None:
        """Stop all motion; callable from any thread, at any time, any number of times."""
        self.stage.stop()
        self.polarizer.stop()
        self.spectrometer.stop()

    def close(self) -> None:
        """Stop the motors, close the shutter and release every line, whatever fails on the way."""
        self._closer()  # at most once

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _close_all(stage: Stage, polarizer: Polarizer, spectrometer: Spectrometer) -> None:
    for action in (
        stage.stop,
        spectrometer.close_shutter,
        stage.close,
        polarizer.close,
        spectrometer.close,
    ):
        try:
            action()
        except DeviceError:
            continue  # a dead line must not keep the others open


def open_rig(config: RigConfig, *, wire_log: Path | None = None) -> Rig:
    """Connect every device of the rig; `ConnectionFailed` names the one that does not answer.

    Addresses that are still ``simulated`` must have been replaced first (`with_addresses`).
    """
    context = Context(
        rig_name=config.name,
        clock=Clock(config.clock_speed()),
        wire_log=wire_log,
        reply_timeout_s=config.wire.reply_timeout_s,
    )
    opened: list[Any] = []
    try:
        for role, table in (
            ("stage", config.stage),
            ("polarizer", config.polarizer),
            ("spectrometer", config.spectrometer),
        ):
            driver = find_driver(role, table.driver, source=f"rig '{config.name}'")  # type: ignore[arg-type]
            opened.append(driver.open(table, context))
    except BaseException:
        for device in reversed(opened):
            device.close()
        raise
    stage, polarizer, spectrometer = opened
    return Rig(config, stage, polarizer, spectrometer, clock=context.clock)
