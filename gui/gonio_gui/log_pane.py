"""The log pane: what happened, when, and what to do about it."""

from __future__ import annotations

import html

from PySide6.QtGui import QTextCursor
from PySide6.QtWidgets import QPlainTextEdit, QWidget

from gonio_gui.model import LOG_LINES, LogLine, Model
from gonio_gui.theme import LIGHT, Theme

MARK = {"info": "", "warning": "Warning: ", "error": "Error: "}


class LogPane(QPlainTextEdit):
    """Lines of the model's log, the newest at the end."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setReadOnly(True)
        self.setMaximumBlockCount(LOG_LINES)
        self.setAccessibleName("Log")
        self._theme = LIGHT
        self._shown = 0

    def set_theme(self, theme: Theme) -> None:
        """Write everything again in other colours."""
        self._theme = theme
        self.clear()
        self._shown = 0

    def draw(self, model: Model) -> None:
        """Append the lines that are new."""
        new = min(model.lines_logged - self._shown, len(model.log))
        if new <= 0:
            return
        for line in list(model.log)[-new:]:
            self.appendHtml(self._as_html(line))
        self._shown = model.lines_logged
        self.moveCursor(QTextCursor.MoveOperation.End)

    def _as_html(self, line: LogLine) -> str:
        theme = self._theme
        colour = {"info": theme.text, "warning": theme.warning, "error": theme.danger}[line.level]
        text = html.escape(MARK[line.level] + line.text).replace("\n", "<br>&nbsp;&nbsp;")
        return (
            f'<span style="color:{theme.faint}">{line.at:%H:%M:%S} {html.escape(line.source)}</span> '
            f'<span style="color:{colour}">{text}</span>'
        )
