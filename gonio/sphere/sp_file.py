"""PerkinElmer .sp, the binary file of a spectrum at constant interval (``PEPE``).

Four bytes ``PEPE``, 40 of description, then blocks: number (int16), length (int32), content.  Block 120 holds
members: number (int16), length (int32), and a content that begins with a type code (uint16).  Little-endian.
Members counted from -29839: 1 range of the abscissa, 3 interval, 4 number of points, 6 and 7 labels of the
axes, 11 values (doubles after their length in bytes), 12 name, 14 history.  A text is ``#u``, its length, its
bytes; the history is a tree of such members, whose numbers tell what they are (5 description, 140 model).
Read from files of a Lambda 1050+ and of a Spectrum; the format is not published.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import StoreError
from gonio.sphere.asc_file import changes_of
from gonio.sphere.file import SphereFile
from gonio.sphere.ordinate import factor_of, ordinate_of
from gonio.sphere.points import spectrum_of
from gonio.sphere.raw import MOST_POINTS, clipped

FloatArray = NDArray[np.float64]

MAGIC = b"PEPE"
_FIRST_BLOCK = 44
_DATA_SET = 120
_BASE = -29839
_RANGE, _INTERVAL, _COUNT, _X_LABEL, _Y_LABEL, _VALUES, _NAME, _HISTORY = 1, 3, 4, 6, 7, 11, 12, 14
_NAMES = {
    _RANGE: "range of the abscissa", _INTERVAL: "interval", _COUNT: "number of points",
    _X_LABEL: "label of the abscissa", _Y_LABEL: "label of the ordinate", _VALUES: "values",
}  # fmt: skip
_TEXT, _COORDINATE_RANGE, _COORDINATE, _LONG, _ARRAY = 29987, 29981, 29979, 29995, 29974
_FACTS = {
    1: "analyst", 3: "date", 5: "description", 140: "instrument", 141: "serial_number", 142: "software",
    210: "slit_nm", 218: "accessory", 238: "detector_change_nm", 241: "depolarizer", 242: "attenuators",
    243: "polarizer_deg",
}  # fmt: skip


def read_sp(
    path: Path, data: bytes, digest: str, *, reads: str | None, only_nm: tuple[float, float] | None
) -> SphereFile:
    """Return the spectrum in an .sp file; `StoreError` names a mistake's field and byte."""
    blocks = _blocks(path, data, _FIRST_BLOCK, len(data), "block")
    if _DATA_SET not in blocks:
        raise StoreError(
            f"{path}: holds no block {_DATA_SET} (a spectrum at constant interval), only {sorted(blocks)}; "
            "export the spectrum as CSV or .asc"
        )
    begin, end = blocks[_DATA_SET]
    found = {n - _BASE: at for n, at in _blocks(path, data, begin, end, "member").items()}
    members = _Members(path, data, found)

    x_label = members.text(_X_LABEL)
    if x_label.strip().lower() != "nm":
        raise StoreError(
            f"{path}: the abscissa is in '{clipped(x_label, 40)}', not in nm; export the spectrum over "
            "wavelength in nm"
        )
    label = members.text(_Y_LABEL)
    factor, remark = factor_of(ordinate_of(label), reads, f"{path}")
    wavelength_nm, value = members.points()
    w, r, _ = spectrum_of(path, wavelength_nm, value, factor, lambda i: f"point {i + 1}", only_nm)

    facts = _history(data, *found[_HISTORY]) if _HISTORY in found else {}
    if _NAME in found:
        facts["title"] = clipped(members.text(_NAME))
    changes = changes_of(facts.get("detector_change_nm", ""))
    remarks = [remark] if remark else []
    if changes is None:
        remarks.append(f"the detector change '{facts['detector_change_nm']}' is not understood")
    return SphereFile(
        path=path, format="PerkinElmer .sp", sha256=digest, wavelength_nm=w, reflectance=r, ordinate=label,
        factor=factor, facts={k: v for k, v in facts.items() if v}, detector_change_nm=changes or (),
        remarks=tuple(remarks),
    )  # fmt: skip


