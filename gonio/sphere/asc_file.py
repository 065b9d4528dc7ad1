"""PerkinElmer .asc, as UV WinLab exports a spectrum of a Lambda (``PEDS 4.00``).

Header lines by number, from zero: 2 title, 3 and 4 date and time (yy/mm/dd), 7 analyst, 8 description,
11 instrument, 12 its serial number, 13 its software, 17 slit, 24 accessories, 41 grating change, 42 lamp
change, 43 detector change (``860.8``), 46 depolarizer, 47 attenuators, 48 polarizer angle; ``#GR``, then
79 unit of the abscissa, 80 ordinate, 81 and 82 scale and offset, 83 first wavelength, 84 interval, 85 number
of points; ``#DATA``, then wavelength and value in each line.  Found in exports of a Lambda 950 and of a
Lambda 1050; the format is not published.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import StoreError
from gonio.sphere.file import SphereFile
from gonio.sphere.ordinate import factor_of, ordinate_of
from gonio.sphere.points import spectrum_of
from gonio.sphere.raw import clipped, lines_of, number_of, text_of

FloatArray = NDArray[np.float64]

_FACTS = {
    2: "title", 3: "date", 4: "time", 7: "analyst", 8: "description", 11: "instrument", 12: "serial_number",
    13: "software", 17: "slit_nm", 24: "accessory", 41: "grating_change_nm", 42: "lamp_change_nm",
    43: "detector_change_nm", 46: "depolarizer", 47: "attenuators", 48: "polarizer_deg",
}  # fmt: skip
_UNIT, _ORDINATE, _SCALE, _OFFSET, _COUNT = 79, 80, 81, 82, 85
_GR = 78


def is_asc(data: bytes) -> bool:
    """Say whether a file begins as an .asc file does."""
    first = data[:200].lstrip(b"\xef\xbb\xbf").splitlines()[:1]
    return bool(first) and first[0].startswith(b"PE ") and b"PEDS" in first[0]


def read_asc(
    path: Path, data: bytes, digest: str, *, reads: str | None, only_nm: tuple[float, float] | None
) -> SphereFile:
    """Return the spectrum in an .asc file; `StoreError` names a mistake's line, counted from 1."""
    lines = lines_of(text_of(path, data))
    words = lines[0].split()
    if words[:2] != ["PE", "UV"] or words[-2:] != ["PEDS", "4.00"]:
        raise StoreError(
            f"{path}, line 1: '{clipped(lines[0], 80)}' announces another format than PE UV ... PEDS 4.00, "
            "the one that is known; export the spectrum as CSV"
        )
    stripped = [line.strip() for line in lines]
    try:
        begin = stripped.index("#DATA")
    except ValueError:
        raise StoreError(
            f"{path}: has no line #DATA among its {len(lines)}; it is cut short, export it again"
        ) from None
    header = stripped[:begin]
    if len(header) <= _ORDINATE:
        raise StoreError(
            f"{path}, line {begin + 1}: #DATA comes after {len(header)} header lines, and PEDS 4.00 has the "
            f"ordinate in line {_ORDINATE + 1}; lines are missing, export it again"
        )
    # a description of several lines would move all that follows; #GR tells
    moved = header.index("#GR") - _GR if "#GR" in header else 0
    if _ORDINATE + moved >= len(header):
        raise StoreError(
            f"{path}, line {begin + 1}: #DATA follows #GR without unit and ordinate; export it again"
        )
    remarks = []
    facts = {name: clipped(header[i]) for i, name in _FACTS.items() if header[i] and (i < 8 or not moved)}
    if moved:
        remarks.append(
            f"#GR stands in line {_GR + moved + 1}, not {_GR + 1}: what the header says of the instrument is "
            "not used"
        )
    _check_unit(path, header[_UNIT + moved], _UNIT + moved)
    factor, remark = factor_of(
        ordinate_of(header[_ORDINATE + moved]), reads, f"{path}, line {_ORDINATE + moved + 1}"
    )
    if remark:
        remarks.append(remark)
    _check_scale(path, header, moved)

    wavelength_nm, value, rows = _points(path, lines, begin + 1)
    promised = number_of(header[_COUNT + moved]) if _COUNT + moved < len(header) else None
    if promised is not None and promised > 0 and promised != len(rows):
        raise StoreError(
            f"{path}: line {_COUNT + moved + 1} promises {promised:g} points, and {len(rows)} stand below "
            "#DATA; the file is cut short or changed, export it again"
        )
    w, r, _ = spectrum_of(path, wavelength_nm, value, factor, lambda i: f"line {rows[i]}", only_nm)
    changes = changes_of(facts.get("detector_change_nm", ""))
    if "detector_change_nm" in facts and changes is None:
        remarks.append(f"the detector change '{facts['detector_change_nm']}' in line 44 is not understood")
    return SphereFile(
        path=path, format="PerkinElmer .asc, PEDS 4.00", sha256=digest, wavelength_nm=w, reflectance=r,
        ordinate=header[_ORDINATE + moved], factor=factor, facts=facts, detector_change_nm=changes or (),
        remarks=tuple(remarks),
    )  # fmt: skip


