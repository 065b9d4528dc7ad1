"""One HTML page and its figures from any file of the program: after the paper's Figures 7 and 9 to 13.

>>> from pathlib import Path
>>> from gonio.report import write_report
>>> write_report(Path("hpl.h5"), Path("hpl-report"), facade_h5=Path("street.h5"))   # doctest: +SKIP
PosixPath('hpl-report/report.html')
"""

from __future__ import annotations

from gonio.report.write import write_any_report, write_facade_report, write_report

__all__ = ["write_any_report", "write_facade_report", "write_report"]
