"""Which Sobol point comes next?  The points of `sampling.sobol` in Gray-code order, one XOR a coordinate.

Over a range whose ends are multiples of the same power of two these are the same points in another order.
States are kept bit-reversed, as the scrambling wants them.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.facade.sampling import MIX_B, compiled, mix, owen
from gonio.facade.sobol import sobol_directions

_ONE = np.uint64(1)
_LOW32 = np.uint64(0xFFFFFFFF)


@cache
def reversed_directions() -> NDArray[np.uint64]:
    """Return the direction numbers of `sobol_directions`, bits reversed, (bits, dimensions) uint64."""
    directions = sobol_directions()
    found = np.zeros_like(directions)
    for bit in range(32):
        found |= ((directions >> np.uint64(bit)) & _ONE) << np.uint64(31 - bit)
    return np.ascontiguousarray(found.T)


@compiled
def first_state(reverse: Any, index: int) -> Any:
    """Return the six coordinates, as bits, of the point with which a range begins at `index`."""
    x0 = x1 = x2 = x3 = x4 = x5 = np.uint64(0)
    rest = np.uint64(index) ^ (np.uint64(index) >> _ONE)
    bit = 0
    while rest != np.uint64(0):
        if rest & _ONE:
            x0 ^= reverse[bit, 0]
            x1 ^= reverse[bit, 1]
            x2 ^= reverse[bit, 2]
            x3 ^= reverse[bit, 3]
            x4 ^= reverse[bit, 4]
            x5 ^= reverse[bit, 5]
        rest >>= _ONE
        bit += 1
    return x0, x1, x2, x3, x4, x5


@compiled
def next_state(reverse: Any, x: Any, index: int) -> Any:
    """Return the bits of the point at `index` from those at ``index - 1``."""
    rest = np.uint64(index)
    bit = 0
    while not rest & _ONE:
        rest >>= _ONE
        bit += 1
    return (
        x[0] ^ reverse[bit, 0],
        x[1] ^ reverse[bit, 1],
        x[2] ^ reverse[bit, 2],
        x[3] ^ reverse[bit, 3],
        x[4] ^ reverse[bit, 4],
        x[5] ^ reverse[bit, 5],
    )


@compiled
def scramblings(key: Any) -> Any:
    """Return what randomises each of the six coordinates."""
    return (
        mix(key) & _LOW32,
        mix(key + MIX_B) & _LOW32,
        mix(key + np.uint64(2) * MIX_B) & _LOW32,
        mix(key + np.uint64(3) * MIX_B) & _LOW32,
        mix(key + np.uint64(4) * MIX_B) & _LOW32,
        mix(key + np.uint64(5) * MIX_B) & _LOW32,
    )


@compiled
def coordinate(bits: Any, scrambling: Any) -> Any:
    """Return a coordinate strictly inside (0, 1)."""
    return (np.float64(owen(bits, scrambling)) + 0.5) * 2.3283064365386963e-10
