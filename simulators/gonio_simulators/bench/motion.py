"""Where a motor is at any time of a move: pieces of constant acceleration, cut short by switches."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Piece:
    """Constant acceleration without reversal; positions in steps of the shaft, times in bench seconds."""

    start_s: float
    duration_s: float
    start: float
    speed: float  # signed, at the start
    acceleration: float  # signed
    end: float

    def position(self, time_s: float) -> float:
        """Return the position at a time within the piece; exactly `end` from its end on."""
        t = time_s - self.start_s
        if t >= self.duration_s:
            return self.end
        return self.start + t * (self.speed + 0.5 * self.acceleration * t)

    def speed_at(self, time_s: float) -> float:
        """Return the signed speed at a time within the piece."""
        return self.speed + self.acceleration * (time_s - self.start_s)


def decelerate(start_s: float, position: float, speed: float, to_speed: float, acceleration: float) -> Piece:
    """Return the piece that brings `speed` down to `to_speed` of the same sign at |acceleration|."""
    slowing = -math.copysign(acceleration, speed)
    duration = (to_speed - speed) / slowing
    end = position + 0.5 * (speed + to_speed) * duration
    return Piece(start_s, duration, position, speed, slowing, end)


def pieces_to(
    start_s: float, position: float, speed: float, target: float, max_speed: float, acceleration: float
) -> list[Piece]:
    """Return the time-optimal way to stand at `target`, from any position and speed.

    From rest it is the trapezoid (or triangle) of duration ``d/v + a/v`` (``2 sqrt(d/a)``).  A motor that
    runs the other way, or too fast to stop at the target, first stops and then comes back.
    """
    pieces: list[Piece] = []

    def append(piece: Piece) -> None:
        nonlocal start_s, position, speed
        if piece.duration_s > 0:
            pieces.append(piece)
            start_s += piece.duration_s
        position, speed = piece.end, speed + piece.acceleration * piece.duration_s

    stopping = speed * abs(speed) / (2.0 * acceleration)
    ahead = (target - position) * speed > 0 and abs(stopping) <= abs(target - position)
    if speed != 0 and not ahead:
        append(decelerate(start_s, position, speed, 0.0, acceleration))
        speed = 0.0
    sign = math.copysign(1.0, target - position)
    if abs(speed) > max_speed:
        append(decelerate(start_s, position, speed, sign * max_speed, acceleration))
        speed = sign * max_speed
    distance = abs(target - position)
    if distance == 0 and speed == 0:
        return pieces
    peak = min(max_speed, math.sqrt(acceleration * distance + 0.5 * speed * speed))
    rise = max(peak - abs(speed), 0.0) / acceleration
    up = sign * 0.5 * (abs(speed) + peak) * rise
    fall = sign * 0.5 * peak * peak / acceleration
    cruise = max((distance - abs(up) - abs(fall)) / peak, 0.0)
    append(Piece(start_s, rise, position, speed, sign * acceleration, position + up))
    speed = sign * peak
    append(Piece(start_s, cruise, position, speed, 0.0, position + sign * peak * cruise))
    last = Piece(start_s, peak / acceleration, position, speed, -sign * acceleration, target)
    append(last)
    return pieces


def cut_at(pieces: list[Piece], low: float, high: float) -> tuple[list[Piece], float | None]:
    """Return the pieces up to where they first leave ``low...high``, and that border (None: never)."""
    kept: list[Piece] = []
    for piece in pieces:
        border = high if piece.end > high else low if piece.end < low else None
        if border is None:
            kept.append(piece)
            continue
        duration = _time_to(piece, border)
        if duration > 0:
            kept.append(replace(piece, duration_s=duration, end=border))
        return kept, border
    return kept, None


def cut_after(pieces: list[Piece], duration_s: float) -> list[Piece]:
    """Return the pieces of the first `duration_s`; they end abruptly, on a whole step."""
    kept: list[Piece] = []
    for piece in pieces:
        left_s = pieces[0].start_s + duration_s - piece.start_s
        if left_s <= 0:
            break
        if left_s < piece.duration_s:
            end = float(round(piece.position(piece.start_s + left_s)))
            kept.append(replace(piece, duration_s=left_s, end=end))
            break
        kept.append(piece)
    return kept


def _time_to(piece: Piece, position: float) -> float:
    """Time from the piece's start to `position`, which lies between its start and its end."""
    distance = position - piece.start
    if distance * (piece.end - piece.start) <= 0:
        return 0.0
    # the smaller positive root, in the form that does not cancel
    root = math.sqrt(max(piece.speed**2 + 2.0 * piece.acceleration * distance, 0.0))
    return min(2.0 * abs(distance) / (abs(piece.speed) + root), piece.duration_s)
