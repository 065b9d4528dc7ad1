"""The NeXus file of a scan, written position by position.

`ScanFile` holds nothing that the journal does not: it may be lost or torn at any time and is then made anew
(`gonio.acquire`).  Rows of positions not measured yet hold NaN and the quality flag NOT_MEASURED.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.errors import StoreError
from gonio.plan.model import Plan, Position
from gonio.store.describe import link_instrument, nexus_group, text_list, write_entry
from gonio.store.latest import LatestReduction
from gonio.store.layout import (
    COLUMNS,
    EVENT_COLUMNS,
    EVENT_TEXTS,
    QUALITY_BITS,
    REFERENCE_COLUMNS,
    REFERENCE_TEXTS,
    Column,
    chunk_rows,
)
from gonio.store.records import DecisionRecord, EventRecord, PositionRecord, ReferenceRecord, ScanHeader
from gonio.store.reduction import Reduced, Reduction
from gonio.store.source import known_positions, rows_of, write_decision, write_positions, write_source
from gonio.store.sweeps import fill_sweeps
from gonio.store.verdict import beamless, changes, no_beam_message

_ABANDONED: list[ScanFile] = []  # kept, so that the collector does not close them
_CACHED_BYTES = 131_072  # of each dataset: the rows being written; each flush looks at every chunk kept
_BLOCK = 1024  # rows corrected at a time: a few MB, however long the scan


@contextmanager
def explained(path: Path, doing: str) -> Iterator[None]:
    """Turn what h5py and the operating system say into a `StoreError` with the path."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise StoreError(
            f"{path}: cannot be {doing} ({error}); check the disk's free space and rights"
        ) from error


