"""All faults together: the simulators stay alive, and every one of them strikes and is recorded."""

from __future__ import annotations

import contextlib
import random

import pytest

from gonio_simulators.faults import CATALOGUE, read_fault_log
from tests.simulators.faults.test_process import running

LINE = [kind.name for kind in CATALOGUE.values() if kind.place in ("line", "cs260")]

TALK = {
    "zaber": [
        b"/1 1 01 home\n",
        b"/1 1 02 get pos\n/2 1 03 warnings\n",
        b"/0 0 04\n",
        b"/1 1 05 move abs 9000\n",
    ],
    "drives": [bytes.fromhex("010300010001d5ca"), bytes.fromhex("0106007c00dbc9a9"), bytes.fromhex("0106")],
    "rotator": [b"0ma00004600", b"0gs", b"0ho0", b"0gp\r\n"],
    "monochromator": [b"GOWAVE 600\r\nWAVE?\r\n", b"FILTER 2\n", b"STB?\n", b"SHUTTER O\n"],
    "lockin": [b"SNAP?1,2;LIAS?\r", b"SENS 20\r", b"SENS?\r"],
}


@pytest.mark.parametrize("device", TALK)
def test_every_fault_of_a_line(faulty, device: str) -> None:
    f = faulty(*(f"{name}:0.1" for name in LINE))
    wire = getattr(f, device)()
    rng = random.Random(3)
    for _ in range(800):
        wire.send(rng.choice(TALK[device]))
        f.advance(0.5)
        f.timers.pass_(rng.choice((0.01, 0.5)))
        wire.take()
    role = {"zaber": "stage", "drives": "stage", "rotator": "polarizer"}.get(device, device)
    applicable = {name for name in LINE if device == "monochromator" or not name.startswith("echo-")}
    assert {i.name for i in f.injected} == applicable
    assert {i.target for i in f.injected} == {role}


def test_a_process_with_all_of_them(tmp_path) -> None:
    log = tmp_path / "faults.log"
    options = ["--fault-log", str(log)]
    for kind in CATALOGUE.values():
        keys = {"hang": ":hang_s=0.05", "power-cycle": ":boot_s=0.02"}.get(kind.name, "")
        options += ["--fault", f"{kind.name}:0.1{keys}"]
    devices = {"stage": "zaber", "polarizer": "rotator", "monochromator": "monochromator", "lockin": "lockin"}
    with running(*options) as simulator:
        rng = random.Random(5)
        for _ in range(25):
            for role, device in devices.items():
                with contextlib.suppress(OSError), simulator.client(role) as client:
                    client.socket.settimeout(0.01)
                    for _ in range(3):
                        client.socket.sendall(rng.choice(TALK[device]))
                        with contextlib.suppress(TimeoutError):
                            client.socket.recv(1000)
    assert "Traceback" not in simulator.err
    assert all(line.startswith("fault ") for line in simulator.err.splitlines())
    injected = read_fault_log(log)
    assert len(injected) > 100
    counted = sum(int(line.split()[-2]) for line in simulator.err.splitlines())
    assert counted == len(injected)
