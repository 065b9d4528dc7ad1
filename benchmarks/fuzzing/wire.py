"""The other end of a driver's line: an honest device whose replies a bad line changes, in virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from random import Random

from fuzzing.mutations import mutate, pieces
from fuzzing.virtual_time import VirtualTime

MOST_READS = 50_000


class Hang(AssertionError):
    """A call read so often that it would never have come back."""


class BadLine:
    """A `gonio_drivers.transport.Port`: bytes never overtake each other, but may come damaged or late.

    Parameters
    ----------
    time
        Moves on with every read.
    device
        Returns the true reply to a request.
    forge
        Returns a reply that is complete and valid but says something else, or belongs to another request.
    """

    def __init__(
        self,
        time: VirtualTime,
        device: Callable[[bytes], bytes],
        forge: Callable[[Random, bytes], bytes] | None = None,
    ) -> None:
        self._time = time
        self._device = device
        self._forge = forge
        self._incoming: deque[tuple[float, bytes]] = deque()
        self._rng = Random(0)
        self._damaged_writes = 0
        self._history: deque[bytes] = deque(maxlen=8)
        self._copies: deque[bytes] = deque(maxlen=20)
        self._shifted = False
        self.delivered = b""  # sent in reply to the requests of the present call
        self.changed = False
        self.forged = False
        self.reads = 0

    def begin(self, rng: Random, damaged_writes: int) -> None:
        """Begin a call, the replies to whose first requests are changed."""
        self._rng = rng
        self._damaged_writes = damaged_writes
        self.delivered = b""
        self.changed = self.forged = self._shifted = False
        self.reads = 0

    @property
    def history(self) -> Sequence[bytes]:
        """The last true replies."""
        return self._history

    @property
    def copies(self) -> bytes:
        """Whole replies of earlier requests that were sent once more, after they had been answered."""
        return b"".join(self._copies)

    def write(self, data: bytes) -> None:
        """Take a request and let the reply come."""
        reply = self._device(data)
        sent = [(0.002, reply)]
        if self._damaged_writes > 0:
            self._damaged_writes -= 1
            rng = self._rng
            changed = reply
            draw = rng.random()
            if draw < 0.06 and self._forge is not None:
                changed = self._forge(rng, reply)
                self.forged = True
            elif draw < 0.9:
                changed = mutate(rng, reply, self._history)
            sent = pieces(rng, changed)
            self.changed |= changed != reply
            copies = [old for old in self._history if old in changed]
            self._copies.extend(copies)
            self._shifted |= bool(copies)
        if reply:
            self._history.append(reply)
        if self._shifted:  # true replies behind a copy come when their requests have been answered
            self._copies.append(reply)
        due_s = self._time.now_s
        for delay_s, piece in sent:
            due_s = max(due_s + delay_s, self._incoming[-1][0] if self._incoming else 0.0)
            if piece:
                self._incoming.append((due_s, piece))
                self.delivered += piece

    def read(self, timeout_s: float) -> bytes:
        """Return what comes first within the time."""
        self.reads += 1
        if self.reads > MOST_READS:
            raise Hang(f"{MOST_READS} reads in one call")
        time = self._time
        end_s = time.now_s + max(timeout_s, 0.0)
        if self._incoming and self._incoming[0][0] <= end_s:
            due_s, piece = self._incoming.popleft()
            time.now_s = max(time.now_s, due_s)
            time.advance(2e-5)  # so that an endless stream of bytes meets the deadline
            return piece
        time.now_s = end_s
        return b""

    def close(self) -> None:
        """Nothing to release."""
