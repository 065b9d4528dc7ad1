"""`python -m gonio_simulators`: what it prints, how it ends, how it fails."""

import csv
import os
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass

import pytest

from gonio_simulators.cli import main
from tests.simulators.wire.conftest import rig_text


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


@pytest.fixture
def run(capfd):
    """Run the command in this process, which is faster than to start one."""

    def call(*options: str) -> Done:
        try:
            code = main(list(options))
        except SystemExit as leave:  # argparse's way out
            code = int(leave.code or 0)
        captured = capfd.readouterr()
        return Done(code, captured.out, captured.err)

    return call


def test_lines_and_ready_then_seconds(run, tmp_path) -> None:
    truth, sphere = tmp_path / "truth.csv", tmp_path / "sphere.csv"
    done = run("--seconds", "0.05", "--truth", str(truth), "--sphere", str(sphere))
    assert (done.code, done.err) == (0, "")
    *lines, ready = done.out.splitlines()
    assert ready == "ready"
    words = [line.split() for line in lines]
    assert [w[:2] for w in words] == [
        ["stage", "zaber"],
        ["polarizer", "elliptec"],
        ["monochromator", "cs260"],
        ["lockin", "sr830"],
    ]
    assert all(w[2].startswith("socket://127.0.0.1:") for w in words)
    for path in (truth, sphere):
        with path.open(newline="", encoding="utf-8") as file:
            header, *rows = csv.reader(file)
        assert header[0] == "wavelength_nm"
        assert len(rows) > 100


def test_only_what_the_rig_names_is_served(run, rig_file) -> None:
    done = run(str(rig_file(stage="applied-motion", framing="tcp")), "--seconds", "0.01")
    assert done.code == 0
    assert [line.split()[1] for line in done.out.splitlines()[:2]] == ["modbus-tcp", "elliptec"]


def test_end_of_standard_input(simulator) -> None:
    with simulator() as sim:
        assert sim.process.poll() is None
    assert sim.process.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals(simulator, number: signal.Signals) -> None:
    with simulator() as sim:
        client = sim.client("stage")
        os.kill(sim.process.pid, number)
        assert sim.process.wait(timeout=10) == 0
        assert client.socket.recv(1) == b""
        client.close()
        with pytest.raises(ConnectionRefusedError):
            sim.client("stage")


def changed(old: str, new: str) -> str:
    text = rig_text()
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            changed('driver = "zaber"', 'driver = "newport"'),
            ["stage.driver = 'newport'", "zaber, applied-motion"],
        ),
        (changed("device = 2", "device = 1"), ["stage.theta_i.device", "both 1"]),
        (
            changed('address = "simulated"', 'address = "socket://127.0.0.1:99999"'),
            ["socket://127.0.0.1:99999"],
        ),
        (changed("clock_speed = 4000.0", "clock_sped = 1000.0"), ["simulation.clock_sped", "clock_speed"]),
        (rig_text(stage="applied-motion", word_order="middle"), ["stage.word_order", "middle"]),
        ("name = [", ["not valid TOML"]),
    ],
)
def test_a_wrong_rig_file_is_one_message(run, tmp_path, text: str, words: list[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    done = run(str(rig), "--seconds", "1")
    assert done.code == 1
    assert "Traceback" not in done.err
    assert "rig.toml" in done.err
    for word in words:
        assert word in done.err
    assert "ready" not in done.out


def test_a_taken_port_is_one_message(run, tmp_path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        rig = tmp_path / "rig.toml"
        rig.write_text(
            changed('address = "simulated"', f'address = "socket://127.0.0.1:{port}"'), encoding="utf-8"
        )
        done = run(str(rig), "--seconds", "1")
    assert done.code == 1
    assert done.out == ""
    assert f"port {port}" in done.err
    assert "already taken" in done.err
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize(
    "options",
    [("--seconds", "0"), ("--clock-speed", "-1"), ("--seed", "x"), ("--nonsense",), ("a.toml", "b.toml")],
)
def test_bad_usage(run, options: tuple[str, ...]) -> None:
    done = run(*options)
    assert done.code == 2
    assert "usage: gonio simulate" in done.err


def test_missing_files(run, tmp_path) -> None:
    done = run(str(tmp_path / "none.toml"))
    assert (done.code, done.out) == (1, "")
    assert "there is no such file" in done.err
    done = run("--truth", str(tmp_path / "no" / "truth.csv"), "--seconds", "1")
    assert (done.code, done.out) == (1, "")
    assert "truth.csv" in done.err


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX pipes")
def test_a_closed_standard_output_is_one_message() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "gonio_simulators", "--seconds", "1"],
        stdout=writer,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=60,
    )
    os.close(writer)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "standard output" in done.stderr
