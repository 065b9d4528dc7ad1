"""The line across the window for what must not be overlooked, with buttons where there is a choice.

It is part of the window and not a dialog: nothing is blocked by it, and Stop motion stays within reach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QSizePolicy, QWidget

from gonio.store.records import Level
from gonio_gui.theme import LIGHT, Theme, translucent

Choice = tuple[str, Callable[[], None]]


class BannerBar(QFrame):
    """A message with its level, and buttons."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("banner")
        self._theme = LIGHT
        self._level: Level = "info"
        self.label = QLabel()
        self.label.setWordWrap(True)
        self.label.setTextFormat(Qt.TextFormat.PlainText)
        self.label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.label.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred)
        self.buttons: list[QPushButton] = []
        self._layout = QHBoxLayout(self)
        self._layout.setContentsMargins(12, 7, 8, 7)
        self._layout.addWidget(self.label, 1)
        self.hide()

    def set_theme(self, theme: Theme) -> None:
        """Redraw in other colours."""
        self._theme = theme
        colour = {"info": theme.good, "warning": theme.warning, "error": theme.danger}[self._level]
        soft = translucent(colour, 0.14)
        self.setStyleSheet(
            f"#banner {{ border: none; border-left: 4px solid {colour}; border-radius: 3px;"
            f" background: rgba({soft.red()}, {soft.green()}, {soft.blue()}, {soft.alpha()}); }}"
            f"#banner QLabel {{ color: {theme.text}; }}"
        )

    def say(self, level: Level, text: str, choices: Sequence[Choice] = ()) -> None:
        """Show a message, with one button per choice."""
        self._level = level
        self.label.setText(text)
        for button in self.buttons:
            self._layout.removeWidget(button)
            button.deleteLater()
        self.buttons = []
        for caption, action in choices:
            button = QPushButton(caption)
            button.clicked.connect(action)
            self._layout.addWidget(button)
            self.buttons.append(button)
        self.set_theme(self._theme)
        self.show()
