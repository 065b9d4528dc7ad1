"""The command line `gonio`.

Exit codes: 0 done, 1 refused or failed with a message on standard error, 2 bad usage, 130 interrupted.
"""

from __future__ import annotations

from gonio.cli.main import main

__all__ = ["main"]
