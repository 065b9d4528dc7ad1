"""Imported first, puts the root of the repository in the place of this folder on the path.

Numba asks for the package `coverage` and would get the benchmark of that name; and the benchmarks share the
tests' peers.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])
