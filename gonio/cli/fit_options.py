"""How shall `gonio fit` fit?  The options of the command line, and what they mean to `gonio.fit`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.errors import ConfigError

if TYPE_CHECKING:  # `gonio --help` need not load them
    from gonio.devices import FloatArray
    from gonio.store import Scan

_FORMS = ("free", "constant", "cauchy", "cauchy3", "sellmeier")


@dataclass(frozen=True, slots=True)
class FitRequest:
    """What the options ask for, as they were written."""

    aperture: str
    polarization: str
    model: str
    n2: str
    loss: str
    intervals: str
    detector_gain_u: float
    detector_offset_u: float

    def arguments(self, scan: Scan) -> dict[str, Any]:
        """Return the keyword arguments of `gonio.fit`; an index is read from its file here."""
        named = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "n2"}
        return named | {"n2": _index(self.n2, scan.wavelength_nm)}

    @property
    def title(self) -> str:
        """What was fitted, for the last line of the output."""
        parts = [f"aperture '{self.aperture}'", f"polarization '{self.polarization}'"]
        parts += [f"model '{self.model}'"] if self.model != "published" else []
        parts += [f"n2 '{self.n2}'"] if self.n2 != "free" else []
        parts += [f"loss '{self.loss}'"] if self.loss != "squares" else []
        return ", ".join(parts)


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is fitted and how."""
    parser.add_argument(
        "--aperture",
        choices=["exact", "eq22", "point", "published"],
        default="exact",
        help="the exact integral (default), or an approximation of the paper, for comparison",
    )
    parser.add_argument(
        "--polarization",
        choices=["joint", "s", "p", "shared_n2"],
        default="joint",
        help="S and P as one surface (default), one of them alone, or each for itself with a common n2",
    )
    parser.add_argument(
        "--model",
        choices=["published", "phong", "reciprocal", "lambert", "ggx", "coupled"],
        default="published",
        help="the scattering model; default the published four-parameter lobe",
    )
    parser.add_argument(
        "--n2",
        default="free",
        metavar="WHAT",
        help="the index: 'free' at every wavelength (default); 'constant', 'cauchy', 'cauchy3' or "
        "'sellmeier' for all together; a number; or a CSV file with the columns wavelength_nm and n2",
    )
    parser.add_argument(
        "--loss",
        choices=["squares", "huber", "tukey"],
        default="squares",
        help="how much a reading far from the fit counts; huber and tukey bear outliers",
    )
    parser.add_argument(
        "--intervals",
        choices=["wald", "profile", "nlparci"],
        default="wald",
        help="95 %% intervals: Wald's with open ends (default), by profile likelihood, or exactly MATLAB's",
    )
    for what, unit in (("gain", "relative"), ("offset", "in r")):
        parser.add_argument(
            f"--detector-{what}-u",
            type=float,
            default=0.0,
            metavar="U",
            help=f"standard uncertainty of each detector's {what} ({unit}); it is then fitted with the rest",
        )


def fit_request(options: argparse.Namespace) -> FitRequest:
    """Return what the options ask for."""
    return FitRequest(**{name: getattr(options, name) for name in FitRequest.__dataclass_fields__})


def _index(text: str, wavelength_nm: FloatArray) -> str | float | FloatArray:
    """Return the argument `n2` of `gonio.fit`."""
    if text in _FORMS:
        return text
    try:
        return float(text)
    except ValueError:
        return _from_table(Path(text), wavelength_nm)


def _from_table(path: Path, wavelength_nm: FloatArray) -> FloatArray:
    """Return n2 at the scan's wavelengths, interpolated linearly in a CSV file's columns."""
    forms = ", ".join(repr(form) for form in _FORMS)
    if not path.is_file():
        raise ConfigError(f"--n2 {path}: is neither a number, nor one of {forms}, nor a file; correct it")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--n2 {path}: cannot be read ({error}); give a CSV file") from None
    rows = [(number, line.split(",")) for number, line in enumerate(lines, 1) if _holds_data(line)]
    header = [name.strip() for name in rows[0][1]] if rows else []
    if header[:2] != ["wavelength_nm", "n2"]:
        raise ConfigError(
            f"--n2 {path}: the first line must be 'wavelength_nm,n2', and lines with a number of each follow"
        )
    table = np.empty((len(rows) - 1, 2))
    for k, (number, fields) in enumerate(rows[1:]):
        try:
            table[k] = [float(fields[0]), float(fields[1])]
        except (ValueError, IndexError):
            raise ConfigError(
                f"--n2 {path}, line {number}: {','.join(fields)!r} are not two numbers; correct it"
            ) from None
    if len(table) == 0 or not np.all(np.isfinite(table)) or np.any(np.diff(table[:, 0]) <= 0.0):
        raise ConfigError(f"--n2 {path}: the wavelengths must be numbers that ascend; sort the lines")
    low, high = float(table[0, 0]), float(table[-1, 0])
    if wavelength_nm.min() < low or wavelength_nm.max() > high:
        raise ConfigError(
            f"--n2 {path}: holds {low:g}...{high:g} nm, but the scan has {wavelength_nm.min():g}..."
            f"{wavelength_nm.max():g} nm; give a table that covers it"
        )
    return np.interp(wavelength_nm, table[:, 0], table[:, 1])


def _holds_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")
