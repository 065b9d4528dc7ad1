"""Which order of the positions takes the rig least time, and what each order costs.

What an order changes is the travel of the axes (long ways back, the second leg of an approach from the wrong
side), the turns of the polarizer, and the drive of the monochromator back to its first wavelength, which an
alternating direction saves.  The readings themselves stay the same.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from gonio.plan.model import Plan
from gonio.plan.motion import move_time
from gonio.plan.tables import DEFAULT_NESTING, Axis, Order
from gonio.plan.timetable import estimate
from gonio.rig import RigConfig

_KINDS: tuple[Literal["nested", "serpentine"], ...] = ("nested", "serpentine")
MANY_POSITIONS = 20_000
"""Up to so many positions every nesting is tried, which takes two seconds; beyond, only the usual one."""

_TO_AND_FRO = {"alternate_wavelengths": True}
_NESTINGS: tuple[tuple[Axis, Axis, Axis], ...] = tuple(itertools.permutations(DEFAULT_NESTING))  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class OrderCost:
    """One order and the duration of the scan with it, on the instrument's clock."""

    order: Order
    total_s: float

    def __str__(self) -> str:
        return describe(self.order)


def describe(order: Order) -> str:
    """Return an order in words."""
    words: list[str] = [order.kind.replace("_", " ")]
    if order.kind in ("nested", "serpentine"):
        words.append(f"{(order.nesting or DEFAULT_NESTING)[-1]} innermost, "
                     f"{(order.nesting or DEFAULT_NESTING)[0]} outermost")  # fmt: skip
        words.append("detector angles " + ("falling" if order.descending else "rising"))
    if order.kind == "random":
        words.append(f"seed {order.seed}")
    if order.alternate_wavelengths:
        words.append("wavelengths to and fro")
    return ", ".join(words)


def resolved(plan: Plan, rig: RigConfig) -> Plan:
    """Return the plan with ``kind = "optimised"`` replaced by the order that takes this rig least time.

    Any other plan is returned as it is.  The stored plan is the resolved one, so a scan that is resumed keeps
    its order even if the rig file has changed since.
    """
    if plan.order.kind != "optimised":
        return plan
    orders = [order.model_copy(update=_TO_AND_FRO) for order in _shortlist(plan, rig)]
    best = min(orders, key=lambda order: estimate(_with_order(plan, order), rig))
    return _with_order(plan, best)


def order_costs(plan: Plan, rig: RigConfig) -> list[OrderCost]:
    """Return the plan's own order first, then the others that are worth a look, each with its time.

    For each axis that may change fastest: all loops the same way, and to and fro, whichever nesting of the
    other two and direction of the detector arm is faster.  Each of the best loops then with the wavelengths
    to and fro.
    """
    own = resolved(plan, rig)
    found = [OrderCost(own.order, estimate(own, rig))]
    short = _shortlist(plan, rig)
    others = [*short, *(order.model_copy(update=_TO_AND_FRO) for order in short)]
    found.extend(
        OrderCost(order, estimate(_with_order(plan, order), rig)) for order in others if order != own.order
    )
    return [found[0], *sorted(found[1:], key=lambda cost: cost.total_s)]


def _shortlist(plan: Plan, rig: RigConfig) -> list[Order]:
    """Return the order with the least travel for each way of running the loops and each innermost axis."""
    if plan.n_positions > MANY_POSITIONS:
        return [
            Order(kind=kind, nesting=DEFAULT_NESTING, descending=falls)
            for kind in _KINDS
            for falls in (False, True)
        ]
    found: list[Order] = []
    for kind, axis in itertools.product(_KINDS, DEFAULT_NESTING):
        same = [
            Order(kind=kind, nesting=nesting, descending=descending)
            for nesting, descending in itertools.product(_NESTINGS, (False, True))
            if nesting[-1] == axis
        ]
        found.append(min(same, key=lambda order: _travel_s(_with_order(plan, order), rig)))
    return found


def _with_order(plan: Plan, order: Order) -> Plan:
    return plan.model_copy(update={"order": order})


def _travel_s(plan: Plan, rig: RigConfig) -> float:
    """Return the time of all moves and turns between positions, on the instrument's clock."""
    turn_s, speed = rig.polarizer.turn_s, rig.clock_speed()

    @functools.cache
    def move_s(start: tuple[float, float], end: tuple[float, float]) -> float:
        found = move_time(rig, start, end)
        return found.instrument_s + rig.latency.of(found.exchanges) * speed

    return sum(
        move_s((a.theta_i_deg, a.theta_mes_deg), (b.theta_i_deg, b.theta_mes_deg))
        + (turn_s if a.polarization != b.polarization else 0.0)
        for a, b in pairwise(plan.positions())
    )
