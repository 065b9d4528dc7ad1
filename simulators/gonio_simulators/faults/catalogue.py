"""Which faults there are: their names, where each applies, what counts as an opportunity, and their keys.

Names are promises: scripts and soak tests rely on them.  `docs/faults.md` says what a real bench shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Place = Literal["line", "cs260", "axis", "stage-axis", "detector", "lockin", "lamp", "monochromator"]
"""Kinds of places; `places.py` knows which of them a bench has."""

Value = float | int | bool | str


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a fault; its type is that of the default."""

    default: Value
    meaning: str
    low: float = 0.0
    high: float = 1e9
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Kind:
    """One fault that can be injected."""

    name: str
    place: Place
    opportunity: str
    what: str
    keys: Mapping[str, Key] = field(default_factory=dict)
    self_timed: bool = False
    """With ``at=`` and ``rate=`` it happens at that very time; others wait for their next opportunity."""


REPLY, REQUEST, MOVE, LOOK = "reply", "request", "move", "look at the outputs"

_UNIT = Key("random", "what is changed", choices=("bit", "byte", "random"))
_PLACE = Key("random", "where the bytes go", choices=("before", "within", "after", "random"))
_PART = Key(-1.0, "part of the move's duration that passes before; below 0: random", -1.0, 1.0)
_HOLD = "bench seconds it stays so; 0: this command only"
_SILENT = Key(False, "the instrument claims that it obeyed: only the light tells")

