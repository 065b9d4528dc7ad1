"""Which warning flags of a Zaber device are faults, which say that its count has no reference?

``F`` begins a fault, ``W`` a warning, ``N`` a note.  Those that change no position are left out: ND, NJ, NR,
NT, NU (another program's stream, a joystick, a rounded setting), WS (stalled and recovered by itself), WT and
WV (warm, voltage).  Reference: Zaber, ASCII Protocol Manual, warning flags.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

NO_REFERENCE = {"WR", "WH"}

FAULTS: Mapping[str, tuple[str, str]] = {
    "FF": ("critical system error", "switch the stage off and on; if it stays, call the manufacturer"),
    "FN": ("its peripheral is not supported", "check what is plugged into the controller"),
    "FZ": ("its peripheral is inactive", "activate it with the manufacturer's software"),
    "FH": ("the hardware emergency stop was pressed", "release the emergency stop, then home and repeat"),
    "FV": ("the supply voltage is out of range and the driver was switched off", "check the power supply"),
    "FO": ("the driver is off", "check the power supply and enable the driver"),
    "FD": ("the motor driver is disabled", "let it cool, check the power supply, then enable the driver"),
    "FC": (
        "the current is too high and the driver was switched off",
        "check the motor for a short or a block",
    ),
    "FM": ("the motor is too hot", "let it cool"),
    "FT": ("its cable is twisted too far", "turn it back, then home the axis"),
    "FA": ("the analog encoder lost its synchronisation", "check the encoder's cable, then home the axis"),
    "FR": ("its overdrive limit was exceeded", "let it cool, lower acceleration_deg_s2 in the rig file"),
    "FQ": ("the encoder failed", "check the encoder's cable, then home the axis"),
    "FI": ("the index was not found", "home the axis"),
    "FS": ("it stalled and stopped", "remove what blocks it, then home the axis and repeat"),
    "FE": ("it met a limit switch", "check limits_deg and zero_deg in the rig file, then home the axis"),
    "FB": ("a stream of another program went out of bounds", "close the other program, then home the axis"),
    "FP": ("it left the interpolated path", "close the other program that drives it, then home the axis"),
    "WL": (
        "it met a limit switch where none was expected",
        "look for what trips the switch, then home the axis",
    ),
    "WP": (
        "its calibration does not suit it and is off",
        "restore its calibration with the manufacturer's software",
    ),
    "NC": ("it is moved by its manual control", "leave the knob alone, then repeat"),
    "NI": ("the move was interrupted by its knob or another program", "leave the stage alone, then repeat"),
    "WM": ("it was displaced while it stood", "find out what pushed it, then home the axis"),
}


def is_referenced(flags: Sequence[str]) -> bool:
    """Say whether the count belongs to the home switch."""
    return not NO_REFERENCE.intersection(flags)


def fault_of(flags: Sequence[str]) -> tuple[str | None, str]:
    """Return the gravest fault in words and what to do, None if there is none; `flags` the gravest first."""
    for flag in flags:
        if flag in FAULTS or flag.startswith("F"):
            fault, remedy = FAULTS.get(
                flag, ("an unknown fault", "look the flag up in the manufacturer's manual")
            )
            return f"{fault} (flag {flag})", remedy
    return None, ""
