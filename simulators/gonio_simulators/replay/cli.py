"""`gonio replay`: serve a wire log back as the devices it was recorded from, or print it.

Prints one line ``ROLE PROTOCOL ADDRESS`` per port, then ``ready``, as `gonio simulate` does.  Exit codes: 0
when told to stop, 1 with a message or if a client asked what the log does not have next, 2 for bad usage.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from pathlib import Path

from gonio.errors import ConfigError, GonioError
from gonio.wirelog import Session, WireLogFile, read_log
from gonio_simulators.clock import BenchClock
from gonio_simulators.ending import stop_when_told
from gonio_simulators.replay.conversation import ReplayedLine
from gonio_simulators.replay.summary import listing, table
from gonio_simulators.replay.tape import LineTape, Tape
from gonio_simulators.wire.lines import PtyPort, TcpPort, new_event_loop


def main(argv: list[str] | None = None) -> int:
    """Run `gonio replay` and return its exit code."""
    options = _parser().parse_args(argv)
    try:
        log = read_log(options.log)
        for warning in log.warnings:
            print(warning, file=sys.stderr)
        session = _session(log, options.session)
        roles = _roles(log, session, options.role)
        if options.print:
            return _print(session, roles)
        if options.pty and not PtyPort.is_available():
            raise ConfigError("--pty: this system has no pseudo-terminals; use the TCP addresses")
        tape = Tape()
        tapes = [LineTape(session.lines[role], tape) for role in roles]
        with asyncio.Runner(loop_factory=new_event_loop) as runner:
            runner.run(_Replay(tapes, options).serve())
    except GonioError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:  # `gonio replay LOG --print | head`
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  # the exit flushes it once more
        return 0
    return _report(tapes, strict=options.strict)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="gonio replay", description="Serve a wire log back as the devices it was recorded from."
    )
    parser.add_argument("log", type=Path, metavar="LOG", help="written with --wire-log")
    parser.add_argument("--role", action="append", metavar="ROLE", help="this line alone (may be repeated)")
    parser.add_argument(
        "--session", type=int, metavar="N", help="which of the file's sessions (default: the last)"
    )
    parser.add_argument("--print", action="store_true", help="print records and figures; serve nothing")
    parser.add_argument(
        "--speed", type=_positive, default=1.0, metavar="X", help="recorded seconds per real second"
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        help="hang up and end at the first request that the log does not answer; a command that was never "
        "given is a failure too",
    )
    parser.add_argument("--seconds", type=_positive, metavar="N", help="stop after N real seconds")
    parser.add_argument(
        "--pty", action="store_true", help="serve each line on a pseudo-terminal, too (POSIX)"
    )
    parser.add_argument("--until-stdin-closes", action="store_true", help="stop at the end of standard input")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be a number above zero")
    return value


def _session(log: WireLogFile, number: int | None) -> Session:
    if number is None:
        return log.sessions[-1]
    if not 1 <= number <= len(log.sessions):
        starts = ", ".join(f"{n}: {s.start or 'undated'}" for n, s in enumerate(log.sessions, 1))
        raise ConfigError(f"wire log {log.path}: has no session {number}; it has {starts}")
    return log.sessions[number - 1]


def _roles(log: WireLogFile, session: Session, wanted: list[str] | None) -> list[str]:
    for role in wanted or ():
        if role not in session.lines:
            raise ConfigError(
                f"wire log {log.path}: has no line '{role}' in this session; it has "
                f"{', '.join(session.lines)}"
            )
    return [role for role in session.lines if wanted is None or role in wanted]


def _print(session: Session, roles: list[str]) -> int:
    for line in listing([session.lines[role] for role in roles]):
        print(line)
    print()
    for line in table(session, roles):
        print(line)
    sys.stdout.flush()
    return 0


class _Replay:
    """The ports of a replay while it lasts."""

    def __init__(self, tapes: list[LineTape], options: argparse.Namespace) -> None:
        self._options = options
        self._stop = asyncio.Event()
        self._reported: set[str] = set()
        clock = BenchClock()
        self._ports: list[tuple[LineTape, TcpPort | PtyPort]] = []
        for tape in tapes:
            line = ReplayedLine(tape, speed=options.speed, on_unexpected=self._unexpected)
            port = TcpPort(line, clock)
            line.hang_up = port.hang_up
            self._ports.append((tape, port))
            if options.pty and tape.protocol != "modbus-tcp":
                self._ports.append((tape, PtyPort(line, clock)))

    async def serve(self) -> None:
        """Serve until told to stop."""
        stop_when_told(
            asyncio.get_running_loop(),
            self._stop,
            until_stdin_closes=self._options.until_stdin_closes,
            seconds=self._options.seconds,
        )
        try:
            for _, port in self._ports:
                await port.start()
            for tape, port in self._ports:
                print(f"{tape.role} {tape.protocol} {port.address}")
            print("ready", flush=True)
            await self._stop.wait()
        finally:
            for _, port in self._ports:
                port.close()
            await asyncio.sleep(0)  # one turn of the loop, in which the transports let go of their sockets

    def _unexpected(self, why: str) -> None:
        if why not in self._reported:
            self._reported.add(why)
            print(why, file=sys.stderr, flush=True)
        if self._options.strict:
            self._stop.set()


def _report(tapes: list[LineTape], *, strict: bool) -> int:
    """Say how much was asked and what was not, on standard error, and return the exit code."""
    failed = False
    for tape in tapes:
        counts = tape.counts
        text = (
            f"{tape.role}: {counts.asked} requests, {counts.repeated} answered with an earlier reply, "
            f"{counts.unexpected} not answered"
        )
        failed |= counts.unexpected > 0
        left = tape.next_left()
        if left is not None:
            failed |= strict
            text += (
                f"; commands of the log not given: {tape.commands_left()}, the first is "
                f"'{left.request.what}' (line {left.number})"
            )
        print(text, file=sys.stderr)
    return int(failed)
