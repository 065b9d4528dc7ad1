"""`gonio fit`, `gonio report`: what is done with stored data."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from gonio.cli.budget import BudgetRequest, with_budget
from gonio.cli.fit_options import FitRequest
from gonio.cli.progress import readable_duration
from gonio.cli.side_by_side import apertures_text, identifiability_text, instrument_text, models_text
from gonio.cli.sphere import SphereRequest, bring_in, sphere_text
from gonio.devices import FloatArray
from gonio.errors import StoreError
from gonio.fitting import FitResult
from gonio.fitting import fit as fit_scan
from gonio.store import Scan, load, read_spectrum


def fit(
    path: Path,
    request: FitRequest,
    *,
    compare: bool,
    models: bool = False,
    sphere: SphereRequest | None = None,
    budget: BudgetRequest | None = None,
) -> int:
    """Fit a scan, store the result beside the data, print the table."""
    scan = load(path)
    if sphere is not None:
        bring_in(path, sphere)
    if compare:
        print(apertures_text(scan, request, _columns(path, "simulated_truth")) + "\n")
    if models:
        print(models_text(scan, request) + "\n")
    start = time.perf_counter()
    result = fit_scan(scan, **request.arguments(scan))
    duration_s = time.perf_counter() - start
    text = None
    if budget is not None:
        result, text = with_budget(scan, result, budget)
    result.save(path)
    print(fit_table(scan, result))
    for said in (identifiability_text(result), instrument_text(result)):
        if said:
            print(f"\n{said}")
    against = sphere_text(scan, result)
    if against:
        print(f"\n{against}\n")
    if text is not None:
        print(f"\n{text}\n")
    print(
        f"{len(result.wavelength_nm)} wavelengths, {len(result.theta_i_deg)} positions, {request.title}: "
        f"{readable_duration(duration_s)}; stored in {path}"
    )
    return 0


def fit_table(scan: Scan, result: FitResult) -> str:
    """Return the printed table of a fit, beside the sphere and (on the simulated bench) the truth, where
    stored.
    """
    return result.table(
        truth=_columns(scan.path, "simulated_truth"),
        sphere=_columns(scan.path, "sphere"),
        detector_names=scan.detector_names,
    )


def _columns(path: Path, group: str) -> dict[str, FloatArray] | None:
    try:
        return read_spectrum(path, group)
    except StoreError:
        return None


def report(file: Path, output: Path | None, facade_file: Path | None) -> int:
    """Write figures and one HTML page."""
    from gonio.report import write_any_report

    folder = output if output is not None else file.with_name(file.stem + "-report")
    page = write_any_report(file, folder, facade_h5=facade_file)
    print(f"report: {page}", file=sys.stderr)
    return 0
