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
from gonio_simulators.bench.motion import Piece, cut_after, cut_at, decelerate, pieces_to
from gonio_simulators.clock import BenchClock

HOMING_SPEED = 0.5
"""Speed of the home routine, as a fraction of the axis's normal speed."""


class Fault(enum.Enum):
    """Why the motor stopped by itself; sides are those of the counter, as the controller knows no angles."""

    NONE = "none"
    LOW_LIMIT = "limit switch towards falling counts"
    HIGH_LIMIT = "limit switch towards rising counts"
    STALL = "stalled"
    OVER_TEMPERATURE = "driver too hot, motor released"
    ENCODER = "encoder failed, motor released"


RELEASED = frozenset((Fault.OVER_TEMPERATURE, Fault.ENCODER))
"""Faults after which the driver does not drive until they are cleared."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What goes wrong in a move that begins; `happened` is told the bench time when it does.

    Of the effects one is chosen: a `fault` (``LOW_LIMIT`` stands for the switch on the side the motor runs
    to), lost steps that the counter does not see (`slips`), or a hand on the knob (`hand_steps`).
    """

    part: float  # of the move's duration that passes before
    happened: Callable[[float], None]
    fault: Fault = Fault.NONE
    hold_s: float = 0.0  # the fault cannot be cleared before
    slips: bool = False
    hand_steps: float = 0.0
    hand_s: float = 0.5


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
        self.disturb: Callable[[bool], Disturbance | None] | None = None
        """Asked at the beginning of each move (True: of a homing) whether something goes wrong in it."""
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
        self._encoder_origin = self._rest
        self._pieces: list[Piece] = []
        self._arms: list[float] = []  # arm at the start of each piece
        self._end_s = -math.inf
        self._end_angle_deg = self._angle(self._arm)
        self._pending_fault = Fault.NONE
        self._homing = False
        self._disturbance: Disturbance | None = None
        self._disturbed_s = math.inf
        self._slipped_s = math.inf  # from then on the shaft stands while the counter runs on
        self._held_until_s = -math.inf
        self._manual = False
        self.interrupted_by_hand = False
        """A hand ended a movement; until `clear_fault`."""
        self.displaced = False
        """Something pushed the axis while it stood; until `clear_fault`."""
        self._up_edges, self._down_edges = self._edges()

    def move_absolute(self, target_steps: int) -> None:
        """Go to a count, from wherever the motor is and however fast it runs."""
        now_s = self._begin()
        position, speed = self._motion(now_s)
        target = float(target_steps) + self._count_origin
        pieces = pieces_to(now_s, position, speed, target, self.speed_steps_s, self.acceleration_steps_s2)
        self._run(now_s, pieces, commanded=True)

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
        pieces += pieces_to(turn_s, beyond, 0.0, 0.0, fast, acceleration)
        self._run(now_s, pieces, homing=True, commanded=True)

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
        """Forget the latched fault, unless its cause lasts; the motor stays where it is."""
        now_s = self.clock.now_s()
        self._settle(now_s)
        self.interrupted_by_hand = self.displaced = False
        if now_s >= self._held_until_s:
            self._fault = Fault.NONE

    def turn_by_hand(self, steps: float, duration_s: float) -> None:
        """Turn the manual knob: the controller follows it, counts, and drops the movement it was in."""
        now_s = self._begin()
        if self.is_moving() and not self._manual:
            self.interrupted_by_hand = True
        position, _ = self._motion(now_s)
        self._run(now_s, _by_hand(now_s, position, steps, duration_s), manual=True)

    def displace(self, steps: float) -> None:
        """Push the axis while the motor holds; an encoder sees where it then stands."""
        now_s = self._begin()
        position, _ = self._motion(now_s)
        instant = Piece(now_s, 0.0, position, 0.0, 0.0, position + float(round(steps)))
        self._run(now_s, [instant])
        self.displaced = True

    def power_cycle(self) -> None:
        """Switch off and on: the motor stands at once, and the controller knows nothing of before."""
        now_s = self._begin()
        here = float(round(self._motion(now_s)[0]))
        self._run(now_s, [])
        self._rest = self._count_origin = self._encoder_origin = here
        self._referenced = False
        self._held_until_s = -math.inf
        self.clear_fault()

    def position_steps(self) -> int:
        """Return the controller's count; before homing it is off by an unknown constant."""
        now_s = self.clock.now_s()
        self._settle(now_s)
        return round(self._motion(now_s)[0] - self._count_origin)

    def encoder_steps(self) -> int:
        """Return what an encoder on the shaft counts: the same, unless the motor lost steps."""
        now_s = self.clock.now_s()
        self._settle(now_s)
        return round(self._motion(min(now_s, self._slipped_s))[0] - self._encoder_origin)

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

    def is_manual(self) -> bool:
        """Say whether a hand turns the motor."""
        return self.is_moving() and self._manual

    @property
    def in_hands(self) -> bool:
        """Whether a hand turns or has disturbed the axis; until `clear_fault`."""
        self._settle(self.clock.now_s())
        return self._manual or self.interrupted_by_hand or self.displaced

    @property
    def origins_steps(self) -> tuple[int, int]:
        """Steps from the home switch to where counter and encoder say 0; 0 once homed, but for lost steps."""
        return round(self._count_origin), round(self._encoder_origin)

    def is_released(self) -> bool:
        """Say whether a fault keeps the driver from driving."""
        return self.fault in RELEASED

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
        self._take_slip_into_account(now_s)
        return now_s

    def _run(
        self,
        now_s: float,
        pieces: list[Piece],
        *,
        homing: bool = False,
        commanded: bool = False,
        manual: bool = False,
    ) -> None:
        if commanded and self.is_released():
            pieces, homing = [], False
        position, _ = self._motion(now_s)
        arm = self._arm_at(now_s)
        self._disturbance, self._disturbed_s, self._slipped_s = None, math.inf, math.inf
        if commanded and pieces and self.disturb is not None:
            pieces = self._disturbed(pieces, self.disturb(homing))
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
        self._homing, self._manual = homing, manual
        self._end_s = kept[-1].start_s + kept[-1].duration_s if kept else now_s
        self._end_angle_deg = self._angle(arm if self._slipped_s > self._end_s else self._arm_at(self._end_s))
        if border is not None:
            self._pending_fault = up_fault if border == top - self._play[0] else down_fault
            if self._end_s < self._disturbed_s:  # a real switch was there first
                self._disturbance = None
        else:
            self._pending_fault = self._fault_of(self._disturbance, kept)
        self._settle(now_s)

    def _disturbed(self, pieces: list[Piece], disturbance: Disturbance | None) -> list[Piece]:
        """Return the pieces as they become with a disturbance in them."""
        if disturbance is None:
            return pieces
        start_s, last = pieces[0].start_s, pieces[-1]
        after_s = disturbance.part * (last.start_s + last.duration_s - start_s)
        self._disturbance, self._disturbed_s = disturbance, start_s + after_s
        if disturbance.slips:
            self._slipped_s = self._disturbed_s
            return pieces
        kept = cut_after(pieces, after_s)
        if disturbance.hand_steps:
            position = kept[-1].end if kept else pieces[0].start
            kept += _by_hand(self._disturbed_s, position, disturbance.hand_steps, disturbance.hand_s)
        return kept

    @staticmethod
    def _fault_of(disturbance: Disturbance | None, kept: list[Piece]) -> Fault:
        if disturbance is None or disturbance.fault is not Fault.LOW_LIMIT:
            return Fault.NONE if disturbance is None else disturbance.fault
        rising = bool(kept) and kept[-1].end > kept[-1].start
        return Fault.HIGH_LIMIT if rising else Fault.LOW_LIMIT

    def _take_slip_into_account(self, now_s: float) -> None:
        """From a new command on, reckon from where the shaft is; the counter keeps its wrong belief."""
        if now_s < self._slipped_s:
            return
        claimed, speed = self._motion(now_s)
        arm, shaft = self._arm_at(now_s), self._motion(self._slipped_s)[0]
        self._count_origin += shaft - claimed
        self._rest, self._arm = shaft, arm
        self._pieces, self._arms = [Piece(now_s, 0.0, shaft, speed, 0.0, shaft)], [arm]
        self._end_s = min(self._end_s, now_s) if speed == 0 else self._end_s
        self._slipped_s = math.inf

    def _settle(self, now_s: float) -> None:
        """Take note of what the end of a motion changes: the fault, the reference."""
        if now_s >= self._disturbed_s:
            self._take_note_of_disturbance()
        if now_s < self._end_s:
            return
        if self._pending_fault is not Fault.NONE:
            self._fault, self._pending_fault = self._pending_fault, Fault.NONE
        elif self._homing:
            self._referenced = True
            self._count_origin = self._encoder_origin = 0.0
        self._homing = self._manual = False

    def _take_note_of_disturbance(self) -> None:
        disturbance, time_s = self._disturbance, self._disturbed_s
        self._disturbance, self._disturbed_s = None, math.inf
        if disturbance is None:
            return
        self._held_until_s = time_s + disturbance.hold_s
        if disturbance.hand_steps:
            self._homing, self._manual, self.interrupted_by_hand = False, True, True
        disturbance.happened(time_s)

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
        time_s = min(time_s, self._slipped_s)
        i = self._piece(time_s)
        return self._drag(self._arms[i], self._pieces[i].position(time_s))

    def _drag(self, arm: float, shaft: float) -> float:
        """Arm after the shaft went to `shaft` without reversal."""
        return min(max(arm, shaft + self._play[0]), shaft + self._play[1])


def _by_hand(start_s: float, position: float, steps: float, duration_s: float) -> list[Piece]:
    """A turn of the knob at constant speed."""
    end = float(round(position + steps))
    return [Piece(start_s, duration_s, position, (end - position) / duration_s, 0.0, end)]


def _edge(entry: tuple[float, Fault]) -> float:
    return entry[0]
