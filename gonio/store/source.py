"""What a scan file says of the source that chose its positions, and of each position that it chose."""

from __future__ import annotations

from collections.abc import Sequence

import h5py
import numpy as np

from gonio.plan.model import Plan, Position
from gonio.store.describe import nexus_group, quantity, text_dataset
from gonio.store.records import DecisionRecord, ScanHeader
from gonio.store.sweeps import write_sweeps

_ONE_LETTER = h5py.string_dtype("utf-8", 1)


def known_positions(
    header: ScanHeader, plan: Plan, decided: Sequence[Position] | None
) -> Sequence[Position] | None:
    """Return the positions of a scan; None while a source has not decided all of them yet."""
    return plan.positions() if header.source is None else decided


def rows_of(header: ScanHeader, positions: Sequence[Position] | None) -> int:
    """Return how many rows the file has: all that a source may ask for, until it has ended."""
    if positions is None:
        assert header.source is not None  # else they are the plan's
        return header.source.max_positions
    return len(positions)


def write_positions(entry: h5py.Group, positions: Sequence[Position] | None) -> None:
    """Write what was asked for, and the sweeps; None leaves that to `write_decision` and the scan's end."""
    data = entry["data"]
    if positions is None:
        for name in ("theta_i_set", "theta_mes_set"):
            data[name][...] = np.nan
        return
    data["theta_i_set"][...] = [p.theta_i_deg for p in positions]
    data["theta_mes_set"][...] = [p.theta_mes_deg for p in positions]
    data["polarization"][...] = np.array([p.polarization for p in positions], dtype=_ONE_LETTER)
    write_sweeps(entry, positions)


def write_decision(data: h5py.Group, record: DecisionRecord) -> None:
    """Write what a source asked for into the position's row."""
    data["theta_i_set"][record.index] = record.theta_i_deg
    data["theta_mes_set"][record.index] = record.theta_mes_deg
    data["polarization"][record.index] = np.array(record.polarization, dtype=_ONE_LETTER)


def write_source(entry: h5py.Group, header: ScanHeader) -> None:
    """Write `/entry/source` of a scan that has one."""
    if header.source is None:
        return
    group = nexus_group(entry, "source", "NXcollection")
    text_dataset(group, "name", header.source.name)
    text_dataset(group, "version", header.source.version)
    text_dataset(group, "text", header.source.text)
    quantity(group, "max_positions", header.source.max_positions, "1", "most positions it may ask for")
