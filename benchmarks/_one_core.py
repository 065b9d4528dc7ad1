"""Keep a benchmark to one core.  Imported before numpy, which reads these settings once."""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"


def machine() -> str:
    """Return how busy the machine is, for the line beside a table of times."""
    return f"one of {os.cpu_count()} cores, load average {os.getloadavg()[0]:.2f}"
