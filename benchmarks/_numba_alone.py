"""Keep numba from taking our coverage.py, which lies beside the benchmarks, for the package of that name.

Imported before numba, which looks for `coverage` when it is loaded, and does without it.
"""

from __future__ import annotations

import sys
from typing import Any

_modules: dict[str, Any] = sys.modules
_modules.setdefault("coverage", None)
