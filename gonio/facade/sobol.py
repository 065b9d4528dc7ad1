"""Which numbers generate the Sobol points?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DIMENSIONS = 16

# Dimensions 2...16 of Joe and Kuo (2008), SIAM J. Sci. Comput. 30: degree and coefficients of the primitive
# polynomial, first direction numbers.
_PRIMITIVE = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
    (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
    (5, 14, (1, 3, 5, 5, 31)),
    (6, 1, (1, 3, 3, 9, 7, 49)),
    (6, 13, (1, 1, 1, 15, 21, 21)),
    (6, 16, (1, 3, 1, 13, 27, 49)),
)


def sobol_directions() -> NDArray[np.uint64]:
    """Return the direction numbers, (16, 32) uint64 of 32 significant bits."""
    table = np.zeros((DIMENSIONS, 32), dtype=np.uint64)
    table[0] = [1 << (31 - bit) for bit in range(32)]
    for dimension, (degree, inner, initial) in enumerate(_PRIMITIVE, start=1):
        numbers = [m << (31 - bit) for bit, m in enumerate(initial)]
        for bit in range(degree, 32):
            number = numbers[bit - degree] ^ (numbers[bit - degree] >> degree)
            for k in range(1, degree):
                if inner >> (degree - 1 - k) & 1:
                    number ^= numbers[bit - k]
            numbers.append(number)
        table[dimension] = numbers
    return table
