"""Which random numbers and directions does a path take?

Every number is a hash of (seed, stream, path, draw), and the first eight draws of a path are a Sobol point
with its own Owen scrambling per replica: nothing depends on which thread computes what, or in which order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numba.core.registry import CPUDispatcher

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile what runs inside a kernel; `gonio.facade.kernels` keeps the machine code.

    Without numba's runtime (`_nrt`): kernels allocate nothing, and with it every access to an array of a
    tuple counts references, which made a ray 30 times slower.  Without the wrappers for Python and C, which
    took 40 % of the time to compile; whoever calls one from Python gets one then.
    """
    inner = njit(nogil=True, error_model="numpy", _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)(
        function
    )
    inner.__class__ = _Inner
    return inner  # type: ignore[no-any-return]


class _Inner(CPUDispatcher):  # type: ignore[misc]
    """A compiled function that only compiled functions call, or tests."""

    def __call__(self, *args: Any) -> Any:
        """Return the value for arguments from Python, through a wrapper compiled on the first call."""
        wrapper = _WRAPPERS.get(self.py_func)
        if wrapper is None:
            wrapper = _WRAPPERS[self.py_func] = _wrapper(self)
        return wrapper(*args)


_WRAPPERS: dict[Callable[..., Any], Callable[..., Any]] = {}


def _wrapper(inner: _Inner) -> Any:
    @njit(nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
    def call(*args: Any) -> Any:
        return inner(*args)

    return call


_ONE = np.uint64(1)
_LOW32 = np.uint64(0xFFFFFFFF)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX_A = np.uint64(0xBF58476D1CE4E5B9)
MIX_B = np.uint64(0x94D049BB133111EB)
_S11, _S16, _S27, _S30, _S31 = (np.uint64(n) for n in (11, 16, 27, 30, 31))
_SWAPS = tuple(
    (np.uint64(shift), np.uint64(mask))
    for shift, mask in ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555))
)
(_W16, _M16), (_W8, _M8), (_W4, _M4), (_W2, _M2), (_W1, _M1) = _SWAPS
_OWEN = tuple(np.uint64(n) for n in (0x3D20ADEA, 0x05526C56, 0x53A22864))
_O1, _O2, _O3 = _OWEN


@compiled
def mix(z: Any) -> Any:
    """Return a 64-bit hash of `z` (the finaliser of splitmix64; Steele, Lea and Flood 2014)."""
    z = (z ^ (z >> _S30)) * MIX_A
    z = (z ^ (z >> _S27)) * MIX_B
    return z ^ (z >> _S31)


@compiled
def key_of(seed: Any, stream: Any, replica: Any) -> Any:
    """Return the key of one independent randomisation."""
    key = mix(np.uint64(seed) + _GOLDEN)
    key = mix(key ^ (np.uint64(stream) * _GOLDEN + _ONE))
    return mix(key + np.uint64(replica) * MIX_A + _GOLDEN)


@compiled
def uniform(key: Any, counter: Any) -> Any:
    """Return draw `counter` of the stream `key`: strictly between 0 and 1, 53 bits."""
    bits = mix(key + np.uint64(counter) * _GOLDEN)
    return (np.float64(bits >> _S11) + 0.5) * 1.1102230246251565e-16


@compiled
def reversed32(x: Any) -> Any:
    """Return 32 bits in reverse order."""
    x = ((x >> _W16) & _M16) | ((x & _M16) << _W16)
    x = ((x >> _W8) & _M8) | ((x & _M8) << _W8)
    x = ((x >> _W4) & _M4) | ((x & _M4) << _W4)
    x = ((x >> _W2) & _M2) | ((x & _M2) << _W2)
    return ((x >> _W1) & _M1) | ((x & _M1) << _W1)


@compiled
def owen(x: Any, scramble: Any) -> Any:
    """Return the 32 bits `x`, given in reverse order, scrambled and in their right order.

    The nested scrambling is the hash of Laine and Karras (2011) on the reversed bits, with the constants of
    Vegdahl as given by Burley (2020), J. Computer Graphics Techniques 9(4).
    """
    x ^= (x * _O1) & _LOW32
    x = (x + scramble) & _LOW32
    x = (x * ((scramble >> _S16) | _ONE)) & _LOW32
    x ^= (x * _O2) & _LOW32
    x ^= (x * _O3) & _LOW32
    return reversed32(x)


@compiled
def sobol(directions: Any, index: Any, dimension: int, key: Any) -> Any:
    """Return coordinate `dimension` of Sobol point `index`, Owen-scrambled by `key`, inside (0, 1)."""
    x = np.uint64(0)
    rest = np.uint64(index)
    bit = 0
    while rest != np.uint64(0):
        if rest & _ONE:
            x ^= directions[dimension, bit]
        rest >>= _ONE
        bit += 1
    scramble = mix(key + np.uint64(dimension) * MIX_B) & _LOW32
    return (np.float64(owen(reversed32(x), scramble)) + 0.5) * 2.3283064365386963e-10


@compiled
def around(x: float, y: float, z: float, cosine: float, sine: float, u: float) -> Any:
    """Return the unit vector at a polar angle from the unit vector (x, y, z), azimuth ``2 pi u``."""
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    p = sine * math.cos(2.0 * math.pi * u)
    q = sine * math.sin(2.0 * math.pi * u)
    return (
        p * (1.0 + sign * x * x * a) + q * b + cosine * x,
        p * sign * b + q * (sign + y * y * a) + cosine * y,
        -p * sign * x - q * y + cosine * z,
    )


@compiled
def cosine_direction(n: Any, u: float, w: float) -> Any:
    """Return a direction of density cos(theta)/pi about the unit normal `n`."""
    return around(n[0], n[1], n[2], math.sqrt(1.0 - u), math.sqrt(u), w)


@compiled
def sun_direction(light: Any, u: float, w: float) -> Any:
    """Return a direction uniform over the sun's disc."""
    t = u * light.disc  # 1 - cos, kept as such: cos of a quarter of a degree has lost half its digits
    s = light.sun
    return around(s[0], s[1], s[2], 1.0 - t, math.sqrt(t * (2.0 - t)), w)


@compiled
def lobe_direction(x: float, y: float, z: float, alpha: float, u: float, w: float) -> Any:
    """Return a direction of density ``(alpha+1)/(2 pi) cos^alpha`` about (x, y, z), exact for any alpha."""
    exponent = math.log(u) / (alpha + 1.0)
    return around(x, y, z, math.exp(exponent), math.sqrt(-math.expm1(2.0 * exponent)), w)