class _Members:
    """The members of the spectrum's block, each checked before it is believed."""

    def __init__(self, path: Path, data: bytes, found: Mapping[int, tuple[int, int]]) -> None:
        self.path, self.data, self.found = path, data, found

    def content(self, number: int, kind: int, least: int) -> tuple[int, int]:
        """Return where a member's content begins, behind its type code, and ends."""
        name = _NAMES.get(number, f"member {number}")
        if number not in self.found:
            raise StoreError(f"{self.path}: the {name} is missing; the file is damaged, export it again")
        begin, end = self.found[number]
        if end - begin < 2 + least:
            raise StoreError(
                f"{self.path}: the {name}, at byte {begin}, has {end - begin} bytes, too few; the file is "
                "damaged, export it again"
            )
        code = struct.unpack_from("<H", self.data, begin)[0]
        if code != kind:
            raise StoreError(
                f"{self.path}: the {name}, at byte {begin}, is of type {code}, not {kind} as in every known "
                "file; export the spectrum as CSV or .asc"
            )
        return begin + 2, end

    def text(self, number: int) -> str:
        """Return a text."""
        begin, end = self.content(number, _TEXT, 2)
        length = struct.unpack_from("<H", self.data, begin)[0]
        if begin + 2 + length > end:
            raise StoreError(
                f"{self.path}: the {_NAMES.get(number, 'text')}, at byte {begin}, declares {length} "
                f"characters and has {end - begin - 2}; the file is damaged, export it again"
            )
        return _decoded(self.data[begin + 2 : begin + 2 + length])

    def points(self) -> tuple[FloatArray, FloatArray]:
        """Return wavelengths, nm, and values, (k,) each, in the order of the file."""
        at, _ = self.content(_RANGE, _COORDINATE_RANGE, 16)
        first, last = struct.unpack_from("<dd", self.data, at)
        at, _ = self.content(_INTERVAL, _COORDINATE, 8)
        interval = struct.unpack_from("<d", self.data, at)[0]
        at, _ = self.content(_COUNT, _LONG, 4)
        count = struct.unpack_from("<i", self.data, at)[0]
        at, end = self.content(_VALUES, _ARRAY, 4)
        size = struct.unpack_from("<i", self.data, at)[0]
        if size < 0 or size % 8 or at + 4 + size > end:
            raise StoreError(
                f"{self.path}: the values, at byte {at}, declare {size} bytes and have {end - at - 4}; the "
                "file is cut short or damaged, export it again"
            )
        if count != size // 8 or not 2 <= count <= MOST_POINTS:
            raise StoreError(
                f"{self.path}: the number of points is {count}, and there are {size // 8} values (2 to "
                f"{MOST_POINTS} are read); the file is damaged, export it again"
            )
        if not (
            np.all(np.isfinite([first, last, interval]))
            and interval != 0.0
            and abs(first + (count - 1) * interval - last) <= 1e-3 * abs(interval)
        ):
            raise StoreError(
                f"{self.path}: {count} points from {first:g} nm in steps of {interval:g} nm do not end at "
                f"{last:g} nm; which of these is wrong cannot be told, export the spectrum as CSV or .asc"
            )
        values = np.frombuffer(self.data, "<f8", count, at + 4).astype(np.float64)
        return first + interval * np.arange(count), values


def _blocks(path: Path, data: bytes, begin: int, end: int, what: str) -> dict[int, tuple[int, int]]:
    """Return where the content of each block in a piece of the file begins and ends, by its number."""
    found: dict[int, tuple[int, int]] = {}
    at = begin
    while at < end:
        if end - at < 6:
            raise StoreError(
                f"{path}: is cut short at byte {at}, within the head of a {what}; export it again"
            )
        number, length = struct.unpack_from("<hi", data, at)
        at += 6
        if length < 0 or length > end - at:
            raise StoreError(
                f"{path}: {what} {number}, at byte {at}, declares {length} bytes, and {end - at} are left; "
                "the file is cut short or damaged, export it again"
            )
        if number in found and what == "member":
            raise StoreError(
                f"{path}: {what} {number} is there twice, at byte {at} again; the file is damaged, export it "
                "again"
            )
        found[number] = (at, at + length)
        at += length
    return found


def _history(data: bytes, begin: int, end: int) -> dict[str, str]:
    """Return what the texts and numbers of the history say.

    They are found by their type code and their length, wherever in the tree they stand: the trees of infrared
    and ultraviolet instruments differ.  Of several of one kind the innermost, which comes last, is the
    measurement's.
    """
    facts: dict[str, str] = {}
    at = data.find(b"#u", begin + 6, end)
    while at != -1 and at + 4 <= end:
        number, length = struct.unpack_from("<hi", data, at - 6)
        size = struct.unpack_from("<H", data, at + 2)[0]
        whole = length == size + 4 and at + 4 + size <= end
        if whole:
            name = _FACTS.get(number - _BASE)
            text = clipped(_decoded(data[at + 4 : at + 4 + size]))
            if name is not None and text:
                facts[name] = text
        at = data.find(b"#u", at + 4 + size if whole else at + 2, end)
    at = data.find(b"\x1cu", begin + 6, end)
    while at != -1 and at + 10 <= end:
        number, length = struct.unpack_from("<hi", data, at - 6)
        name = _FACTS.get(number - _BASE)
        if length in (10, 14) and name is not None:  # a double, in some versions with four bytes behind it
            facts.setdefault(name, f"{struct.unpack_from('<d', data, at + 2)[0]:.10g}")
        at = data.find(b"\x1cu", at + 2, end)
    return facts


def _decoded(raw: bytes) -> str:
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return "".join(c for c in text if c.isprintable())
