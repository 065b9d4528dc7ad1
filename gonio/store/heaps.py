"""Would the HDF5 library ever come back from this file?

Texts of any length stand in global heaps: blocks that begin with ``GCOL``, version 1, three zeros and the
size of the block (8 bytes), then objects of a number, a count (2 bytes each), 4 zeros, a size (8 bytes) and
as many bytes, padded to 8; number 0 is the free rest and counts its own header.  The library walks from
object to object and believes every size: one of zero keeps it walking for ever (HDFGroup/hdf5, issue 1707),
and no time-out reaches it there.  So the walk is done here first.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_OBJECT = struct.Struct("<HHIQ")
_LARGEST_BYTES = 500_000_000
"""Beyond, looking for heaps would take longer than it is worth: damage hits data then, not texts."""


def endless_heap(path: Path) -> int | None:
    """Return where a heap stands in whose objects the library would get lost; None if there is none."""
    size = path.stat().st_size
    if not 0 < size <= _LARGEST_BYTES:
        return None
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_SIGNATURE)
        while at >= 0:
            if not _ends(data, at):
                return at
            at = data.find(_SIGNATURE, at + len(_SIGNATURE))
    return None


def _ends(data: mmap.mmap, start: int) -> bool:
    end = start + int.from_bytes(data[start + 8 : start + 16], "little")
    if end > len(data):
        return True  # cut short: the library finds that out itself
    at = start + 16
    while at + _OBJECT.size <= end:
        number, _, _, size = _OBJECT.unpack_from(data, at)
        step = size if number == 0 else _OBJECT.size + (size + 7) // 8 * 8
        if step == 0 or at + step > end:
            return False
        at += step
    return True
