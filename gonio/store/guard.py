"""Is there anything in an HDF5 file that would lead out of it, or take more memory than it has a right to?

Asked of every file before anything is read from it.  Links are looked at, never followed:

- links to other files, datasets kept in other files and views of other files are refused anywhere;
- no dataset may declare far more bytes than the file has, and none of its chunks: both are taken as a whole;
- texts are counted piece by piece, since a million entries can all be one and the same long text;
- cycles of groups end where they meet themselves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py

from gonio.errors import StoreError

_MOST_OBJECTS = 100_000
_DEEPEST = 64
_FREE_BYTES = 16_000_000
_MOST_INFLATED = 16
"""A dataset may declare 16 MB and this many times the file's size: measured data compress to a half, rows not
measured yet to nothing, and they take room on the disk when the scan begins."""
_LONGEST_TEXTS = 64_000_000
_TEXTS_AT_ONCE = 256


def refuse_dangerous(path: Path, file: h5py.File) -> None:
    """Raise `StoreError` with the place in the file if something in it must not be touched."""
    for problem in dangers(path, file):
        raise StoreError(f"{path}: {problem}")


def dangers(path: Path, file: h5py.File) -> Iterator[str]:
    """Yield what must not be touched in an open file, each with its place and what to do."""
    most_bytes = _FREE_BYTES + _MOST_INFLATED * path.stat().st_size
    texts = 0
    seen: set[int] = set()
    # h5py's low level: a file has some hundred objects, and every command looks at each
    waiting: list[tuple[str, Any, int]] = [("", h5py.h5g.open(file.id, b"/"), 0)]
    while waiting:
        name, item, depth = waiting.pop()
        try:
            address = h5py.h5o.get_info(item).addr
            if address in seen:
                continue
            seen.add(address)
            if len(seen) > _MOST_OBJECTS or depth > _DEEPEST:
                yield f"{name} is one of too many objects, or nested too deeply; give a file written by gonio"
                return
            yield from _attributes(name, item)
            if isinstance(item, h5py.h5g.GroupID):
                for key in item:
                    kind = item.links.get_info(key).type
                    place = f"{name}/{key.decode('utf-8', 'replace')}"
                    if kind == h5py.h5l.TYPE_EXTERNAL:
                        target = item.links.get_val(key)[0].decode("utf-8", "replace")
                        yield (
                            f"{place} is a link to another file ({target}), which is not followed; "
                            "remove it, or copy what it links to into the file"
                        )
                    elif kind == h5py.h5l.TYPE_HARD:
                        waiting.append((place, h5py.h5o.open(item, key), depth + 1))
            elif isinstance(item, h5py.h5d.DatasetID):
                problems = list(_dataset(name, item, most_bytes))
                yield from problems
                texts += 0 if problems else _text_bytes(item)
                if texts > _LONGEST_TEXTS:
                    yield f"{name} holds more than {_LONGEST_TEXTS} bytes of text; restore the file"
                    return
        except (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError) as error:
            yield f"{name or '/'} is damaged ({error}); restore the file from a copy"
            return


def _attributes(name: str, item: Any) -> Iterator[str]:
    for number in range(h5py.h5a.get_num_attrs(item)):
        attribute = h5py.h5a.open(item, index=number)
        if math.prod(attribute.shape) * attribute.get_type().get_size() > _FREE_BYTES:
            yield f"{name or '/'} has an attribute of shape {attribute.shape}; restore the file from a copy"


def _dataset(name: str, dataset: Any, most_bytes: int) -> Iterator[str]:
    creation = dataset.get_create_plist()
    if creation.get_external_count():
        yield f"{name} is kept in another place of the disk, which is not read; copy it into the file"
    layout = creation.get_layout()
    if layout == h5py.h5d.VIRTUAL:
        for number in range(creation.get_virtual_count()):
            source = creation.get_virtual_filename(number)
            if source != ".":
                yield (
                    f"{name} is a view of another file ({source}), which is not read; copy the values into "
                    "the file"
                )
                break
    size = dataset.get_type().get_size()
    shape = dataset.shape
    if shape is not None and math.prod(shape) * size > most_bytes:
        yield f"{name} declares {shape} values, more than are stored; restore the file"
    if layout == h5py.h5d.CHUNKED and math.prod(creation.get_chunk()) * size > most_bytes:
        yield f"{name} is cut into chunks of {creation.get_chunk()} values; restore the file from a copy"


def _text_bytes(dataset: Any) -> int:
    """Return the bytes of a dataset's texts of any length, stopping once they are too many."""
    kind = dataset.get_type()
    if not (isinstance(kind, h5py.h5t.TypeStringID) and kind.is_variable_str() and dataset.rank == 1):
        return 0
    texts = h5py.Dataset(dataset)
    total = 0
    for low in range(0, len(texts), _TEXTS_AT_ONCE):
        total += sum(len(text) for text in texts[low : low + _TEXTS_AT_ONCE])
        if total > _LONGEST_TEXTS:
            break
    return total
