"""The bytes of a file that somebody gives: bounded, and as text where they are text."""

from __future__ import annotations

import re
import stat
from pathlib import Path

from gonio.errors import StoreError

LARGEST_BYTES = 20_000_000
"""200...2500 nm in steps of 0.01 nm, 25 bytes a line, is 6 MB."""
MOST_POINTS = 500_000
_LINE_ENDS = re.compile(r"\r\n|\n|\r")  # str.splitlines would also cut at characters of latin-1 texts
_NUMBER = re.compile(
    r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|[+-]?(?:nan|inf)", re.IGNORECASE
)  # float() also takes 1_000 and digits of other scripts


def read_bytes(path: Path) -> bytes:
    """Return the content of a regular file of at most `LARGEST_BYTES`; `StoreError` says why not."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise StoreError(f"{path}: is not a file; give the file of the sphere's spectrum")
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except FileNotFoundError:
        raise StoreError(f"{path}: there is no such file; check the path") from None
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: cannot be read ({error}); check its rights") from None
    if len(data) > LARGEST_BYTES:
        raise StoreError(
            f"{path}: is larger than {LARGEST_BYTES / 1e6:g} MB, which no spectrum of a sphere is; check the "
            "file"
        )
    if not data:
        raise StoreError(f"{path}: is empty; export the spectrum again")
    return data


def text_of(path: Path, data: bytes) -> str:
    """Return bytes as text: UTF-8 with or without mark, UTF-16 with one, else latin-1.

    `StoreError` if they hold characters that no text has.
    """
    try:
        marked = data.startswith((b"\xff\xfe", b"\xfe\xff"))
        text = data.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    found = re.search(r"[\x00-\x08\x0e-\x1f\x7f]", text)
    if found is not None:
        line = text.count("\n", 0, found.start()) + 1
        raise StoreError(
            f"{path}, line {line}: holds the byte 0x{ord(found.group()):02x}, which no text has; give a CSV, "
            "or PerkinElmer .asc or .sp file"
        )
    return text


def lines_of(text: str) -> list[str]:
    """Return the lines of a text, whatever ends them."""
    return _LINE_ENDS.split(text)


def number_of(cell: str) -> float | None:
    """Return the number that a cell holds, with decimal point or decimal comma; None if it holds none.

    Both in one cell are a thousands separator, which is not read: 1,234.5 and 1.234,5 mean the same.
    """
    text = cell.strip()
    if "," in text:
        if "." in text or text.count(",") > 1:
            return None
        text = text.replace(",", ".")
    if not _NUMBER.fullmatch(text):
        return None
    return float(text)


def clipped(text: str, most: int = 500) -> str:
    """Return a text of a header, without what a title does not need."""
    clean = " ".join(text.split())
    return clean if len(clean) <= most else clean[: most - 1] + "…"
