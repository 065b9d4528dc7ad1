"""The sphere's spectrum beside the scan: ``/entry/sphere`` of a scan file.

Columns ``k_g`` (specular beam included) or ``k_d`` (excluded), reflectance as a fraction, and ``k_g_u`` or
``k_d_u``, its standard uncertainty, coverage factor 1.  Attributes say how the uncertainty was stated, in
which geometry was measured, and where it comes from: file name, SHA-256, header.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigError, StoreError
from gonio.sphere.file import SphereFile
from gonio.sphere.geometry import Geometry, parse_geometry
from gonio.sphere.uncertainty import SphereUncertainty
from gonio.store.spectra import attach_spectrum, read_facts, read_spectrum

FloatArray = NDArray[np.float64]

GROUP = "sphere"
NOT_STATED = "no uncertainty stated"
FROM_COLUMN = "as its file says (column {name}, k = 1)"
_HEADER = (
    "title", "date", "time", "analyst", "description", "instrument", "serial_number", "software", "slit_nm",
    "accessory", "grating_change_nm", "lamp_change_nm", "detector_change_nm", "depolarizer", "attenuators",
    "polarizer_deg",
)  # fmt: skip
FACTS = (
    "source_file", "source_format", "source_sha256", "source_ordinate", "remarks", "description",
    "uncertainty", "geometry", "geometry_stated", "detector_change_nm",
    *(f"header_{name}" for name in _HEADER),
)  # fmt: skip
"""Attributes that are read back."""


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """What an integrating sphere says of the sample.

    Attributes
    ----------
    wavelength_nm, value, standard : (k,)
        Ascending; reflectance as a fraction, and its standard uncertainty, NaN where none is stated.
    uncertainty
        How the uncertainty was stated, in words.
    detector_change_nm
        Where the sphere's own spectrometer changed its detector, as far as known.
    facts
        What is known of its origin, by name.
    """

    wavelength_nm: FloatArray
    value: FloatArray
    standard: FloatArray
    uncertainty: str = NOT_STATED
    geometry: Geometry = field(default_factory=lambda: Geometry(stated=False))
    detector_change_nm: tuple[float, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The file it comes from, for people."""
        return self.facts.get("source_file", "the sphere's spectrum")


def sphere_of(file: SphereFile, uncertainty: SphereUncertainty, geometry: Geometry) -> Sphere:
    """Return a file's spectrum with what the user states of it; `ConfigError` if the two do not fit."""
    facts = {f"header_{name}": text for name, text in file.facts.items()} | {
        "source_file": file.path.name.encode("utf-8", "replace").decode(),
        "source_format": file.format,
        "source_sha256": file.sha256,
        "source_ordinate": file.ordinate,
    }
    if file.remarks:
        facts["remarks"] = "; ".join(file.remarks)
    return Sphere(
        wavelength_nm=file.wavelength_nm,
        value=file.reflectance,
        standard=uncertainty.standard(file.reflectance, file.columns, file.factor),
        uncertainty=uncertainty.describe(),
        geometry=geometry,
        detector_change_nm=file.detector_change_nm,
        facts=facts,
    )


def attach_sphere(path: str | os.PathLike[str], sphere: Sphere) -> None:
    """Store a sphere's spectrum in a scan file, in place of what was there; `StoreError` if it cannot be."""
    name = sphere.geometry.coefficient
    columns = {"wavelength_nm": sphere.wavelength_nm, name: sphere.value, f"{name}_u": sphere.standard}
    facts: dict[str, str | float] = {
        **sphere.facts,
        "quantity": "reflectance, as a fraction",
        "uncertainty": sphere.uncertainty,
        "coverage_factor": 1.0,  # of the column; how it was stated stands in `uncertainty`
        "geometry": sphere.geometry.text,
        "geometry_stated": "yes" if sphere.geometry.stated else "no",
        "theta_i_deg": sphere.geometry.theta_i_deg,
        "specular": sphere.geometry.specular,
    }
    if sphere.detector_change_nm:
        facts["detector_change_nm"] = " ".join(f"{w:.10g}" for w in sphere.detector_change_nm)
    attach_spectrum(path, GROUP, columns, facts)


def read_sphere(path: str | os.PathLike[str]) -> Sphere:
    """Return the sphere's spectrum stored in a scan file, of this version or an older one.

    `StoreError` if there is none, or none of a reflectance.
    """
    return sphere_of_columns(read_spectrum(path, GROUP), read_facts(path, GROUP, FACTS), Path(path))


def sphere_of_columns(
    columns: Mapping[str, FloatArray], facts: Mapping[str, str] | None = None, path: Path | None = None
) -> Sphere:
    """Return the sphere's spectrum of columns as they are stored: ``k_g`` or ``k_d``, with ``_u`` if known.

    `path` names the scan file in messages.  `StoreError` if the columns are no spectrum of a sphere.
    """
    facts = dict(facts or {})
    where = f"{path}: /entry/{GROUP}" if path is not None else "the sphere's spectrum"
    geometry = _geometry(facts, columns, where)
    name = geometry.coefficient
    if name not in columns or "wavelength_nm" not in columns:
        raise StoreError(
            f"{where} holds {', '.join(columns)}, and not {name} over wavelength_nm; bring the spectrum in "
            "again with gonio fit --sphere"
        )
    wavelength_nm, value = columns["wavelength_nm"], columns[name]
    standard = columns.get(f"{name}_u")
    known = np.isfinite(wavelength_nm) & np.isfinite(value)
    if standard is not None and np.any(standard < 0.0):
        raise StoreError(f"{where}/{name}_u holds negative uncertainties; bring the spectrum in again")
    order = np.argsort(wavelength_nm[known], kind="stable")
    if np.any(np.diff(wavelength_nm[known][order]) == 0.0):
        raise StoreError(f"{where} has a wavelength twice; bring the spectrum in again")
    said = FROM_COLUMN.format(name=f"{name}_u") if standard is not None else NOT_STATED
    return Sphere(
        wavelength_nm=wavelength_nm[known][order],
        value=value[known][order],
        standard=np.full(order.shape, np.nan) if standard is None else standard[known][order],
        uncertainty=facts.pop("uncertainty", said),
        geometry=geometry,
        detector_change_nm=_changes(facts.pop("detector_change_nm", ""), where),
        facts={k: v for k, v in facts.items() if k not in ("geometry", "geometry_stated")},
    )


def _geometry(facts: Mapping[str, str], columns: Mapping[str, FloatArray], where: str) -> Geometry:
    if "geometry" not in facts:  # a file of before there was one to state
        return Geometry(
            specular="included" if "k_g" in columns or "k_d" not in columns else "excluded", stated=False
        )
    try:
        found = parse_geometry(facts["geometry"])
    except ConfigError as error:
        raise StoreError(f"{where}: {error}") from None
    return Geometry(found.theta_i_deg, found.specular, facts.get("geometry_stated", "yes") == "yes")


def _changes(text: str, where: str) -> tuple[float, ...]:
    try:
        found = tuple(float(word) for word in text.split())
    except ValueError:
        found = (np.nan,)
    if not np.all(np.isfinite(found)):
        raise StoreError(
            f"{where}: detector_change_nm = '{text[:60]}' is no list of wavelengths; bring it in again"
        )
    return tuple(sorted(found))
