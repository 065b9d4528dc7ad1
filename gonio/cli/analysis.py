"""`gonio fit`, `gonio facade`, `gonio report`: what is done with stored data."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from gonio.cli.budget import BudgetRequest, with_budget
from gonio.cli.fit_options import FitRequest
from gonio.cli.progress import progress_bar, readable_duration
from gonio.cli.sphere import SphereRequest, bring_in, sphere_text
from gonio.devices import FloatArray
from gonio.errors import ConfigError, StoreError
from gonio.fitting import FitResult, PolarizationChoice
from gonio.fitting import fit as fit_scan
from gonio.fitting.compare import compare_apertures
from gonio.store import Scan, load, read_spectrum


def fit(
    path: Path,
    request: FitRequest,
    *,
    compare: bool,
    sphere: SphereRequest | None = None,
    budget: BudgetRequest | None = None,
) -> int:
    """Fit a scan, store the result beside the data, print the table."""
    scan = load(path)
    if sphere is not None:
        bring_in(path, sphere)
    if compare:
        _compare(scan, request)
    start = time.perf_counter()
    result = fit_scan(scan, **request.arguments(scan))
    duration_s = time.perf_counter() - start
    text = None
    if budget is not None:
        result, text = with_budget(scan, result, budget)
    result.save(path)
    print(fit_table(scan, result))
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


def _compare(scan: Scan, request: FitRequest) -> None:
    if request.model != "published" or request.polarization == "shared_n2":
        raise ConfigError(
            "--compare shows what the paper's aperture models do to its own lobe; leave --model and "
            "--polarization shared_n2 out"
        )
    polarization: PolarizationChoice = request.polarization  # type: ignore[assignment]
    found = compare_apertures(scan, polarization=polarization, truth=_columns(scan.path, "simulated_truth"))
    print(found.table() + "\n")


def facade(scene_file: Path, output: Path, *, rel_tol: float, seed: int, threads: int | None) -> int:
    """Simulate a street scene and store the irradiance."""
    if not 0 < rel_tol < 1:
        raise ConfigError(
            f"--rel-tol {rel_tol:g} is not between 0 and 1; 0.01 asks for a standard error of 1 %"
        )
    if output.exists():
        raise StoreError(f"{output} exists already; choose another name with -o, or remove it")
    from gonio.facade import load_scene, simulate

    scene = load_scene(scene_file)
    start = time.perf_counter()
    with progress_bar("facade", 1.0) as bar:
        irradiance = simulate(scene, rel_tol=rel_tol, seed=seed, threads=threads, progress=bar.update)
    irradiance.save(output)
    print(irradiance.table())
    print(f"{readable_duration(time.perf_counter() - start)}; stored in {output}")
    return 0


def report(file: Path, output: Path | None, facade_file: Path | None) -> int:
    """Write figures and one HTML page."""
    from gonio.report import write_any_report

    folder = output if output is not None else file.with_name(file.stem + "-report")
    page = write_any_report(file, folder, facade_h5=facade_file)
    print(f"report: {page}", file=sys.stderr)
    return 0
