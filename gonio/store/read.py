"""Read a scan file back, trusting nothing in it.

A file may be truncated, foreign, or made to do harm; every dataset is checked for its place (no link out
of the file), its dimensions, its type, and that the file is large enough for what it declares, before
memory is taken for it.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture, IncidentBeam
from gonio.errors import ConfigError, StoreError
from gonio.store.checked import Checked
from gonio.store.guard import refuse_dangerous
from gonio.store.heaps import endless_heap
from gonio.store.scan import Scan

_ATTEMPTS = 3
_ABSURD = 1e30  # whose square is still a number
_DAMAGE = (
    OSError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    ArithmeticError,
    AttributeError,
    MemoryError,
)
"""What reading raises where a file holds something else than it should."""


def load(path: str | os.PathLike[str]) -> Scan:
    """Return the scan in a file; an unfinished one has fewer positions than its plan and `finished` false.

    While a scan runs, in this process or another, the positions so far are read from its journal, which is
    whole at any instant: see `gonio.acquire.live`.

    Raises
    ------
    StoreError
        The file is missing, not HDF5, cut short, not a gonio scan, contradicts itself, or holds no position
        yet.
    """
    path = Path(path)
    for _ in range(_ATTEMPTS):
        scan = _unfinished(path)
        if scan is not None:
            return scan
        try:
            with opened(path, "r") as file:
                return scan_in(path, file)
        except StoreError:
            if not os.path.isfile(_journal(path)):  # else a scan has begun, or ended, between the two looks
                raise
    raise StoreError(f"{path}: changes faster than it can be read; try again when the scan has ended")


def scan_in(path: Path, file: h5py.File) -> Scan:
    """Return the scan in an open file; `path` is its name in messages."""
    return _Reader(path, file).scan()


def _unfinished(path: Path) -> Scan | None:
    """Return what the journal beside the file holds so far; None if there is none that can be read."""
    if not os.path.isfile(_journal(path)):  # Path.is_file raises for names that are too long
        return None
    from gonio.acquire.live import measured_so_far  # it writes scans, and so needs this package

    return measured_so_far(path)


def _journal(path: Path) -> Path:
    return path.with_name(path.name + ".journal")


@contextmanager
def opened(path: Path, mode: str, *, guarded: bool = True) -> Iterator[h5py.File]:
    """Open an HDF5 file that leads nowhere else; `StoreError` says why it cannot be, or what is broken.

    Not `guarded`, it may lead anywhere: for who looks at that himself.
    """
    _refuse_what_is_no_file(path)
    try:
        is_hdf5 = h5py.is_hdf5(path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error}); check its rights") from None
    if not is_hdf5:
        raise StoreError(f"{path}: is not an HDF5 file; give a file written by gonio scan")
    if endless_heap(path) is not None:
        raise StoreError(
            f"{path}: is damaged (a heap of texts that the HDF5 library would read for ever); if a journal "
            f"lies beside it, gonio scan --resume {path} makes it anew, else restore it from a copy"
        )
    try:
        file = h5py.File(path, mode)
    except BlockingIOError:
        raise StoreError(
            f"{path}: is being written by another process; wait until the scan has ended, or try again"
        ) from None
    except PermissionError as error:
        raise StoreError(f"{path}: cannot be opened for writing ({error}); check its rights") from None
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(
            f"{path}: is damaged or cut short ({error}); if a journal lies beside it, "
            f"gonio scan --resume {path} makes it anew"
        ) from None
    try:
        if guarded:
            refuse_dangerous(path, file)
        yield file
    except _DAMAGE as error:
        raise StoreError(f"{path}: is damaged ({error}); restore it from a copy") from error
    finally:
        with suppress(OSError, RuntimeError):  # closing what is damaged may fail once more
            file.close()


def _refuse_what_is_no_file(path: Path) -> None:
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        raise StoreError(f"{path}: there is no such file; check the path") from None
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error}); check its rights") from None
    if stat.S_ISDIR(status.st_mode):
        raise StoreError(f"{path}: is a folder and not an HDF5 file; give a file written by gonio scan")
    if not stat.S_ISREG(status.st_mode):
        raise StoreError(f"{path}: is not an HDF5 file but a device or a pipe; give a file on a disk")
    if status.st_size == 0:
        raise StoreError(
            f"{path}: is empty; if a journal lies beside it, continue with gonio scan --resume {path}"
        )


class _Reader(Checked):
    def scan(self) -> Scan:
        self.group("entry")
        names = self.texts("entry/data/detector_names")
        wavelength_nm = self.numbers("entry/data/wavelength", 1, "f")
        n, m = self.declared_shape("entry/data/r", 2)
        if len(wavelength_nm) != m:
            raise self.foreign(f"r has {m} columns, but there are {len(wavelength_nm)} wavelengths")
        if not (np.all(np.isfinite(wavelength_nm)) and np.all(wavelength_nm > 0)):
            raise self.foreign("wavelength holds values that are not positive numbers")
        detector_index = self.numbers("entry/data/detector_index", 1, "u", (m,)).astype(np.uint8)
        if m == 0 or n == 0:
            raise self.foreign("it holds no position or no wavelength")
        if detector_index.max() >= len(names):
            raise self.foreign(
                f"detector_index reaches {detector_index.max()}, but {len(names)} detectors are named"
            )

        theta_i = self.numbers("entry/data/theta_i", 1, "f", (n,))
        measured = np.flatnonzero(np.isfinite(theta_i))
        if len(measured) == 0:
            raise StoreError(f"{self.path}: no position has been measured yet; wait, or resume the scan")

        def per_position(name: str, kind: str = "f") -> NDArray[Any]:
            values = self.numbers(f"entry/data/{name}", 1, kind, (n,))[measured]
            if name.startswith("theta") and not np.all(np.abs(values) <= 360.0):
                raise self.foreign(
                    f"/entry/data/{name} holds angles beyond 360 deg, or none, of positions measured"
                )
            return values

        def table(name: str, kind: str = "f") -> NDArray[Any]:
            values = self.numbers(f"entry/data/{name}", 2, kind, (n, m), measured)
            if kind == "f" and np.any(np.abs(values) > _ABSURD):
                raise self.foreign(f"/entry/data/{name} holds numbers that nothing measures")
            if name.endswith(("errors", "uncertainty")) and np.any(values < 0.0):
                raise self.foreign(f"/entry/data/{name} holds negative uncertainties")
            return values

        polarization = np.char.decode(
            self.numbers("entry/data/polarization", 1, "S", (n,))[measured], "utf-8"
        )
        if not np.all(np.isin(polarization, ("s", "p"))):
            raise self.foreign("polarization holds something else than s and p")
        return Scan(
            path=self.path,
            title=self.text("entry/title"),
            sample_name=self.text("entry/sample/name"),
            wavelength_nm=wavelength_nm,
            detector_index=detector_index,
            detector_names=names,
            theta_i_deg=per_position("theta_i"),
            theta_mes_deg=per_position("theta_mes"),
            theta_o_deg=per_position("theta_o"),
            polarization=polarization,
            r=table("r"),
            r_sd=table("r_errors"),
            raw_signal_v=table("raw_signal"),
            dark_v=table("dark"),
            baseline_v=table("baseline"),
            gain_u=table("gain_uncertainty"),
            offset_u=table("offset_uncertainty"),
            quality=table("quality", "u").astype(np.uint16),
            time_s=per_position("time"),
            aperture=self._aperture(),
            position=per_position("position", "i").astype(np.int64),
            n_planned=n,
            finished=self.attribute("entry", "scan_status") == "finished",
            plan_text=self.text("entry/plan"),
            rig_text=self.text("entry/rig"),
            start_time=self.text("entry/start_time"),
            beam=self._beam(),
        )

    def _aperture(self) -> Aperture:
        where = "entry/instrument/aperture"
        width, height, distance = (
            float(self.scalar(f"{where}/{k}")) for k in ("width", "height", "distance")
        )
        try:
            return Aperture(width_mm=width, height_mm=height, distance_mm=distance)
        except (ConfigError, ValueError) as error:
            raise self.foreign(f"{where}: {error}") from None

    def _beam(self) -> IncidentBeam | None:
        where, names = "entry/instrument/beam", ("width", "height", "divergence")
        # files of rigs that do not say, and those before gonio could, have none of them
        if not (self.has(where) and any(self.has(f"{where}/{name}") for name in names)):
            return None
        try:
            return IncidentBeam(*(float(self.scalar(f"{where}/{name}")) for name in names))
        except (ConfigError, ValueError) as error:
            raise self.foreign(f"{where}: {error}") from None
