"""How long things take that are no physics: an exchange on a wire, a record on the disk.

These are real seconds.  On hardware they add to settling and motion as they are; on a simulated bench whose
clock runs `speed` times as fast, each of them costs `speed` times as many instrument seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gonio.config import NotNegative, Strict


class LatencyConfig(Strict):
    """``[latency]`` of the rig file: real seconds for one question and its answer, by role.

    ``gonio plan PLAN --rig RIG --measure`` measures them on the connected rig and prints this table.
    """

    stage_s: NotNegative = 0.0
    polarizer_s: NotNegative = 0.0
    monochromator_s: NotNegative = 0.0
    lockin_s: NotNegative = 0.0
    record_s: NotNegative = 0.0  # a finished position or reference until the disk has it

    def of(self, exchanges: Mapping[str, float]) -> float:
        """Return the real seconds of so many exchanges by role; a role without a key costs nothing."""
        return sum(count * float(getattr(self, f"{role}_s", 0.0)) for role, count in exchanges.items())


@dataclass(frozen=True, slots=True)
class PassTime:
    """What one pass over the wavelengths takes.

    Attributes
    ----------
    instrument_s
        Driving, changes of grating, filter and detector, settling and averaging, in instrument seconds.
    exchanges
        Questions and answers on the wire, by role.
    """

    instrument_s: float
    exchanges: Mapping[str, float] = field(default_factory=dict)
