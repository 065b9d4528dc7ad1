"""The measured curves: polar plots of S and P at one wavelength, and the spectrum at the last position."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSlider, QSplitter, QVBoxLayout, QWidget

from gonio_gui.live import NANOMETRES_OF_INTEREST, LiveScan
from gonio_gui.polar import Curve, PolarPlot
from gonio_gui.spectrum import SpectrumPlot
from gonio_gui.theme import LIGHT, Theme

NAMES = {"s": "S polarization", "p": "P polarization"}
MARKS = ("●", "■", "▼", "◆", "⬟", "★")  # what `theme.SYMBOLS` look like in a line of text


class Plots(QWidget):
    """Draws a `LiveScan`; redraws only what has changed since the last time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._theme = LIGHT
        self._live: LiveScan | None = None
        self._drawn: dict[str, tuple[int, ...]] = {}
        self.polar = {name: PolarPlot(title) for name, title in NAMES.items()}
        self.spectrum = SpectrumPlot()
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("Wavelength of the polar plots")
        self.slider.valueChanged.connect(self._wavelength_moved)
        self.wavelength = QLabel()
        self.legend = QLabel()
        self._lay_out()

    def _lay_out(self) -> None:
        upper = QWidget()
        column = QVBoxLayout(upper)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        head = QHBoxLayout()
        self.wavelength.setMinimumWidth(150)
        head.addWidget(self.wavelength)
        head.addWidget(self.slider, 1)
        head.addSpacing(12)
        head.addWidget(self.legend)
        column.addLayout(head)
        pair = QHBoxLayout()
        pair.setSpacing(6)
        for plot in self.polar.values():
            pair.addWidget(plot, 1)
        column.addLayout(pair, 1)
        splitter = QSplitter(Qt.Orientation.Vertical)
        splitter.addWidget(upper)
        splitter.addWidget(self.spectrum)
        splitter.setChildrenCollapsible(False)
        splitter.setSizes([285, 430])
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(splitter)

    @property
    def column(self) -> int:
        """Index of the wavelength that the polar plots are drawn at."""
        return self.slider.value()

    def set_theme(self, theme: Theme) -> None:
        """Redraw in other colours."""
        self._theme = theme
        self._drawn.clear()
        for plot in self.polar.values():
            plot.set_theme(theme)
        self.spectrum.set_theme(theme)
        self._write_legend()

    def prepare(self, live: LiveScan | None) -> None:
        """Show another scan."""
        wanted_nm = NANOMETRES_OF_INTEREST
        if self._live is not None:
            wanted_nm = float(self._live.wavelength_nm[self.column])  # what the user looks at stays
        self._live = live
        self._drawn.clear()
        self.setEnabled(live is not None)
        if live is None:
            return
        present = live.plan.polarization
        for name, plot in self.polar.items():
            plot.setVisible(name in present)
            plot.prepare(live.incidences_deg)
        self.slider.setRange(0, len(live.wavelength_nm) - 1)
        self.slider.setValue(live.column_near(wanted_nm))
        self.spectrum.prepare(live.wavelength_nm.tolist(), live.detector_change_nm)
        self._wavelength_moved(self.slider.value())
        self._write_legend()

    def draw(self) -> None:
        """Draw one plot that something new was measured for; the others follow with the next calls.

        Each costs 10 ms and more with its painting, which all together would be felt as a jerk.
        """
        live = self._live
        if live is None:
            return
        numbers = {theta_i: number for number, theta_i in enumerate(live.incidences_deg)}
        for name, revision in live.revision.items():
            if not self._is_new(name, (revision, self.column)):
                continue
            self.polar[name].draw(
                [
                    Curve(numbers[key.theta_i_deg], key.theta_i_deg, *live.curve(key, self.column))
                    for key in live.sweeps
                    if key.polarization == name
                ]
            )
            return
        spectrum = live.last_spectrum()
        if spectrum is not None and self._is_new("spectrum", tuple(live.revision.values())):
            self.spectrum.draw(spectrum, live.detector_change_nm)

    def _is_new(self, what: str, state: tuple[int, ...]) -> bool:
        """Whether something has changed since it was drawn; it is taken as drawn from now on."""
        before = self._drawn.get(what)
        self._drawn[what] = state
        return before != state

    def _wavelength_moved(self, column: int) -> None:
        if self._live is None:
            return
        wavelength_nm = float(self._live.wavelength_nm[min(column, len(self._live.wavelength_nm) - 1)])
        self.wavelength.setText(f"r(θ<sub>o</sub>) at <b>{wavelength_nm:g} nm</b>")
        self.spectrum.mark(wavelength_nm)

    def _write_legend(self) -> None:
        if self._live is None:
            return
        entries = []
        for number, theta_i in enumerate(self._live.incidences_deg[:8]):
            colour, mark = self._theme.cycle[number % len(self._theme.cycle)], MARKS[number % len(MARKS)]
            entries.append(f'<span style="color:{colour}">{mark}</span>&nbsp;{theta_i:g}°')
        more = " …" if len(self._live.incidences_deg) > 8 else ""
        self.legend.setText(
            "incidence θ<sub>i</sub> (mark on the circle): &nbsp;" + " &nbsp; ".join(entries) + more
        )
