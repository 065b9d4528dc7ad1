"""Read the spectrum of an integrating sphere from a file of any known format.

The format is told by the content, not by the name: ``PEPE`` begins a PerkinElmer .sp file, a first line with
``PEDS`` a PerkinElmer .asc file; anything else is read as CSV.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigError, StoreError
from gonio.sphere.raw import read_bytes

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SphereFile:
    """What a file holds.

    Attributes
    ----------
    wavelength_nm, reflectance : (k,)
        Ascending, nm; reflectance as a fraction.
    ordinate
        Label of the ordinate, as in the file.
    columns
        Further columns of a CSV file by name, (k,) each, in the unit of the file; NaN where a cell is empty.
    factor
        By which the file's ordinate was multiplied: 0.01 for percent.
    facts
        What the header says of instrument, date, accessory, slit, ... ; only what is there.
    detector_change_nm
        Where the sphere's spectrometer changed its detector, as its header says.
    remarks
        What a reader should know of the reading.
    """

    path: Path
    format: str
    sha256: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    ordinate: str
    factor: float
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    detector_change_nm: tuple[float, ...] = ()
    remarks: tuple[str, ...] = ()


def read_sphere_file(
    path: str | os.PathLike[str],
    *,
    reads: str | None = None,
    column: str | None = None,
    only_nm: tuple[float, float] | None = None,
) -> SphereFile:
    """Return the spectrum in a CSV, PerkinElmer .asc or PerkinElmer .sp file.

    Parameters
    ----------
    reads
        ``"%R"`` or ``"R"`` where the file leaves open what its values are; see `gonio.sphere.ordinate`.
    column
        Name of the column of a CSV file that has several.
    only_nm
        Use the wavelengths between these two alone.

    Raises
    ------
    StoreError
        The file cannot be read, is none of these formats, is damaged, or holds no reflectance spectrum; with
        the line or field.
    ConfigError
        An option makes no sense.
    """
    from gonio.sphere import asc_file, csv_file, sp_file

    path = Path(path)
    if only_nm is not None and not (0.0 < only_nm[0] < only_nm[1] < np.inf):
        raise ConfigError(
            f"{only_nm[0]:g}-{only_nm[1]:g} nm is no range of wavelengths; give the shorter one first"
        )
    data = read_bytes(path)
    digest = hashlib.sha256(data).hexdigest()
    if data.startswith(sp_file.MAGIC):
        known, read = "PerkinElmer .sp", sp_file.read_sp
    elif asc_file.is_asc(data):
        known, read = "PerkinElmer .asc", asc_file.read_asc
    else:
        suffix = path.suffix.lower()
        if suffix in (".sp", ".asc"):
            wanted = "PEPE" if suffix == ".sp" else "a line with PEDS"
            raise StoreError(
                f"{path}: begins with {data[:12]!r}, not with {wanted} as a PerkinElmer {suffix} file does; "
                "export it again, or as CSV"
            )
        return csv_file.read_csv(path, data, digest, reads=reads, column=column, only_nm=only_nm)
    if column is not None:
        raise ConfigError(f"{path}: is a {known} file, which has no named columns; leave '{column}' out")
    return read(path, data, digest, reads=reads, only_nm=only_nm)
