"""What does each `[materials.NAME]` of a scene file mean in each band?"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import GonioError, SceneError
from gonio.facade.bands import Band, power_shares
from gonio.facade.optics import FloatArray, Optics
from gonio.facade.scene_file import DEFAULT_BAND_NM, MaterialTable, SpectrumTable
from gonio.spectral import LEAST_COVERAGE, WeightName, band_weights

_ONE_SIDED = {
    "s": "S light alone; its rho_s and n2 stand for P light too",
    "p": "P light alone; its rho_s and n2 stand for S light too",
}


def read_materials(
    tables: Mapping[str, MaterialTable], spectrum: SpectrumTable | None, folder: Path, source: str
) -> tuple[dict[str, Optics], tuple[Band, ...], list[str]]:
    """Return the materials averaged over all bands, the bands if there are several, and notes on both.

    The average over all bands weighs each by its share of the light, so that for what is linear in the
    coefficients it equals the sum over the bands.
    """
    limits = [DEFAULT_BAND_NM] if spectrum is None else list(spectrum.limits_nm)
    weight: WeightName = "flat" if spectrum is None else spectrum.weight
    notes: list[str] = []
    dni, dhi = _shares(limits, spectrum, source)
    if len(limits) > 1:
        notes.append(_bands_text(limits, dni, dhi, spectrum, weight))
    average: dict[str, Optics] = {}
    each: list[dict[str, Optics]] = [{} for _ in limits]
    # the two kinds of light have one set of materials: their mean share weighs
    parts = 0.5 * (dni + dhi)
    for name, table in tables.items():
        if table.scan is None:
            average[name] = _given(table)
            for band in each:
                band[name] = average[name]
            continue
        own = limits
        if "band_nm" in table.model_fields_set:
            if spectrum is not None:
                raise SceneError(
                    f"{source}: materials.{name}.band_nm is given, and so is [spectrum], which is for all "
                    "materials; remove one of them"
                )
            own = [table.band_nm]
        found, whole, sentence = _measured(name, table, own, weight, parts, folder, source)
        notes.append(sentence)
        average[name] = whole
        for band, optics in zip(each, found, strict=True):
            band[name] = optics
    if len(limits) == 1:
        return average, (), notes
    bands = tuple(
        Band(low, high, float(a), float(b), materials)
        for (low, high), a, b, materials in zip(limits, dni, dhi, each, strict=True)
    )
    return average, bands, notes


def _given(table: MaterialTable) -> Optics:
    if table.albedo is not None:
        return Optics(table.albedo)
    if table.k_d is not None:
        assert table.k_s is not None
        return Optics.two_coefficients(table.k_d, table.k_s)
    assert table.rho_d is not None
    assert table.rho_s is not None
    assert table.alpha is not None
    assert table.n2 is not None
    return Optics(table.rho_d, table.rho_s, table.alpha, table.n2)


def _measured(
    name: str,
    table: MaterialTable,
    limits: list[tuple[float, float]],
    weight: WeightName,
    parts: FloatArray,
    folder: Path,
    source: str,
) -> tuple[list[Optics], Optics, str]:
    """Return the material of a stored fit in each band and over all, and a sentence on where it is from."""
    from gonio.fitting import load_fit
    from gonio.material import Material

    assert table.scan is not None
    where = f"{source}: materials.{name}.scan = '{table.scan}'"
    scan = folder / table.scan
    if not scan.is_file():
        raise SceneError(
            f"{where}: there is no such file beside the scene; measure and fit it first, or correct the name"
        )
    try:
        fit = load_fit(scan, table.fit)
        material = Material.from_fit(fit)
        shares, covered = zip(*(_band(material, low, high, weight) for low, high in limits), strict=True)
        found = [_optics(material, share) for share in shares]
        whole = found[0]
        if len(found) > 1:
            whole = _optics(material, np.asarray(parts @ np.stack(shares)))
    except GonioError as error:
        raise SceneError(f"{where}: {error}") from None
    digest = hashlib.sha256(scan.read_bytes()).hexdigest()[:12]
    sentence = [
        f"material '{name}': {scan.name} (sha256 {digest}), fit {fit.aperture}_{fit.polarization}, "
        f"{limits[0][0]:g}-{limits[-1][1]:g} nm weighed {weight}: rho_d {whole.rho_d:.4g}, "
        f"rho_s {whole.rho_s:.4g}, alpha {whole.alpha:.4g}, n2 {whole.n2:.4g}"
    ]
    if fit.polarization in _ONE_SIDED:
        sentence.append(f"fitted to {_ONE_SIDED[fit.polarization]}")
    least = min(covered)
    if least < LEAST_COVERAGE:
        low, high = limits[covered.index(least)]
        sentence.append(
            f"its wavelengths cover {100.0 * least:.0f} % of the band {low:g}-{high:g} nm, "
            "whose average is of that part"
        )
    return found, whole, "; ".join(sentence)


def _band(material: Any, low: float, high: float, weight: WeightName) -> tuple[FloatArray, float]:
    """Return the share of each wavelength in a band, (m,), and the covered part of the band's weight."""
    at = material.wavelength_nm
    if at.size == 1 and low <= float(at[0]) <= high:
        return np.ones(1), 0.0  # a laser, say: all there is
    weights = band_weights(at, low, high, weight, least_coverage=1e-3)
    return weights.share, weights.covered


def _optics(material: Any, share: FloatArray) -> Optics:
    return Optics.from_material(material.averaged(share, material.name))


# -- shares


def _shares(
    limits: list[tuple[float, float]], spectrum: SpectrumTable | None, source: str
) -> tuple[FloatArray, FloatArray]:
    """Return the parts of DNI and DHI in each band; exactly 1 for a single one."""
    found: list[FloatArray] = []
    for key in ("dni_share", "dhi_share"):
        given = getattr(spectrum, key, None)
        if given is not None:
            found.append(np.asarray(given, np.float64) / np.sum(given))  # they were checked to add up to 1
            continue
        try:
            found.append(power_shares(limits))
        except SceneError as error:
            raise SceneError(f"{source}: {error}") from None
    return found[0], found[1]


def _bands_text(
    limits: list[tuple[float, float]],
    dni: FloatArray,
    dhi: FloatArray,
    spectrum: SpectrumTable | None,
    weight: str,
) -> str:
    each = ", ".join(
        f"{low:g}-{high:g} nm {100 * a:.2f} / {100 * b:.2f} %"
        for (low, high), a, b in zip(limits, dni, dhi, strict=True)
    )
    own = [key for key in ("dni_share", "dhi_share") if getattr(spectrum, key, None) is not None]
    origin = {0: "by the power of AM1.5G", 1: f"{own[:1]} as given, the other by AM1.5G", 2: "as given"}
    return (
        f"{len(limits)} bands with all of DNI / DHI in them, {origin[len(own)]}: {each}; "
        f"materials weighed {weight} within a band"
    )
