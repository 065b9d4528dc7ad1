"""Is there room on the disk, asked before it is needed.

A full disk must not be met in the middle of a write: HDF5 can neither go on nor close a file whose flush
failed.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from gonio.errors import StoreError

RESERVE_BYTES = 4_000_000  # more than a journal record and the chunks of a record in the `.h5`
_BLOCK = bytes(1 << 20)


def must_have_room(path: Path, needed_bytes: int) -> None:
    """Raise `StoreError` unless the disk of `path` says that it has that much left."""
    free_bytes = shutil.disk_usage(path.absolute().parent).free
    if free_bytes < needed_bytes:
        raise StoreError(
            f"{path}: the disk has {free_bytes / 1e6:.1f} MB left and {needed_bytes / 1e6:.1f} MB are needed "
            "to go on safely; free some space"
        )


def prove_room(path: Path, needed_bytes: int) -> None:
    """Raise `StoreError` unless that much can really be written beside `path`: quotas and dying disks too."""
    must_have_room(path, needed_bytes)
    trial = path.with_name(path.name + ".trial")
    try:
        with trial.open("wb") as file:
            for start in range(0, needed_bytes, len(_BLOCK)):
                file.write(_BLOCK[: needed_bytes - start])
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise StoreError(
            f"{path}: {needed_bytes / 1e6:.1f} MB cannot be written beside it ({error}); free some disk "
            "space, or restore the connection to the disk"
        ) from error
    finally:
        trial.unlink(missing_ok=True)
