"""docs/drivers.md, followed to the letter: its files make a package whose driver is found, moves, stops and
sees faults; its register maps are accepted.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.config import parse_toml, validate
from gonio.errors import DeviceError
from gonio.rig import default_rig_text
from gonio_drivers.lines import Line
from gonio_drivers.modbus_axis import RegisterStageConfig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "drivers.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^`([\w.]+)`:\n\n```\w+\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE))
MAPS = re.findall(r"^```toml\n(\[stage\.registers\]\n.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)

PIECES = [
    b"1QS12345,M,R,-\r",
    b"1QS-7,I,U,S\r",
    b"1ID",
    b"TT1\r",
    b"1??02\r",
    b"2QS1,I,R,-\r",
    b"\r",
    b"1QS1,",
]

ASK_GONIO = """
from gonio.rig import load_rig, find_driver
rig = load_rig("rig.toml")
print(type(rig.stage).__name__, rig.stage.theta_mes.device, rig.stage.theta_mes.blind_zone_deg)
print(find_driver("stage", "turntable", source="page").open.__module__)
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The page's files in a folder, installed as far as an entry point asks for it."""
    folder = tmp_path_factory.mktemp("turntable")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    project = tomllib.loads(FILES["pyproject.toml"])["project"]
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    metadata = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    points = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in entries.items())
        for group, entries in project["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("\n".join(points), encoding="utf-8")
    head, _, rest = default_rig_text().partition("[stage]\n")
    tail = rest[rest.index("[polarizer]") :]
    (folder / "rig.toml").write_text(head + FILES["stage.toml"] + tail, encoding="utf-8")
    return folder


def run(folder: Path, *arguments: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_driver_is_found_and_its_rig_table_is_valid(package):
    assert run(package, "-c", ASK_GONIO).splitlines() == ["TurntableStage 2 15.0", "gonio_turntable"]


def test_the_pages_own_test_passes(package):
    """It moves, stops, sees a stall, a restart and a refusal, over a real port."""
    tests = re.findall(r"^def (test_\w+)", FILES["test_turntable.py"], flags=re.MULTILINE)
    assert len(tests) >= 6
    out = run(package, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_turntable.py")
    assert f"{len(tests)} passed" in out


@given(st.lists(st.binary(max_size=12) | st.sampled_from(PIECES), max_size=12))
def test_whatever_bytes_come_the_driver_raises_nothing_but_its_own_errors(chunks):
    """And what it accepts is a reply of the right form, never a piece of another."""
    incoming = list(chunks)

    class Noise:
        def write(self, data: bytes) -> None: ...

        def read(self, timeout_s: float) -> bytes:
            return incoming.pop(0) if incoming and timeout_s > 0 else b""

        def close(self) -> None: ...

    namespace: dict[str, Any] = {"__name__": "gonio_turntable"}
    exec(compile(FILES["gonio_turntable.py"], "gonio_turntable.py", "exec"), namespace)
    drive = object.__new__(namespace["TurntableDrive"])
    drive.line, drive.device = Line(Noise(), "stage", "noise"), "theta_i"
    drive.config = namespace["TurntableAxis"](device=1, steps_per_deg=1000.0, limits_deg=(0.0, 90.0))
    try:
        state = drive.state()
    except DeviceError:
        return
    assert re.search(rb"1QS%d,[IM],[RU],." % state.position_steps, b"".join(chunks))


def test_the_driver_has_no_more_than_60_lines():
    lines = [line for line in FILES["gonio_turntable.py"].splitlines() if line.strip()]
    assert len(lines) <= 60


@pytest.mark.parametrize("name", ["gonio_turntable.py", "pyproject.toml", "test_turntable.py"])
def test_the_example_folder_is_the_page(name):
    assert (ROOT / "examples" / "drivers" / "turntable" / name).read_text(encoding="utf-8") == FILES[name]


@pytest.mark.parametrize("text", MAPS, ids=lambda text: re.search(r"# (\S+)", text)[1])
def test_register_maps_of_the_page_are_accepted(text):
    axes = {
        "theta_i": {"device": 1, "steps_per_deg": 1000.0, "limits_deg": [0.0, 95.0]},
        "theta_mes": {"device": 2, "steps_per_deg": -1000.0, "zero_deg": 180.0, "limits_deg": [15.0, 180.0]},
    }
    table = {"driver": "modbus-registers", **parse_toml(text, source="page")["stage"], **axes}
    config = validate(RegisterStageConfig, table, source="page")
    assert all(canary is not None for canary in config.canaries().values())


def test_there_are_maps_and_every_link_leads_somewhere():
    assert len(MAPS) == 2
    for target in re.findall(r"\]\((?!#|http)([^)#]+)", PAGE):
        assert (ROOT / "docs" / target).exists(), target


def test_every_key_of_the_map_is_on_the_page():
    from gonio_drivers.modbus_axis_map import RegisterMap

    assert [key for key in RegisterMap.model_fields if f"`{key}`" not in PAGE] == []
