"""`gonio fit`, `gonio facade`, `gonio report`: what is done with stored data."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from gonio.cli.progress import progress_bar, readable_duration
from gonio.devices import FloatArray
from gonio.errors import ConfigError, StoreError
from gonio.fitting import ApertureModel, FitResult, PolarizationChoice
from gonio.fitting import fit as fit_scan
from gonio.store import Scan, load, read_spectrum

COMPARED: tuple[ApertureModel, ...] = ("point", "eq22", "published", "exact")


def fit(path: Path, aperture: ApertureModel, polarization: PolarizationChoice, *, compare: bool) -> int:
    """Fit a scan, store the result beside the data, print the table."""
    scan = load(path)
    if compare:
        _compare(scan, polarization)
    start = time.perf_counter()
    result = fit_scan(scan, aperture=aperture, polarization=polarization)
    duration_s = time.perf_counter() - start
    result.save(path)
    print(fit_table(scan, result))
    print(
        f"{len(result.wavelength_nm)} wavelengths, {scan.r.shape[0]} positions, aperture '{aperture}', "
        f"polarization '{polarization}': {readable_duration(duration_s)}; stored in {path}"
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


def _compare(scan: Scan, polarization: PolarizationChoice) -> None:
    print(
        "aperture model       rho_d     rho_s     alpha        n2    k_d(8)    k_s(8)    residual      time"
    )
    for aperture in COMPARED:
        start = time.perf_counter()
        result = fit_scan(scan, aperture=aperture, polarization=polarization)
        duration_s = time.perf_counter() - start
        k = result.hemispherical(8.0)
        medians = [*np.nanmedian(result.value, axis=0), np.nanmedian(k.k_d.value), np.nanmedian(k.k_s.value)]
        rms = float(np.nanmedian(result.rms))
        print(
            f"{aperture:<16}"
            + "".join(f"{value:>10.4g}" for value in medians)
            + f"{rms:>12.2e}{duration_s:>8.2f} s"
        )
    truth = _columns(scan.path, "simulated_truth")
    if truth is not None:
        known = [
            np.median(np.interp(scan.wavelength_nm, truth["wavelength_nm"], truth[name]))
            for name in ("rho_d", "rho_s", "alpha", "n2", "k_d", "k_s")
        ]
        print(f"{'true':<16}" + "".join(f"{value:>10.4g}" for value in known))
    print("Medians over the wavelengths; the residual is the root mean square of data minus fit, in r.\n")


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
