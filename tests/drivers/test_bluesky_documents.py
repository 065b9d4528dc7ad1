"""The real RunEngine measures on the simulated bench, and its documents become the same `.h5`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

pytest.importorskip("bluesky")

import bluesky.plans as bp
from bluesky import RunEngine, protocols
from bluesky.plan_stubs import mv

import gonio
from gonio.acquire import Runner
from gonio.acquire.bluesky_devices import BlueskyDevices, bluesky_devices
from gonio.acquire.bluesky_plans import paper_scan, with_references
from gonio.acquire.documents import NexusWriter
from gonio.errors import RefusedError, StoreError
from gonio.plan import parse_plan
from gonio.rig import Rig

PLAN = parse_plan(
    """
title = "with bluesky"
[sample]
name = "panel"
[[wavelengths]]
values_nm = [500.0, 840.0, 900.0]
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = [40.0, 55.0, 60.0, 65.0, 80.0]
[[sweeps]]
theta_i_deg = 50.0
theta_mes_deg = [60.0, 95.0, 100.0, 105.0]
[references]
averages = 2
"""
)


@pytest.fixture
def rig(bench: Any) -> Iterator[Rig]:
    with bench.open() as opened:
        yield opened


@pytest.fixture
def devices(rig: Rig) -> BlueskyDevices:
    return bluesky_devices(rig, PLAN)


def test_structural_protocols(devices: BlueskyDevices) -> None:
    assert isinstance(devices.spectrum, protocols.Readable)
    assert isinstance(devices.spectrum, protocols.Triggerable)
    assert isinstance(devices.spectrum, protocols.Configurable)
    assert isinstance(devices.spectrum, protocols.Stageable)
    assert isinstance(devices.spectrum, protocols.Stoppable)
    assert isinstance(devices.polarization, protocols.Movable)
    assert isinstance(devices.polarization, protocols.Readable)
    assert isinstance(devices.light, protocols.Movable)


def test_a_whole_plan_becomes_the_file_that_the_runner_writes(
    rig: Rig, devices: BlueskyDevices, tmp_path: Path
) -> None:
    ours, theirs = tmp_path / "ours.h5", tmp_path / "theirs.h5"
    documents: list[tuple[str, dict[str, Any]]] = []
    engine = RunEngine({})
    engine.subscribe(NexusWriter(theirs, rig.config))
    engine.subscribe(lambda name, document: documents.append((name, document)))
    engine(paper_scan(devices, rig.config, PLAN))
    Runner(rig, PLAN, ours).run()
    assert layout(theirs) == layout(ours)
    one, other = gonio.load(ours), gonio.load(theirs)
    assert other.finished
    assert other.title == "with bluesky"
    assert other.sample_name == "panel"
    assert parse_plan(other.plan_text) == PLAN
    np.testing.assert_allclose(other.theta_i_deg, one.theta_i_deg, atol=0.011)
    np.testing.assert_allclose(other.theta_mes_deg, one.theta_mes_deg, atol=0.011)
    assert other.polarization.tolist() == one.polarization.tolist()
    np.testing.assert_allclose(other.r, one.r, rtol=0.02, atol=2e-3)  # the noise of this bench
    with h5py.File(theirs) as file:
        references = file["entry/references"]
        assert references["when"].asstr()[...].tolist() == ["start"] * 3 + ["end"] * 3
        assert references["averages"][...].tolist() == [2] * 6
        (message,) = file["entry/events/message"].asstr()[...].tolist()
    assert message.startswith("bluesky run ")
    assert message.endswith(": success")
    fit = gonio.fit(other)
    assert np.all(np.isfinite(fit.value))
    # and the same again from documents that somebody kept as text
    kept = [json.loads(json.dumps([n, d], default=lambda a: a.tolist())) for n, d in documents]
    again = NexusWriter(tmp_path / "again.h5", rig.config)
    for name, document in kept:
        again(name, document)
    np.testing.assert_array_equal(gonio.load(tmp_path / "again.h5").r, other.r)


def layout(path: Path) -> dict[str, Any]:
    """Return every dataset's type, trailing shape and attributes, and every group's attributes."""
    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        attributes = {key: str(value) for key, value in item.attrs.items()}
        if isinstance(item, h5py.Dataset):
            rows = () if name.startswith(("entry/references", "entry/events")) else item.shape
            found[name] = (str(item.dtype), rows, attributes)
        else:
            found[name] = attributes

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


@pytest.mark.parametrize(
    "points",
    [
        lambda d: bp.scan(d.detectors, d.theta_mes, 60.0, 100.0, 3, md={"sample": "tile"}),
        lambda d: bp.list_scan(d.detectors, d.theta_mes, [60.0, 70.0, 60.0], md={"sample": "tile"}),
        lambda d: bp.grid_scan(
            d.detectors, d.theta_i, 30.0, 50.0, 2, d.theta_mes, 60.0, 100.0, 2, md={"sample": "tile"}
        ),
    ],
    ids=["scan", "list_scan", "grid_scan"],
)
def test_plans_of_bluesky_with_references(
    rig: Rig, devices: BlueskyDevices, tmp_path: Path, points: Any
) -> None:
    path = tmp_path / "scan.h5"
    engine = RunEngine({})
    engine(mv(devices.polarization, "p", devices.theta_i, 30.0))
    engine(with_references(devices, rig.config, points(devices)), NexusWriter(path, rig.config))
    scan = gonio.load(path)
    assert scan.finished
    assert scan.sample_name == "tile"
    assert set(scan.polarization.tolist()) == {"p"}
    n = {3: [60.0, 80.0, 100.0], 4: [60.0, 100.0, 60.0, 100.0]}
    expected = [60.0, 70.0, 60.0] if scan.theta_mes_deg[1] < 75.0 else n[len(scan.position)]
    np.testing.assert_allclose(scan.theta_mes_deg, expected, atol=0.011)
    assert parse_plan(scan.plan_text).n_positions == len(expected)
    assert np.all(np.isfinite(scan.r))
    with h5py.File(path) as file:
        assert file["entry/references/kind"].asstr()[...].tolist() == ["dark", "baseline"] * 2


def test_without_references_there_is_no_r_and_an_aborted_run_is_not_finished(
    rig: Rig, devices: BlueskyDevices, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    engine = RunEngine({})
    engine(mv(devices.polarization, "s", devices.theta_i, 30.0))
    with pytest.raises(RefusedError, match="blind zone"):
        engine(
            bp.list_scan(devices.detectors, devices.theta_mes, [60.0, 70.0, 5.0]),
            NexusWriter(path, rig.config),
        )
    scan = gonio.load(path)
    assert not scan.finished
    assert len(scan.position) == 2
    assert np.all(np.isnan(scan.r))
    assert np.all(np.isfinite(scan.raw_signal_v))


def test_what_cannot_be_written_is_said_before_anything_moves(
    rig: Rig, devices: BlueskyDevices, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    path.touch()
    engine = RunEngine({})
    with pytest.raises(StoreError, match="exists already and is never overwritten"):
        engine(bp.count(devices.detectors), NexusWriter(path, rig.config))
    with pytest.raises(RefusedError, match="polarization is not known"):
        engine(bp.count(devices.detectors))
    engine(mv(devices.polarization, "s"))
    with pytest.raises(StoreError, match=r"lack theta_i, theta_mes; read all of BlueskyDevices.detectors"):
        engine(bp.count([devices.spectrum]), NexusWriter(tmp_path / "b.h5", rig.config))
    with pytest.raises(RefusedError, match="polarization = 'x': give 's' or 'p'"):
        engine(mv(devices.polarization, "x"))
