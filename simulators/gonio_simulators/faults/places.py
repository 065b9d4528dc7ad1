"""Where a fault applies: the places that a target names, or all that its kind knows."""

from __future__ import annotations

from collections.abc import Sequence

from gonio.errors import ConfigError
from gonio_simulators.faults.catalogue import Place
from gonio_simulators.faults.spec import FaultSpec, suggest

ROLES = ("stage", "polarizer", "monochromator", "lockin")
STAGE_AXES = ("theta_i", "theta_mes")
LAMP = "lamp"


def places_of(spec: FaultSpec, detectors: Sequence[str]) -> tuple[str, ...]:
    """Return the places at which a fault is to be injected.

    Parameters
    ----------
    spec
        The fault; without a target it is injected wherever it applies.
    detectors
        The names of the bench's detectors.

    Raises
    ------
    ConfigError
        If the fault does not apply at its target; the message lists where it does.
    """
    everywhere: dict[Place, tuple[str, ...]] = {
        "line": ROLES,
        "cs260": ("monochromator",),
        "axis": (*STAGE_AXES, "polarizer"),
        "stage-axis": STAGE_AXES,
        "detector": tuple(detectors),
        "lockin": ("lockin",),
        "lamp": (LAMP,),
        "monochromator": ("monochromator",),
    }
    known = everywhere[spec.kind.place]
    if spec.target is None:
        return known
    if spec.target in known:
        return (spec.target,)
    if spec.target == "stage" and set(STAGE_AXES) <= set(known):
        return STAGE_AXES
    names = ("stage", *known) if set(STAGE_AXES) <= set(known) else known
    raise ConfigError(
        f"fault '{spec.text}': {spec.kind.name} does not apply to '{spec.target}'; "
        f"{suggest(spec.target, names)}"
    )
