"""A fit beside its data: ``/entry/fit_NAME`` (NXprocess) of the scan file, written and read back."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import gonio
from gonio.aperture import Aperture, IncidentBeam
from gonio.errors import StoreError
from gonio.fitting.result import FitResult
from gonio.store.checked import Checked
from gonio.store.read import opened

_TEXT = h5py.string_dtype("utf-8")
_NAME = re.compile(r"[A-Za-z0-9_]+")

# field, unit, quantity; the attributes of FitResult that are arrays, stored under their own names
_ARRAYS: tuple[tuple[str, str, str], ...] = (
    ("wavelength_nm", "nm", "set wavelength"),
    ("detector_index", "", "index into the instrument's detectors"),
    ("value", "", "the parameters, in the order of their names"),
    ("se", "", "standard uncertainty of value"),
    ("lower", "", "lower end of the 95 % interval"),
    ("upper", "", "upper end of the 95 % interval"),
    ("covariance", "", "covariance of value"),
    ("basic", "", "the fit's own parameters, such as rho_d, k_n = rho_s R(0), ln(alpha), n2"),
    ("basic_covariance", "", "covariance of basic"),
    ("modes", "", "shifts of basic by one standard uncertainty of each cause that wavelengths share"),
    ("shared_value", "", "coefficients of n2, gains minus 1 and offsets that wavelengths share"),
    ("shared_covariance", "", "covariance of shared_value"),
    ("chi2", "", "weighted sum of squared residuals"),
    ("dof", "", "degrees of freedom"),
    ("rms", "", "root mean square residual of r"),
    ("condition", "", "condition number of the correlation matrix"),
    ("residual", "", "r minus fitted r"),
    ("sigma", "", "standard deviation of r behind the weights, before scaling by chi2"),
    ("theta_i_deg", "deg", "incidence"),
    ("theta_o_deg", "deg", "observation angle from the normal, positive on the specular side"),
)
_BEAM = (("width_mm", "mm"), ("height_mm", "mm"), ("divergence_deg", "deg"))
_NAMES = ("parameters", "mode_names", "shared_names", "remarks")
_LATER: tuple[str, ...] = ("modes", "shared_value", "shared_covariance")
"""Fields that fits of earlier versions lack; they shared nothing."""


def save_fit(fit: FitResult, path: Path | str, name: str | None) -> str:
    """Write ``/entry/fit_NAME``; it is complete before it replaces an older one of that name."""
    name = _name_of(fit) if name is None else name.removeprefix("fit_")
    if not _NAME.fullmatch(name):
        raise StoreError(f"fit name {name!r} may hold letters, digits and _ only; choose another")
    with _opened(path, "r+") as file:
        entry = file["entry"]
        made = f".fit_{name}"
        if made in entry:
            del entry[made]
        group = entry.create_group(made)
        _write(group, fit)
        final = f"fit_{name}"
        if final in entry:
            del entry[final]
        entry.move(made, final)
        file.flush()
    return name


def _name_of(fit: FitResult) -> str:
    """Return the name of a fit: aperture and polarization, and what else is not as usual."""
    plain = {"model": "published", "n2": "free", "loss": "squares"}
    other = [getattr(fit, what) for what, usual in plain.items() if getattr(fit, what) != usual]
    return "_".join([fit.aperture, fit.polarization, *(f"n2_{x}" if x == fit.n2 else x for x in other)])


def load_fit(path: Path | str, name: str | None = None) -> FitResult:
    """Return a stored fit.

    Parameters
    ----------
    path
        The scan file.
    name
        ``"exact_joint"`` or ``"fit_exact_joint"``; None takes the exact joint fit, or else the newest.

    Raises
    ------
    StoreError
        No such file, no fit in it, or none of that name; the message lists those that are there.
    """
    with _opened(path, "r") as file:
        entry = file["entry"]
        there = [key.removeprefix("fit_") for key in entry if key.startswith("fit_")]
        if not there:
            raise StoreError(f"{path}: holds no fit; run: gonio fit {path}")
        if name is None:
            newest = max(there, key=lambda key: _text(entry[f"fit_{key}/date"]))
            name = "exact_joint" if "exact_joint" in there else newest
        name = name.removeprefix("fit_")
        if name not in there:
            raise StoreError(f"{path}: holds no fit '{name}'; it holds: {', '.join(sorted(there))}")
        return _read(entry[f"fit_{name}"], f"{path}:/entry/fit_{name}")


@contextmanager
def _opened(path: Path | str, mode: str) -> Iterator[Any]:
    with opened(Path(path), mode) as file:
        parts = Checked(Path(path), file)
        if not parts.has("entry"):
            raise StoreError(
                f"{path}: is not a gonio scan, /entry is missing; give a file written by gonio scan"
            )
        parts.group("entry")
        yield file


def _write(group: Any, fit: FitResult) -> None:
    group.attrs["NX_class"] = "NXprocess"
    for key, text in {
        "program": "gonio",
        "version": gonio.__version__,
        "date": datetime.datetime.now(datetime.UTC).isoformat(),
        "model": fit.model,
        "aperture": fit.aperture,
        "polarization": fit.polarization,
        "intervals": fit.intervals,
        "weights": fit.weights,
        "loss": fit.loss,
        "n2": fit.n2,
        "sample_name": fit.sample_name,
    }.items():
        group.create_dataset(key, data=text, dtype=_TEXT)
    for field in _NAMES:
        group.create_dataset(field, data=list(getattr(fit, field)), dtype=_TEXT)
    group.create_dataset("notes", data=list(fit.notes), dtype=_TEXT)
    group.create_dataset("polarization_of", data=[str(p) for p in fit.polarization_of], dtype=_TEXT)
    for field, unit, quantity in _ARRAYS:
        data = group.create_dataset(field, data=getattr(fit, field))
        data.attrs["quantity"] = quantity
        data.attrs["units"] = unit
    size = group.create_group("instrument")
    for field in ("width_mm", "height_mm", "distance_mm"):
        size.create_dataset(field, data=getattr(fit.instrument, field)).attrs["units"] = "mm"
    if fit.beam is not None:
        beam = group.create_group("beam")
        for field, unit in _BEAM:
            beam.create_dataset(field, data=getattr(fit.beam, field)).attrs["units"] = unit


def _read(group: Any, where: str) -> FitResult:
    try:
        old = "loss" not in group  # before a fit could share anything, or have another model
        count = len(group["parameters"])
        arrays: dict[str, Any] = {
            field: group[field][()] for field, _, _ in _ARRAYS if not (old and field in _LATER)
        }
        if old:
            nothing = np.zeros((0, len(group["value"]), count))
            arrays |= dict(zip(_LATER, (nothing, np.zeros(0), np.zeros((0, 0))), strict=True))
        names: dict[str, Any] = {
            field: () if old and field != "parameters" else tuple(group[field].asstr()[()])
            for field in _NAMES
        }
        return FitResult(
            **arrays,
            **names,
            model="published" if old else _text(group["model"]),
            n2="free" if old else _text(group["n2"]),
            loss="squares" if old else _text(group["loss"]),  # type: ignore[arg-type]
            notes=tuple(group["notes"].asstr()[()]),
            polarization_of=np.asarray(group["polarization_of"].asstr()[()], np.str_),
            aperture=_text(group["aperture"]),  # type: ignore[arg-type]
            polarization=_text(group["polarization"]),  # type: ignore[arg-type]
            intervals=_text(group["intervals"]),  # type: ignore[arg-type]
            weights=_text(group["weights"]),
            sample_name=_text(group["sample_name"]),
            beam=IncidentBeam(*(float(group["beam"][field][()]) for field, _ in _BEAM))
            if "beam" in group
            else None,
            instrument=Aperture(
                *(float(group["instrument"][f][()]) for f in ("width_mm", "height_mm", "distance_mm"))
            ),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{where}: is damaged or of another version ({error}); fit the scan again") from None


def _text(data: Any) -> str:
    return str(data.asstr()[()])