class ScanFile:
    """An open scan file: `add_*`, then `finish` and `close`.

    In mode ``memory`` nothing is on the disk, and `path` is but the name in messages.  Where a source chooses
    the positions there are rows for all that it may ask for, or for those `decided` once it has ended.
    """

    def __init__(
        self,
        path: Path,
        header: ScanHeader,
        plan: Plan,
        mode: Literal["x", "w", "memory"],
        decided: Sequence[Position] | None = None,
    ) -> None:
        self.path = path
        self._plan = plan
        self._header = header
        self._references: list[ReferenceRecord] = []
        self._latest = LatestReduction(header.detector_index)
        self._decided: set[int] | None = None if header.source is None else set()
        try:
            if mode == "memory":
                self._file = h5py.File(str(path), "w", driver="core", backing_store=False)
            else:
                self._file = h5py.File(path, mode, rdcc_nbytes=_CACHED_BYTES)
        except FileExistsError:
            raise StoreError(f"{path} exists already and is never overwritten; choose another name") from None
        except OSError as error:
            raise StoreError(
                f"{path}: cannot be created ({error}); check the folder and its rights"
            ) from None
        try:
            with explained(path, "written"):
                self._describe(decided)
                self._file.flush()
        except BaseException:
            self._file.close()
            if mode != "memory":
                path.unlink(missing_ok=True)  # made just now, and nothing is in it
            raise

    # -- layout
    # ------------------------------------------------------------------------------------------------

    def _describe(self, decided: Sequence[Position] | None) -> None:
        plan, header = self._plan, self._header
        entry = write_entry(self._file, header, plan)
        data = nexus_group(entry, "data", "NXdata")
        data.attrs["signal"] = "r"
        data.attrs["axes"] = ["position", "wavelength"]
        data.attrs["title"] = plan.title
        positions = known_positions(header, plan, decided)
        wavelength_nm = plan.wavelength_nm if header.wavelength_nm is None else header.wavelength_nm
        n, m = rows_of(header, positions), len(wavelength_nm)
        self._n = n
        if m != len(header.detector_index):
            raise StoreError(f"{self.path}: {m} wavelengths, but detectors for {len(header.detector_index)}")
        rows = chunk_rows(m)
        for name, column in COLUMNS.items():
            shape = {"nm": (n, m), "n": (n,), "m": (m,)}[column.dims]
            options: dict[str, Any] = {"dtype": column.dtype, "fillvalue": column.fill}
            if column.dtype == "str":
                options = {"dtype": h5py.string_dtype("utf-8", 1)}
            elif np.dtype(column.dtype).kind in "iu" and not np.isfinite(column.fill):
                del options["fillvalue"]
            if column.dims == "nm":
                options["chunks"] = (min(rows, n), m)
            dataset = data.create_dataset(name, shape, **options)
            dataset.attrs.update(column.attributes())
            if column.dims == "n" and column.dtype == "f8":
                dataset[...] = np.nan  # takes its place on the disk, so that a file's size vouches for its n
            if column.dims in ("n", "m"):
                data.attrs[f"{name}_indices"] = 0 if column.dims == "n" else 1
        data["quality"].attrs["bits"] = QUALITY_BITS
        data["wavelength"][...] = wavelength_nm
        data["detector_index"][...] = header.detector_index
        data["position"][...] = np.arange(n)
        names = [detector.name for detector in header.rig.detectors]
        text_list(data, "detector_names", names, "detector names, in the order of detector_index")
        self._use_columns(data)
        write_positions(entry, positions)
        write_source(entry, header)
        link_instrument(entry, header.detector_index, names)
        self._describe_references(entry, m)
        events = nexus_group(entry, "events", "NXcollection")
        for name, what in EVENT_TEXTS.items():
            text_list(events, name, None, what)
        for name, column in EVENT_COLUMNS.items():
            _growing(events, name, column, m)
        self._entry = entry

    def _use_columns(self, data: h5py.Group) -> None:
        """Keep the columns at hand, and what a write to each needs: making that costs more than the write."""
        self._columns = {name: data[name] for name in COLUMNS}
        self._memory: dict[tuple[int, ...], Any] = {}  # dataspaces by shape
        self._places = {
            name: (dataset.id, dataset.id.get_space(), h5py.h5t.py_create(dataset.dtype))
            for name, dataset in self._columns.items()
        }

    def _describe_references(self, entry: h5py.Group, m: int) -> None:
        group = nexus_group(entry, "references", "NXcollection")
        for name, what in REFERENCE_TEXTS.items():
            text_list(group, name, None, what)
        for name, column in REFERENCE_COLUMNS.items():
            _growing(group, name, column, m)

    # -- what is measured
    # --------------------------------------------------------------------------------------

    def add_reference(self, record: ReferenceRecord) -> None:
        """Append a reference; r already stored changes only at `finish`."""
        with explained(self.path, "written"):
            _append(
                self._entry["references"],
                {
                    "kind": record.kind,
                    "when": record.when,
                    "polarization": record.polarization,
                    "averages": np.max(record.averages),
                    "theta_i": record.theta_i_deg,
                    "theta_mes": record.theta_mes_deg,
                    "time": record.time_s,
                    "signal": record.signal_v,
                    "signal_sd": record.signal_sd_v,
                    "wavelength_readback": record.wavelength_nm,
                    "quality": record.quality,
                },
            )
        self._references.append(record)
        self._latest.add(record)

    def add_decision(self, record: DecisionRecord) -> None:
        """Write what a source asked for, before it is measured."""
        self._refuse_beyond(record.index)
        with explained(self.path, "written"):
            write_decision(self._entry["data"], record)
        if self._decided is not None:
            self._decided.add(record.index)

    def expects(self, index: int) -> bool:
        """Say whether it is known what was asked for at a position; else its readings mean nothing."""
        return self._decided is None or index in self._decided

    def _refuse_beyond(self, index: int) -> None:
        if index >= self._n:
            whose = "the plan" if self._header.source is None else "its source"
            raise StoreError(
                f"{self.path}: position {index} is not among the {self._n} of {whose}; check its journal"
            )

    def add_positions(self, records: Sequence[PositionRecord]) -> None:
        """Write the rows of positions whose indices follow each other without a gap."""
        first, last = records[0].index, records[-1].index
        if [record.index for record in records] != list(range(first, last + 1)):
            raise ValueError("the positions of a block must be consecutive")
        self._refuse_beyond(last)
        raw = _stacked([record.signal_v for record in records])
        raw_sd = _stacked([record.signal_sd_v for record in records])
        time_s = _stacked([record.time_s for record in records])
        averages = np.stack([np.broadcast_to(record.averages, raw.shape[1:]) for record in records])
        theta_i = np.array([record.theta_i_deg for record in records])
        theta_mes = np.array([record.theta_mes_deg for record in records])
        reduced = self._latest.now().apply(
            raw, raw_sd, averages, time_s, [record.polarization for record in records]
        )
        rows = slice(first, last + 1)
        with explained(self.path, "written"):
            self._write_reduced(rows, reduced)
            for name, values in (
                ("raw_signal", raw),
                ("raw_signal_sd", raw_sd),
                ("reading_time", time_s),
                ("wavelength_readback", _stacked([record.wavelength_nm for record in records])),
                ("quality", _stacked([record.quality for record in records])),
                ("theta_i", theta_i),
                ("theta_mes", theta_mes),
                ("theta_o", theta_mes - theta_i),
                ("time", np.fmin.reduce(time_s, axis=1)),  # its pass may run from long to short wavelengths
                ("polarizer_angle", np.array([record.polarizer_deg for record in records])),
                ("averages", averages),
            ):
                self._put(name, rows, values)

    def _put(self, name: str, rows: slice, values: NDArray[Any]) -> None:
        """Write rows of a column by h5py's low level, which takes a tenth of the time of the high one."""
        dataset, place, memory_type = self._places[name]
        contiguous = np.ascontiguousarray(values, dtype=COLUMNS[name].dtype)
        place.select_hyperslab((rows.start,) + (0,) * (contiguous.ndim - 1), contiguous.shape)
        memory = self._memory.get(contiguous.shape)
        if memory is None:
            memory = self._memory[contiguous.shape] = h5py.h5s.create_simple(contiguous.shape)
        dataset.write(memory, place, contiguous, memory_type)

    def _write_reduced(self, rows: slice, reduced: Reduced) -> None:
        for name, values in (
            ("r", reduced.r),
            ("r_errors", reduced.r_sd),
            ("dark", reduced.dark_v),
            ("baseline", reduced.baseline_v),
            ("gain_uncertainty", reduced.gain_u),
            ("offset_uncertainty", reduced.offset_u),
        ):
            self._put(name, rows, values)

    def add_event(self, event: EventRecord) -> None:
        """Append an event."""
        with explained(self.path, "written"):
            _append(
                self._entry["events"],
                {
                    "time": event.time_s,
                    "level": event.level,
                    "source": event.source,
                    "message": event.message,
                },
            )

    def copy_group(self, group: h5py.Group) -> None:
        """Copy a group of another file into `/entry`."""
        group.file.copy(group, self._entry)

    def flush(self) -> None:
        """Hand everything to the operating system, so that the file opens if this process dies now."""
        with explained(self.path, "written"):
            self._file.flush()

    def finish(self, end_time: str) -> list[EventRecord]:
        """Correct every position with all references, and mark the scan as finished.

        Returns what the references say of the lamp and the amplifiers, which is among the events then.
        """
        reduction = Reduction(self._references, self._header.detector_index)
        columns = self._columns
        polarization = columns["polarization"].asstr()[...]
        with explained(self.path, "finished"):
            for low in range(0, len(polarization), _BLOCK):
                rows = slice(low, low + _BLOCK)
                reduced = reduction.apply(
                    columns["raw_signal"][rows],
                    columns["raw_signal_sd"][rows],
                    columns["averages"][rows],
                    columns["reading_time"][rows],
                    polarization[rows].tolist(),
                )
                self._write_reduced(rows, reduced)
        told = self._told_by_references(reduction)
        for event in told:
            self.add_event(event)
        with explained(self.path, "finished"):
            fill_sweeps(self._entry)
            self._entry["end_time"][()] = end_time.encode()
            self._entry.attrs["scan_status"] = "finished"
            self._file.flush()
        return told

    def _told_by_references(self, reduction: Reduction) -> list[EventRecord]:
        """Return what lamp and amplifiers did by the references, as events."""
        if not self._references:
            return []
        time_s, at_s = self._columns["time"][...], float(np.nanmax(self._references[-1].time_s))
        detectors = self._header.rig.detectors
        events: list[EventRecord] = []
        missing = beamless(reduction, self._references, self._header.detector_index)
        if missing:
            message = no_beam_message(missing, [detector.name for detector in detectors])
            events.append(EventRecord(at_s, time.time(), "warning", "store", message))
        for change in changes(reduction, self._references, self._header.detector_index):
            after, before = change.after, change.before
            between = (time_s > np.nanmin(before.time_s)) & (time_s < np.nanmax(after.time_s))
            rows = np.flatnonzero(between)
            message = change.message(
                detectors[change.detector].name,
                (int(rows[0]), int(rows[-1])) if len(rows) else None,
            )
            events.append(EventRecord(at_s, time.time(), change.level, "store", message))
        return events

    @property
    def hdf5(self) -> h5py.File:
        """The open HDF5 file, to be read from."""
        return self._file

    def close(self) -> None:
        """Close the file; more than once does nothing."""
        if self._file.id.valid:
            with explained(self.path, "closed"):
                self._file.close()

    def abandon(self) -> None:
        """Never touch the file again: HDF5 may crash on closing a file whose last flush failed."""
        _ABANDONED.append(self)

    def move_to(self, path: Path) -> None:
        """Put the file in the place of `path` in one step, and go on writing it there."""
        self.close()
        with explained(path, "replaced"):
            sync_file(self.path)
            os.replace(self.path, path)
            sync_folder(path.parent)
            self.path = path
            self._file = h5py.File(path, "r+", rdcc_nbytes=_CACHED_BYTES)
            self._entry = self._file["entry"]
            self._use_columns(self._entry["data"])


def _stacked(rows: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays as rows; one alone, as in a running scan, without a copy."""
    return rows[0][None] if len(rows) == 1 else np.stack(rows)


def _growing(group: h5py.Group, name: str, column: Column, m: int) -> None:
    shape = (m,) if column.dims == "nm" else ()
    dataset = group.create_dataset(
        name, (0, *shape), dtype=column.dtype, maxshape=(None, *shape), chunks=(16, *shape)
    )
    dataset.attrs.update(column.attributes())


def _append(group: h5py.Group, row: dict[str, Any]) -> None:
    """Add one entry to each of the growing datasets of a group."""
    for name, value in row.items():
        dataset = group[name]
        dataset.resize(dataset.shape[0] + 1, axis=0)
        dataset[-1] = value


def sync_file(path: Path) -> None:
    """Wait until a closed file's contents are on the disk."""
    descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Wait until a new, renamed or removed name is on the disk; Windows does this by itself."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
