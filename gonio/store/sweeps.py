"""One NXdata per incidence and polarization, theta_o against wavelength, for plotting.

The arrays are HDF5 virtual datasets onto the rows of `/entry/data`: nothing is stored twice, so nothing
can disagree, and a sweep fills while the scan runs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise

import h5py
import numpy as np

from gonio.plan.model import Position
from gonio.store.layout import COLUMNS, sweep_name


def write_sweeps(entry: h5py.Group, positions: Sequence[Position]) -> None:
    """Make the groups `/entry/sweep_*` of positions that stand in `/entry/data` in the same order."""
    rows_of: dict[str, list[Position]] = defaultdict(list)
    for position in positions:
        rows_of[sweep_name(position.theta_i_deg, position.polarization)].append(position)
    data = entry["data"]
    for name, members in rows_of.items():
        members.sort(key=lambda position: position.theta_o_deg)
        rows = [position.index for position in members]
        group = entry.create_group(name)
        group.attrs["NX_class"] = "NXdata"
        group.attrs["signal"] = "r"
        group.attrs["axes"] = ["theta_o", "wavelength"]
        group.attrs["theta_o_indices"] = 0
        group.attrs["wavelength_indices"] = 1
        group.attrs["title"] = f"r at theta_i = {members[0].theta_i_deg:g} deg, {members[0].polarization}"
        for column in ("r", "r_errors", "theta_o"):
            group.create_virtual_dataset(column, _rows_of(data[column], rows), fillvalue=np.nan)
            group[column].attrs.update(COLUMNS[column].attributes())
        group["wavelength"] = data["wavelength"]
        group.create_dataset("theta_i", data=members[0].theta_i_deg).attrs["units"] = "deg"
        group["theta_i"].attrs["quantity"] = "incidence angle from the sample normal, as planned"


def _rows_of(source: h5py.Dataset, rows: list[int]) -> h5py.VirtualLayout:
    """Map rows of a dataset of the same file, one block per run of consecutive rows."""
    layout = h5py.VirtualLayout(shape=(len(rows), *source.shape[1:]), dtype=source.dtype)
    # "." is this file, whatever it is called or renamed to
    origin = h5py.VirtualSource(".", source.name, shape=source.shape)
    breaks = [i + 1 for i, (a, b) in enumerate(pairwise(rows)) if b != a + 1]
    for low, high in pairwise([0, *breaks, len(rows)]):
        layout[low:high] = origin[rows[low] : rows[low] + high - low]
    return layout
