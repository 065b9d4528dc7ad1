"""The tree that finds what a ray hits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.facade.layout import FloatArray, IntArray


class Tree(NamedTuple):
    """Boxes and links, and the order of the primitives in its leaves."""

    bounds: NDArray[np.float32]
    child: NDArray[np.int32]
    order: IntArray


def build(
    origin: FloatArray,
    u: FloatArray,
    v: FloatArray,
    triangle: NDArray[np.uint8],
    extent: float,
    *,
    periodic: bool,
) -> Tree:
    """Return the tree of m primitives."""
    return Tree(
        np.zeros((0, 6, 8), np.float32), np.zeros((0, 8), np.int32), np.arange(len(origin), dtype=np.int64)
    )
