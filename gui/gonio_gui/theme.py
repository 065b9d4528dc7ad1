"""Which colours the drawings use, in light and in dark.

Okabe and Ito's set, told apart with every common colour blindness; on a dark ground its dark members are
lightened.  Meaning never rests on colour alone: each incidence has a symbol, each state of a position a
shape.
"""

from __future__ import annotations

from dataclasses import dataclass

from PySide6.QtGui import QColor, QPalette


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of all drawings, as ``#rrggbb``."""

    dark: bool
    ground: str
    text: str
    faint: str  # text of secondary importance
    grid: str
    beam: str
    body: str  # solid parts of the bench
    danger: str
    warning: str
    good: str
    cycle: tuple[str, ...]  # one per incidence


LIGHT = Theme(
    dark=False,
    ground="#ffffff",
    text="#1a1a1a",
    faint="#5f6368",
    grid="#d5d8dc",
    beam="#e69f00",
    body="#4d5761",
    danger="#b3261e",
    warning="#8a5a00",
    good="#00704f",
    cycle=("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"),
)

DARK = Theme(
    dark=True,
    ground="#1b1d20",
    text="#e8eaed",
    faint="#a3a8ae",
    grid="#3c4046",
    beam="#f0b429",
    body="#b4bcc6",
    danger="#ff8a80",
    warning="#f0c060",
    good="#4fd1a5",
    cycle=("#56b4e9", "#f0a830", "#35c796", "#e39bc4", "#ff8a4c", "#8fb8ff"),
)

SYMBOLS = ("o", "s", "t", "d", "p", "star")
"""pyqtgraph's names of the symbols that go with `Theme.cycle`."""


def theme_of(palette: QPalette) -> Theme:
    """Return the theme that goes with the system's palette."""
    return DARK if palette.color(QPalette.ColorRole.Window).lightness() < 128 else LIGHT


def translucent(colour: str, alpha: float) -> QColor:
    """Return a colour with an opacity between 0 and 1."""
    found = QColor(colour)
    found.setAlphaF(alpha)
    return found
