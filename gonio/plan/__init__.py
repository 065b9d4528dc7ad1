"""What to measure: the plan file, its positions in order, and whether a rig can do it in what time."""

from __future__ import annotations

from gonio.plan.channels import Channels, channels
from gonio.plan.check import Refusal, check
from gonio.plan.listing import positions_from_csv
from gonio.plan.model import Plan, Position, load_plan, parse_plan
from gonio.plan.optimise import OrderCost, order_costs, resolved
from gonio.plan.tables import (
    Order,
    PositionList,
    Reading,
    References,
    Repeats,
    Sample,
    Source,
    Sweep,
    WavelengthRange,
)
from gonio.plan.timetable import Timetable, estimate, timetable

__all__ = [
    "Channels",
    "Order",
    "OrderCost",
    "Plan",
    "Position",
    "PositionList",
    "Reading",
    "References",
    "Refusal",
    "Repeats",
    "Sample",
    "Source",
    "Sweep",
    "Timetable",
    "WavelengthRange",
    "channels",
    "check",
    "estimate",
    "load_plan",
    "order_costs",
    "parse_plan",
    "positions_from_csv",
    "resolved",
    "timetable",
]
