"""When do the bytes of an instrument leave: in their order, some of them late, some held back."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

Deliver = Callable[[bytes], None]
"""Hands bytes on."""

Later = Callable[[float, Callable[[], None]], object]
"""Calls a function after real seconds."""


def loop_later(delay_s: float, action: Callable[[], None]) -> object:
    """Call a function after real seconds, by a timer of the running loop."""
    return asyncio.get_running_loop().call_later(delay_s, action)


class Outbox:
    """A line keeps the order of its bytes: what is late delays what comes behind it.

    Only what is *held* is overtaken: it leaves in front of the answer to a later request.
    """

    def __init__(self, later: Later) -> None:
        self._later = later
        self._queue: deque[tuple[float, bytes, Deliver]] = deque()
        self._held = b""
        self._held_since = 0  # number of the request that it answers
        self._generation = 0

    def send(self, delay_s: float, data: bytes, transmit: Deliver) -> None:
        """Send real seconds after what is before it has gone; at once if nothing is."""
        if not self._queue and delay_s <= 0:
            transmit(data)
            return
        self._queue.append((delay_s, data, transmit))
        if len(self._queue) == 1:
            self._wait_for_first()

    def hold(self, data: bytes, request: int, delay_s: float, transmit: Deliver) -> None:
        """Hold an answer back until `take_held` for a later request, or for real seconds if above 0."""
        self._held += data
        self._held_since = request
        if delay_s > 0:
            self._later(delay_s, lambda: self._release(transmit))

    def take_held(self, request: int) -> bytes:
        """Return what is held and answers an earlier request than this one."""
        if self._held_since >= request:
            return b""
        held, self._held = self._held, b""
        return held

    def forget(self) -> None:
        """Drop everything: the client has gone, or the instrument."""
        self._held = b""
        self._queue.clear()
        self._generation += 1

    def _release(self, transmit: Deliver) -> None:
        held, self._held = self._held, b""
        if held:
            self.send(0.0, held, transmit)

    def _wait_for_first(self) -> None:
        generation = self._generation
        self._later(self._queue[0][0], lambda: self._next(generation))

    def _next(self, generation: int) -> None:
        if generation != self._generation:
            return
        while True:
            _, data, transmit = self._queue.popleft()
            transmit(data)
            if not self._queue:
                return
            if self._queue[0][0] > 0:
                self._wait_for_first()
                return
