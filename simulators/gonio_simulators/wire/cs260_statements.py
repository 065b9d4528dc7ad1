"""What each statement to a Cornerstone 260 does, its response, and the status and error codes.

After the instrument's manual, appendix "Low level commands and queries".  Set and read back, but without
effect on the bench: bandpass (it sets motorised slits), slits 2 and 3, calibration, address.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from gonio_simulators.bench.bench import Bench

NOT_UNDERSTOOD, BAD_PARAMETER, NOT_ALLOWED, NO_ACCESSORY, LABEL_TOO_LONG = 1, 2, 3, 6, 9
_LABEL_LENGTH = 8
_STEP_NM_AT_1200 = 0.1  # one step of the drive, nm, with 1200 lines/mm
_SLIT_RANGE_UM = (4, 3000)
_LINES = {1: 1200, 2: 600, 3: 300}
_NUMBERED = re.compile(r"(GRAT|FILTER|SLIT)(\d)([A-Z]+)\Z")
_DECIMALS = {"NM": 3, "UM": 6, "WN": 2}  # nanometres, micrometres, wavenumbers (1/cm)
_NM_PER_UM, _NM_TIMES_WN = 1e3, 1e7

INFORMATION = "NEWPORT CORP,CORNERSTONE 260,74100,SN 2601,V1.06"


class StatementError(Exception):
    """The statement sets the error code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Controller:
    """The monochromator's controller."""

    def __init__(self, bench: Bench) -> None:
        self.monochromator = bench.monochromator
        self._has_wheel = bool(bench.config.spectrometer.monochromator.filters)
        self.clock = bench.clock
        self.handshake = False
        self._error = 0
        self._status = 0
        self._unit = "NM"
        self._address = 4
        self._slits_um = {n: round(self.monochromator.slit_um) for n in (1, 2, 3)}
        self._bandpass_nm = 0.0
        self._labels: dict[tuple[str, int], str] = {}
        self._calibration: dict[tuple[str, int], float] = {}
        self._queries: dict[str, Callable[[], str]] = {
            "WAVE": lambda: self._format_wavelength(self.monochromator.wavelength_nm),
            "GOWAVE": lambda: self._format_wavelength(self.monochromator.wavelength_nm),
            "UNITS": lambda: self._unit,
            "STEP": lambda: str(round(self.monochromator.wavelength_nm / self._step_nm())),
            "GRAT": self._grating,
            "FILTER": self._filter,
            "SHUTTER": lambda: "O" if self.monochromator.shutter_open else "C",
            "OUTPORT": lambda: str(self.monochromator.output_port),
            "BANDPASS": lambda: f"{self._bandpass_nm:.3f}",
            "INFO": lambda: INFORMATION,
            "ADDRESS": lambda: str(self._address),
            "HANDSHAKE": lambda: str(int(self.handshake)),
            "STB": self._take_status,
            "ERROR": self._take_error,
        }
        self._commands: dict[str, Callable[[str], None]] = {
            "GOWAVE": self._go_wave,
            "CALIBRATE": self._calibrate,
            "STEP": self._step,
            "GRAT": lambda p: self._select(self.monochromator.select_grating, p),
            "FILTER": self._select_filter,
            "OUTPORT": lambda p: self._select(self.monochromator.set_output_port, p),
            "SHUTTER": self._shutter,
            "UNITS": self._set_units,
            "BANDPASS": self._set_bandpass,
            "ADDRESS": self._set_address,
            "HANDSHAKE": self._set_handshake,
            "ABORT": self._abort,
        }

    @property
    def has_error(self) -> bool:
        """Whether the status byte tells of an error."""
        return self._status != 0

    def power_cycle(self) -> None:
        """Switch off and on: everything goes to its place at power-on, and no error is known."""
        self.monochromator.power_cycle()
        self.handshake, self._error, self._status, self._unit = False, 0, 0, "NM"

    def carry_out(self, statement: str) -> str:
        """Carry out one statement and return the response, empty for a command or an error."""
        try:
            name, _, parameter = statement.upper().partition(" ")
            if name.endswith("?"):
                return self._query(name[:-1])
            if parameter == "?":
                return self._query(name)
            self._command(name, parameter.strip())
            if (code := self.monochromator.take_error()) >= 0:
                raise StatementError(code)
        except StatementError as error:
            self._error = error.code
            self._status = 0x20
        return ""

    def take_handshake(self) -> bytes:
        """Return the status byte as the handshake; reporting clears it."""
        return f"{self._take_status()}\r\n".encode("ascii")

    # -- queries ------------------------------------------------------------------------------------------

    def _query(self, name: str) -> str:
        query = self._queries.get(name)
        if query is not None:
            return query()
        kind, number, what = self._numbered(name)
        if kind == "SLIT":
            return str(self._slits_um[number])
        if what == "LABEL":
            return self._labels.get((kind, number), f"{kind}{number}"[:_LABEL_LENGTH])
        if what == "LINES":
            return str(_LINES.get(number, 1200))
        return f"{self._calibration.get((what, number), 1.0 if what == 'FACTOR' else 0.0):.7f}"

    def _grating(self) -> str:
        number = self.monochromator.grating
        label = self._labels.get(("GRAT", number), f"GRAT{number}")
        return f"{number},{_LINES.get(number, 1200)},{label}"

    def _filter(self) -> str:
        if not self._has_wheel:
            raise StatementError(NO_ACCESSORY)
        return str(self.monochromator.filter)

    def _take_status(self) -> str:
        status, self._status = self._status, 0
        return f"{status:02X}"

    def _take_error(self) -> str:
        code, self._error = self._error, 0
        return str(code)

    def _format_wavelength(self, wavelength_nm: float) -> str:
        value = {
            "NM": wavelength_nm,
            "UM": wavelength_nm / _NM_PER_UM,
            "WN": _NM_TIMES_WN / wavelength_nm,
        }[self._unit]
        return f"{value:.{_DECIMALS[self._unit]}f}"

    def _wavelength_nm(self, parameter: str) -> float:
        value = _number(parameter)
        if self._unit != "WN":
            return value * (_NM_PER_UM if self._unit == "UM" else 1.0)
        if value <= 0:
            raise StatementError(BAD_PARAMETER)
        return _NM_TIMES_WN / value

    # -- commands -----------------------------------------------------------------------------------------

    def _command(self, name: str, parameter: str) -> None:
        command = self._commands.get(name)
        if command is not None:
            command(parameter)
            return
        kind, number, what = self._numbered(name)
        if kind == "SLIT":
            self._set_slit(number, parameter)
        elif what == "LABEL":
            if len(parameter) > _LABEL_LENGTH:
                raise StatementError(LABEL_TOO_LONG)
            self._labels[kind, number] = parameter
        elif what == "LINES":
            raise StatementError(BAD_PARAMETER)  # the gratings that are fitted have the lines they have
        else:
            self._calibration[what, number] = _number(parameter)

    def _numbered(self, name: str) -> tuple[str, int, str]:
        """Split such names as GRAT1LABEL, FILTER3LABEL and SLIT1MICRONS."""
        match = _NUMBERED.match(name)
        if match is None:
            raise StatementError(NOT_UNDERSTOOD)
        kind, number, what = match[1], int(match[2]), match[3]
        known = {
            "GRAT": ("LABEL", "LINES", "FACTOR", "OFFSET", "ZERO"),
            "FILTER": ("LABEL",),
            "SLIT": ("MICRONS",),
        }
        if what not in known[kind]:
            raise StatementError(NOT_UNDERSTOOD)
        if not 1 <= number <= (6 if kind == "FILTER" else 3):
            raise StatementError(NOT_UNDERSTOOD)
        return kind, number, what

    def _go_wave(self, parameter: str) -> None:
        try:
            self.monochromator.goto(self._wavelength_nm(parameter))
        except ValueError:
            raise StatementError(NOT_ALLOWED) from None

    def _calibrate(self, parameter: str) -> None:
        """Accept only where the drive is: it is true on the bench and has nothing to correct."""
        wavelength_nm = self._wavelength_nm(parameter)
        if abs(wavelength_nm - self.monochromator.wavelength_nm) > self._step_nm():
            raise StatementError(BAD_PARAMETER)

    def _step_nm(self) -> float:
        return _STEP_NM_AT_1200 * 1200 / _LINES.get(self.monochromator.grating, 1200)

    def _step(self, parameter: str) -> None:
        target_nm = self.monochromator.wavelength_nm + _whole(parameter) * self._step_nm()
        try:
            self.monochromator.goto(target_nm)
        except ValueError:
            raise StatementError(BAD_PARAMETER) from None

    def _select_filter(self, parameter: str) -> None:
        if not self._has_wheel:
            raise StatementError(NO_ACCESSORY)
        self._select(self.monochromator.select_filter, parameter)

    @staticmethod
    def _select(select: Callable[[int], None], parameter: str) -> None:
        try:
            select(_whole(parameter))
        except ValueError:
            raise StatementError(BAD_PARAMETER) from None

    def _shutter(self, parameter: str) -> None:
        if parameter not in ("O", "C"):
            raise StatementError(BAD_PARAMETER)
        self.monochromator.set_shutter(parameter == "O")

    def _set_slit(self, number: int, parameter: str) -> None:
        """Set a slit; the entrance slit (1) sets the bandwidth of the simulated instrument."""
        width_um = round(_number(parameter))
        if not _SLIT_RANGE_UM[0] <= width_um <= _SLIT_RANGE_UM[1]:
            raise StatementError(BAD_PARAMETER)
        self._slits_um[number] = width_um
        if number == 1:
            self.monochromator.set_slit(width_um)

    def _set_units(self, parameter: str) -> None:
        if parameter not in _DECIMALS:
            raise StatementError(BAD_PARAMETER)
        self._unit = parameter

    def _set_bandpass(self, parameter: str) -> None:
        value = _number(parameter)
        if value < 0:
            raise StatementError(BAD_PARAMETER)
        self._bandpass_nm = value

    def _set_address(self, parameter: str) -> None:
        value = _whole(parameter)
        if not 1 <= value <= 30:
            raise StatementError(BAD_PARAMETER)
        self._address = value

    def _set_handshake(self, parameter: str) -> None:
        if parameter not in ("0", "1"):
            raise StatementError(BAD_PARAMETER)
        self.handshake = parameter == "1"

    def _abort(self, parameter: str) -> None:
        self.monochromator.abort()


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise StatementError(BAD_PARAMETER) from None
    if not abs(value) < 1e9:
        raise StatementError(BAD_PARAMETER)
    return value


def _whole(text: str) -> int:
    value = _number(text)
    if value != int(value):
        raise StatementError(BAD_PARAMETER)
    return int(value)
