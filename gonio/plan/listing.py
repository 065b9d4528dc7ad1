"""Position lists from CSV files, brought into the plan so that it needs no other file to be resumed."""

from __future__ import annotations

import csv
import difflib
import math
from pathlib import Path
from typing import Any

from gonio.errors import ConfigError
from gonio.plan.tables import PositionList, refuse_out_of_plane

COLUMNS = ("theta_i_deg", "theta_mes_deg", "polarization")


def position_columns(path: Path) -> dict[str, Any]:
    """Return the columns of a CSV file as the keys of a ``[[positions]]`` table.

    Lines that are empty or begin with ``#`` are passed over; the first other line names the columns.

    Raises
    ------
    ConfigError
        The file cannot be read, a column is unknown or missing, or a value is none; with its line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: there is no such file; give its path as seen from the plan file"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); save it as CSV in UTF-8") from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise ConfigError(f"{path}: is empty; the first line names the columns: {','.join(COLUMNS)}")
    rows = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in lines)]
    header = rows[0]
    _check_header(path, header)
    columns: dict[str, list[Any]] = {name: [] for name in header}
    for (number, _), row in zip(lines[1:], rows[1:], strict=True):
        if len(row) != len(header):
            raise ConfigError(
                f"{path}: line {number} has {len(row)} values for {len(header)} columns; correct it (the "
                "decimal sign is a point, values are separated by commas)"
            )
        for name, cell in zip(header, row, strict=True):
            columns[name].append(_value(path, number, name, cell))
    if not columns["theta_i_deg"]:
        raise ConfigError(f"{path}: names columns but lists no position; add a line for each")
    return {"copied_from": path.name, **columns}


def _check_header(path: Path, header: list[str]) -> None:
    try:
        refuse_out_of_plane(header)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    for name in header:
        if name not in COLUMNS:
            near = difflib.get_close_matches(name, COLUMNS, n=1, cutoff=0.5)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise ConfigError(
                f"{path}: '{name}' is an unknown column; {hint}known columns: {', '.join(COLUMNS)}"
            )
        if header.count(name) > 1:
            raise ConfigError(f"{path}: the column {name} is there twice; remove one")
    for name in COLUMNS[:2]:
        if name not in header:
            raise ConfigError(f"{path}: the column {name} is missing; add it")


def _value(path: Path, number: int, name: str, cell: str) -> float | str:
    if name == "polarization":
        if cell not in ("s", "p"):
            raise ConfigError(
                f"{path}: line {number}: polarization = '{cell}' must be s or p; leave the whole column "
                "out to measure every position in each polarization of the plan"
            )
        return cell
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{path}: line {number}: {name} = '{cell}' is not an angle in degrees; correct it")
    return value


def with_files(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a plan's tables with every ``file`` of its ``[[positions]]`` replaced by what it holds."""
    entries = tables.get("positions")
    if not isinstance(entries, list):
        return tables  # none, or a mistake that the model explains

    def replaced(entry: Any) -> Any:
        if not isinstance(entry, dict) or not isinstance(entry.get("file"), str) or len(entry) > 1:
            return entry
        return position_columns(folder / entry["file"])

    return {**tables, "positions": [replaced(entry) for entry in entries]}


def positions_from_csv(path: str | Path) -> PositionList:
    """Return a position list for a plan made in Python; raises as `position_columns`."""
    return PositionList(**position_columns(Path(path)))
