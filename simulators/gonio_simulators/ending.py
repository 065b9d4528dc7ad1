"""When does a serving process end: at a signal, after some time, or when its standard input closes."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import threading


def stop_when_told(
    loop: asyncio.AbstractEventLoop, stop: asyncio.Event, *, until_stdin_closes: bool, seconds: float | None
) -> None:
    """Set `stop` at SIGINT or SIGTERM and, if asked, at the end of standard input or after real seconds."""
    _stop_on_signals(loop, stop)
    if until_stdin_closes:
        threading.Thread(target=_wait_for_end_of_input, args=(loop, stop), daemon=True).start()
    if seconds is not None:
        loop.call_later(seconds, stop.set)


def _stop_on_signals(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        try:
            loop.add_signal_handler(number, stop.set)
        except NotImplementedError:  # Windows, which looks at signals only between two waits of the loop
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(stop.set))
            _tick(loop)


def _tick(loop: asyncio.AbstractEventLoop) -> None:
    loop.call_later(0.2, _tick, loop)


def _wait_for_end_of_input(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    """Read standard input to its end.

    A thread, because files, pipes and consoles cannot all be watched by one loop; `os.read`, because a
    buffered reader that still waits at exit would hold a lock that the interpreter needs.
    """
    with contextlib.suppress(OSError):  # no standard input at all is an end, too
        while os.read(0, 4096):
            continue
    with contextlib.suppress(RuntimeError):  # the loop has ended before
        loop.call_soon_threadsafe(stop.set)
