"""Plans for bluesky's RunEngine, of the steps that `Runner` takes; bluesky is imported when one is begun."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gonio.acquire.bluesky_devices import BlueskyDevices
from gonio.acquire.steps import PositionStep, Step, steps_of
from gonio.devices import Polarization
from gonio.plan.model import Plan
from gonio.plan.optimise import resolved
from gonio.rig import RigConfig
from gonio.store.records import ReferenceKind


def references(
    devices: BlueskyDevices, rig: RigConfig, kind: ReferenceKind, polarization: Polarization | None = None
) -> Iterator[Any]:
    """Take one dark, or one baseline in a polarization, in the baseline position; a part of a run.

    Put it before and after the points of a plan of your own, between `open_run` and `close_run`.
    """
    from bluesky.plan_stubs import mv, trigger_and_read

    if polarization is not None:
        yield from mv(devices.polarization, polarization)
    yield from mv(devices.theta_i, rig.baseline.theta_i_deg, devices.theta_mes, rig.baseline.theta_mes_deg)
    yield from mv(devices.light, "dark" if kind == "dark" else "direct")
    yield from trigger_and_read(devices.detectors)
    yield from mv(devices.light, "sample")


def with_references(devices: BlueskyDevices, rig: RigConfig, points: Iterator[Any]) -> Iterator[Any]:
    """Take a dark and the baseline at the beginning and at the end of the run that `points` makes.

    The baseline is that of the polarization selected when the plan begins::

        RE(mv(devices.polarization, "s"))
        RE(with_references(devices, rig.config, bp.scan(devices.detectors, devices.theta_mes, 15, 105, 31)))
    """
    from bluesky.plan_stubs import mv
    from bluesky.preprocessors import plan_mutator

    polarization = devices.polarization.value

    def both() -> Iterator[Any]:
        yield from references(devices, rig, "dark")
        yield from references(devices, rig, "baseline", polarization)

    def and_back() -> Iterator[Any]:
        theta_i, theta_mes = devices.theta_i.position_deg(), devices.theta_mes.position_deg()
        yield from both()
        # the axis that the plan does not move belongs where it was
        yield from mv(devices.theta_i, theta_i, devices.theta_mes, theta_mes)

    def before(message: Any) -> Iterator[Any]:
        yield from both()
        yield message

    closing = False

    def around(message: Any) -> tuple[Iterator[Any] | None, Iterator[Any] | None]:
        nonlocal closing
        if message.command == "open_run":
            return None, and_back()
        if message.command == "close_run" and not closing:
            closing = True  # the message comes by once more, from `before`
            return before(message), None
        return None, None

    yield from plan_mutator(points, around)  # type: ignore[no-untyped-call,unused-ignore]


def paper_scan(devices: BlueskyDevices, rig: RigConfig, plan: Plan | None = None) -> Iterator[Any]:
    """Measure a plan of gonio, by default the paper's: its positions in their order, with its references."""
    from bluesky.plan_stubs import mv, trigger_and_read
    from bluesky.preprocessors import run_decorator, stage_decorator

    plan = resolved(plan or Plan.paper(), rig)

    @stage_decorator([devices.spectrum])  # type: ignore[untyped-decorator,unused-ignore]
    @run_decorator(md={"plan_name": "gonio", "sample": plan.sample.name, "title": plan.title})  # type: ignore[untyped-decorator,unused-ignore]
    def run() -> Iterator[Any]:
        for step in steps_of(plan, rig):
            yield from one(step)

    def one(step: Step) -> Iterator[Any]:
        if isinstance(step, PositionStep):
            at = step.position
            yield from mv(devices.polarization, at.polarization)
            yield from mv(devices.theta_i, at.theta_i_deg, devices.theta_mes, at.theta_mes_deg)
            yield from trigger_and_read(devices.detectors)
        else:
            polarization = None if step.polarization == "any" else step.polarization
            yield from references(devices, rig, step.kind, polarization)

    yield from run()
