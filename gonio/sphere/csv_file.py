"""A sphere's spectrum as CSV: a header line such as ``nm,%R``, then a line for each wavelength.

Above the header may stand a title and other lines, or comments with ``#``.  Columns are parted by tabulators,
semicolons or commas, whichever the header has; decimals by a point or, unless commas part the columns, by a
comma.  The first column is the wavelength and names its unit; a column whose name ends in ``_u`` is an
uncertainty.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import StoreError
from gonio.sphere.file import SphereFile
from gonio.sphere.ordinate import factor_of, ordinate_of
from gonio.sphere.points import spectrum_of
from gonio.sphere.raw import MOST_POINTS, clipped, lines_of, number_of, text_of

FloatArray = NDArray[np.float64]

COLUMN_OPTION = "--sphere-column"
_OURS = ("k_g", "k_d")
_NUMBERS = re.compile(r'\s*"?[+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?"?\s*(?:[,;\t]|$)', re.ASCII)
_MOST_COLUMNS = 100
_UNITS = {"nm": 1.0, "nanometer": 1.0, "nanometers": 1.0, "nanometre": 1.0, "nanometres": 1.0, "um": 1e3,
          "µm": 1e3, "μm": 1e3, "micron": 1e3, "microns": 1e3}  # fmt: skip


def read_csv(
    path: Path,
    data: bytes,
    digest: str,
    *,
    reads: str | None,
    column: str | None,
    only_nm: tuple[float, float] | None,
) -> SphereFile:
    """Return the spectrum in a CSV file; `StoreError` names a mistake's line, counted from 1."""
    lines = lines_of(text_of(path, data))
    numbered = [(n, line) for n, line in enumerate(lines, start=1) if line.strip()]
    comments = [line.strip().strip('"') for _, line in numbered if _is_comment(line)]
    numbered = [(n, line) for n, line in numbered if not _is_comment(line)]
    first = next((i for i, (_, line) in enumerate(numbered) if _NUMBERS.match(line)), None)
    if first is None:
        raise StoreError(
            f"{path}: holds no line that begins with a number; give a CSV, or a PerkinElmer .asc or .sp file"
        )
    if first == 0:
        raise StoreError(
            f"{path}, line {numbered[0][0]}: begins with numbers, and no header says what they are; put one "
            "above them, such as nm,%R"
        )
    if len(numbered) - first > MOST_POINTS:
        raise StoreError(
            f"{path}: holds {len(numbered) - first} lines of numbers, more than {MOST_POINTS}, which no "
            "spectrum of a sphere has; check the file"
        )
    head_line, head = numbered[first - 1]
    delimiter = next((c for c in "\t;," if c in head), None)
    if delimiter is None:
        raise StoreError(
            f"{path}, line {head_line}: the header '{clipped(head, 60)}' has no tabulator, semicolon or "
            "comma between its columns; correct it"
        )
    names = [name.strip() for name in _cells(path, head_line, head, delimiter)]
    open_end = len(names) > 2 and not names[-1]  # "nm;%R;" is two columns
    names = names[:-1] if open_end else names
    scale = _scale_nm(path, head_line, names[0])
    chosen = _chosen(path, head_line, names, column)
    factor, remark = factor_of(ordinate_of(names[chosen]), reads, f"{path}, line {head_line}")

    table, rows = _table(path, numbered[first:], names, delimiter, open_end, required=(0, chosen))
    w, r, index = spectrum_of(
        path, scale * table[:, 0], table[:, chosen], factor, lambda i: f"line {rows[i]}", only_nm
    )
    others = {
        name: np.ascontiguousarray(table[index, i])
        for i, name in enumerate(names)
        if i not in (0, chosen) and name
    }
    above = [line.strip().strip('"') for _, line in numbered[: first - 1]] + comments
    facts = {"description": clipped("; ".join(line.lstrip("# ") for line in above))} if above else {}
    return SphereFile(
        path=path, format="CSV", sha256=digest, wavelength_nm=w, reflectance=r, ordinate=names[chosen],
        factor=factor, columns=others, facts=facts, remarks=(remark,) if remark else (),
    )  # fmt: skip


def _is_comment(line: str) -> bool:
    return line.lstrip().lstrip('"').startswith("#")


def _cells(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except (csv.Error, StopIteration) as error:
        raise StoreError(f"{path}, line {number}: cannot be read ({error}); correct it") from None


def _scale_nm(path: Path, number: int, name: str) -> float:
    """Return the factor from the first column to nm."""
    words = re.findall(r"[a-zµμ]+(?:-1|⁻¹)?", name.lower())
    units = [word for word in words if word in _UNITS]
    if len(set(units)) != 1:
        raise StoreError(
            f"{path}, line {number}: the first column is '{clipped(name, 40)}'; it must be the wavelength, "
            "with its unit nm or um in the header, such as nm or Wavelength (nm)"
        )
    return _UNITS[units[0]]


def _chosen(path: Path, number: int, names: list[str], column: str | None) -> int:
    """Return the number of the column of the reflectance."""
    if len(names) > _MOST_COLUMNS:
        raise StoreError(f"{path}, line {number}: has {len(names)} columns; leave those of the sphere")
    if len(set(names)) != len(names):
        raise StoreError(f"{path}, line {number}: a column name is there twice; rename one")
    if column is not None:
        if column not in names[1:]:
            raise StoreError(
                f"{path}, line {number}: has no column '{column}', but {', '.join(names[1:])}; choose one of "
                "them"
            )
        return names.index(column)
    able = [i for i, name in enumerate(names) if i and name and not name.endswith("_u")]
    ours = [i for i in able if names[i] in _OURS]
    if len(able) != 1 and ours:
        able = ours[:1]
    if len(able) != 1:
        listed = ", ".join(repr(names[i]) for i in able) or "none"
        raise StoreError(
            f"{path}, line {number}: one column beside the wavelength must be the reflectance, and there "
            f"are: {listed}; choose with {COLUMN_OPTION} NAME"
        )
    return able[0]


def _table(
    path: Path,
    numbered: list[tuple[int, str]],
    names: list[str],
    delimiter: str,
    open_end: bool,
    required: tuple[int, int],
) -> tuple[FloatArray, list[int]]:
    """Return the numbers, (k, columns), and the lines they stand in; NaN for an empty cell that may be."""
    table = np.full((len(numbered), len(names)), np.nan)
    comma = point = 0  # the first line with a decimal comma, with a decimal point
    for row, (number, line) in enumerate(numbered):
        cells = _cells(path, number, line, delimiter)
        if open_end and len(cells) == len(names) + 1 and not cells[-1].strip():
            cells = cells[:-1]
        if len(cells) != len(names):
            hint = "; decimal commas need semicolons between the columns" if delimiter == "," else ""
            raise StoreError(
                f"{path}, line {number}: {len(cells)} values under {len(names)} names; correct that "
                f"line{hint}"
            )
        for i, cell in enumerate(cells):
            if not cell.strip() and i not in required:
                continue
            value = number_of(cell)
            if value is None:
                raise StoreError(
                    f"{path}, line {number}: {names[i]} = '{clipped(cell, 40)}' is not a number; correct it"
                )
            table[row, i] = value
            comma = comma or (number if "," in cell else 0)
            point = point or (number if "." in cell else 0)
    if comma and point:
        raise StoreError(
            f"{path}: line {comma} has a decimal comma, line {point} a decimal point; one of them is no "
            "decimal sign, correct it"
        )
    return table, [number for number, _ in numbered]
