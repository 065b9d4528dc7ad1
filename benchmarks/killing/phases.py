"""In which part of its work is a scan killed: its functions say what they are in, and set the timer.

The kernel's timer sends SIGKILL to the process at a microsecond, in the middle of whatever it does then,
inside HDF5 too; no handler and no clean-up runs.  What was under way is left in a byte that outlives the
process.
"""

from __future__ import annotations

import ctypes
import mmap
import signal
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gonio.acquire.journal import Journal
from gonio.acquire.measuring import Measurer
from gonio.acquire.session import Session
from gonio.acquire.steps import ReferenceStep
from gonio.store.file import ScanFile

PHASES = (
    "outside",  # preparing, between steps, after the end
    "creation",
    "rebuild",
    "reference",
    "position",
    "journal",
    "rows",
    "flush",
    "confirming",
    "finish",
)


class _Event(ctypes.Structure):  # struct sigevent of Linux
    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("rest", ctypes.c_char * 48),
    )


class _TimerSpec(ctypes.Structure):  # struct itimerspec
    _fields_ = (("interval", ctypes.c_long * 2), ("value", ctypes.c_long * 2))


def kill_in(seconds: float) -> None:
    """Let the kernel send SIGKILL to this process after that time."""
    libc = ctypes.CDLL(None, use_errno=True)
    timer = ctypes.c_void_p()
    event = _Event(None, signal.SIGKILL, 0, b"")
    if libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) != 0:
        raise OSError(ctypes.get_errno(), "timer_create")
    whole = int(seconds)
    spec = _TimerSpec((0, 0), (whole, max(int((seconds - whole) * 1e9), 1)))
    if libc.timer_settime(timer, 0, ctypes.byref(spec), None) != 0:
        raise OSError(ctypes.get_errno(), "timer_settime")


@dataclass(frozen=True, slots=True)
class Order:
    """Die at the `nth` entry into a phase, after a share of the time that it takes."""

    phase: str
    nth: int
    share: float
    typical_s: float


class Watch:
    """Keeps the phase of this process in a shared byte, and carries out an order to die.

    Wraps the functions of the program for good: it is made in a process that has only a scan to do.
    """

    def __init__(self, shared: mmap.mmap, order: Order | None) -> None:
        self.spent_s: dict[str, list[float]] = defaultdict(list)
        self._shared = shared
        self._order = order
        self._entries: dict[str, int] = defaultdict(int)
        self._put("outside")
        if order is not None and order.phase == "outside":
            kill_in(order.share * order.typical_s + 1e-6)
        self._wrap(Session, "begin", "creation")
        self._wrap(Session, "resume", "rebuild")
        self._wrap(Session, "finish", "finish")
        self._wrap(Journal, "write", "journal")
        self._wrap(Journal, "confirm", "confirming")
        self._wrap(ScanFile, "add_positions", "rows")
        self._wrap(ScanFile, "flush", "flush")
        self._wrap(Measurer, "measure", lambda s: "reference" if isinstance(s, ReferenceStep) else "position")

    def _put(self, phase: str) -> int:
        before, self._shared[0] = self._shared[0], PHASES.index(phase)
        return before

    def _wrap(self, owner: type[Any], name: str, phase: str | Callable[[Any], str]) -> None:
        original = owner.__dict__[name]
        bound = isinstance(original, classmethod)
        function: Callable[..., Any] = original.__func__ if bound else original

        def watched(*args: Any, **kwargs: Any) -> Any:
            entered = phase if isinstance(phase, str) else phase(args[1])
            before = self._put(entered)
            order = self._order
            if order is not None and order.phase == entered:
                self._entries[entered] += 1
                if self._entries[entered] == order.nth:
                    kill_in(order.share * order.typical_s + 1e-6)
            began_s = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.spent_s[entered].append(time.perf_counter() - began_s)
                self._shared[0] = before

        setattr(owner, name, classmethod(watched) if bound else watched)
