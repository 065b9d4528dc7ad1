"""Registers and coils over Modbus RTU (serial, or RTU frames over TCP) and Modbus TCP; every pymodbus call is
here.

pymodbus builds and parses the frames; the bytes travel over our own `Line`, so that deadlines, log, lock and
the treatment of late replies are those of every other device.  pymodbus' own clients poll with sleeps and, on
RTU, take a reply that is 50 ms late for the answer to the next request: RTU has no transaction number.  Here

* nothing is repeated inside pymodbus (``retries=0``): a repeated write could start a motion twice;
* a reply must have the function, address and length of its request;
* after a timeout or a damaged reply the line is read until quiet and a canary is read: a number of registers
  that no other request asks for, so that only its own reply can have its length.  The next canary after one
  that failed has another length: the late reply to the first does not prove that the replies after it are in
  step (found by `benchmarks/fuzz.py`: the reading that followed was the one asked for seconds before).
"""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.framer import FramerType
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.transport import CommParams, CommType

from gonio.errors import DeviceError
from gonio.rig import Context
from gonio_drivers.lines import Line, NoReply, open_line
from gonio_drivers.transport import Parity

Framing = Literal["rtu", "tcp"]
WordOrder = Literal["big", "little"]
ReadFunction = Literal[1, 2, 3, 4]  # coils, discrete inputs, holding registers, input registers

CANARY_REGISTER = 0x00
CANARY_COUNT = 7  # asked by nothing else, see the module's docstring


@dataclass(frozen=True, slots=True)
class Canary:
    """The request that proves that both ends are in step; function 8 is a loopback of changing bytes."""

    function: Literal[1, 2, 3, 4, 8] = 3
    address: int = CANARY_REGISTER
    count: int = CANARY_COUNT
    spare: tuple[int, ...] = ()  # other lengths that nobody asks for


LOOPBACK = Canary(8, 0, 0)

_CANARY = Canary(spare=(6, 5, 4, 9, 10, 11, 12))

_EXCEPTIONS = {
    1: ("does not know this function", "check the model and firmware of the drive"),
    2: ("does not have this register", "check the model and firmware of the drive"),
    3: ("refused the value", "check speeds and scale factors in the rig file"),
    4: ("failed to execute the command", "read the drive's alarm and reset it"),
    5: ("needs long for the command that it has accepted", "wait, read its state, then go on"),
    6: ("stays busy", "stop its own program (Q program), then repeat"),
    0x14: ("stays busy", "stop its own program (Q program), then repeat"),  # Applied Motion's code for it
}
_ILLEGAL_FUNCTION = 1
_BUSY = {6, 0x14}  # refused and nothing done: to be sent again later
_BUSY_LOOK_S = 0.05
_WRITE_PATIENCE = 2.0  # times as long as for a reading: some drives confirm what they have carried out
_WRITES = {5, 6, 15, 16}
_CONFIRMED_BY_ECHO = {5, 6, 8}  # the confirmation has the bytes of the request


class ModbusRefused(DeviceError):
    """The unit answered with a Modbus exception."""

    def __init__(self, device: str, code: int) -> None:
        fault, remedy = _EXCEPTIONS.get(code, ("answered with an unknown Modbus exception", "see its manual"))
        super().__init__(device, f"{fault} (Modbus exception {code})", remedy)
        self.code = code


# pymodbus logs every timeout as an error, which would land on the terminal beside our own message
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())


class _LineClient(ModbusBaseSyncClient):
    """A pymodbus client whose transport is a `Line`."""

    def __init__(self, line: Line, framing: Framing) -> None:
        framer = FramerType.RTU if framing == "rtu" else FramerType.SOCKET
        # Called a serial line even over TCP: pymodbus would close a socket that it does not own after some
        # timeouts.
        parameters = CommParams(
            comm_type=CommType.SERIAL, host=line.address, timeout_connect=line.reply_timeout_s
        )
        super().__init__(framer, 0, parameters, None, None, None)
        self._line = line
        self._has_crc = framing == "rtu"
        self._request = b""
        self._awaits_echo = False
        self._echoes = False  # an RS-485 adapter that hears what it sends; known from the first request on

    def connect(self) -> bool:
        return True

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        self._line.send(request)
        self._request = request
        self._awaits_echo = self._has_crc
        return len(request)

    def recv(self, size: int | None) -> bytes:
        data = self._receive()
        if self._awaits_echo and data:
            self._awaits_echo = False
            data = self._without_echo(data)
        return data

    @property
    def unit(self) -> int:
        """The unit that was asked last."""
        return self._request[0 if self._has_crc else 6]

    @property
    def timeout_s(self) -> float:
        """Real seconds for the reply to the last request."""
        function = self._request[1 if self._has_crc else 7]
        return self._line.reply_timeout_s * (_WRITE_PATIENCE if function in _WRITES else 1.0)

    def _receive(self) -> bytes:
        left_s = self._line.deadline_s(self.timeout_s) - time.monotonic()
        return self._line.receive(left_s) if left_s > 0 else b""

    def _without_echo(self, data: bytes) -> bytes:
        """Take away the request itself, which a two-wire adapter may hear before the reply.

        A reply that only confirms has the same bytes; there the echo counts only if there have been echoes
        before, or a silent drive would seem to confirm every command.
        """
        request = self._request
        if request[1] in _CONFIRMED_BY_ECHO and not self._echoes:
            return data
        while len(data) < len(request) and request.startswith(data):
            more = self._receive()
            if not more:
                return data
            data += more
        if not data.startswith(request):
            return data
        self._echoes = True
        return data[len(request) :] or self._receive()

    def close(self) -> None:
        self._line.close()


