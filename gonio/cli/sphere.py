"""`gonio fit --sphere ...`: bring an integrating sphere's spectrum in, and print the fit beside it."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.errors import ConfigError, StoreError

if TYPE_CHECKING:  # `gonio --help` need not load them
    from gonio.fitting import FitResult
    from gonio.sphere import Sphere
    from gonio.store import Scan


@dataclass(frozen=True, slots=True)
class SphereRequest:
    """What the options ask for, as they were written."""

    path: Path
    uncertainty: str
    geometry: str | None
    reads: str | None
    column: str | None
    only_nm: str | None


def add_sphere_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gonio fit` that have to do with the sphere."""
    group = parser.add_argument_group("the integrating sphere of the same sample")
    group.add_argument(
        "--sphere",
        type=Path,
        metavar="FILE",
        help="its spectrum: CSV, PerkinElmer .asc or .sp; stored beside the scan, and compared with the fit",
    )
    group.add_argument(
        "--sphere-u",
        metavar="TEXT",
        help="its uncertainty, such as '1 %% relative, k=2', '0.005 absolute, 95 %%' or 'column NAME, k=1'",
    )
    group.add_argument(
        "--sphere-geometry",
        metavar="TEXT",
        help="8:di (specular beam included, compared with k_g; taken if not stated) or 8:de (excluded, k_d)",
    )
    group.add_argument(
        "--sphere-reads",
        choices=["%R", "R"],
        help="reflectance in percent, or as a fraction, where the file does not say",
    )
    group.add_argument("--sphere-column", metavar="NAME", help="which column of a CSV file")
    group.add_argument(
        "--sphere-nm", metavar="LOW-HIGH", help="use these wavelengths alone, such as 300-1500"
    )


def sphere_request(options: argparse.Namespace) -> SphereRequest | None:
    """Return what the options ask for; None without ``--sphere``.

    `ConfigError` if another option of the sphere is there without it, or it without its uncertainty.
    """
    others = {
        "--sphere-u": options.sphere_u,
        "--sphere-geometry": options.sphere_geometry,
        "--sphere-reads": options.sphere_reads,
        "--sphere-column": options.sphere_column,
        "--sphere-nm": options.sphere_nm,
    }
    if options.sphere is None:
        given = [name for name, value in others.items() if value is not None]
        if given:
            raise ConfigError(f"{given[0]} is said of no file; give it with --sphere FILE")
        return None
    return SphereRequest(
        options.sphere,
        options.sphere_u or "",
        options.sphere_geometry,
        options.sphere_reads,
        options.sphere_column,
        options.sphere_nm,
    )


def bring_in(scan_file: Path, request: SphereRequest) -> Sphere:
    """Read the sphere's file, store it beside the scan, and return it; the scan is as before if refused."""
    from gonio.sphere import (
        Geometry,
        attach_sphere,
        parse_geometry,
        parse_uncertainty,
        read_sphere_file,
        sphere_of,
    )

    geometry = Geometry(stated=False) if request.geometry is None else parse_geometry(request.geometry)
    file = read_sphere_file(
        request.path, reads=request.reads, column=request.column, only_nm=_range(request.only_nm)
    )
    if not request.uncertainty.strip():
        raise ConfigError(
            f"--sphere {request.path}: its uncertainty is not stated; a comparison without one says nothing. "
            "Give --sphere-u 'NUMBER relative|absolute, k=...', such as '1 % relative, k=2'"
        )
    sphere = sphere_of(file, parse_uncertainty(request.uncertainty, file.reflectance), geometry)
    attach_sphere(scan_file, sphere)
    return sphere


def sphere_text(scan: Scan, result: FitResult) -> str:
    """Return the comparison with the sphere stored beside the scan; empty if there is none."""
    from gonio.sphere import compare, read_sphere

    try:
        sphere = read_sphere(scan.path)
    except StoreError as error:
        return "" if "holds no /entry/sphere" in str(error) else f"the sphere is not compared: {error}"
    return compare(result, sphere, detector_names=scan.detector_names).table()


def _range(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(?:-|:|\.\.\.?|to)\s*(\d+(?:\.\d+)?)\s*(?:nm)?\s*", text)
    if found is None:
        raise ConfigError(f"--sphere-nm '{text}' is no range; write it like 300-1500")
    return float(found.group(1)), float(found.group(2))
