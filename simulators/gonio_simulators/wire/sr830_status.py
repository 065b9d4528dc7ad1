"""The status registers of an SR830: events, overloads, and what of them reaches the status byte."""

from __future__ import annotations

from collections.abc import Callable

from gonio_simulators.wire.sr830_parameters import Illegal, OutOfRange, item_of, whole

# bits of the LIA status register; the bench's low-pass itself never overloads (bit 1)
INPUT_OVERLOAD, OUTPUT_OVERLOAD, TRIGGERED = 1 << 0, 1 << 2, 1 << 6

# bits of the standard event register
INPUT_OVERFLOW, EXECUTION_ERROR, ILLEGAL_COMMAND, POWER_ON = 1 << 0, 1 << 4, 1 << 5, 1 << 7

# bits of the serial poll status byte
NO_SCAN, IDLE = 1 << 0, 1 << 1


class StatusRegisters:
    """Bits stay set until they are read or ``*CLS`` clears them.

    Parameters
    ----------
    condition
        The bits of the status byte that tell of the present: `NO_SCAN`, `IDLE`.
    """

    def __init__(self, condition: Callable[[], int]) -> None:
        self._condition = condition
        self.events = POWER_ON
        self.lia = 0
        self._enabled = {"*ESE": 0, "*SRE": 0, "ERRE": 0, "LIAE": 0}

    def read_lia(self, parameters: list[str]) -> str:
        """Answer ``LIAS?``."""
        answer, self.lia = _register(self.lia, parameters)
        return answer

    def read_events(self, is_query: bool, parameters: list[str]) -> str:
        """Answer ``*ESR?``."""
        if not is_query:
            raise Illegal
        answer, self.events = _register(self.events, parameters)
        return answer

    def read_errors(self, is_query: bool, parameters: list[str]) -> str:
        """Answer ``ERRS?``: the simulated instrument passes its self-tests."""
        if not is_query:
            raise Illegal
        return _register(0, parameters)[0]

    def read_status_byte(self, is_query: bool, parameters: list[str]) -> str:
        """Answer ``*STB?``."""
        if not is_query:
            raise Illegal
        status = self._condition()
        status |= bool(self.lia & self._enabled["LIAE"]) << 3
        status |= bool(self.events & self._enabled["*ESE"]) << 5
        status |= bool(status & self._enabled["*SRE"] & ~0x40) << 6
        return _register(status, parameters)[0]

    def switch_on(self, *, clears_enables: bool) -> None:
        """Be as after power comes on; ``*PSC 0`` keeps the enable registers."""
        self.events, self.lia = POWER_ON, 0
        if clears_enables:
            self._enabled = dict.fromkeys(self._enabled, 0)

    def enable(self, name: str, is_query: bool, parameters: list[str]) -> str:
        """Set or read an enable register: the whole, or bit i of it."""
        value = self._enabled[name]
        if is_query:
            return _register(value, parameters)[0]
        given = [whole(p) for p in parameters]
        if len(given) == 1 and 0 <= given[0] <= 255:
            self._enabled[name] = given[0]
        elif len(given) == 2 and 0 <= given[0] <= 7 and given[1] in (0, 1):
            self._enabled[name] = value & ~(1 << given[0]) | given[1] << given[0]
        else:
            raise OutOfRange
        return ""

    def clear(self, is_query: bool, parameters: list[str]) -> str:
        """Carry out ``*CLS``."""
        if is_query or parameters:
            raise Illegal
        self.events = self.lia = 0
        return ""


def _register(value: int, parameters: list[str]) -> tuple[str, int]:
    """Return a status register, or one bit of it, and what is left in it once that is read."""
    if not parameters:
        return str(value), 0
    bit = item_of(parameters, 1, 0, 7)
    return str(value >> bit & 1), value & ~(1 << bit)
