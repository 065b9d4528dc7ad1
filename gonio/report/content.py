"""What does a scan file hold that a report can show?

The scan itself comes from `gonio.load`, fits from `gonio.load_fit`; this module adds what belongs to the
page alone: provenance, reference readings, events, and the spectra brought in beside the data.
A part that is missing is left out; one that cannot be read is named in `Content.problems`, and the rest is
shown.
"""

from __future__ import annotations

import datetime
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.errors import GonioError

if TYPE_CHECKING:
    from gonio.fitting import FitResult
    from gonio.store import Scan

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spectrum:
    """A spectrum brought in from elsewhere: named columns over wavelength, each (n_wavelength,) float64."""

    wavelength_nm: FloatArray
    columns: Mapping[str, FloatArray]
    facts: Mapping[str, str] = field(default_factory=dict)  # of the sphere, see `gonio.sphere.stored`

    def column(self, *names: str) -> FloatArray | None:
        """Return the first column there is under one of `names`, or ``None``."""
        for name in names:
            if name in self.columns:
                return self.columns[name]
        return None

    def at(self, wavelength_nm: FloatArray, *names: str) -> FloatArray:
        """Return a column interpolated linearly at `wavelength_nm`; NaN outside its range or without it."""
        values = self.column(*names)
        if values is None:
            return np.full(np.shape(wavelength_nm), np.nan)
        known = np.isfinite(values)
        if not np.any(known):
            return np.full(np.shape(wavelength_nm), np.nan)
        order = np.argsort(self.wavelength_nm[known])
        return np.interp(
            wavelength_nm,
            self.wavelength_nm[known][order],
            values[known][order],
            left=np.nan,
            right=np.nan,
        )


@dataclass(frozen=True, slots=True)
class References:
    """Dark and baseline passes: `kind`, `polarization`, `time_s` are (k,), `signal_v` is (k, n_wavelength).

    `time_s` is the start of the pass; a dark pass has polarization ``"any"``.
    """

    kind: tuple[str, ...]
    polarization: tuple[str, ...]
    time_s: FloatArray
    signal_v: FloatArray


@dataclass(frozen=True, slots=True)
class Event:
    """One line of the scan's log."""

    time_s: float
    level: str
    source: str
    message: str


@dataclass(frozen=True, slots=True)
class Content:
    """Everything a scan's report is drawn from; what the file lacks is empty or ``None``."""

    scan: Scan
    fits: Mapping[str, FitResult] = field(default_factory=dict)
    sphere: Spectrum | None = None
    truth: Spectrum | None = None
    references: References | None = None
    events: Sequence[Event] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    problems: Sequence[str] = ()  # parts of the file that could not be read, and why

    @property
    def rig(self) -> Mapping[str, Any]:
        """The rig's tables as written; empty if the file has none or not as TOML."""
        try:
            return tomllib.loads(self.scan.rig_text)
        except tomllib.TOMLDecodeError:
            return {}

    @property
    def simulated(self) -> bool:
        """Say whether the data are the simulated bench's: it left its truth, or its rig has [simulation]."""
        return self.truth is not None or "simulation" in self.rig

    @property
    def blind_zone_deg(self) -> float:
        """Half-angle around the incident beam barred to the detector, deg; 0 if the rig names none."""
        table: Any = self.rig
        for key in ("stage", "theta_mes", "blind_zone_deg"):
            table = table.get(key) if isinstance(table, dict) else None
        return float(table) if isinstance(table, int | float) and np.isfinite(table) else 0.0

    def main_fit(self) -> FitResult | None:
        """Return the fit the report is about: exact aperture, both polarizations, or the next best stored."""
        ranked = sorted(self.fits.values(), key=lambda f: (f.aperture != "exact", f.polarization != "joint"))
        return ranked[0] if ranked else None

    def fit_of(self, polarization: str) -> FitResult | None:
        """Return the fit of one polarization alone with the main fit's aperture model, if stored."""
        main = self.main_fit()
        for fit in self.fits.values():
            if main is not None and fit.aperture == main.aperture and fit.polarization == polarization:
                return fit
        return None


# -- reading
# ------------------------------------------------------------------------------------------------------


