"""How does a run go on where it stopped?  Its sums, kept in the result's file, and whose sums they are.

The points of every estimator are numbered and their sums are added in the order of these numbers, so a run
that is stopped after any batch and continued gives the bits of one that was not stopped.  That holds for the
same scene, seed and kernels only: a digest of all of them is kept beside the sums and must agree.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import SceneError

if TYPE_CHECKING:
    from gonio.facade.result import Irradiance

State = Mapping[str, NDArray[Any]]
DIGEST = "digest"
CHECKPOINT_EVERY_S = 30.0


def digest_of(*things: object) -> NDArray[np.uint8]:
    """Return SHA-256 of arrays, (named) tuples of arrays, numbers and texts, (32,) uint8."""
    total = hashlib.sha256()
    for thing in things:
        _add(total, thing)
    return np.frombuffer(total.digest(), np.uint8).copy()


def _add(total: Any, thing: object) -> None:
    if isinstance(thing, tuple | list):
        total.update(f"({len(thing)}".encode())
        for part in thing:
            _add(total, part)
    elif isinstance(thing, np.ndarray):
        total.update(f"{thing.dtype.str}{thing.shape}".encode())
        total.update(np.ascontiguousarray(thing).tobytes())
    else:
        total.update(f"{type(thing).__name__} {thing!r};".encode())


def check_digest(state: State, digest: NDArray[np.uint8]) -> None:
    """Raise `SceneError` if the state belongs to another scene, seed, estimator or version of the kernels."""
    kept = state.get(DIGEST)
    if kept is None or not np.array_equal(kept, digest):
        raise SceneError(
            "the points kept in the result do not belong to this run: the scene, a scan it names, the seed, "
            "the estimator or the version of gonio is another one; simulate the scene anew"
        )


def pack_state(**values: NDArray[Any] | int | float) -> dict[str, NDArray[Any]]:
    """Return the values as arrays of their own, which later batches do not change."""
    return {key: np.array(value) for key, value in values.items()}


class Checkpoints:
    """Keep the result so far on disk while a long run goes on, so that even ``kill -9`` loses little.

    Parameters
    ----------
    path
        The file of the final result; it is replaced as a whole each time.
    prepare
        What to change in a result before it is written, such as options that only the caller knows.
    every_s
        Time between two writes.
    most_share
        Of the time that may go into writing: large results are written less often.
    """

    def __init__(
        self,
        path: Path,
        prepare: Callable[[Irradiance], Irradiance] = lambda irradiance: irradiance,
        every_s: float = CHECKPOINT_EVERY_S,
        most_share: float = 0.05,
    ) -> None:
        self.path = path
        self.prepare = prepare
        self.every_s = every_s
        self.most_share = most_share
        self.written = 0
        self._due_s = time.monotonic() + every_s

    def __call__(self, so_far: Callable[[], Irradiance]) -> None:
        """Write what `so_far` returns, if it is time to."""
        started_s = time.monotonic()
        if started_s < self._due_s:
            return
        self.prepare(so_far()).save(self.path)
        ended_s = time.monotonic()
        between_s = (ended_s - started_s) * (1.0 / self.most_share - 1.0)
        self._due_s = ended_s + max(self.every_s, between_s)
        self.written += 1
