"""Measure with bluesky's RunEngine and keep gonio's file: an axis in small steps, with references around it.

    python bluesky_session.py rig.toml sample.h5

Needs bluesky (`pip install bluesky`).  Without a rig file (give "-") the simulated ARTA is measured.  The
RunEngine brings its own pauses, metadata and callbacks; `gonio scan` is the one that survives a power cut.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gonio
from gonio.acquire.bluesky_devices import bluesky_devices
from gonio.acquire.bluesky_plans import with_references
from gonio.acquire.documents import NexusWriter
from gonio.bench_process import served
from gonio.plan import parse_plan

WAVELENGTHS = """
[[wavelengths]]
values_nm = [450.0, 550.0, 650.0]
[[sweeps]]                 # where to measure is bluesky's business here
theta_i_deg = 45.0
theta_mes_deg = [90.0]
[references]
averages = 4
"""


def show(name: str, document: dict[str, Any]) -> None:
    """Print the angles of each event."""
    if name == "event":
        data = document["data"]
        print(
            f"{data['spectrum_light']:<8}theta_i {data['theta_i']:7.2f}  theta_mes {data['theta_mes']:7.2f}"
        )


def main(rig_file: str, output: str) -> int:
    """Scan the detector arm through the specular direction, in S."""
    import bluesky.plans as bp
    from bluesky import RunEngine
    from bluesky.plan_stubs import mv

    config = gonio.load_rig(None if rig_file == "-" else Path(rig_file))
    with served(config) as reachable, gonio.open_rig(reachable) as rig:
        devices = bluesky_devices(rig, parse_plan(WAVELENGTHS))
        engine = RunEngine({})
        engine.subscribe(show)
        engine(mv(devices.polarization, "s", devices.theta_i, 45.0))
        points = bp.scan(
            devices.detectors, devices.theta_mes, 80.0, 100.0, 5, md={"sample": "tile", "title": "The lobe"}
        )
        engine(with_references(devices, rig.config, points), NexusWriter(output, rig.config))
    scan = gonio.load(output)
    print(scan.to_xarray().r.sel(wavelength=550.0).values)
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
