"""The journal of a scan: an append-only file in which every record is on the disk before it counts.

    file   = MAGIC, frame, frame, ...            the first frame holds the `ScanHeader`
    frame  = MARK (4 bytes), length (u32), crc32 of length and payload (u32), payload; little-endian
    payload= one line of JSON with the numbers and texts, then the arrays it lists, packed

A record counts when its frame is complete, its checksum holds and the disk has confirmed it.  Death of
the process or of the power can only leave the last frame torn: it is cut off when the journal is opened
again.  A frame damaged in the middle (by the disk) is passed over; what it held is measured again.

While a journal is written, zeros stand ahead of its end: a disk confirms bytes that replace others sooner
than bytes that make a file longer, since the file's length and place need not be confirmed with them.
"""

from __future__ import annotations

import dataclasses
import json
import os
import stat
import struct
import sys
import zlib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from gonio.acquire.lock import FileLock
from gonio.errors import StoreError
from gonio.store.file import sync_folder
from gonio.store.records import (
    DecisionRecord,
    DetectorFacts,
    EventRecord,
    PositionRecord,
    Record,
    ReferenceRecord,
    RigFacts,
    ScanHeader,
    SourceFacts,
)
from gonio.store.sane import refuse_nonsense

MAGIC = b"gonio journal 1\n"
_MARK = b"\xf5rec"
_FRAME = struct.Struct("<4sII")
_AHEAD = bytes(1 << 18)  # fifty positions of a hundred wavelengths

