"""What is checked before a scan makes a file or moves anything."""

from __future__ import annotations

import datetime
import time
from dataclasses import dataclass
from pathlib import Path

import gonio
from gonio.acquire.room import RESERVE_BYTES, must_have_room
from gonio.acquire.session import facts_of, refuse_existing
from gonio.acquire.sourcing import Asked
from gonio.acquire.steps import Step, steps_of
from gonio.aperture import Aperture, IncidentBeam
from gonio.errors import RefusedError
from gonio.plan.channels import Channels, channels
from gonio.plan.check import check
from gonio.plan.model import Plan, Position
from gonio.plan.timetable import timetable
from gonio.rig import Rig, RigConfig
from gonio.store.records import ScanHeader

BYTES_PER_READING = 300  # journal and .h5 together, and a rebuilt .h5 beside the old one
_SHOWN_REFUSALS = 10


@dataclass(frozen=True, slots=True)
class Prepared:
    """A plan that this rig can measure now: its columns and steps, and what its devices say they are.

    Where a source decides there are no steps yet, and `first` is the position that it begins with.
    """

    columns: Channels
    steps: list[Step]
    devices: dict[str, str]
    first: Position | None


def prepared(rig: Rig, plan: Plan, path: Path, *, continues: bool, source: Asked | None) -> Prepared:
    """Check plan against rig, target file, disk space, and that each device answers.

    Raises
    ------
    RefusedError
        The rig must not or cannot measure the plan, or the first position of the source.
    StoreError
        The file is in the way, or the disk too full.
    DeviceError
        A device does not answer.
    """
    config = rig.config
    refusals = check(plan, config)
    if refusals:
        shown = "\n".join(str(refusal) for refusal in refusals[:_SHOWN_REFUSALS])
        more = f"\n... and {len(refusals) - _SHOWN_REFUSALS} more" if len(refusals) > _SHOWN_REFUSALS else ""
        raise RefusedError(f"the plan '{plan.title}' cannot be measured:\n{shown}{more}")
    # refuses dimensions that no aperture and no beam has
    Aperture(config.aperture.width_mm, config.aperture.height_mm, config.aperture.distance_mm)
    if config.beam is not None:
        IncidentBeam(config.beam.width_mm, config.beam.height_mm, config.beam.divergence_deg)
    if not continues:
        refuse_existing(path)
    columns = channels(plan, config)
    steps: list[Step] = []
    first = None
    if source is None:
        steps = steps_of(plan, config)
        _must_fit(path, len(steps) * len(columns))
    else:
        if not continues:
            first = source.decide([], [])
        _must_fit(path, _most_steps(source, plan, config) * len(columns))
    answers = {"stage": rig.stage.identify(), "polarizer": rig.polarizer.identify()}
    return Prepared(columns, steps, answers | dict(rig.spectrometer.identify()), first)


def header_of(rig: Rig, plan: Plan, ready: Prepared, source: Asked | None) -> ScanHeader:
    """Return what is known of a scan that begins now."""
    return ScanHeader(
        plan_text=plan.to_toml(),
        rig_text=rig.config.text,
        rig=facts_of(rig.config),
        detector_index=ready.columns.detector_index,
        devices=ready.devices,
        program=f"gonio {gonio.__version__}",
        start_time=now_iso(),
        unix_s=time.time(),
        wavelength_nm=ready.columns.wavelength_nm,
        source=None if source is None else source.facts,
    )


def now_iso() -> str:
    """Return the time of day with its offset."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def _most_steps(source: Asked, plan: Plan, config: RigConfig) -> int:
    """Return how many steps a source can make; with references by the minute, at most one set each."""
    references = plan.references
    ends = len(timetable(plan.model_copy(update={"sweeps": (), "positions_listed": ()}), config).steps)
    between = source.max_positions // (references.every_positions or 1) if references.periodic_kinds else 0
    return source.max_positions + ends + between * (1 + len(plan.polarization))


def _must_fit(path: Path, readings: int) -> None:
    must_have_room(path, readings * BYTES_PER_READING + RESERVE_BYTES)
