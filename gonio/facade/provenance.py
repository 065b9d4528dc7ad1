"""Which programs made this, and when?  Nothing that names the machine."""

from __future__ import annotations

import datetime
import functools
import importlib.metadata
import platform
from collections.abc import Mapping

from gonio import __version__

_PROGRAMS = ("numpy", "numba", "h5py", "pvlib")


@functools.cache
def _versions() -> tuple[tuple[str, str], ...]:
    """Return the versions of this process's programs; asked once, the answer cannot change."""
    found = [("gonio", __version__), ("python", platform.python_version())]
    for name in _PROGRAMS:
        try:
            found.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            continue
    return tuple(found)


def versions() -> Mapping[str, str]:
    """Return the versions of gonio, Python and the libraries whose numbers are in the result."""
    return dict(_versions())


def now_utc() -> str:
    """Return the time of day, UTC, ISO 8601 to the second."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
