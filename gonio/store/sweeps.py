"""One NXdata per incidence and polarization, theta_o against wavelength, for plotting.

The arrays are HDF5 virtual datasets onto the rows of `/entry/data`: nothing is stored twice, so nothing
can disagree, and a sweep fills while the scan runs.  HDF5 takes a view's memory and time with the square of
its pieces, so a plan that scatters its rows (random order, thousands of positions) has copies instead, made
when the scan ends.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise

import h5py
import numpy as np

from gonio.plan.model import Position
from gonio.store.layout import COLUMNS, sweep_name

_MOST_PIECES = 1000  # of all sweeps together; views of them are made in a tenth of a second
_BLOCK = 1024
_VIEWED = ("r", "r_errors", "theta_o")


def write_sweeps(entry: h5py.Group, positions: Sequence[Position]) -> None:
    """Make the groups `/entry/sweep_*` of positions that stand in `/entry/data` in the same order."""
    rows_of: dict[str, list[Position]] = defaultdict(list)
    for position in positions:
        rows_of[sweep_name(position.theta_i_deg, position.polarization)].append(position)
    data = entry["data"]
    for members in rows_of.values():
        members.sort(key=lambda position: position.theta_o_deg)
    scattered = sum(len(_pieces(members)) for members in rows_of.values()) > _MOST_PIECES
    for name, members in rows_of.items():
        rows = [position.index for position in members]
        group = entry.create_group(name)
        group.attrs["NX_class"] = "NXdata"
        group.attrs["signal"] = "r"
        group.attrs["axes"] = ["theta_o", "wavelength"]
        group.attrs["theta_o_indices"] = 0
        group.attrs["wavelength_indices"] = 1
        group.attrs["title"] = f"r at theta_i = {members[0].theta_i_deg:g} deg, {members[0].polarization}"
        for column in _VIEWED:
            if scattered:
                shape = (len(rows), *data[column].shape[1:])
                group.create_dataset(column, shape, data[column].dtype, fillvalue=np.nan)
            else:
                group.create_virtual_dataset(column, _rows_of(data[column], members), fillvalue=np.nan)
            group[column].attrs.update(COLUMNS[column].attributes())
        group.attrs["position_indices"] = 0
        group["position"] = np.array(rows, dtype=np.int64)
        group["position"].attrs.update(COLUMNS["position"].attributes())
        group["wavelength"] = data["wavelength"]
        group.create_dataset("theta_i", data=members[0].theta_i_deg).attrs["units"] = "deg"
        group["theta_i"].attrs["quantity"] = "incidence angle from the sample normal, as planned"


def fill_sweeps(entry: h5py.Group) -> None:
    """Copy what is measured into the sweeps that are no views."""
    data = entry["data"]
    for name in entry:
        if not name.startswith("sweep_") or entry[name]["r"].is_virtual:
            continue
        rows = entry[name]["position"][...]
        for low in range(0, len(rows), _BLOCK):
            chosen = rows[low : low + _BLOCK]
            ascending, back = np.unique(chosen, return_inverse=True)  # HDF5 selects rows in their order only
            for column in _VIEWED:
                entry[name][column][low : low + len(chosen)] = data[column][ascending][back]


def _pieces(members: Sequence[Position]) -> list[int]:
    """Return where runs of consecutive rows begin."""
    rows = [position.index for position in members]
    return [0, *(i + 1 for i, (a, b) in enumerate(pairwise(rows)) if b != a + 1)]


def _rows_of(source: h5py.Dataset, members: Sequence[Position]) -> h5py.VirtualLayout:
    """Map rows of a dataset of the same file, one block per run of consecutive rows."""
    layout = h5py.VirtualLayout(shape=(len(members), *source.shape[1:]), dtype=source.dtype)
    # "." is this file, whatever it is called or renamed to
    origin = h5py.VirtualSource(".", source.name, shape=source.shape)
    for low, high in pairwise([*_pieces(members), len(members)]):
        first = members[low].index
        layout[low:high] = origin[first : first + high - low]
    return layout
