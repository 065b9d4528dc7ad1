"""One motorised rotation axis: what its controller counts, and where its arm truly is.

The motor shaft stands at `q` steps, the arm behind the gear's lost motion `b` at `p` steps.  While the
angle falls, the shaft takes the arm along at ``p = q``; while it rises, it first takes up the lost motion and
the arm stays `b` behind.  The home routine ends with a falling angle, so the counter is true for targets
approached from above and `backlash_deg` off for those approached from below.

The switches sit at the arm.  Angles are ``zero_deg + p / steps_per_deg``.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass

from gonio_simulators.bench.config import HOME_OVERSHOOT_DEG, ZONE_MARGIN_DEG
from gonio_simulators.bench.motion import Piece, cut_at, decelerate, pieces_to
from gonio_simulators.clock import BenchClock

HOMING_SPEED = 0.5
"""Speed of the home routine, as a fraction of the axis's normal speed."""


class Fault(enum.Enum):
    """Why the motor stopped by itself; sides are those of the counter, as the controller knows no angles."""

    NONE = "none"
    LOW_LIMIT = "limit switch towards falling counts"
    HIGH_LIMIT = "limit switch towards rising counts"
    STALL = "stalled"


@dataclass(frozen=True, slots=True)
class MotorHardware:
    """The mechanics of one axis; `limits_deg` are the limit switches, infinite where there are none."""

    name: str
    steps_per_deg: float  # negative: rising counts turn towards smaller angles
    zero_deg: float = 0.0  # angle at step 0, where the home switch is
    limits_deg: tuple[float, float] = (-math.inf, math.inf)
    blind_zone_deg: float = 0.0
    speed_deg_s: float = 20.0
    acceleration_deg_s2: float = 100.0
    backlash_deg: float = 0.0
    power_on_deg: float = 0.0
    obstacle_deg: float | None = None


