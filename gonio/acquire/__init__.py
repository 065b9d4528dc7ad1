"""Run a plan on a rig and lose nothing: the runner, its journal, and how an interrupted scan goes on."""

from __future__ import annotations

from gonio.acquire.interrupted import resume_scan, stored_rig
from gonio.acquire.policy import FaultPolicy
from gonio.acquire.runner import Runner
from gonio.acquire.state import Snapshot, State

__all__ = ["FaultPolicy", "Runner", "Snapshot", "State", "resume_scan", "stored_rig"]
