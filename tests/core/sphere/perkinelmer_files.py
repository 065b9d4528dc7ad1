"""Writes files as a Lambda's software does: for the readers' tests, and written without looking at them.

The layouts are those of shared/FORMATS.md and of exports of a Lambda 950 and 1050 that others have published.
The spectra are made up.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

ASC_DEFAULTS = {
    0: "PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00        ",
    1: "   -1",
    2: "HPL white.Sample.Raw.asc",
    3: "26/11/03",
    4: "10:12:30.00",
    5: "26/11/03",
    6: "10:12:30.00",
    7: "A. Operator",
    8: "8 deg wedge, sphere 150 mm",
    9: "300.000000",
    10: "1",
    11: "Lambda 950",
    12: "950L0000001",
    13: "PerkinElmer UV WinLab 6.0.4",
    15: "0",
    16: "0",
    17: "3350/servo 860.8/2",
    20: "UV/VIS",
    24: "RBeamAtt,SBeamAtt,150mm sphere",
    29: "Program",
    41: "860.8",
    42: "319.2",
    43: "860.8",
    44: "Front",
    45: "100",
    46: "off",
    47: "S:100 R:100",
    75: "#HDR",
    76: "-1",
    77: "-1",
    78: "#GR",
    79: "nm",
    80: "%R",
    81: "1.0",
    82: "0.0",
    86: "8",
}


def asc(
    points: Sequence[tuple[float, float]],
    changed: Mapping[int, str] | None = None,
    *,
    end: str = "\n",
    point: str = ".",
) -> str:
    """Return an .asc file of wavelengths and values; `changed` replaces header lines, numbered from zero."""

    def number(value: float) -> str:
        return f"{value:.6f}".replace(".", point)

    header = {**ASC_DEFAULTS}
    if points:
        values = [y for _, y in points]
        header |= {
            83: number(points[0][0]),
            85: str(len(points)),
            87: number(max(values)),
            88: number(min(values)),
        }
        header[84] = number(points[1][0] - points[0][0]) if len(points) > 1 else "0"
    header |= changed or {}
    lines = [header.get(i, "") for i in range(89)]
    lines += ["#DATA", *(f"{number(x)}\t{number(y)}" for x, y in points), ""]
    return end.join(lines)


def block(number: int, content: bytes) -> bytes:
    return struct.pack("<hi", number, len(content)) + content


def member(number: int, content: bytes) -> bytes:
    """Return member `number`, counted from -29839."""
    return block(number - 29839, content)


def text(value: str) -> bytes:
    raw = value.encode("utf-8")
    return b"#u" + struct.pack("<H", len(raw)) + raw


def double(value: float) -> bytes:
    return b"\x1cu" + struct.pack("<d", value)


def sp(
    values: Sequence[float],
    first: float,
    interval: float,
    *,
    unit: str = "nm",
    ordinate: str = "%R",
    last: float | None = None,
    count: int | None = None,
    size: int | None = None,
    leave_out: Sequence[int] = (),
) -> bytes:
    """Return an .sp file; `last`, `count`, `size` are what the members say, true unless given."""
    n = len(values)
    instrument = b"".join(
        member(number, content)
        for number, content in (
            (140, text("Lambda 950")),
            (141, text("950L0000001")),
            (210, text("3350/servo 860.8/2")),
            (218, text("RBeamAtt,SBeamAtt,150mm sphere")),
            (238, double(860.8)),
        )
    )
    inner = block(122, block(125, instrument) + member(3, text("tue nov 03 10:12:30 2026")))
    history = block(121, member(1, text("")) + member(3, text("tue nov 24 09:00:00 2026")) + member(6, inner))
    raw = struct.pack(f"<{n}d", *values)
    members = {
        14: history,
        13: b"\x1au" + struct.pack("<i", 0),
        0: b",u" + struct.pack("<h", 16),
        1: b"\x1du" + struct.pack("<dd", first, first + (n - 1) * interval if last is None else last),
        2: b"\x1du" + struct.pack("<dd", min(values), max(values)),
        3: b"\x1bu" + struct.pack("<d", interval),
        4: b"+u" + struct.pack("<i", n if count is None else count),
        6: text(unit),
        7: text(ordinate),
        12: text("HPL white"),
        11: b"\x16u" + struct.pack("<i", len(raw) if size is None else size) + raw,
    }
    content = b"".join(member(number, value) for number, value in members.items() if number not in leave_out)
    return b"PEPE" + b"2D constant interval DataSet file".ljust(40, b"\0") + block(120, content)
