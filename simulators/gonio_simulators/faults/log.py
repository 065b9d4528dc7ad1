"""Which faults were injected: one line each as it happens, and how to read them back.

bench seconds <TAB> real time (ISO 8601, UTC) <TAB> name <TAB> target <TAB> details
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

from gonio.errors import ConfigError

_HEADER = "# bench_s\treal_time\tname\ttarget\tdetails\n"


@dataclass(frozen=True, slots=True)
class Injected:
    """One fault that was injected."""

    bench_s: float
    real_time: datetime
    name: str
    target: str
    details: str

    def line(self) -> str:
        """Return the line of the log, without its end."""
        details = self.details.replace("\t", " ").replace("\n", " ")
        real_time = self.real_time.isoformat(timespec="microseconds")
        return f"{self.bench_s:.6f}\t{real_time}\t{self.name}\t{self.target}\t{details}"


class FaultLog:
    """Counts injections and writes them to a file, if one is named.

    Parameters
    ----------
    path
        Appended to, so that a bench that is started again goes on with the same log; None for no file.
    now
        Real time.
    """

    def __init__(self, path: Path | None = None, now: Callable[[], datetime] | None = None) -> None:
        self.counts: Counter[str] = Counter()
        """How often each fault has struck; a name that is asked for counts from 0."""
        self._now = now or (lambda: datetime.now(UTC))
        self._file: TextIO | None = None
        if path is not None:
            try:
                self._file = path.open("a", encoding="utf-8", newline="\n")
                if self._file.tell() == 0:
                    self._file.write(_HEADER)
                    self._file.flush()
            except OSError as error:
                raise ConfigError(
                    f"{path}: the fault log cannot be written ({error.strerror}); choose another file"
                ) from None

    def record(self, bench_s: float, name: str, target: str, details: str) -> None:
        """Note one injection; on the disk's way when this returns."""
        self.counts[name] += 1
        if self._file is not None:
            self._file.write(Injected(bench_s, self._now(), name, target, details).line() + "\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file; any number of times."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def summary(self) -> str:
        """Return the counts, a line per name."""
        return "\n".join(f"fault {name} injected {count} x" for name, count in self.counts.items())


def read_fault_log(path: str | os.PathLike[str]) -> list[Injected]:
    """Return what a fault log holds; a line that a kill cut short is left out.

    Raises
    ------
    ConfigError
        If the file is no fault log.
    """
    injected = []
    lines = Path(path).read_text(encoding="utf-8").split("\n")
    for number, line in enumerate(lines[:-1], start=1):
        if line.startswith("#") or not line:
            continue
        words = line.split("\t")
        try:
            bench_s, real_time, name, target, details = words
            injected.append(
                Injected(float(bench_s), datetime.fromisoformat(real_time), name, target, details)
            )
        except ValueError:
            raise ConfigError(f"{path}: line {number} is no line of a fault log; give another file") from None
    return injected
