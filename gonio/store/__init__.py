"""The measured file: written position by position, read back as a `Scan`.

Only `gonio.acquire` writes scans (`gonio.store.file`); everybody else starts with `load`.
"""

from __future__ import annotations

from gonio.store.read import load
from gonio.store.scan import Scan
from gonio.store.spectra import attach_csv_spectrum, read_spectrum

__all__ = ["Scan", "attach_csv_spectrum", "load", "read_spectrum"]
