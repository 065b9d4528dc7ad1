"""Spectra brought in beside a scan: the integrating sphere of the same sample, the simulated bench's truth.

A CSV file has one header line; the first column is the wavelength, and the unit is the end of a name
after an underscore (``wavelength_nm``, ``theta_i_deg``), none for a ratio (``k_g``).  Lines that begin
with ``#`` are kept as the description.  What else is known of a spectrum (where it comes from, in which
geometry it was measured) is kept as text attributes of its group; see `gonio.sphere.stored`.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np

from gonio.devices import FloatArray
from gonio.errors import StoreError
from gonio.store.checked import Checked
from gonio.store.layout import SPECTRUM_GROUPS
from gonio.store.read import opened

_UNITS = {"nm": "nm", "um": "um", "deg": "deg", "rad": "rad", "percent": "%"}
"""Endings that are units; ``s`` and ``v`` are not among them, since k_s is no time."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_LARGEST_BYTES = 20_000_000
_LONGEST_FACT = 2000
"""Characters; all attributes of an HDF5 object together may have 64 kB."""


def attach_csv_spectrum(path: str | os.PathLike[str], group: str, csv_path: str | os.PathLike[str]) -> None:
    """Store the columns of a CSV file as NXdata ``/entry/GROUP`` of a scan file, in place of what was there.

    Parameters
    ----------
    path
        A finished scan file.
    group
        ``sphere`` or ``simulated_truth``.
    csv_path
        Header and columns as the module says; an empty cell is NaN, but not in the first column.

    Raises
    ------
    StoreError
        Either file cannot be used; the scan file is then as before.
    """
    _check_group(group)
    columns, description = read_csv_spectrum(Path(csv_path))
    attach_spectrum(path, group, columns, {"description": description} if description else {})


def attach_spectrum(
    path: str | os.PathLike[str],
    group: str,
    columns: Mapping[str, FloatArray],
    facts: Mapping[str, str | float],
) -> None:
    """Store columns as NXdata ``/entry/GROUP`` of a scan file, in place of what was there.

    Parameters
    ----------
    columns
        (k,) each, by names as in the module's CSV; the first is ``wavelength_nm``, ascending.
    facts
        Attributes of the group; a longer text than 2000 characters is cut.

    Raises
    ------
    StoreError
        The scan file cannot be used; it is then as before.
    """
    path = Path(path)
    _check_group(group)
    with opened(path, "r+") as file:
        entry = file.get("entry")
        if not isinstance(entry, h5py.Group) or "data" not in entry:
            raise StoreError(
                f"{path}: is not a gonio scan: /entry/data is missing; give a file written by gonio scan"
            )
        made = f".{group}"  # complete first, then moved into place
        if made in entry:
            del entry[made]
        _write(entry.create_group(made), columns, facts)
        if group in entry:
            del entry[group]
        entry.move(made, group)


def read_spectrum(path: str | os.PathLike[str], group: str) -> dict[str, FloatArray]:
    """Return the columns of ``/entry/GROUP`` by their names in the CSV header, each (k,) float64.

    Raises
    ------
    StoreError
        There is no such spectrum in the file.
    """
    path = Path(path)
    _check_group(group)
    with opened(path, "r") as file:
        parts = Checked(path, file)
        if not parts.has("entry") or not parts.has(f"entry/{group}"):
            raise StoreError(
                f"{path}: holds no /entry/{group}; bring one in with gonio.store.attach_csv_spectrum"
            )
        columns: dict[str, FloatArray] = {}
        shape = None
        for name in parts.group(f"entry/{group}").attrs["columns"]:
            where = f"entry/{group}/{_dataset_name(str(name))}"
            columns[str(name)] = parts.numbers(where, 1, "f", shape)
            shape = columns[str(name)].shape
        return columns


def read_facts(path: str | os.PathLike[str], group: str, names: Sequence[str]) -> dict[str, str]:
    """Return the text attributes of ``/entry/GROUP`` that are there and not empty; `StoreError` as above."""
    path = Path(path)
    _check_group(group)
    with opened(path, "r") as file:
        parts = Checked(path, file)
        found = {name: parts.attribute(f"entry/{group}", name) for name in names}
        return {name: text for name, text in found.items() if text}


