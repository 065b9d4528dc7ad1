"""Look where a sample's lobe is, then measure it there in small steps.

    python coarse_then_fine.py rig.toml sample

The first scan is coarse and quick.  The second puts its positions where r changes: nine degrees about the
maximum of the first, in steps of one degree.  Both are ordinary scans: each can be interrupted and resumed.
Without a rig file (give "-") the simulated ARTA is measured.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import gonio
from gonio.acquire import FaultPolicy, Runner
from gonio.bench_process import served
from gonio.errors import GonioError
from gonio.plan import parse_plan

COARSE = """
title = "Where is the lobe?"
polarization = ["s"]
[[wavelengths]]
values_nm = [550.0]
[[sweeps]]
theta_i_deg = 45.0
theta_mes_deg = { start = 20.0, stop = 130.0, step = 10.0 }
"""
FINE = """
title = "The lobe in small steps"
[[wavelengths]]
values_nm = [450.0, 550.0, 650.0, 750.0]
[[sweeps]]
theta_i_deg = 45.0
theta_mes_deg = {{ start = {start:.1f}, stop = {stop:.1f}, step = 1.0 }}
[references]
every_positions = 20
"""


def main(rig_file: str, sample: str) -> int:
    """Measure both scans; return 1 with a message if something stands in the way."""
    config = gonio.load_rig(None if rig_file == "-" else Path(rig_file))
    policy = FaultPolicy(retries=3, then="skip")
    try:
        with served(config) as rig, gonio.open_rig(rig) as connected:
            coarse = Runner(connected, parse_plan(COARSE), f"{sample}-coarse.h5", policy=policy).run()
            scan = gonio.load(coarse)
            peak_deg = float(scan.theta_mes_deg[np.nanargmax(scan.r[:, 0])])
            print(f"the lobe is near theta_mes = {peak_deg:.1f} deg")
            plan = parse_plan(FINE.format(start=round(peak_deg) - 9.0, stop=round(peak_deg) + 9.0))
            fine = gonio.load(Runner(connected, plan, f"{sample}-fine.h5", policy=policy).run())
    except GonioError as error:
        print(error, file=sys.stderr)
        return 1
    best = np.nanargmax(fine.r[:, 1])
    print(f"maximum at theta_mes = {fine.theta_mes_deg[best]:.1f} deg: r = {fine.r[best, 1]:.4f}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
