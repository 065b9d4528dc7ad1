"""Is a file what docs/file.md says?  Groups, attributes, units, dimensions, types; then what they hold.

Nothing in the file is trusted, and nothing is changed.  What the values must fulfil is in
`gonio.store.check_values`.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from gonio.aperture import Aperture
from gonio.errors import ConfigError, StoreError
from gonio.store.check_facade import check_facade
from gonio.store.check_values import check_values
from gonio.store.checked import Checked
from gonio.store.findings import Finding, Findings
from gonio.store.guard import dangers
from gonio.store.layout import (
    COLUMNS,
    EVENT_COLUMNS,
    EVENT_TEXTS,
    REFERENCE_COLUMNS,
    REFERENCE_TEXTS,
    SPECTRUM_GROUPS,
    Column,
)
from gonio.store.read import opened

FACADE_TYPE = "gonio facade simulation"
_TEXTS = ("title", "start_time", "program", "plan", "rig", "experiment_type", "angle_reference_frame")
_MOST_TEXTS = 10_000_000


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a file is, in words, and what is wrong with it."""

    kind: str
    findings: list[Finding] = field(default_factory=list)


def check_file(path: Path) -> Verdict:
    """Check a file; one that cannot be opened, or is something else, has one finding that says so."""
    try:
        with opened(path, "r", guarded=False) as file:
            dangerous = [
                Finding(str(path), danger, "do not use the file as it is") for danger in dangers(path, file)
            ]
            if dangerous:
                return Verdict("HDF5 file that is not safe to read", dangerous)
            return _checked(path, file)
    except StoreError as error:
        text = str(error).removeprefix(f"{path}: ")
        problem, _, remedy = text.partition("; ")
        return Verdict(
            "no file that can be checked", [Finding(str(path), problem, remedy or "check the path")]
        )


def _checked(path: Path, file: h5py.File) -> Verdict:
    parts = Checked(path, file)
    found = Findings(parts)
    if not parts.has("entry"):
        return Verdict(
            "HDF5 file of another program",
            [Finding("/", "is not a gonio file: /entry is missing", "give a file written by gonio")],
        )
    entry = found.get(parts.group, "entry")
    if entry is None:
        return Verdict("HDF5 file of another program", found.found)
    kind = found.get(parts.text, "entry/experiment_type") if parts.has("entry/experiment_type") else ""
    if kind == FACADE_TYPE:
        interrupted = check_facade(found, entry)
        beside = f", interrupted; go on with gonio facade --resume {path}" if interrupted else ""
        return Verdict(f"facade result{beside}", found.found)
    if not parts.has("entry/data"):
        found.add("entry/data", "is missing: no scan is in this file", "give a file written by gonio scan")
        return Verdict("HDF5 file of another program", found.found)
    status = parts.attribute("entry", "scan_status")
    _check_scan(found, status)
    journal = path.with_name(path.name + ".journal")
    if status == "finished" and journal.exists():
        found.add(
            "entry", f"is finished, but {journal.name} lies beside it", f"run gonio scan --resume {path} once"
        )
    shape = parts.declared_shape("entry/data/r", 2) if not found.found else None
    size = f", {shape[0]} positions x {shape[1]} wavelengths" if shape else ""
    beside = "; continue it with gonio scan --resume" if journal.exists() else ", without its journal"
    return Verdict(
        f"scan{size}, " + ("finished" if status == "finished" else f"unfinished{beside}"), found.found
    )


def _check_scan(found: Findings, status: str) -> None:
    parts = found.parts
    found.attribute("", "NX_class", "NXroot")
    found.attribute("", "default", "entry")
    found.group("entry", "NXentry")
    found.attribute("entry", "default", "data")
    if status not in ("finished", "unfinished"):
        found.add("entry", f"attribute scan_status is '{status}'", "set it to finished or unfinished")
    for name in _TEXTS:
        found.get(parts.text, f"entry/{name}")
    for name in ("start_time", "end_time"):
        if name == "end_time" and status != "finished":
            continue
        text = found.get(parts.text, f"entry/{name}")
        if text is not None and not _is_time(text):
            found.add(f"entry/{name}", f"'{text}' is no time", "write it as 2026-11-24T09:30:00+01:00")
    if found.group("entry/sample", "NXsample") is not None:
        found.get(parts.text, "entry/sample/name")
    names = found.get(parts.texts, "entry/data/detector_names") or ()
    _check_instrument(found, names)
    n_m = _check_data(found)
    if n_m is None:
        return
    n, m = n_m
    k = _check_rows(found, "references", REFERENCE_COLUMNS, REFERENCE_TEXTS, m)
    events = _check_rows(found, "events", EVENT_COLUMNS, EVENT_TEXTS, m)
    for group in parts.group("entry"):
        if group.startswith("sweep_"):
            _check_plot(found, f"entry/{group}", "r", ("theta_o", "wavelength"))
        elif group in SPECTRUM_GROUPS:
            found.group(f"entry/{group}", "NXdata")
    if not found.found:
        check_values(found, n, m, k, events, finished=status == "finished")


