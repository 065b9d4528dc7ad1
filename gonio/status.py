"""Progress of an action that runs in a thread, in the shape of bluesky's Status."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class ThreadStatus:
    """Runs an action in a daemon thread and says when and how it ended.

    Satisfies `gonio.devices.Status` and `bluesky.protocols.Status` structurally.
    """

    def __init__(self, action: Callable[[], object], name: str) -> None:
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._exception: BaseException | None = None
        self._callbacks: list[Callable[[Any], None]] = []
        self._action = action
        self._thread = threading.Thread(target=self._run, name=f"{name} move", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """True once the action has ended, well or badly."""
        return self._ended.is_set()

    @property
    def success(self) -> bool:
        """True once the action has ended well."""
        return self.done and self._exception is None

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return what ended the action, None if it ended well; `TimeoutError` if it has not ended in time."""
        if not self._ended.wait(timeout):
            raise TimeoutError("the action has not ended yet")
        return self._exception

    def wait(self, timeout: float | None = None) -> None:
        """Block until the action has ended and raise what ended it, if anything did."""
        exception = self.exception(timeout)
        if exception is not None:
            raise exception

    def add_callback(self, callback: Callable[[Any], None]) -> None:
        """Call `callback(self)` when the action ends, or now if it already has."""
        with self._lock:
            if not self._ended.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def _run(self) -> None:
        try:
            self._action()
        except BaseException as error:  # handed to whoever waits; a thread has nobody else to tell
            self._exception = error
        with self._lock:
            self._ended.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)
