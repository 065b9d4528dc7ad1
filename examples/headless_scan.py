"""Measure several samples one after the other, without a window, and fit each.

    python headless_scan.py plan.toml rig.toml sample-a sample-b

Without a rig file (give "-") the simulated ARTA is measured.  Each scan is a file of its own; one that was
interrupted goes on where it stopped, one that is complete is left alone.  A position where a device fails is
tried again five times, then left out; what happened is printed and stands in the file.
"""

from __future__ import annotations

import sys
from pathlib import Path

import gonio
from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan
from gonio.acquire.journal import journal_path
from gonio.bench_process import served
from gonio.errors import GonioError
from gonio.store.records import EventRecord

POLICY = FaultPolicy(retries=5, then="skip")


def show(snapshot: Snapshot) -> None:
    """Print a line per ten positions; `left_s` is instrument time."""
    if snapshot.state is State.RUNNING and snapshot.readings_done and snapshot.done % 10 == 0:
        print(
            f"\r{snapshot.done}/{snapshot.total} positions, {snapshot.left_s / 60:.0f} min left   ",
            end="",
            flush=True,
        )


def tell(record: object) -> None:
    """Print what went wrong; positions and references come by here as well, once they are on the disk."""
    if isinstance(record, EventRecord) and record.level != "info":
        print(f"\n{record.level}: {record.message}")


def main(plan_file: str, rig_file: str, *samples: str) -> int:
    """Scan and fit every sample; stop at the first error, with everything measured on disk."""
    plan = gonio.load_plan(Path(plan_file))
    config = gonio.load_rig(None if rig_file == "-" else Path(rig_file))
    try:
        with served(config) as rig, gonio.open_rig(rig) as connected:
            for sample in samples:
                path = Path(f"{sample}.h5")
                if journal_path(path).exists():
                    resume_scan(path, connected, on_snapshot=show, on_record=tell, policy=POLICY).run()
                elif not path.exists():
                    named = plan.model_copy(
                        update={"sample": plan.sample.model_copy(update={"name": sample})}
                    )
                    Runner(connected, named, path, on_snapshot=show, on_record=tell, policy=POLICY).run()
                fit = gonio.fit(gonio.load(path))
                fit.save(path)
                print(f"\n{sample}\n{fit.table()}")
    except GonioError as error:
        print(f"\n{error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