def _check_instrument(found: Findings, detectors: tuple[str, ...]) -> None:
    parts, where = found.parts, "entry/instrument"
    if found.group(where, "NXinstrument") is None:
        return
    for name, nx_class in (
        ("aperture", "NXaperture"),
        ("monochromator", "NXmonochromator"),
        ("polarizer", "NXpolarizer"),
        ("source", "NXsource"),
        ("beam", "NXbeam"),
        *((f"detector_{name}", "NXdetector") for name in detectors),
    ):
        found.group(f"{where}/{name}", nx_class)
    size = [found.get(parts.scalar, f"{where}/aperture/{name}") for name in ("width", "height", "distance")]
    omega = found.get(parts.scalar, f"{where}/aperture/solid_angle")
    if None in size or omega is None:
        return
    for name, units in (("width", "mm"), ("height", "mm"), ("distance", "mm"), ("solid_angle", "sr")):
        found.attribute(f"{where}/aperture/{name}", "units", units)
    try:
        expected = Aperture(*size).solid_angle_sr
    except (ConfigError, ValueError) as error:
        found.add(f"{where}/aperture", str(error), "write the aperture as measured with a ruler")
        return
    if not np.isclose(omega, expected, rtol=1e-9):
        found.add(
            f"{where}/aperture/solid_angle", f"is {omega:g} sr, of these sizes {expected:g} sr", "correct it"
        )


def _check_data(found: Findings) -> tuple[int, int] | None:
    """Check the datasets of `/entry/data` and return n and m; None if they cannot be told."""
    parts = found.parts
    shape = found.get(parts.declared_shape, "entry/data/r", 2)
    if shape is None:
        return None
    n_m: tuple[int, int] = shape
    _check_plot(found, "entry/data", "r", ("position", "wavelength"))
    for name, column in COLUMNS.items():
        _check_column(found, f"entry/data/{name}", column, *n_m)
        if column.dims != "nm" and _number(parts, "entry/data", f"{name}_indices") != (column.dims == "m"):
            found.add(
                "entry/data",
                f"attribute {name}_indices is missing or wrong",
                f"set it to {int(column.dims == 'm')}",
            )
    return n_m


def _check_column(found: Findings, place: str, column: Column, n: int, m: int) -> None:
    dataset = found.get(found.parts.dataset, place)
    if dataset is None:
        return
    expected = {"nm": (n, m), "n": (n,), "m": (m,)}[column.dims]
    if dataset.shape != expected:
        found.add(place, f"has shape {dataset.shape}, expected {expected}")
    kinds = "S" if column.dtype == "str" else np.dtype(column.dtype).kind
    if dataset.dtype.kind != kinds:
        found.add(place, f"holds {dataset.dtype}, expected {column.dtype}")
    found.attribute(place, "quantity")
    if column.units:
        found.attribute(place, "units", column.units)


def _check_rows(
    found: Findings, group: str, columns: dict[str, Column], texts: dict[str, str], m: int
) -> int:
    """Check a group of rows that grow, and return their number."""
    parts, where = found.parts, f"entry/{group}"
    if found.group(where, "NXcollection") is None:
        return 0
    shape = found.get(parts.declared_shape, f"{where}/time", 2 if columns["time"].dims == "nm" else 1)
    if shape is None:
        return 0
    for name, column in columns.items():
        _check_column(found, f"{where}/{name}", column, shape[0], m)
    for name in texts:
        if shape[0] and (rows := found.get(parts.texts, f"{where}/{name}", _MOST_TEXTS)) is not None:
            if len(rows) != shape[0]:
                found.add(f"{where}/{name}", f"has {len(rows)} rows, time has {shape[0]}")
            found.attribute(f"{where}/{name}", "quantity")
    return int(shape[0])


def _check_plot(found: Findings, place: str, signal: str, axes: tuple[str, ...]) -> None:
    """Check what a NeXus viewer needs of an NXdata."""
    group = found.group(place, "NXdata")
    if group is None:
        return
    found.attribute(place, "signal", signal)
    found.attribute(place, "title")
    named = group.attrs.get("axes")
    told = [str(name) for name in named] if isinstance(named, np.ndarray) and named.ndim == 1 else []
    if told != list(axes):
        found.add(place, f"attribute axes is {told}", f"set it to {list(axes)}")
    members = [
        found.get(found.parts.object, f"{place}/{name}") for name in (signal, f"{signal}_errors", *axes)
    ]
    if any(not isinstance(member, h5py.Dataset) for member in members):
        return
    shape = tuple(axis.shape[0] if axis.shape else 0 for axis in members[2:])
    for name, member in zip((signal, f"{signal}_errors"), members[:2], strict=True):
        if member.shape != shape:
            found.add(f"{place}/{name}", f"has shape {member.shape}, its axes {shape}")


def _number(parts: Checked, place: str, attribute: str) -> int | None:
    attributes = parts.object(place).attrs
    if attribute not in attributes or attributes.get_id(attribute).shape != ():
        return None
    value = attributes[attribute]
    return int(value) if isinstance(value, np.integer) else None


def _is_time(text: str) -> bool:
    try:
        return datetime.datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False