_KINDS: dict[str, type[Any]] = {
    "header": ScanHeader,
    "reference": ReferenceRecord,
    "decision": DecisionRecord,
    "position": PositionRecord,
    "event": EventRecord,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def journal_path(path: Path) -> Path:
    """Return ``FILE.h5.journal`` for ``FILE.h5``."""
    return path.with_name(path.name + ".journal")


# -- records as bytes
# ---------------------------------------------------------------------------------------------


def encode(record: Record) -> bytes:
    """Return a record as one frame."""
    fields: dict[str, Any] = {"record": _NAMES[type(record)]}
    arrays: list[tuple[str, str, int]] = []
    packed: list[bytes] = []
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if value is None and field.default is None:
            continue  # a scan that has no such thing is written as before there was one
        if isinstance(value, np.ndarray):
            little = value.astype(value.dtype.newbyteorder("<"), copy=False)
            arrays.append((field.name, little.dtype.str, value.size))
            packed.append(little.tobytes())
        else:
            fields[field.name] = dataclasses.asdict(value) if dataclasses.is_dataclass(value) else value  # type: ignore[arg-type]
    text = json.dumps({**fields, "arrays": arrays}, ensure_ascii=False).encode()
    payload = b"".join([text, b"\n", *packed])
    length = struct.pack("<I", len(payload))
    return _FRAME.pack(_MARK, len(payload), zlib.crc32(payload, zlib.crc32(length))) + payload


def decode(payload: bytes) -> Record:
    """Return the record in a frame's payload; `ValueError` if the bytes are none."""
    text, newline, rest = payload.partition(b"\n")
    fields = json.loads(text)
    kind = _KINDS.get(fields.pop("record", None)) if isinstance(fields, dict) else None
    if kind is None or not newline:
        raise ValueError("not a record")
    at = 0
    for name, dtype, size in fields.pop("arrays"):
        array = np.frombuffer(rest, dtype=dtype, count=size, offset=at)
        at += array.nbytes
        fields[name] = array.astype(array.dtype.newbyteorder("="))
    if kind is ScanHeader:
        rig = fields["rig"]
        rig["detectors"] = tuple(DetectorFacts(**detector) for detector in rig["detectors"])
        fields["rig"] = RigFacts(**rig)
        if "source" in fields:
            fields["source"] = SourceFacts(**fields["source"])
    record: Record = kind(**fields)
    return record


def frames(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the end and the payload of every whole frame, passing over damaged bytes between them."""
    at = len(MAGIC)
    while True:
        payload = _frame_at(data, at)
        if payload is None:
            at = data.find(_MARK, at + 1)
            if at < 0:
                return
            continue
        at += _FRAME.size + len(payload)
        yield at, payload


def _frame_at(data: bytes, at: int) -> bytes | None:
    if at + _FRAME.size > len(data):
        return None
    mark, length, checksum = _FRAME.unpack_from(data, at)
    start = at + _FRAME.size
    if mark != _MARK or start + length > len(data):
        return None
    payload = data[start : start + length]
    return payload if zlib.crc32(payload, zlib.crc32(data[at + 4 : at + 8])) == checksum else None


# -- the file
# -----------------------------------------------------------------------------------------------------


class Journal:
    """An open, locked journal; made by `create` or `reopen`."""

    def __init__(self, path: Path, lock: FileLock, descriptor: int) -> None:
        self.path = path
        self._lock = lock
        self._descriptor: int | None = descriptor
        self._end = os.lseek(descriptor, 0, os.SEEK_CUR)  # of the last record that the disk has
        self._zeros_end = self._end
        self._pending = 0  # bytes that the disk has not confirmed yet
        self._confirmed: Future[None] | None = None
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="journal")

    @classmethod
    def create(cls, path: Path, header: ScanHeader) -> Journal:
        """Start the journal of a new scan; `StoreError` if there is one already."""
        try:
            descriptor = os.open(
                path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644
            )
        except FileExistsError:
            if died_at_birth(path):
                path.unlink()
                return cls.create(path, header)
            raise _in_the_way(path) from None
        except OSError as error:
            raise StoreError(
                f"{path}: cannot be created ({error}); check the folder and its rights"
            ) from None
        try:
            journal = cls(path, FileLock(path), descriptor)
            journal._write(MAGIC + encode(header))
            journal.confirm()
            sync_folder(path.absolute().parent)
        except BaseException:
            os.close(descriptor)
            path.unlink(missing_ok=True)
            raise
        return journal

    @classmethod
    def reopen(cls, path: Path) -> tuple[Journal, ScanHeader, list[Record], str]:
        """Open the journal of an interrupted scan, and cut off a torn end.

        Returns
        -------
        journal, header, the records after it, and a note on what was cut off or damaged (empty if nothing)

        Raises
        ------
        StoreError
            There is none, another process writes it, or its beginning is not that of a journal.
        """
        try:
            lock = FileLock(path)
        except FileNotFoundError:
            raise StoreError(f"{path}: there is no such journal, so there is no scan to resume") from None
        except BlockingIOError:
            raise StoreError(
                f"{path}: another process is measuring into this file; wait until it has ended, or stop it"
            ) from None
        except OSError as error:
            raise StoreError(f"{path}: cannot be opened ({error}); check its rights") from None
        try:
            header, records, end, note = _read(path)
            descriptor = os.open(path, os.O_WRONLY | getattr(os, "O_BINARY", 0))
            os.ftruncate(descriptor, end)
            os.lseek(descriptor, end, os.SEEK_SET)
            _sync(descriptor)
        except BaseException:
            lock.release()
            raise
        return cls(path, lock, descriptor), header, records, note

    def append(self, record: Record) -> None:
        """Write a record and wait until the disk has it."""
        self.write(record)
        self.confirm()

    def write(self, record: Record) -> None:
        """Write a record, and let the disk work at it while something else is done, until `confirm`."""
        self._write(encode(record))

    def confirm(self) -> None:
        """Wait until the disk has what was written; `StoreError` if it has not, and nothing is kept of it."""
        confirmed, self._confirmed = self._confirmed, None
        if confirmed is None:
            return
        try:
            confirmed.result()
        except OSError as error:
            raise self._taken_back(error) from error
        self._end += self._pending
        self._pending = 0

    def _write(self, data: bytes) -> None:
        if self._descriptor is None:
            raise StoreError(f"{self.path}: is closed")
        self.confirm()
        try:
            if self._end + len(data) > self._zeros_end:
                _write_all(self._descriptor, bytes(len(data)) + _AHEAD)
                self._zeros_end = os.lseek(self._descriptor, 0, os.SEEK_CUR)
                os.lseek(self._descriptor, self._end, os.SEEK_SET)
            _write_all(self._descriptor, data)
        except OSError as error:
            raise self._taken_back(error) from error
        self._pending = len(data)
        self._confirmed = self._syncing(self._descriptor)

    def _syncing(self, descriptor: int) -> Future[None]:
        try:
            return self._disk.submit(_sync, descriptor)
        except RuntimeError:  # the interpreter is about to end, and begins nothing in the background any more
            done: Future[None] = Future()
            try:
                _sync(descriptor)
            except OSError as error:
                done.set_exception(error)
            else:
                done.set_result(None)
            return done

    def _taken_back(self, error: OSError) -> StoreError:
        """Cut off what may have been written, and return what to raise."""
        assert self._descriptor is not None
        self._pending = 0
        with suppress(OSError):  # half a record more or less: reading passes over it
            os.lseek(self._descriptor, self._end, os.SEEK_SET)
            self._zeros_end = self._end
            os.ftruncate(self._descriptor, self._end)
        return StoreError(
            f"{self.path}: cannot be written ({error}); free some disk space, or restore the connection "
            "to the disk"
        )

    def records(self) -> list[Record]:
        """Return every record after the header, from the disk."""
        return _read(self.path)[1]

    def close(self) -> None:
        """Close the journal and give up its lock; more than once does nothing."""
        if self._descriptor is not None:
            with suppress(StoreError):  # whoever wrote it has waited for it, or has an error already
                self.confirm()
        descriptor, self._descriptor = self._descriptor, None
        self._disk.shutdown()
        if descriptor is not None:
            with suppress(OSError):
                os.ftruncate(descriptor, self._end)  # the zeros ahead
            os.close(descriptor)
        self._lock.release()

    def remove(self) -> None:
        """Delete the journal of a finished scan."""
        if os.name == "nt":
            self.close()  # an open file cannot be deleted there
        self.path.unlink()
        self.close()
        sync_folder(self.path.absolute().parent)


def read_records(path: Path) -> tuple[ScanHeader, list[Record]]:
    """Return what a journal holds, without locking it: another process may be writing it.

    `FileNotFoundError` if there is none, `StoreError` if it is not a journal or has no header yet.
    """
    header, records, _, _ = _read(path)
    return header, records


def read_header(path: Path) -> ScanHeader:
    """Return the header of a journal without locking it; `StoreError` as from `Journal.reopen`."""
    try:
        return _read(path)[0]
    except FileNotFoundError:
        raise StoreError(f"{path}: there is no such journal, so there is no scan to resume") from None


def _read(path: Path) -> tuple[ScanHeader, list[Record], int, str]:
    """Return header, records, the end of the last whole frame, and a note on damage."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a pipe would keep us waiting for ever
            raise StoreError(f"{path}: is no file; move it out of the way")
        data = path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error}); check its rights") from None
    if not data.startswith(MAGIC) and not MAGIC.startswith(data):
        raise StoreError(f"{path}: is not the journal of a gonio scan; move it out of the way")
    records: list[Record] = []
    end = whole = len(MAGIC)
    for frame_end, payload in frames(data):
        end = frame_end
        whole += _FRAME.size + len(payload)
        try:
            record = decode(payload)
            if records or isinstance(record, ScanHeader):
                first = records[0] if records else record
                if isinstance(first, ScanHeader):
                    refuse_nonsense(record, first)
            records.append(record)
        except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
            raise StoreError(
                f"{path}: holds a record that this version of gonio does not know ({error}); resume with the "
                "version that began the scan"
            ) from None
    if records and not isinstance(records[0], ScanHeader):
        raise StoreError(
            f"{path}: its beginning is damaged, so that nothing says what its {len(records)} records belong "
            f"to; keep it, and a copy of {path.name.removesuffix('.journal')}, which holds what was measured"
        )
    if not records:
        raise StoreError(
            f"{path}: the scan died before its first reading; start it again (gonio scan PLAN -o FILE)"
        )
    notes: list[str] = []
    if end > whole:
        notes.append(f"{end - whole} bytes in the middle of the journal are damaged and were passed over")
    torn = len(data[end:].rstrip(b"\0"))  # zeros were written ahead
    if torn:
        notes.append(f"{torn} bytes of an unfinished record were cut off the journal")
    assert isinstance(records[0], ScanHeader)
    return records[0], records[1:], end, "; ".join(notes)


def died_at_birth(path: Path) -> bool:
    """Say whether the journal is the torn beginning of one, without even a header, and nobody writes it."""
    try:
        lock = FileLock(path)
        try:
            data = path.read_bytes()
        finally:
            lock.release()
    except OSError:
        return False
    return (data.startswith(MAGIC) or MAGIC.startswith(data)) and next(frames(data), None) is None


def _in_the_way(path: Path) -> StoreError:
    data_file = path.name.removesuffix(".journal")
    return StoreError(
        f"{path}: a scan into {data_file} was begun and is not finished; continue it with "
        f"gonio scan --resume {path.with_name(data_file)}, or choose another name"
    )


def _write_all(descriptor: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def _sync(descriptor: int) -> None:
    """Wait until the disk has what was written."""
    if sys.platform == "darwin":
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)  # fsync there leaves the data in the drive's cache
    elif sys.platform == "linux":
        os.fdatasync(descriptor)  # the length goes with the data, the time of change need not
    else:
        os.fsync(descriptor)
