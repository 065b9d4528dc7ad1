"""bluesky's own RunEngine drives an axis of the simulated bench."""

from __future__ import annotations

import pytest

bluesky = pytest.importorskip("bluesky")


def test_structural_protocols(bench):
    from bluesky import protocols

    with bench.open() as rig:
        axis = rig.stage.theta_i
        for protocol in (protocols.Movable, protocols.Readable, protocols.Stoppable, protocols.HasHints):
            assert isinstance(axis, protocol), protocol
        status = axis.set(31.0)
        assert isinstance(status, protocols.Status)
        status.wait(30)
        assert axis.position == pytest.approx(31.0, abs=0.001)


def test_scan_plan(bench):
    from bluesky import RunEngine
    from bluesky.plans import scan

    documents: list[tuple[str, dict]] = []
    with bench.open() as rig:
        engine = RunEngine({})
        engine(
            scan([], rig.stage.theta_i, 20.0, 40.0, 5),
            lambda name, document: documents.append((name, document)),
        )
    positions = [d["data"]["theta_i"] for name, d in documents if name == "event"]
    assert positions == pytest.approx([20.0, 25.0, 30.0, 35.0, 40.0], abs=0.001)
    (stop,) = [d for name, d in documents if name == "stop"]
    assert stop["exit_status"] == "success"
    (descriptor,) = [d for name, d in documents if name == "descriptor"]
    assert descriptor["data_keys"]["theta_i"]["units"] == "deg"


def test_a_refused_target_fails_the_plan(bench):
    from bluesky import RunEngine
    from bluesky.plan_stubs import mv

    from gonio.errors import RefusedError

    with bench.open() as rig, pytest.raises(RefusedError, match="blind zone"):
        RunEngine({})(mv(rig.stage.theta_mes, 5.0))
