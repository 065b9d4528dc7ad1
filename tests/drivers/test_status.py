"""A status tells once how its action ended."""

from __future__ import annotations

import threading

import pytest

from gonio_drivers.status import ThreadStatus


def test_success_and_callbacks_before_and_after_the_end():
    go = threading.Event()
    called: list[ThreadStatus] = []
    status = ThreadStatus(lambda: go.wait(10), "x")
    status.add_callback(called.append)
    assert not status.done
    assert not status.success
    with pytest.raises(TimeoutError):
        status.exception(0.0)
    go.set()
    status.wait(10)
    status._thread.join(10)
    status.add_callback(called.append)
    assert called == [status, status]
    assert status.success
    assert status.exception() is None


def test_failure_is_handed_to_who_waits():
    def fail() -> None:
        raise ValueError("no")

    status = ThreadStatus(fail, "x")
    with pytest.raises(ValueError, match="no"):
        status.wait(10)
    assert status.done
    assert not status.success
    assert isinstance(status.exception(), ValueError)