class ModbusLine:
    """Registers of the units on one line."""

    def __init__(
        self, line: Line, framing: Framing, word_order: WordOrder, *, frame_gap_s: float = 0.0
    ) -> None:
        self.line = line
        self._client = _LineClient(line, framing)
        self._word_order = word_order
        self._frame_gap_s = frame_gap_s
        self._last_s = 0.0
        self._one_by_one: set[int] = set()  # units without function 16
        self._canaries: dict[int, Canary | None] = {}
        self._loopbacks = itertools.count(1)
        self._failed_proofs = 0  # since the last that succeeded
        client = self._client
        self._reads = {
            1: client.read_coils,
            2: client.read_discrete_inputs,
            3: client.read_holding_registers,
            4: client.read_input_registers,
        }

    def use_canary(self, unit: int, canary: Canary | None) -> None:
        """Prove with another request than 7 registers from 0; None where the framing numbers its replies."""
        self._canaries[unit] = canary

    def read(self, unit: int, address: int, count: int, *, function: ReadFunction = 3) -> list[int]:
        """Return `count` registers, each 0...65535, or bits, each 0 or 1; repeated once if the reply fails.

        Raises
        ------
        ReplyError
            No reply or a damaged one, twice.
        DeviceError
            The unit answered with a Modbus exception.
        """
        canary = self._canaries.get(unit, _CANARY)
        if canary is not None and count in (canary.count, *canary.spare) and function == canary.function:
            raise ValueError(f"{count} registers is the length kept for the canary")
        return self.line.query(lambda: self._read(unit, address, count, function))

    def _read(self, unit: int, address: int, count: int, function: ReadFunction) -> list[int]:
        with self.line.transaction(lambda: self._prove(unit)):
            return self._read_now(unit, address, count, function)

    def _read_now(self, unit: int, address: int, count: int, function: ReadFunction) -> list[int]:
        read = self._reads[function]
        reply = self._asked(lambda: read(address, count=count, device_id=unit))
        if function >= 3:
            values = list(reply.registers)
            complete = len(values) == count
        else:  # bits come eight to a byte
            values = [int(bit) for bit in reply.bits[:count]]
            complete = len(reply.bits) == (count + 7) // 8 * 8
        if reply.function_code != function or not complete:
            what = "registers" if function >= 3 else "bits"
            raise self.line.damaged(
                _shown(reply), f"not the {count} {what} asked of unit {unit} at 0x{address:02X}"
            )
        self.line.answered()
        return values

    def write(self, unit: int, address: int, values: Sequence[int]) -> None:
        """Write several registers, once: function 16, or function 6 for each where the unit lacks that.

        Raises
        ------
        ReplyError
            The confirmation is missing or damaged: the unit may or may not have taken the values.
        DeviceError
            The unit answered with a Modbus exception.
        """
        if unit not in self._one_by_one:
            try:
                self._write_together(unit, address, values)
                return
            except ModbusRefused as refused:
                if refused.code != _ILLEGAL_FUNCTION:
                    raise
                self._one_by_one.add(unit)
        for i, value in enumerate(values):
            self.write_one(unit, address + i, value)

    def _write_together(self, unit: int, address: int, values: Sequence[int]) -> None:
        with self.line.transaction(lambda: self._prove(unit)):
            reply = self._asked(lambda: self._client.write_registers(address, list(values), device_id=unit))
            if (reply.function_code, reply.address, reply.count) != (16, address, len(values)):
                raise self.line.damaged(_shown(reply), f"not the confirmation of a write to 0x{address:02X}")
            self.line.answered()

    def write_one(self, unit: int, address: int, value: int) -> None:
        """Write one register (function 6), once; raises as `write`."""
        with self.line.transaction(lambda: self._prove(unit)):
            reply = self._asked(lambda: self._client.write_register(address, value, device_id=unit))
            if (reply.function_code, reply.address, reply.registers) != (6, address, [value]):
                raise self.line.damaged(_shown(reply), f"not the confirmation of a write to 0x{address:02X}")
            self.line.answered()

    def write_coil(self, unit: int, address: int, on: bool) -> None:
        """Set or reset one coil (function 5), once; raises as `write`."""
        with self.line.transaction(lambda: self._prove(unit)):
            reply = self._asked(lambda: self._client.write_coil(address, on, device_id=unit))
            if (reply.function_code, reply.address, reply.bits[:1]) != (5, address, [on]):
                raise self.line.damaged(_shown(reply), f"not the confirmation of coil 0x{address:02X}")
            self.line.answered()

    def prove(self, unit: int) -> None:
        """Ask for the canary, to find out whether the unit knows it; raises as `read`."""
        with self.line.transaction():
            self._prove(unit)

    def s32(self, registers: Sequence[int]) -> int:
        """Return two registers as a signed 32-bit number."""
        kind = self._client.DATATYPE.INT32
        value = self._client.convert_from_registers(list(registers), kind, word_order=self._word_order)
        assert isinstance(value, int)
        return value

    def from_s32(self, value: int) -> list[int]:
        """Return a signed 32-bit number as two registers."""
        return self._client.convert_to_registers(
            value, self._client.DATATYPE.INT32, word_order=self._word_order
        )

    def renew(self) -> bool:
        """Open the line anew if it was lost or is in doubt; say whether it was."""
        return self.line.renew()

    def close(self) -> None:
        """Release the line."""
        self.line.close()

    def _asked(self, ask: Callable[[], ModbusPDU]) -> ModbusPDU:
        """Return the reply; a unit that is busy is asked again for as long as a reply may take."""
        end_s = time.monotonic() + self.line.reply_timeout_s
        while True:
            try:
                return self._asked_once(ask)
            except ModbusRefused as refused:
                if refused.code not in _BUSY or time.monotonic() > end_s:
                    raise
            time.sleep(_BUSY_LOOK_S)

    def _asked_once(self, ask: Callable[[], ModbusPDU]) -> ModbusPDU:
        if self._frame_gap_s:  # RTU frames are told apart by 3.5 characters of silence
            time.sleep(max(0.0, self._last_s + self._frame_gap_s - time.monotonic()))
        try:
            reply = ask()
        except ConnectionException as error:
            raise self.line.damaged(b"", str(error)) from None
        except ModbusIOException as error:
            if "No response" in str(error):
                silence = self.line.timed_out(self._client.timeout_s)
                device = f"{self.line.device} unit {self._client.unit}"
                raise NoReply(device, silence.fault, silence.remedy) from None
            raise self.line.damaged(b"", str(error)) from None
        except ModbusException as error:
            raise self.line.damaged(b"", str(error)) from None
        finally:
            self._last_s = time.monotonic()
        if isinstance(reply, ExceptionResponse):
            self.line.answered()
            raise ModbusRefused(f"{self.line.device} unit {reply.dev_id}", reply.exception_code)
        return reply

    def _prove(self, unit: int) -> None:
        canary = self._canaries.get(unit, _CANARY)
        if canary is None:
            return
        if canary.function != 8:
            counts = (canary.count, *canary.spare)
            count = counts[self._failed_proofs % len(counts)]
            self._failed_proofs += 1
            self._read_now(unit, canary.address, count, canary.function)
            self._failed_proofs = 0
            return
        sent = (next(self._loopbacks) & 0xFFFF).to_bytes(2, "big")
        reply = self._asked(lambda: self._client.diag_query_data(sent, device_id=unit))
        if reply.function_code != 8 or getattr(reply, "message", None) != sent:
            raise self.line.damaged(_shown(reply), f"not the loopback asked of unit {unit}")
        self.line.answered()


def _shown(reply: ModbusPDU) -> bytes:
    return str(reply).encode("ascii", "replace")


def open_modbus(
    role: str,
    address: str,
    context: Context,
    *,
    framing: Framing,
    word_order: WordOrder,
    baudrate: int,
    parity: Parity = "none",
) -> ModbusLine:
    """Open an address for Modbus.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened.
    """
    line = open_line(
        role,
        address,
        context,
        protocol=f"modbus-{framing}",
        baudrate=baudrate,
        parity=parity,
        reply_timeout_s=1.0,
    )
    serial_rtu = framing == "rtu" and "://" not in address
    # Modbus over Serial Line V1.02, 2.5.1.1: 3.5 characters of 11 bits, fixed at 1.75 ms above 19200 baud
    gap_s = (3.5 * 11.0 / baudrate if baudrate <= 19200 else 1.75e-3) if serial_rtu else 0.0
    return ModbusLine(line, framing, word_order, frame_gap_s=gap_s)
