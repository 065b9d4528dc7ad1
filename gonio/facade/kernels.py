"""The two compiled entry points, and their cache on disk.

Numba's cache notices a change of the file an entry point is in, but not of the other files it calls.  Its key
does hold what the entry point closes over, so both close over a digest of the sources they are compiled from.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from numba import njit

from gonio.facade import backward as _backward
from gonio.facade import (
    gray,
    intersect,
    lanes,
    layout,
    lobe,
    sampling,
    skylight,
    stokes,
    strip,
    tracing,
    vectors,
)
from gonio.facade import photons as _photons_module
from gonio.facade import rows as _rows_module

_paths = _backward.backward_paths
_trace_rows = _rows_module.trace_rows
_photons = _photons_module.photons


def _digest() -> int:
    total = hashlib.sha256()
    for module in (
        layout,
        sampling,
        gray,
        strip,
        vectors,
        lanes,
        intersect,
        skylight,
        tracing,
        lobe,
        stokes,
        _rows_module,
        _backward,
        _photons_module,
    ):
        if module.__file__ is not None and Path(module.__file__).is_file():
            total.update(Path(module.__file__).read_bytes())
    return int.from_bytes(total.digest()[:7], "big")


def _entry_points(digest: int) -> tuple[Any, Any, Any]:
    @njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
    def backward(g, light, patches, directions, seed, replicas, window, lobe, out, exposed):  # type: ignore[no-untyped-def]
        if digest < 0:
            return 0
        return _paths(g, light, patches, directions, seed, replicas, window, lobe, out, exposed)

    @njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
    def photons(  # type: ignore[no-untyped-def]
        g, light, patches, chance, directions, seed, source, replicas, follow, polarised, base, window,
        tally, tally_d, energy,
    ):  # fmt: skip
        if digest < 0:
            return 0
        return _photons(
            g, light, patches, chance, directions, seed, source, replicas, follow, polarised, base, window,
            tally, tally_d, energy,
        )  # fmt: skip

    @njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
    def rows(  # type: ignore[no-untyped-def]
        g,
        light,
        table,
        patches,
        chosen,
        reverse,
        angles,
        seed,
        replicas,
        window,
        length,
        place,
        index,
        count,
        weight,
        sums,
    ):
        if digest < 0:
            return 0
        return _trace_rows(
            g, light, table, patches, chosen, reverse, angles, seed, replicas, window, length, place,
            index, count, weight, sums,
        )  # fmt: skip

    return backward, photons, rows


DIGEST = _digest()
"""Of all sources that the kernels are compiled from."""

backward, photons, rows = _entry_points(DIGEST)


def compiled_already() -> bool:
    """Say whether both kernels have been compiled or loaded in this process."""
    return bool(backward.signatures and photons.signatures)