_LIST = (
    Kind(
        "slow-reply",
        "line",
        REPLY,
        "the reply comes late, but within what the driver waits",
        {"delay_s": Key(0.3, "real seconds")},
    ),
    Kind("dropped-reply", "line", REPLY, "the reply is lost"),
    Kind(
        "late-reply",
        "line",
        REPLY,
        "the reply is held back and comes together with the answer to the next request, in front of it",
        {"delay_s": Key(0.0, "real seconds after which it comes anyway; 0: never without a next answer")},
    ),
    Kind("dropped-request", "line", REQUEST, "the request is lost on its way in"),
    Kind(
        "hang",
        "line",
        REQUEST,
        "the device is silent, then alive again",
        {
            "hang_s": Key(3.0, "real seconds of silence"),
            "buffers": Key(False, "requests that came meanwhile are answered at the end, not lost"),
        },
    ),
    Kind(
        "garbage",
        "line",
        REPLY,
        "random bytes get into a reply",
        {"size": Key(8, "bytes", 1, 4096), "place": _PLACE},
    ),
    Kind("corrupt-reply", "line", REPLY, "one bit or byte of a reply is changed", {"unit": _UNIT}),
    Kind(
        "corrupt-request",
        "line",
        REQUEST,
        "one bit or byte of a request is changed on its way in",
        {"unit": _UNIT},
    ),
    Kind(
        "split-reply",
        "line",
        REPLY,
        "a reply comes in many small pieces with gaps",
        {"size": Key(1, "bytes of a piece", 1, 4096), "gap_s": Key(0.005, "real seconds between pieces")},
    ),
    Kind("doubled-reply", "line", REPLY, "a reply comes twice"),
    Kind(
        "disconnect",
        "line",
        REQUEST,
        "the connection is closed in mid-command, after half of the reply; on a pty the cable is out",
        {
            "refuse_s": Key(0.0, "real seconds in which nobody can connect (on a pty: silence)"),
            "executed": Key(
                "random", "whether the request still took effect", choices=("yes", "no", "random")
            ),
        },
    ),
    Kind("echo-missing", "cs260", "echo", "the echo of a statement is lost"),
    Kind("echo-doubled", "cs260", "echo", "the echo of a statement comes twice"),
    Kind(
        "alarm",
        "axis",
        MOVE,
        "the drive raises an alarm in mid-move and releases the motor",
        {
            "cause": Key(
                "over-temperature", "why", choices=("over-temperature", "position-error", "encoder")
            ),
            "part": _PART,
            "hold_s": Key(5.0, "bench seconds before the alarm can be cleared"),
        },
    ),
    Kind("limit", "stage-axis", MOVE, "a limit switch trips in mid-move", {"part": _PART}),
    Kind(
        "stall",
        "axis",
        MOVE,
        "the motor loses its steps in mid-move",
        {
            "silent": Key(False, "no fault: the controller is idle as after a good move"),
            "readback": Key(
                "target",
                "if silent, what it says of its position: target as in open loop, truth by an encoder",
                choices=("target", "truth"),
            ),
            "part": _PART,
        },
    ),
    Kind(
        "knob",
        "axis",
        MOVE,
        "somebody turns the manual knob, or pushes the axis",
        {
            "size_deg": Key(1.0, "how far; the direction is random", 1e-3, 360.0),
            "moving": Key(False, "in mid-move; otherwise up to idle_s after it"),
            "idle_s": Key(2.0, "bench seconds after the end of a move within which it happens"),
            "turn_s": Key(0.5, "bench seconds that the turn takes", 1e-3),
            "by": Key("knob", "what moves the axis", choices=("knob", "push")),
            "part": _PART,
        },
        self_timed=True,
    ),
    Kind(
        "power-cycle",
        "line",
        REQUEST,
        "the device restarts: reference and volatile settings are lost, it is silent while it boots",
        {
            "boot_s": Key(0.5, "real seconds of silence"),
            "memory": Key("kept", "the lock-in's battery-backed settings", choices=("kept", "lost")),
        },
        self_timed=True,
    ),
    Kind(
        "detector-saturated",
        "detector",
        LOOK,
        "the detector is over-range: its signal stands at the rail",
        {
            "hold_s": Key(5.0, "bench seconds"),
            "level_v": Key(1.5, "volts at the amplifier; above 1.09 its input is overloaded", 1e-6, 100.0),
        },
        self_timed=True,
    ),
    Kind(
        "lockin-overload",
        "lockin",
        LOOK,
        "a spike: the overload bit of one look, and an output that is off for a few time constants",
        {
            "at": Key("input", "which bit", choices=("input", "output")),
            "size": Key(0.05, "of the spike in the output, in full scales", -1.0, 1.0),
        },
        self_timed=True,
    ),
    Kind(
        "lamp-drift",
        "lamp",
        LOOK,
        "the lamp's power changes for good",
        {
            "size": Key(-0.02, "relative change", -0.999, 10.0),
            "ramp_s": Key(0.0, "bench seconds that the change takes; 0: a step"),
        },
        self_timed=True,
    ),
    Kind(
        "lamp-out",
        "lamp",
        LOOK,
        "the lamp goes out and comes back",
        {"hold_s": Key(60.0, "bench seconds")},
        self_timed=True,
    ),
    Kind(
        "detector-change",
        "detector",
        LOOK,
        "the detector's gain makes a step, for good",
        {"size": Key(-0.05, "relative change", -0.999, 10.0)},
        self_timed=True,
    ),
    Kind(
        "filter-stuck",
        "monochromator",
        "change of the filter",
        "the wheel stays where it is",
        {
            "silent": _SILENT,
            "code": Key(6, "what ERROR? says; -1: nothing", -1, 9),
            "hold_s": Key(0.0, _HOLD),
        },
    ),
    Kind(
        "grating-stuck",
        "monochromator",
        "change of the grating",
        "the turret stays where it is",
        {
            "silent": _SILENT,
            "code": Key(8, "what ERROR? says; -1: nothing", -1, 9),
            "hold_s": Key(0.0, _HOLD),
        },
    ),
    Kind(
        "shutter-stuck",
        "monochromator",
        "change of the shutter",
        "the shutter stays as it is",
        {
            "silent": _SILENT,
            "code": Key(-1, "what ERROR? says; -1: nothing", -1, 9),
            "hold_s": Key(0.0, _HOLD),
        },
    ),
    Kind(
        "wavelength-stuck",
        "monochromator",
        "change of the wavelength",
        "the drive stops short of the target",
        {
            "silent": _SILENT,
            "code": Key(-1, "what ERROR? says; -1: nothing", -1, 9),
            "hold_s": Key(0.0, _HOLD),
            "part": Key(0.5, "of the way that is made", 0.0, 1.0),
        },
    ),
)

CATALOGUE: Mapping[str, Kind] = {kind.name: kind for kind in _LIST}

PLACES_TEXT: Mapping[Place, str] = {
    "line": "stage polarizer monochromator lockin",
    "cs260": "monochromator",
    "axis": "stage theta_i theta_mes polarizer",
    "stage-axis": "stage theta_i theta_mes",
    "detector": "the detectors' names",
    "lockin": "lockin",
    "lamp": "lamp",
    "monochromator": "monochromator",
}


def fault_table() -> str:
    """Return the table that ``gonio simulate --list-faults`` prints."""
    lines = [
        "NAME[@TARGET]:WHEN[:KEY=VALUE...]",
        "WHEN: probability per opportunity, nth=K, every=K, at=T (bench seconds) or rate=R (per bench hour)",
    ]
    for kind in CATALOGUE.values():
        lines += [
            "",
            f"{kind.name}: {kind.what}",
            f"    targets: {PLACES_TEXT[kind.place]}; per {kind.opportunity}",
        ]
        lines += [f"    {name}={_shown(key.default)}  {_meaning(key)}" for name, key in kind.keys.items()]
    return "\n".join(lines)


def _shown(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value}"


def _meaning(key: Key) -> str:
    return f"{key.meaning} ({', '.join(key.choices)})" if key.choices else key.meaning
