"""What is checked before a scan makes a file or moves anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gonio.acquire.room import RESERVE_BYTES, must_have_room
from gonio.acquire.session import refuse_existing
from gonio.acquire.steps import Step, steps_of
from gonio.aperture import Aperture
from gonio.errors import RefusedError
from gonio.plan.channels import Channels, channels
from gonio.plan.check import check
from gonio.plan.model import Plan
from gonio.rig import Rig

BYTES_PER_READING = 300  # journal and .h5 together, and a rebuilt .h5 beside the old one
_SHOWN_REFUSALS = 10


@dataclass(frozen=True, slots=True)
class Prepared:
    """A plan that this rig can measure now: its columns and steps, and what its devices say they are."""

    columns: Channels
    steps: list[Step]
    devices: dict[str, str]


def prepared(rig: Rig, plan: Plan, path: Path, *, continues: bool) -> Prepared:
    """Check plan against rig, target file, disk space, and that each device answers.

    Raises
    ------
    RefusedError
        The rig must not or cannot measure the plan.
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
    # refuses dimensions that no aperture has
    Aperture(config.aperture.width_mm, config.aperture.height_mm, config.aperture.distance_mm)
    if not continues:
        refuse_existing(path)
    columns = channels(plan, config)
    steps = steps_of(plan, config)
    _must_fit(path, len(steps) * len(columns))
    answers = {"stage": rig.stage.identify(), "polarizer": rig.polarizer.identify()}
    return Prepared(columns, steps, answers | dict(rig.spectrometer.identify()))


def _must_fit(path: Path, readings: int) -> None:
    must_have_room(path, readings * BYTES_PER_READING + RESERVE_BYTES)
