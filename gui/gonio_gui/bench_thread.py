"""The thread that owns the bench and runs the scan, so that the window never waits for hardware.  No Qt.

Orders go in through methods that return at once; what happens comes back as messages in `outbox`, which the
window empties from a timer.  One thread opens the devices, runs the runner and closes the devices again; only
stopping, which the devices allow from any thread, takes a short-lived thread of its own, because it must not
queue behind a move.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan
from gonio.bench_process import served
from gonio.errors import DeviceError, GonioError, ScanStopped
from gonio.plan import Plan
from gonio.rig import Rig, RigConfig, open_rig
from gonio.store import Scan, load
from gonio.store.records import EventRecord, Level, PositionRecord, Record, ReferenceRecord

ATTENDED = FaultPolicy(then="pause")  # somebody sits before the window, or will
POLL_S = 1.0  # how often the axes are read back while nothing is measured


@dataclass(frozen=True, slots=True)
class Connected:
    """Every device answers; `devices` holds what each says of itself, by role."""

    devices: dict[str, str]


@dataclass(frozen=True, slots=True)
class Disconnected:
    """There is no connection; `reason` says why, empty if it was asked for."""

    reason: str = ""


@dataclass(frozen=True, slots=True)
class AxesRead:
    """Where the axes stand, read back while nothing is measured."""

    theta_i_deg: float
    theta_mes_deg: float


@dataclass(frozen=True, slots=True)
class Begun:
    """A scan begins or goes on; the records of what it has measured before follow, then the new ones."""

    plan: Plan
    path: Path


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """The finished scan, corrected with all references."""

    scan: Scan


@dataclass(frozen=True, slots=True)
class ScanEnded:
    """The scan is over, for now or for good."""

    path: Path
    how: Literal["done", "stopped", "failed"]
    message: str
    device_failed: bool = False


@dataclass(frozen=True, slots=True)
class Note:
    """A line for the log."""

    level: Level
    source: str
    text: str


@dataclass(frozen=True, slots=True)
class Closed:
    """The devices are released and the thread ends: the last message."""


Message = (
    Connected | Disconnected | AxesRead | Begun | Stored | ScanEnded | Note | Closed
    | Snapshot | ReferenceRecord | PositionRecord | EventRecord
)  # fmt: skip


class BenchThread:
    """Connects, measures and lets go, in a thread of its own; see the module for how it is used."""

    def __init__(self) -> None:
        self.outbox: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._orders: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._devices = contextlib.ExitStack()
        self._rig: Rig | None = None
        self._runner: Runner | None = None
        self._stop_wanted = threading.Event()
        self._poll = False
        self._thread = threading.Thread(target=self._work, name="gonio-bench", daemon=True)
        self._thread.start()

    # -- orders, from the GUI thread --------------------------------------------------------------------

    def connect(self, config: RigConfig) -> None:
        """Connect a rig in place of the one before; a simulated bench is started for it."""
        self._orders.put(lambda: self._connect(config))

    def start(self, plan: Plan, path: Path) -> None:
        """Measure a plan into a new file."""
        self._stop_wanted.clear()
        self._orders.put(lambda: self._measure(path, lambda rig: self._new_runner(rig, plan, path)))

    def continue_file(self, path: Path) -> None:
        """Go on with an interrupted scan."""
        self._stop_wanted.clear()
        self._orders.put(lambda: self._measure(path, lambda rig: self._resumed_runner(rig, path)))

    def pause(self) -> None:
        """Pause after the position being measured."""
        runner = self._runner
        if runner is not None:
            runner.pause()

    def resume(self) -> None:
        """Go on after a pause."""
        runner = self._runner
        if runner is not None:
            runner.resume()

    def stop_scan(self) -> None:
        """Stop the scan within a reading; it can be resumed."""
        self._stop_wanted.set()
        self._aside(self._stop_runner)

    def stop_motion(self) -> None:
        """Stop every motor now, and the scan with them."""
        self._stop_wanted.set()
        # the runner first, so that it takes the interrupted move for a stop and not for a fault
        self._aside(self._stop_runner, self._stop_rig)

    def close(self) -> None:
        """Stop the scan, release the devices and end; `Closed` follows."""
        self.stop_scan()
        self._orders.put(None)

    def join(self, timeout_s: float) -> bool:
        """Wait for the end after `close`; say whether it came."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # -- stopping, in a short-lived thread --------------------------------------------------------------

    def _aside(self, *actions: Callable[[], None]) -> None:
        def act() -> None:
            for action in actions:
                try:
                    action()
                except GonioError as error:
                    self._note("error", "stop", str(error))

        threading.Thread(target=act, name="gonio-stop", daemon=True).start()

    def _stop_runner(self) -> None:
        runner = self._runner
        if runner is not None:
            runner.stop()

    def _stop_rig(self) -> None:
        rig = self._rig
        if rig is None:
            self._note("warning", "stop", "no rig is connected: there is no motion to stop")
            return
        rig.stop()
        self._note("info", "stop", "all motion stopped")

    # -- the bench's own thread -------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            try:
                order = self._orders.get(timeout=POLL_S)
            except queue.Empty:
                self._guarded(self._read_axes)
                continue
            if order is None:
                break
            self._guarded(order)
        self._guarded(self._let_go)
        self.outbox.put(Closed())

    def _guarded(self, order: Callable[[], None]) -> None:
        """Carry out an order; whatever it raises becomes a line in the log, and the thread lives on."""
        try:
            order()
        except GonioError as error:
            self._note("error", "bench", str(error))
        except Exception as error:
            traceback.print_exc()
            self._note(
                "error", "gonio", f"defect of the program: {type(error).__name__}: {error}; please report it"
            )

    def _note(self, level: Level, source: str, text: str) -> None:
        self.outbox.put(Note(level, source, text))

    def _connect(self, config: RigConfig) -> None:
        self._let_go()
        try:
            reachable = self._devices.enter_context(served(config))
            rig = self._devices.enter_context(open_rig(reachable))
            devices = {"stage": rig.stage.identify(), "polarizer": rig.polarizer.identify()}
            devices |= dict(rig.spectrometer.identify())
        except BaseException as error:
            self._let_go()
            self.outbox.put(Disconnected(str(error) or type(error).__name__))
            if isinstance(error, GonioError):
                return  # the message is all there is to say
            raise
        self._rig = rig
        self.outbox.put(Connected(devices))
        self._poll = True
        self._read_axes()

    def _let_go(self) -> None:
        self._poll, self._rig = False, None
        devices, self._devices = self._devices, contextlib.ExitStack()
        devices.close()

    def _read_axes(self) -> None:
        if self._rig is None or not self._poll:
            return
        stage = self._rig.stage
        try:
            self.outbox.put(AxesRead(stage.theta_i.position_deg(), stage.theta_mes.position_deg()))
        except DeviceError:
            self._poll = False  # said once, not every second
            raise

    def _new_runner(self, rig: Rig, plan: Plan, path: Path) -> Runner:
        return Runner(rig, plan, path, on_snapshot=self._watch, on_record=self._pass_on, policy=ATTENDED)

    def _resumed_runner(self, rig: Rig, path: Path) -> Runner:
        return resume_scan(path, rig, on_snapshot=self._watch, on_record=self._pass_on, policy=ATTENDED)

    def _watch(self, snapshot: Snapshot) -> None:
        self.outbox.put(snapshot)
        if self._stop_wanted.is_set() and self._runner is not None and snapshot.state is State.PREPARING:
            self._runner.stop()  # asked for after the click on Start, before the runner could hear it

    def _pass_on(self, record: Record) -> None:
        if isinstance(record, PositionRecord | ReferenceRecord | EventRecord):
            self.outbox.put(record)

    def _measure(self, path: Path, make_runner: Callable[[Rig], Runner]) -> None:
        ended = ScanEnded(path, "failed", "the scan ended by a defect of the program; see the terminal")
        try:
            if self._rig is None:
                raise GonioError("no rig is connected; connect one first")
            self._runner = make_runner(self._rig)
            self.outbox.put(Begun(self._runner.plan, path))
            self._runner.run()
            ended = ScanEnded(path, "done", f"stored in {path}")
            self.outbox.put(Stored(load(path)))
        except ScanStopped as stop:
            ended = ScanEnded(path, "stopped", str(stop))
        except GonioError as error:
            ended = ScanEnded(path, "failed", str(error), isinstance(error, DeviceError))
        finally:
            self._runner = None
            self._poll = True
            self.outbox.put(ended)
