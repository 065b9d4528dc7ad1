"""Vectors of three numbers as tuples, for the kernels: no allocation, no reference count."""

from __future__ import annotations

from typing import Any

from gonio.facade.sampling import compiled


@compiled
def dot(a: Any, b: Any) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]


@compiled
def cross(a: Any, b: Any) -> Any:
    """Return the vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def along(p: Any, t: float, d: Any) -> Any:
    """Return ``p + t d``."""
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


@compiled
def mirrored(d: Any, n: Any) -> Any:
    """Return the direction `d` mirrored at a plane of unit normal `n`."""
    t = 2.0 * dot(d, n)
    return d[0] - t * n[0], d[1] - t * n[1], d[2] - t * n[2]


@compiled
def negative(d: Any) -> Any:
    """Return ``-d``."""
    return -d[0], -d[1], -d[2]


@compiled
def row(array: Any, k: int) -> Any:
    """Return row `k` of an (n, 3) array as three numbers (a view would count references in every thread)."""
    return array[k, 0], array[k, 1], array[k, 2]
