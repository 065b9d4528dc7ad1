"""Files that people write, or that a crash leaves: rig, plan and wire log, damaged; one kind of error."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from pathlib import Path
from random import Random

from fuzzing.mutations import mutate
from fuzzing.outcome import Result, Verdict
from fuzzing.virtual_time import VirtualTime
from gonio.errors import GonioError
from gonio.plan import Plan, parse_plan
from gonio.rig import default_rig_text, parse_rig
from gonio.wirelog import read_log

_VALUES = (
    *(
        "nan",
        "inf",
        "-1",
        "0",
        "1e308",
        "1e-320",
        "true",
        '""',
        '"x"',
        "[]",
        "{}",
        "[[1]]",
        "1979-05-27",
        "9" * 400,
    ),
    *(
        "[1.0, 2.0]",
        "{ start = 1.0, stop = 2.0, step = 1e-9 }",
        '"\\u0000"',
        "[" * 50,
        "[" * 3000,
        "0x7fffffffffffffff",
        "15.0",
    ),
)


class _TomlTarget:
    """A parser of TOML text that says `GonioError` to everything wrong."""

    name = ""
    text = ""

    def __init__(self, time: VirtualTime) -> None:
        self.lines = self.text.splitlines()

    def parse(self, text: str) -> object:
        """Call the parser."""
        raise NotImplementedError

    def one(self, rng: Random) -> Result:
        """Parse one damaged text."""
        if rng.random() < 0.5:
            text = self._edited(rng)
        else:
            text = mutate(rng, self.text.encode("utf-8"), (self.text.encode("utf-8"),)).decode("latin-1")
        try:
            self.parse(text)
        except GonioError as error:
            return Result(refused=type(error).__name__)
        return Result(Verdict.RIGHT)

    def _edited(self, rng: Random) -> str:
        """Return the text as a hasty user leaves it: a line less or twice, a value of another kind."""
        lines = self.lines.copy()
        for _ in range(rng.randint(1, 3)):
            i = rng.randrange(len(lines))
            draw = rng.random()
            if draw < 0.2:
                del lines[i]
            elif draw < 0.4:
                lines.insert(rng.randrange(len(lines)), lines[i])
            elif "=" in lines[i]:
                key = lines[i].partition("=")[0]
                lines[i] = f"{key if draw < 0.9 else key[1:]}= {rng.choice(_VALUES)}"
        return "\n".join(lines)


class RigFiles(_TomlTarget):
    """The built-in rig file."""

    name = "rig.toml"
    text = default_rig_text()

    def parse(self, text: str) -> object:
        """Return the rig."""
        return parse_rig(text)


class PlanFiles(_TomlTarget):
    """The paper's plan."""

    name = "plan.toml"
    text = Plan.paper().to_toml()

    def parse(self, text: str) -> object:
        """Return the plan, after asking for what is computed from it."""
        plan = parse_plan(text)
        return plan.n_positions, len(plan.wavelength_nm)


_SESSION = "session of 2026-07-30T12:00:00.000+00:00"
_LOG = (
    f"0.000143 stage = wire-log 1: zaber at socket://127.0.0.1:4001, {_SESSION}, instrument clock x1\n"
    "0.000811 stage > 2f3120310a  /1 1\\n\n"
    "0.001190 stage < 403031203120303320  @01 1 03 \n"
    "0.001195 stage < 4f4b0d0a  OK\\r\\n\n"
    f"0.001500 lockin = wire-log 1: sr830, {_SESSION}\n"
    "0.002000 lockin > -  *IDN?\\r\n"
    "0.003000 lockin < 53540d  ST\\r\n"
    "0.004000 stage = gave up\n"
).encode("ascii")


class WireLogs:
    """A wire log with two lines."""

    name = "wire log"

    def __init__(self, time: VirtualTime) -> None:
        folder = tempfile.mkdtemp()
        weakref.finalize(self, shutil.rmtree, folder)
        self._path = Path(folder) / "wire.log"
        self._lines = tuple(line + b"\n" for line in _LOG.splitlines())
        self._path.write_bytes(_LOG)

    def one(self, rng: Random) -> Result:
        """Read one damaged log."""
        with self._path.open("r+b", buffering=0) as file:
            os.ftruncate(file.fileno(), 0)
            file.write(mutate(rng, _LOG, self._lines))
        try:
            read_log(self._path)
        except GonioError as error:
            return Result(refused=type(error).__name__)
        return Result(Verdict.RIGHT)
