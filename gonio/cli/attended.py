"""What the person at the terminal sees of a running scan, and how they answer it.

Faults are printed as they happen.  A scan that pauses waits for Enter; without a terminal to type at it does
not pause but ends, so that a nightly job never hangs.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from gonio.acquire import FaultPolicy, Runner, Snapshot, State
from gonio.acquire.policy import Then
from gonio.acquire.session import OnRecord
from gonio.cli.progress import Bar, progress_bar, readable_duration
from gonio.rig import Rig, RigConfig
from gonio.store.records import EventRecord

MakeRunner = Callable[[Callable[[Snapshot], None], OnRecord], Runner]

ENDINGS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")  # Ctrl-C, a service manager, a closed terminal


def policy_of(retries: int | None, then: Then | None) -> FaultPolicy:
    """Return the policy of the options given; a person at a terminal is asked, nobody is not."""
    default = FaultPolicy()
    return FaultPolicy(
        default.retries if retries is None else retries,
        ("pause" if _is_attended() else "abort") if then is None else then,
    )


def run_attended(title: str, rig: Rig, make: MakeRunner) -> Path:
    """Run a scan with a progress bar; Ctrl-C stops in order and leaves a file that can be resumed."""
    with progress_bar(title, 1.0) as bar:
        runner = make(_progress(bar, rig.config, lambda: runner), _faults(bar))
        with _stopped_by_signals(runner):
            return runner.run()


def _is_attended() -> bool:
    return sys.stdin is not None and sys.stdin.isatty()


def _progress(bar: Bar, rig: RigConfig, runner: Callable[[], Runner]) -> Callable[[Snapshot], None]:
    speed = rig.clock_speed()  # the person waits in real seconds
    before = State.IDLE

    def show(snapshot: Snapshot) -> None:
        nonlocal before
        if snapshot.state is State.RUNNING:
            state = f"{readable_duration(snapshot.left_s / speed)} left"
        else:
            state = snapshot.state.value
        if snapshot.state is State.PAUSED and before is not State.PAUSED:
            bar.say(f"paused: {snapshot.message}")
            threading.Thread(target=_ask, args=(bar, runner()), daemon=True).start()
        before = snapshot.state
        done = snapshot.readings_done / max(snapshot.readings_total, 1)
        bar.update(done, f"{snapshot.done}/{snapshot.total} positions, {state}")

    return show


def _ask(bar: Bar, runner: Runner) -> None:
    """Wait for Enter and go on; nobody at the other end is a reason to stop."""
    bar.say("mend it and press Enter to go on, or Ctrl-C to stop (what is measured is safe)")
    if sys.stdin is not None and sys.stdin.readline():
        runner.resume()
    else:
        runner.stop()


def _faults(bar: Bar) -> OnRecord:
    def tell(record: object) -> None:
        if isinstance(record, EventRecord) and record.level != "info":
            bar.say(f"{record.level}: {record.message}")

    return tell


@contextmanager
def _stopped_by_signals(runner: Runner) -> Iterator[None]:
    """Turn the ways to end a program into an orderly stop; a second Ctrl-C interrupts at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous: dict[int, Any] = {}

    def stop(_signal: int, _frame: FrameType | None) -> None:
        restore()
        # not here: the handler may run inside the very lock that stop() needs
        threading.Thread(target=runner.stop, daemon=True).start()

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    for name in ENDINGS:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            previous[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        restore()
