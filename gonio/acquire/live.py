"""What has a scan measured so far?  Asked by any process, while another writes it.

HDF5 promises nothing to a reader of a file that another process is writing, and locks it.  The journal does:
it is only appended to, and each record has its checksum.  So the positions so far are read from there, and
corrected in memory as the writer does, without touching the `.h5`, its lock, or the scan.
"""

from __future__ import annotations

from pathlib import Path

from gonio.acquire.journal import journal_path, read_records
from gonio.acquire.session import add_records
from gonio.errors import StoreError
from gonio.plan.model import parse_plan
from gonio.store.file import ScanFile
from gonio.store.read import scan_in
from gonio.store.scan import Scan

_LARGEST_BYTES = 2_000_000_000


def measured_so_far(path: Path) -> Scan | None:
    """Return the positions in the journal beside `path`; None if it has just ended.

    Raises
    ------
    StoreError
        The journal is none, or no position has been measured yet.
    """
    journal = journal_path(path)
    try:
        size = journal.stat().st_size
        if size > _LARGEST_BYTES:
            raise StoreError(
                f"{path}: the scan is unfinished, and its journal of {size / 1e9:.1f} GB too large to be "
                "read meanwhile; wait until it has ended"
            )
        header, records = read_records(journal)
    except FileNotFoundError:
        return None
    try:
        plan = parse_plan(header.plan_text, source=f"the plan in {journal.name}")
        file = ScanFile(path, header, plan, "memory")
        try:
            add_records(file, records)
            file.flush()  # sizes are held against what is in the file, not in a cache
            return scan_in(path, file.hdf5)
        finally:
            file.close()
    except (ValueError, TypeError, LookupError) as error:
        raise StoreError(
            f"{journal}: holds records that contradict each other ({error}); restore it from a copy"
        ) from error