def read_content(path: Path) -> Content:
    """Return everything a report of this scan can show; `StoreError` if the file holds no readable scan."""
    from gonio.store import load

    scan = load(path)
    problems: list[str] = []
    fits = _read_fits(path, problems)
    return Content(
        scan=scan,
        fits=fits,
        sphere=_read_spectrum(path, "sphere", problems),
        truth=_read_spectrum(path, "simulated_truth", problems),
        references=_attempt(path, "the reference readings", _read_references, problems),
        events=_attempt(path, "the events", _read_events, problems) or (),
        provenance=_attempt(path, "the provenance", _read_provenance, problems) or {},
        problems=tuple(problems),
    )


def _group_names(path: Path) -> list[str]:
    from gonio.store.read import opened

    with opened(path, "r") as file:
        entry = file["entry"]
        return [str(name) for name in entry if entry.get(name, getclass=True) is h5py.Group]


def _read_fits(path: Path, problems: list[str]) -> dict[str, FitResult]:
    from gonio.fitting import load_fit

    fits: dict[str, FitResult] = {}
    for name in _group_names(path):
        if not name.startswith("fit_"):
            continue
        try:
            fits[name] = load_fit(path, name)
        except GonioError as error:
            problems.append(f"/entry/{name} cannot be shown: {error}")
    return fits


def _read_spectrum(path: Path, group: str, problems: list[str]) -> Spectrum | None:
    from gonio.sphere.stored import FACTS, GROUP, sphere_of_columns
    from gonio.store import read_spectrum
    from gonio.store.spectra import read_facts

    if group not in _group_names(path):
        return None
    try:
        columns = dict(read_spectrum(path, group))
        facts = read_facts(path, group, FACTS) if group == GROUP else {}
        if group == GROUP:
            sphere_of_columns(columns, facts, path)
        return Spectrum(columns.pop("wavelength_nm"), columns, facts)
    except (GonioError, KeyError) as error:
        problems.append(f"/entry/{group} cannot be shown: {error}")
        return None


def _attempt(path: Path, what: str, read: Any, problems: list[str]) -> Any:
    """Return what `read` makes of the file; a strange group costs only its own part of the page."""
    from gonio.store.read import opened

    try:
        with opened(path, "r") as file:
            return read(file["entry"])
    except (GonioError, IndexError, AttributeError) as error:
        problems.append(f"{what} cannot be shown: {error}")
        return None


def _read_references(entry: h5py.Group) -> References | None:
    group = entry.get("references")
    if not isinstance(group, h5py.Group) or len(group["kind"]) == 0:
        return None
    time_s = np.asarray(group["time"][...], dtype=np.float64)
    return References(
        kind=tuple(group["kind"].asstr()[...].tolist()),
        polarization=tuple(group["polarization"].asstr()[...].tolist()),
        time_s=time_s if time_s.ndim == 1 else time_s[:, 0],
        signal_v=np.asarray(group["signal"][...], dtype=np.float64),
    )


def _read_events(entry: h5py.Group) -> tuple[Event, ...]:
    group = entry.get("events")
    if not isinstance(group, h5py.Group):
        return ()
    texts = [group[name].asstr()[...].tolist() for name in ("level", "source", "message")]
    return tuple(
        Event(float(time_s), *words)
        for time_s, *words in zip(group["time"][...].tolist(), *texts, strict=True)
    )


def _read_provenance(entry: h5py.Group) -> dict[str, str]:
    """Return what is said of the measurement, in the order of the page."""
    found: dict[str, str] = {}
    for label, name in (
        ("Sample", "sample/name"),
        ("Description", "sample/description"),
        ("Rig", "instrument/name"),
        ("Started", "start_time"),
        ("Ended", "end_time"),
        ("Measured by", "program"),
    ):
        dataset = entry.get(name)
        if isinstance(dataset, h5py.Dataset) and dataset.shape == ():
            text = str(dataset.asstr()[()]).strip()
            if text:
                found[label] = text
    instrument = entry.get("instrument")
    if isinstance(instrument, h5py.Group):
        for name, part in instrument.items():
            if name.endswith("_identity") and isinstance(part, h5py.Group) and "model" in part:
                label = name.removesuffix("_identity").replace("_", " ").capitalize()
                found[label] = str(part["model"].asstr()[()])
    return found


def file_facts(path: Path) -> str:
    """Return a file's name, size and time of last change."""
    status = path.stat()
    changed = datetime.datetime.fromtimestamp(status.st_mtime, tz=datetime.UTC)
    return f"{path.name}, {status.st_size / 1e6:.2f} MB, last changed {changed:%Y-%m-%d %H:%M} UTC"
