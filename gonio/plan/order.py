"""In which order positions are measured.

``as_written``
    Sweep by sweep as listed, within a sweep polarization by polarization, within these the detector angles as
    listed; then the position lists.
``nested``
    Three nested loops, the slowest first in `nesting`; each axis always runs the same way.
``serpentine``
    The same, to and fro: each loop begins where the one before it ended, so that nothing travels back empty.
``random``
    Shuffled, polarizations too, from the stored seed: a drift of the bench then looks like noise and not like
    a dependence on an angle.
``optimised``
    Whichever of these loops takes the rig least time; `gonio.plan.optimise.resolved` puts it in, and until a
    rig is known it is ``serpentine``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gonio.devices import Polarization
from gonio.plan.tables import DEFAULT_NESTING, Axis, Order


class Place(NamedTuple):
    """A position without its number."""

    theta_i_deg: float
    theta_mes_deg: float
    polarization: Polarization


_COLUMN: dict[Axis, int] = {"theta_i": 0, "theta_mes": 1, "polarization": 2}


def arrange(places: Sequence[Place], order: Order, *, repeats: int, of: str) -> list[Place]:
    """Return the places in measuring order, each as often as it is repeated."""
    rng = np.random.default_rng(order.seed or 0)
    once = _arranged(places, order, rng)
    if of == "position":
        return [place for place in once for _ in range(repeats)]
    found = list(once)
    for number in range(1, repeats):
        if order.kind == "random":
            found.extend(_arranged(places, order, rng))
        elif order.kind in ("serpentine", "optimised"):
            found.extend(once[::-1] if number % 2 else once)
        else:
            found.extend(once)
    return found


def _arranged(places: Sequence[Place], order: Order, rng: np.random.Generator) -> list[Place]:
    if order.kind == "as_written":
        return list(places)
    if order.kind == "random":
        return [places[i] for i in rng.permutation(len(places)).tolist()]
    nesting = order.nesting or DEFAULT_NESTING
    return _nested(places, nesting, serpentine=order.kind != "nested", descending=bool(order.descending))


def _nested(
    places: Sequence[Place], nesting: Sequence[Axis], *, serpentine: bool, descending: bool
) -> list[Place]:
    """Order by the first axis of `nesting`, within its groups by the next: detector angles by size, the
    others as they are listed.
    """
    axis, inner = nesting[0], nesting[1:]
    groups: dict[float | str, list[Place]] = {}
    for place in places:
        groups.setdefault(place[_COLUMN[axis]], []).append(place)
    values = list(groups)
    if axis == "theta_mes":
        values.sort(reverse=descending)
    found: list[Place] = []
    for number, value in enumerate(values):
        group = groups[value]
        if inner:
            group = _nested(group, inner, serpentine=serpentine, descending=descending)
        found.extend(group[::-1] if serpentine and number % 2 else group)
    return found