class Motor:
    """One axis; it evolves in bench time when it is asked, without a thread of its own.

    Parameters
    ----------
    hardware
        The mechanics.
    clock
        Bench time.
    before_command
        Called before each command changes the motion, so that whoever integrates the past can do so first.
    """

    def __init__(
        self, hardware: MotorHardware, clock: BenchClock, before_command: Callable[[], None] | None = None
    ) -> None:
        self.hardware = hardware
        self.clock = clock
        self.before_command = before_command
        scale = abs(hardware.steps_per_deg)
        self.speed_steps_s: float = hardware.speed_deg_s * scale
        self.acceleration_steps_s2: float = hardware.acceleration_deg_s2 * scale
        self._referenced = False
        self._fault = Fault.NONE
        # Where the arm may stand, relative to the shaft; with a negative scale a falling angle counts up.
        lost = float(round(hardware.backlash_deg * scale))
        self._play = (0.0, lost) if hardware.steps_per_deg < 0 else (-lost, 0.0)
        self._rest = float(round(self._steps(hardware.power_on_deg)))
        self._arm = self._rest
        self._count_origin = self._rest  # the counter says 0 where power came on
        self._pieces: list[Piece] = []
        self._arms: list[float] = []  # arm at the start of each piece
        self._end_s = -math.inf
        self._end_angle_deg = self._angle(self._arm)
        self._pending_fault = Fault.NONE
        self._homing = False
        self._up_edges, self._down_edges = self._edges()

    def move_absolute(self, target_steps: int) -> None:
        """Go to a count, from wherever the motor is and however fast it runs."""
        now_s = self._begin()
        position, speed = self._motion(now_s)
        target = float(target_steps) + self._count_origin
        self._run(
            now_s, pieces_to(now_s, position, speed, target, self.speed_steps_s, self.acceleration_steps_s2)
        )

    def home(self) -> None:
        """Go to the home switch at reduced speed, the last bit with a falling angle."""
        now_s = self._begin()
        position, speed = self._motion(now_s)
        fast, acceleration = HOMING_SPEED * self.speed_steps_s, self.acceleration_steps_s2
        above = self.hardware.zero_deg + self.hardware.backlash_deg + HOME_OVERSHOOT_DEG
        beyond = float(round(self._steps(above)))
        pieces = pieces_to(now_s, position, speed, beyond, fast, acceleration)
        turn_s = pieces[-1].start_s + pieces[-1].duration_s if pieces else now_s
        self._referenced = False
        self._run(now_s, pieces + pieces_to(turn_s, beyond, 0.0, 0.0, fast, acceleration), homing=True)

    def stop(self) -> None:
        """Decelerate and stand still on a whole step."""
        now_s = self._begin()
        position, speed = self._motion(now_s)
        if speed == 0:
            self._run(now_s, [])
            return
        halt = decelerate(now_s, position, speed, 0.0, self.acceleration_steps_s2)
        whole = float(math.ceil(halt.end) if speed > 0 else math.floor(halt.end))
        self._run(now_s, pieces_to(now_s, position, speed, whole, abs(speed), self.acceleration_steps_s2))

    def clear_fault(self) -> None:
        """Forget the latched fault; the motor stays where it is."""
        self._settle(self.clock.now_s())
        self._fault = Fault.NONE

    def position_steps(self) -> int:
        """Return the controller's count; before homing it is off by an unknown constant."""
        now_s = self.clock.now_s()
        self._settle(now_s)
        return round(self._motion(now_s)[0] - self._count_origin)

    def speed_now_steps_s(self) -> float:
        """Return the signed speed of the shaft, steps/s."""
        return self._motion(self.clock.now_s())[1]

    def angle_deg(self) -> float:
        """Return where the arm truly is, degrees."""
        return self.angle_at(self.clock.now_s())

    def angle_at(self, time_s: float) -> float:
        """Return where the arm is at a bench time since the last command, degrees."""
        if time_s >= self._end_s:
            return self._end_angle_deg
        return self._angle(self._arm_at(time_s))

    def is_moving(self) -> bool:
        """Say whether the shaft turns."""
        now_s = self.clock.now_s()
        self._settle(now_s)
        return now_s < self._end_s

    def is_homing(self) -> bool:
        """Say whether the home routine runs."""
        return self.is_moving() and self._homing

    @property
    def referenced(self) -> bool:
        """Whether the home routine has been through since power came on."""
        self._settle(self.clock.now_s())
        return self._referenced

    @property
    def fault(self) -> Fault:
        """The latched reason of the last stop that nobody asked for."""
        self._settle(self.clock.now_s())
        return self._fault

    @property
    def motion_s(self) -> tuple[float, float]:
        """Bench times of start and end of the last motion; an interval of no length if there was none."""
        return (self._pieces[0].start_s if self._pieces else math.inf), self._end_s

    def _steps(self, angle_deg: float) -> float:
        return (angle_deg - self.hardware.zero_deg) * self.hardware.steps_per_deg

    def _angle(self, steps: float) -> float:
        return self.hardware.zero_deg + steps / self.hardware.steps_per_deg

    def _edges(self) -> tuple[list[tuple[float, Fault]], list[tuple[float, Fault]]]:
        """Arm positions that stop a rise, and those that stop a fall, with the fault each raises."""
        forbidden: list[tuple[float, float]] = []
        low, high = self.hardware.limits_deg
        for border, side in ((low, -math.inf), (high, math.inf)):
            if math.isfinite(border):
                a, b = self._steps(border), side * math.copysign(1.0, self.hardware.steps_per_deg)
                forbidden.append((min(a, b), max(a, b)))
        zone = self.hardware.blind_zone_deg - ZONE_MARGIN_DEG
        if zone > 0:
            a, b = self._steps(-zone), self._steps(zone)
            forbidden.append((min(a, b), max(a, b)))
        # Whole steps, so that the count of a motor that stands at its switch is exact.
        up = [(float(math.floor(a)), Fault.HIGH_LIMIT) for a, _ in forbidden if math.isfinite(a)]
        down = [(float(math.ceil(b)), Fault.LOW_LIMIT) for _, b in forbidden if math.isfinite(b)]
        if self.hardware.obstacle_deg is not None:
            at = float(round(self._steps(self.hardware.obstacle_deg)))
            (up if at >= self._arm else down).append((at, Fault.STALL))
        return up, down

    def _begin(self) -> float:
        if self.before_command is not None:
            self.before_command()
        now_s = self.clock.now_s()
        self._settle(now_s)
        return now_s

    def _run(self, now_s: float, pieces: list[Piece], *, homing: bool = False) -> None:
        position, _ = self._motion(now_s)
        arm = self._arm_at(now_s)
        top, up_fault = min(
            ((e, f) for e, f in self._up_edges if e >= arm - 1.0), default=(math.inf, Fault.NONE), key=_edge
        )
        bottom, down_fault = max(
            ((e, f) for e, f in self._down_edges if e <= arm + 1.0),
            default=(-math.inf, Fault.NONE),
            key=_edge,
        )
        kept, border = cut_at(pieces, bottom - self._play[1], top - self._play[0])
        self._rest, self._arm = position, arm
        self._pieces, self._arms = kept, []
        for piece in kept:
            self._arms.append(arm)
            arm = self._drag(arm, piece.end)
        self._end_angle_deg = self._angle(arm)
        self._homing = homing
        self._end_s = kept[-1].start_s + kept[-1].duration_s if kept else now_s
        self._pending_fault = (
            Fault.NONE if border is None else up_fault if border == top - self._play[0] else down_fault
        )
        self._settle(now_s)

    def _settle(self, now_s: float) -> None:
        """Take note of what the end of a motion changes: the fault, the reference."""
        if now_s < self._end_s:
            return
        if self._pending_fault is not Fault.NONE:
            self._fault, self._pending_fault = self._pending_fault, Fault.NONE
        elif self._homing:
            self._referenced = True
            self._count_origin = 0.0
        self._homing = False

    def _piece(self, time_s: float) -> int:
        """Index of the piece that is under way at a time, the last one after the end."""
        for i in range(len(self._pieces) - 1, 0, -1):
            if time_s >= self._pieces[i].start_s:
                return i
        return 0

    def _motion(self, time_s: float) -> tuple[float, float]:
        """Shaft position in steps and signed speed in steps/s."""
        if not self._pieces:
            return self._rest, 0.0
        piece = self._pieces[self._piece(time_s)]
        return piece.position(time_s), (0.0 if time_s >= self._end_s else piece.speed_at(time_s))

    def _arm_at(self, time_s: float) -> float:
        if not self._pieces:
            return self._arm
        i = self._piece(time_s)
        return self._drag(self._arms[i], self._pieces[i].position(time_s))

    def _drag(self, arm: float, shaft: float) -> float:
        """Arm after the shaft went to `shaft` without reversal."""
        return min(max(arm, shaft + self._play[0]), shaft + self._play[1])


def _edge(entry: tuple[float, Fault]) -> float:
    return entry[0]