def read_csv_spectrum(path: Path) -> tuple[dict[str, FloatArray], str]:
    """Return the columns of a CSV file by name, and its comments; `StoreError` names a mistake's line."""
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise StoreError(
                f"{path}: is larger than {_LARGEST_BYTES} bytes, which no spectrum is; check the file"
            )
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise StoreError(f"{path}: there is no such file; check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError(f"{path}: cannot be read ({error}); give a CSV file in UTF-8") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    comments = [line.lstrip("# ").rstrip() for _, line in lines if line.startswith("#")]
    lines = [(number, line) for number, line in lines if not line.startswith("#")]
    if len(lines) < 2:
        raise StoreError(f"{path}: holds no header line and values below it; give a CSV file with a header")
    header = [name.strip() for name in next(csv.reader(io.StringIO(lines[0][1])))]
    _check_header(path, lines[0][0], header)
    rows = [_values(path, number, line, header) for number, line in lines[1:]]
    table = np.array(rows, dtype=np.float64)
    if not np.all(np.diff(table[:, 0]) > 0):
        at = int(np.flatnonzero(~(np.diff(table[:, 0]) > 0))[0]) + 1
        raise StoreError(
            f"{path}, line {lines[1 + at][0]}: {header[0]} = {table[at, 0]:g} does not ascend; sort the lines"
        )
    return {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(header)}, "\n".join(comments)


def _check_header(path: Path, number: int, header: list[str]) -> None:
    for name in header:
        if not _NAME.fullmatch(name):
            raise StoreError(
                f"{path}, line {number}: '{name}' is no column name; use letters, digits and underscores, "
                "such as wavelength_nm"
            )
    if len(set(map(_dataset_name, header))) != len(header):
        raise StoreError(f"{path}, line {number}: a column name is there twice; rename one")
    if header[0] != "wavelength_nm":
        raise StoreError(
            f"{path}, line {number}: the first column is '{header[0]}'; it must be wavelength_nm"
        )
    if len(header) < 2:
        raise StoreError(f"{path}, line {number}: there is no column beside the wavelength; add one")


def _values(path: Path, number: int, line: str, header: list[str]) -> list[float]:
    cells = next(csv.reader(io.StringIO(line)))
    if len(cells) != len(header):
        raise StoreError(
            f"{path}, line {number}: {len(cells)} values under {len(header)} names; correct that line"
        )
    values: list[float] = []
    for name, cell in zip(header, cells, strict=True):
        try:
            value = float(cell) if cell.strip() or not values else np.nan
        except ValueError:
            raise StoreError(
                f"{path}, line {number}: {name} = '{cell}' is not a number; correct it"
            ) from None
        values.append(value)
    if not (np.isfinite(values[0]) and values[0] > 0):
        raise StoreError(f"{path}, line {number}: {header[0]} = {values[0]} is not a wavelength; correct it")
    return values


def _write(group: h5py.Group, columns: Mapping[str, FloatArray], facts: Mapping[str, str | float]) -> None:
    names = list(columns)
    group.attrs["NX_class"] = "NXdata"
    group.attrs["columns"] = names
    group.attrs["axes"] = ["wavelength"]
    group.attrs["signal"] = _dataset_name(names[1])
    if len(names) > 2:
        group.attrs["auxiliary_signals"] = [_dataset_name(name) for name in names[2:]]
    for name, fact in facts.items():
        group.attrs[name] = fact[:_LONGEST_FACT] if isinstance(fact, str) else fact
    for name, values in columns.items():
        dataset = group.create_dataset(_dataset_name(name), data=values)
        dataset.attrs["units"] = _unit(name)
        dataset.attrs["quantity"] = _dataset_name(name)


def _unit(name: str) -> str:
    return _UNITS.get(name.rpartition("_")[2], "1") if "_" in name else "1"


def _dataset_name(name: str) -> str:
    """Return the column's name without its unit."""
    stem, _, last = name.rpartition("_")
    return stem if stem and last in _UNITS else name


def _check_group(group: str) -> None:
    if group not in SPECTRUM_GROUPS:
        raise StoreError(f"'{group}' is no place for a spectrum; use one of: {', '.join(SPECTRUM_GROUPS)}")
