"""Show the progress of long work: a bar with the time left on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

LINE_EVERY_S = 10.0  # without a terminal (a log file, CI)


def readable_duration(seconds: float) -> str:
    """Return a duration as a person says it: ``45 s``, ``3 min 20 s``, ``9 h 50 min``."""
    if seconds != seconds or seconds < 0:
        return "unknown"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    if whole < 86400:
        return f"{whole // 3600} h {whole % 3600 // 60} min"
    return f"{whole // 86400} d {whole % 86400 // 3600} h"


@dataclass
class Bar:
    """A running bar; `update` is cheap enough to be called after every reading."""

    title: str
    total: float
    _draw: Callable[[float, str], None]
    _print: Callable[[str], None]
    _last_s: float = field(default=0.0)

    def say(self, text: str) -> None:
        """Print a line that stays, above the bar."""
        self._print(text)

    def update(self, done: float, text: str = "") -> None:
        """Show `done` of `total` and a short text; redraws at most ten times a second."""
        now = time.monotonic()
        if now - self._last_s >= 0.1 or done >= self.total:
            self._last_s = now
            self._draw(done, text)


@contextlib.contextmanager
def progress_bar(title: str, total: float) -> Iterator[Bar]:
    """Yield a `Bar` drawn on standard error."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield Bar(
            title, total, _line_printer(title, total), lambda text: print(text, file=sys.stderr, flush=True)
        )
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>5.1f} %"),
        TextColumn("{task.fields[text]}"),
        TimeElapsedColumn(),
        console=console,
        auto_refresh=False,  # no drawing thread beside the scan
    ) as bars:
        task: TaskID = bars.add_task(title, total=total, text="")

        def draw(done: float, text: str) -> None:
            bars.update(task, completed=done, text=text)
            bars.refresh()

        yield Bar(title, total, draw, lambda text: console.print(text, markup=False, highlight=False))


def _line_printer(title: str, total: float) -> Callable[[float, str], None]:
    last_s = time.monotonic()

    def draw(done: float, text: str) -> None:
        nonlocal last_s
        if time.monotonic() - last_s >= LINE_EVERY_S:
            last_s = time.monotonic()
            print(f"{title}: {100 * done / max(total, 1e-300):.0f} %, {text}", file=sys.stderr, flush=True)

    return draw
