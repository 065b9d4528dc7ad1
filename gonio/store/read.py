"""Read a scan file back, trusting nothing in it.

A file may be truncated, foreign, or made to do harm; every dataset is checked for its place (no link out
of the file), its dimensions, its type, and that the file is large enough for what it declares, before
memory is taken for it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio.errors import ConfigError, StoreError
from gonio.store.scan import Scan

_MOST_COMPRESSED = (
    1032  # deflate's best ratio; files written here are not compressed, but may have been repacked
)
_LONGEST_TEXT = 10_000_000


def load(path: str | os.PathLike[str]) -> Scan:
    """Return the scan in a file; an unfinished one has fewer positions than its plan and `finished` false.

    Raises
    ------
    StoreError
        The file is missing, not HDF5, cut short, not a gonio scan, contradicts itself, holds no position
        yet, or is being written by another process.
    """
    path = Path(path)
    with opened(path, "r") as file:
        return _Reader(path, file).scan()


@contextmanager
def opened(path: Path, mode: str) -> Iterator[h5py.File]:
    """Open an HDF5 file; `StoreError` says why it cannot be, or what is broken in it."""
    if not path.exists():
        raise StoreError(f"{path}: there is no such file; check the path")
    try:
        is_hdf5 = path.is_file() and h5py.is_hdf5(path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error}); check its rights") from None
    if path.is_file() and path.stat().st_size == 0:
        raise StoreError(
            f"{path}: is empty; if a journal lies beside it, continue with gonio scan --resume {path}"
        )
    if not is_hdf5:
        raise StoreError(f"{path}: is not an HDF5 file; give a file written by gonio scan")
    try:
        file = h5py.File(path, mode)
    except BlockingIOError:
        raise StoreError(
            f"{path}: is being written by another process; wait until the scan has ended"
        ) from None
    except (OSError, RuntimeError) as error:
        raise StoreError(
            f"{path}: is damaged or cut short ({error}); if a journal lies beside it, "
            f"gonio scan --resume {path} makes it anew"
        ) from None
    try:
        yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, UnicodeError, OverflowError) as error:
        raise StoreError(f"{path}: is damaged ({error}); restore it from a copy") from error
    finally:
        file.close()


class _Reader:
    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path = path
        self.file = file
        self.size = path.stat().st_size

    def scan(self) -> Scan:
        entry = self._group("entry")
        names = self._texts("entry/data/detector_names")
        wavelength_nm = self._numbers("entry/data/wavelength", 1, "f")
        n, m = self._declared_shape("entry/data/r", 2)
        if len(wavelength_nm) != m:
            raise self._foreign(f"r has {m} columns, but there are {len(wavelength_nm)} wavelengths")
        if not (np.all(np.isfinite(wavelength_nm)) and np.all(wavelength_nm > 0)):
            raise self._foreign("wavelength holds values that are not positive numbers")
        detector_index = self._numbers("entry/data/detector_index", 1, "u", (m,)).astype(np.uint8)
        if m == 0 or n == 0:
            raise self._foreign("it holds no position or no wavelength")
        if detector_index.max() >= len(names):
            raise self._foreign(
                f"detector_index reaches {detector_index.max()}, but {len(names)} detectors are named"
            )

        theta_i = self._numbers("entry/data/theta_i", 1, "f", (n,))
        measured = np.flatnonzero(np.isfinite(theta_i))
        if len(measured) == 0:
            raise StoreError(f"{self.path}: no position has been measured yet; wait, or resume the scan")

        def per_position(name: str, kind: str = "f") -> NDArray[Any]:
            return self._numbers(f"entry/data/{name}", 1, kind, (n,))[measured]

        def table(name: str, kind: str = "f") -> NDArray[Any]:
            return self._numbers(f"entry/data/{name}", 2, kind, (n, m), measured)

        polarization = np.char.decode(
            self._numbers("entry/data/polarization", 1, "S", (n,))[measured], "utf-8"
        )
        if not np.all(np.isin(polarization, ("s", "p"))):
            raise self._foreign("polarization holds something else than s and p")
        return Scan(
            path=self.path,
            title=self._text("entry/title"),
            sample_name=self._text("entry/sample/name"),
            wavelength_nm=wavelength_nm,
            detector_index=detector_index,
            detector_names=names,
            theta_i_deg=theta_i[measured],
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
            finished=str(entry.attrs.get("scan_status", "unfinished")) == "finished",
            plan_text=self._text("entry/plan"),
            rig_text=self._text("entry/rig"),
            start_time=self._text("entry/start_time"),
        )

    def _aperture(self) -> Aperture:
        where = "entry/instrument/aperture"
        width, height, distance = (
            float(self._scalar(f"{where}/{k}")) for k in ("width", "height", "distance")
        )
        try:
            return Aperture(width_mm=width, height_mm=height, distance_mm=distance)
        except (ConfigError, ValueError) as error:
            raise self._foreign(f"{where}: {error}") from None

    # -- checked access
    # ----------------------------------------------------------------------------------------

    def _foreign(self, what: str) -> StoreError:
        return StoreError(f"{self.path}: is not a gonio scan: {what}; give a file written by gonio scan")

    def _object(self, name: str) -> h5py.Group | h5py.Dataset:
        """Return what hard links lead to; a soft or external link could lead anywhere."""
        here: Any = self.file
        for part in name.split("/"):
            link = here.get(part, getlink=True) if isinstance(here, h5py.Group) else None
            if link is None:
                raise self._foreign(f"/{name} is missing")
            if not isinstance(link, h5py.HardLink):
                raise self._foreign(f"/{name} is a link out of its place")
            here = here[part]
        return here

    def _group(self, name: str) -> h5py.Group:
        found = self._object(name)
        if not isinstance(found, h5py.Group):
            raise self._foreign(f"/{name} is not a group")
        return found

    def _dataset(self, name: str) -> h5py.Dataset:
        found = self._object(name)
        if not isinstance(found, h5py.Dataset) or found.shape is None:
            raise self._foreign(f"/{name} is not a dataset with values")
        if found.is_virtual or found.external:
            raise self._foreign(f"/{name} is kept in another place of the disk")
        return found

    def _declared_shape(self, name: str, ndim: int) -> tuple[int, ...]:
        shape = self._dataset(name).shape
        if len(shape) != ndim:
            raise self._foreign(f"/{name} has {len(shape)} dimensions, expected {ndim}")
        return tuple(int(length) for length in shape)

    def _numbers(
        self,
        name: str,
        ndim: int,
        kind: str,
        shape: tuple[int, ...] | None = None,
        rows: NDArray[np.intp] | None = None,
    ) -> NDArray[Any]:
        """Return a dataset of the expected dimensions and kind of number, or only some of its rows."""
        dataset = self._dataset(name)
        found = self._declared_shape(name, ndim)
        if shape is not None and found != shape:
            raise self._foreign(f"/{name} has shape {found}, expected {shape}")
        if dataset.dtype.kind != kind:
            raise self._foreign(f"/{name} holds {dataset.dtype}, expected a type of kind '{kind}'")
        wanted = (len(rows) if rows is not None else found[0]) * int(np.prod(found[1:], dtype=object))
        stored = min(int(dataset.id.get_storage_size()), self.size)
        packed = dataset.compression is not None or dataset.id.get_create_plist().get_nfilters() > 0
        if wanted * dataset.dtype.itemsize > stored * (_MOST_COMPRESSED if packed else 1):
            raise self._foreign(f"/{name} declares {wanted} values, more than are stored")
        if rows is None or len(rows) == found[0]:
            values = dataset[...]
        elif rows[-1] - rows[0] + 1 == len(rows):
            values = dataset[rows[0] : rows[-1] + 1]
        else:
            values = dataset[rows]
        return np.asarray(values, dtype=np.float64) if kind == "f" else np.asarray(values)

    def _scalar(self, name: str) -> float:
        dataset = self._dataset(name)
        if dataset.shape != () or dataset.dtype.kind != "f":
            raise self._foreign(f"/{name} is not a number")
        return float(dataset[()])

    def _text(self, name: str) -> str:
        dataset = self._dataset(name)
        if dataset.shape != () or h5py.check_string_dtype(dataset.dtype) is None:
            raise self._foreign(f"/{name} is not a text")
        text = dataset.asstr()[()]
        return str(text)[:_LONGEST_TEXT]

    def _texts(self, name: str) -> tuple[str, ...]:
        dataset = self._dataset(name)
        if (
            len(dataset.shape) != 1
            or not 0 < dataset.shape[0] < 256
            or h5py.check_string_dtype(dataset.dtype) is None
        ):
            raise self._foreign(f"/{name} is not a list of names")
        return tuple(str(name) for name in dataset.asstr()[...])
