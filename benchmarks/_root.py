"""Imported first, puts the root of the repository in the place of this folder on the path.

The benchmarks share the tests' peers.
"""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])