def _check_unit(path: Path, unit: str, index: int) -> None:
    if unit.lower() != "nm":
        raise StoreError(
            f"{path}, line {index + 1}: the abscissa is in '{clipped(unit, 40)}', not in nm; export the "
            "spectrum over wavelength in nm"
        )


def _check_scale(path: Path, header: list[str], moved: int) -> None:
    """Refuse another scale or offset than 1 and 0: whether the values contain it already is not known."""
    for index, name, plain in ((_SCALE + moved, "scale", 1.0), (_OFFSET + moved, "offset", 0.0)):
        found = number_of(header[index]) if index < len(header) else None
        if found is not None and found != plain:
            raise StoreError(
                f"{path}, line {index + 1}: the ordinate has {name} {found:g}, where every known file has "
                f"{plain:g}, and whether the values contain it is not known; export the spectrum as CSV"
            )


def _points(path: Path, lines: list[str], begin: int) -> tuple[FloatArray, FloatArray, list[int]]:
    """Return wavelengths, values and line numbers (from 1) of the points below ``#DATA``."""
    rows, x, y = [], [], []
    comma = point = 0  # the first line with a decimal comma, with a decimal point
    for number, line in enumerate(lines[begin:], start=begin + 1):
        cells = line.split()
        if not cells:
            continue
        values = [number_of(cell) for cell in cells]
        if len(values) != 2 or values[0] is None or values[1] is None:
            raise StoreError(
                f"{path}, line {number}: '{clipped(line, 60)}' is not a wavelength and a value; the file is "
                "damaged, export it again"
            )
        comma = comma or (number if "," in line else 0)
        point = point or (number if "." in line else 0)
        rows.append(number)
        x.append(values[0])
        y.append(values[1])
    last = rows[-2:]
    if len(last) == 2 and last[1] == len(lines) and _decimals(lines[-1]) < _decimals(lines[last[0] - 1]):
        raise StoreError(
            f"{path}, line {last[1]}: '{clipped(lines[-1], 60)}' ends the file within a number; it is cut "
            "short, export it again"
        )
    if comma and point:
        raise StoreError(
            f"{path}: line {comma} has a decimal comma, line {point} a decimal point; one of them is no "
            "decimal sign, export it again"
        )
    return np.array(x, np.float64), np.array(y, np.float64), rows


def _decimals(line: str) -> int:
    """Return the decimals of the last number in a line; the instrument's software writes six."""
    return len(re.split("[.,]", line)[-1]) if re.search("[.,][0-9]*$", line) else 0


def changes_of(text: str) -> tuple[float, ...] | None:
    """Return the wavelengths in a line, ascending; zero stands for none.  None if they are not numbers."""
    found = [number_of(word) for word in re.split(r"[\s;]+", text) if word]
    if any(value is None or not 0 <= value < 1e5 for value in found):
        return None
    return tuple(sorted(value for value in found if value))
