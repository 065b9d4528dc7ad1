"""What the window shows: plan, rig, connection, progress, measured values, log.  No Qt.

Messages of the bench's thread change it through `apply`; every panel draws from it and nothing else.
"""

from __future__ import annotations

import dataclasses
import datetime
import enum
import math
import re
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from gonio.acquire import Snapshot, State
from gonio.acquire.journal import journal_path
from gonio.errors import RefusedError
from gonio.plan import Plan, Refusal, check, estimate
from gonio.rig import RigConfig
from gonio.store.records import EventRecord, Level, PositionRecord, ReferenceRecord
from gonio_gui.bench_thread import (
    AxesRead,
    Begun,
    Closed,
    Connected,
    Disconnected,
    Message,
    Note,
    ScanEnded,
    Stored,
)
from gonio_gui.live import LiveScan

LOG_LINES = 2000
SHOWN_REFUSALS = 4


class Phase(enum.Enum):
    """What the window can do now."""

    OFFLINE = "not connected"
    CONNECTING = "connecting"
    READY = "ready"
    STARTING = "preparing"
    RUNNING = "measuring"
    PAUSING = "pausing after this position"
    PAUSED = "paused, shutter closed, lamp on"
    STOPPING = "stopping"
    CLOSED = "closed"

    @property
    def busy(self) -> bool:
        """Whether a scan is under way."""
        return self in {Phase.STARTING, Phase.RUNNING, Phase.PAUSING, Phase.PAUSED, Phase.STOPPING}


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line of the log pane."""

    at: datetime.datetime
    level: Level
    source: str
    text: str


@dataclass(frozen=True, slots=True)
class Banner:
    """What the user must not overlook, until the next action."""

    level: Level
    text: str
    reconnect: bool = False  # whether connecting again may help


class Model:
    """The state behind the window.

    Parameters
    ----------
    rig, plan
        What to measure and on which bench.
    path
        The file to write; without one a name is made of the sample's and the time, in the working folder.
    """

    def __init__(self, rig: RigConfig, plan: Plan, path: Path | None = None) -> None:
        self.phase = Phase.OFFLINE
        self.rig = rig
        self.devices: dict[str, str] = {}
        self.snapshot: Snapshot | None = None
        self.theta_i_deg = math.nan
        self.theta_mes_deg = math.nan
        self.banner: Banner | None = None
        self.log: deque[LogLine] = deque(maxlen=LOG_LINES)
        self.lines_logged = 0
        self.set_plan(plan)
        self.path = path or self.suggested_path()

    # -- what is to be measured -------------------------------------------------------------------------

    def set_plan(self, plan: Plan) -> None:
        """Show another plan; what was measured before leaves the window, not the disk."""
        self.plan = plan
        self.refusals: list[Refusal] = check(plan, self.rig)
        self.live: LiveScan | None = None
        self.duration_s = math.nan
        self.snapshot = None
        try:
            self.live = LiveScan(plan, self.rig)
            self.duration_s = estimate(plan, self.rig)
        except RefusedError:
            pass  # a wavelength without a detector: it stands in `refusals`
        self.banner = self._refused()

    def _refused(self) -> Banner | None:
        """Return why the rig cannot measure the plan, None if it can."""
        if not self.refusals:
            return None
        shown = "\n".join(str(refusal) for refusal in self.refusals[:SHOWN_REFUSALS])
        more = len(self.refusals) - SHOWN_REFUSALS
        rest = f"\n… and {more} more" if more > 0 else ""
        return Banner("error", f"The rig cannot measure this plan:\n{shown}{rest}")

    def begin(self, plan: Plan) -> None:
        """Show an empty scan of a plan that the runner has accepted."""
        if plan != self.plan:
            self.set_plan(plan)
        else:
            self.live, self.snapshot = LiveScan(plan, self.rig), None

    def set_rig(self, rig: RigConfig) -> None:
        """Use another bench for the same plan."""
        self.rig = rig
        self.theta_i_deg = self.theta_mes_deg = math.nan
        self.set_plan(self.plan)

    @property
    def resumable(self) -> bool:
        """Whether the chosen file is an interrupted scan."""
        return journal_path(self.path).exists()

    def suggested_path(self) -> Path:
        """Return a file name in the working folder that is not taken."""
        stem = re.sub(r"[^\w]+", "-", self.plan.sample.name.lower()).strip("-") or "scan"
        stamp = datetime.datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
        path, number = Path.cwd() / f"{stem}-{stamp}.h5", 2
        while path.exists() or journal_path(path).exists():
            path, number = path.with_name(f"{stem}-{stamp}-{number}.h5"), number + 1
        return path

    # -- what happens -----------------------------------------------------------------------------------

    def say(self, level: Level, source: str, text: str) -> None:
        """Add a line to the log."""
        self.log.append(LogLine(datetime.datetime.now().astimezone(), level, source, text))
        self.lines_logged += 1

    def apply(self, message: Message) -> None:
        """Take note of what the bench's thread reports."""
        match message:
            case Snapshot():
                self._apply_snapshot(message)
            case PositionRecord():
                if self.live is not None:
                    self.live.add_position(message)
            case ReferenceRecord():
                if self.live is not None:
                    self.live.add_reference(message)
                whose = "" if message.polarization == "any" else f", {message.polarization.upper()}"
                name = "100 % baseline" if message.kind == "baseline" else "dark"
                self.say("info", "reference", f"{name} at the {message.when} measured{whose}")
            case EventRecord():
                self.say(message.level, message.source, message.message)
            case Begun():
                self.begin(message.plan)
                self.say("info", "scan", f"measuring '{message.plan.title}' into {message.path}")
            case Stored():
                if self.live is not None:
                    self.live.replace(message.scan)
            case AxesRead():
                self.theta_i_deg, self.theta_mes_deg = message.theta_i_deg, message.theta_mes_deg
            case Note():
                self.say(message.level, message.source, message.text)
                if message.level == "error":
                    self.banner = Banner("error", message.text, reconnect=True)
            case Connected():
                self._apply_connected(message)
            case Disconnected():
                self._apply_disconnected(message)
            case ScanEnded():
                self._apply_ended(message)
            case Closed():
                self.phase = Phase.CLOSED

    def _apply_snapshot(self, snapshot: Snapshot) -> None:
        before = self.snapshot
        if snapshot.wavelength_nm is None and snapshot.state is State.RUNNING and before is not None:
            # between two steps nothing is being measured: what was stays in view, it does not flicker
            snapshot = dataclasses.replace(
                snapshot,
                position=before.position if snapshot.position is None else snapshot.position,
                polarization=snapshot.polarization or before.polarization,
                wavelength_nm=before.wavelength_nm,
            )
        self.snapshot = snapshot
        if snapshot.theta_i_deg is not None and snapshot.theta_mes_deg is not None:
            self.theta_i_deg, self.theta_mes_deg = snapshot.theta_i_deg, snapshot.theta_mes_deg
        if self.phase is Phase.STOPPING:
            return  # until the thread says that the scan has ended
        if snapshot.state is State.RUNNING and self.phase is not Phase.PAUSING:
            self.phase = Phase.RUNNING
        elif snapshot.state is State.PAUSED:
            self.phase = Phase.PAUSED
            if "by the operator" not in snapshot.message:
                self.banner = Banner("error", f"{snapshot.message}. Mend it, then Resume.")
        elif snapshot.state is State.ABORTING:
            self.phase = Phase.STOPPING

    def _apply_connected(self, message: Connected) -> None:
        self.phase, self.devices = Phase.READY, message.devices
        self.banner = self._refused()
        for role, text in message.devices.items():
            self.say("info", role, text)

    def _apply_disconnected(self, message: Disconnected) -> None:
        self.phase, self.devices = Phase.OFFLINE, {}
        self.theta_i_deg = self.theta_mes_deg = math.nan
        if message.reason:
            self.banner = Banner("error", message.reason, reconnect=True)
            self.say("error", "connection", message.reason)

    def _apply_ended(self, message: ScanEnded) -> None:
        self.phase = Phase.READY
        level: Level = {"done": "info", "stopped": "warning", "failed": "error"}[message.how]  # type: ignore[assignment]
        text = message.message
        if message.how == "stopped" and journal_path(message.path).exists():
            text = f"Stopped. Everything measured is kept in {message.path}; Resume scan goes on from there."
        elif message.how == "done":
            text = f"Finished. The scan is stored in {message.path}"
        self.banner = Banner(level, text, reconnect=message.device_failed)
        self.say(level, "scan", text)
        if message.how == "done":
            self.path = self.suggested_path()  # the next scan never writes over this one
