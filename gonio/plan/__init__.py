"""What to measure: the plan file, its positions in order, and whether a rig can do it in what time."""

from __future__ import annotations

from gonio.plan.check import Refusal, check, estimate
from gonio.plan.model import Plan, Position, load_plan, parse_plan

__all__ = ["Plan", "Position", "Refusal", "check", "estimate", "load_plan", "parse_plan"]
