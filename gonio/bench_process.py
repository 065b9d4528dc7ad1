"""Start and stop the simulated bench as a process of its own.

The process shares nothing with this one but the bytes on its ports.  It ends with this process, however this
one ends: it serves until its standard input closes, and the operating system closes that pipe even after a
`kill -9`.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from gonio.errors import ConnectionFailed
from gonio.rig import RigConfig, with_addresses

START_DEADLINE_S = 60.0  # a cold start on a slow disk; about 1 s otherwise


@dataclass(frozen=True, slots=True)
class BenchPort:
    """One line that the simulator printed."""

    role: str
    protocol: str
    address: str


@contextlib.contextmanager
def simulated_bench(
    rig: RigConfig, *, truth_csv: Path | None = None, sphere_csv: Path | None = None
) -> Iterator[list[BenchPort]]:
    """Serve the simulated bench of `rig` while the context lasts.

    Parameters
    ----------
    rig
        The rig whose text describes the bench.
    truth_csv, sphere_csv
        Where the simulator shall write what is true on the bench, and the spectrum of its integrating sphere.

    Raises
    ------
    ConnectionFailed
        If the simulator does not start; with the simulator's own message.
    """
    with tempfile.TemporaryDirectory(prefix="gonio-bench-") as folder:
        rig_file = Path(folder) / "rig.toml"
        rig_file.write_text(rig.text, encoding="utf-8")
        command = [sys.executable, "-m", "gonio_simulators", str(rig_file), "--until-stdin-closes"]
        if truth_csv is not None:
            command += ["--truth", str(truth_csv)]
        if sphere_csv is not None:
            command += ["--sphere", str(sphere_csv)]
        # A session of its own: Ctrl-C reaches this process, which still needs the bench to stop the motors
        # in order.
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=os.name == "posix",
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        try:
            yield _read_ports(process)
        finally:
            _end(process)


@contextlib.contextmanager
def served(
    rig: RigConfig, *, truth_csv: Path | None = None, sphere_csv: Path | None = None
) -> Iterator[RigConfig]:
    """Yield `rig` with addresses that answer: itself for real hardware, else served by the simulated
    bench.
    """
    if not any(address == "simulated" for address in rig.addresses().values()):
        yield rig
        return
    with simulated_bench(rig, truth_csv=truth_csv, sphere_csv=sphere_csv) as ports:
        yield with_addresses(rig, {port.role: port.address for port in ports})


def _read_ports(process: subprocess.Popen[str]) -> list[BenchPort]:
    lines: queue.Queue[str | None] = queue.Queue()
    assert process.stdout is not None
    threading.Thread(target=_forward, args=(process.stdout, lines), daemon=True).start()
    deadline = time.monotonic() + START_DEADLINE_S
    ports: list[BenchPort] = []
    while True:
        try:
            line = lines.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            raise _did_not_start(f"it was not ready within {START_DEADLINE_S:g} s") from None
        if line is None:
            assert process.stderr is not None
            raise _did_not_start(process.stderr.read().strip() or "it ended without a message")
        words = line.split()
        if words == ["ready"]:
            return ports
        if len(words) == 3:
            ports.append(BenchPort(*words))


def _forward(stream: IO[str], lines: queue.Queue[str | None]) -> None:
    with contextlib.suppress(ValueError):  # the stream is closed under us when the bench is ended
        for line in stream:
            lines.put(line)
    lines.put(None)


def _did_not_start(reason: str) -> ConnectionFailed:
    return ConnectionFailed(
        "simulated bench",
        f"did not start: {reason}",
        "correct this, or give a rig of real hardware with --rig",
    )


def _end(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.close()
    try:
        process.wait(timeout=3)
    except subprocess.TimeoutExpired:
        process.terminate()
        try:
            process.wait(timeout=3)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    for stream in (process.stdout, process.stderr):
        if stream is not None:
            stream.close()
