"""One process at a time on one file.

The lock is the operating system's, so it ends with the process, however that ends.  It is taken on a
handle of its own, and on Windows, where locked bytes cannot be read by others, on one byte far beyond the
end of the file.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

_FAR_BYTE = 1 << 40


class FileLock:
    """An exclusive lock on an existing file, held until `release`."""

    def __init__(self, path: Path) -> None:
        """Take the lock at once, or raise `BlockingIOError` if another handle or process has it."""
        self._descriptor: int | None = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        try:
            _lock(self._descriptor)
            _still_there(self._descriptor, path)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Give the lock back; more than once does nothing."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)  # which ends the lock too


def _still_there(descriptor: int, path: Path) -> None:
    """Raise `FileNotFoundError` if the file was removed between the opening and the locking of it."""
    if not os.path.samestat(os.fstat(descriptor), os.stat(path)):
        raise FileNotFoundError(path)


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        os.lseek(descriptor, _FAR_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(str(error)) from error

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
