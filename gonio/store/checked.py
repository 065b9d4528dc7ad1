"""Access to the parts of a file that trusts nothing in it: place, kind, dimensions, type, size.

`gonio.store.guard` has looked at the whole file; here each part that is read must also be what it should be.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.errors import StoreError

_MOST_COMPRESSED = 1032
"""Deflate's best ratio; files written here are not compressed, but may have been repacked."""
_LONGEST_TEXT = 10_000_000


class Checked:
    """The parts of an open file by their paths without leading slash; `StoreError` says what is wrong."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path = path
        self.file = file
        self.size = int(file.id.get_filesize())

    def foreign(self, what: str) -> StoreError:
        """Return the error of a file that no gonio wrote."""
        return StoreError(f"{self.path}: is not a gonio scan: {what}; give a file written by gonio scan")

    def object(self, name: str) -> h5py.Group | h5py.Dataset:
        """Return what hard links lead to; a soft or external link could lead anywhere."""
        here: Any = self.file
        for part in name.split("/"):
            link = here.get(part, getlink=True) if isinstance(here, h5py.Group) else None
            if link is None:
                raise self.foreign(f"/{name} is missing")
            if not isinstance(link, h5py.HardLink):
                raise self.foreign(f"/{name} is a link out of its place")
            here = here[part]
        return here

    def has(self, name: str) -> bool:
        """Say whether there is something under a name whose parents are groups."""
        parent, _, last = name.rpartition("/")
        group = self.object(parent) if parent else self.file
        return isinstance(group, h5py.Group) and group.get(last, getlink=True) is not None

    def group(self, name: str) -> h5py.Group:
        """Return a group."""
        found = self.object(name)
        if not isinstance(found, h5py.Group):
            raise self.foreign(f"/{name} is not a group")
        return found

    def dataset(self, name: str) -> h5py.Dataset:
        """Return a dataset whose values stand in the file under its own name."""
        found = self.object(name)
        if not isinstance(found, h5py.Dataset) or found.shape is None:
            raise self.foreign(f"/{name} is not a dataset with values")
        if found.is_virtual or found.external:
            raise self.foreign(f"/{name} is kept in another place of the disk")
        return found

    def declared_shape(self, name: str, ndim: int) -> tuple[int, ...]:
        """Return the dimensions of a dataset, of which there must be `ndim`."""
        shape = self.dataset(name).shape
        if len(shape) != ndim:
            raise self.foreign(f"/{name} has {len(shape)} dimensions, expected {ndim}")
        return tuple(int(length) for length in shape)

    def numbers(
        self,
        name: str,
        ndim: int,
        kind: str,
        shape: tuple[int, ...] | None = None,
        rows: NDArray[np.intp] | None = None,
    ) -> NDArray[Any]:
        """Return a dataset of the expected dimensions and kind of number, or only some of its rows."""
        dataset = self.dataset(name)
        found = self.declared_shape(name, ndim)
        if shape is not None and found != shape:
            raise self.foreign(f"/{name} has shape {found}, expected {shape}")
        if dataset.dtype.kind != kind:
            raise self.foreign(f"/{name} holds {dataset.dtype}, expected a type of kind '{kind}'")
        wanted = (len(rows) if rows is not None else found[0]) * int(np.prod(found[1:], dtype=object))
        stored = min(int(dataset.id.get_storage_size()), self.size)
        packed = dataset.compression is not None or dataset.id.get_create_plist().get_nfilters() > 0
        if wanted * dataset.dtype.itemsize > stored * (_MOST_COMPRESSED if packed else 1):
            raise self.foreign(f"/{name} declares {wanted} values, more than are stored")
        if rows is None or len(rows) == found[0]:
            values = dataset[...]
        elif rows[-1] - rows[0] + 1 == len(rows):
            values = dataset[rows[0] : rows[-1] + 1]
        else:
            values = dataset[rows]
        return np.asarray(values, dtype=np.float64) if kind == "f" else np.asarray(values)

    def scalar(self, name: str) -> float:
        """Return one number."""
        dataset = self.dataset(name)
        if dataset.shape != () or dataset.dtype.kind != "f":
            raise self.foreign(f"/{name} is not a number")
        return float(dataset[()])

    def text(self, name: str) -> str:
        """Return one text."""
        dataset = self.dataset(name)
        if dataset.shape != () or h5py.check_string_dtype(dataset.dtype) is None:
            raise self.foreign(f"/{name} is not a text")
        return str(dataset.asstr()[()])[:_LONGEST_TEXT]

    def texts(self, name: str, most: int = 255) -> tuple[str, ...]:
        """Return a list of texts, which must not be empty nor longer than `most`."""
        dataset = self.dataset(name)
        if (
            len(dataset.shape) != 1
            or not 0 < dataset.shape[0] <= most
            or h5py.check_string_dtype(dataset.dtype) is None
        ):
            raise self.foreign(f"/{name} is not a list of names")
        return tuple(str(text) for text in dataset.asstr()[...])

    def attribute(self, name: str, attribute: str) -> str:
        """Return a text attribute of an object; empty if it is not there or no text."""
        attributes = self.object(name).attrs if name else self.file.attrs
        if attribute not in attributes:
            return ""
        place = attributes.get_id(attribute)
        if place.shape != () or h5py.check_string_dtype(place.dtype) is None:
            return ""
        value = attributes[attribute]
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
