"""What came out?  Irradiance with standard errors, by contribution, in a file that any NeXus viewer opens."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio import __version__
from gonio.errors import StoreError
from gonio.facade.geometry import Vector
from gonio.store.read import opened

FloatArray = NDArray[np.float64]

CONTRIBUTIONS = ("direct", "sky", "diffuse", "specular")
"""Direct sun, direct view of the sky, reflected only diffusely, reflected by a lobe at least once."""

_POWERS = ("emitted_w", "created_w", "absorbed_w", "under_horizon_w", "escaped_w", "unfinished_w")


@dataclass(frozen=True, slots=True)
class Estimate:
    """Irradiance and its standard error, W/m2, both of one shape."""

    value: FloatArray
    standard_error: FloatArray


@dataclass(frozen=True, slots=True)
class Receiver:
    """One gridded surface; arrays are (rows, columns), row 0 the lowest, columns along the street's azimuth.

    `mean` and `mean_contributions` are averages over the surface, with standard errors of their own: patches
    share photons, so they do not follow from those of the patches.
    """

    name: str
    origin_m: Vector
    u_m: Vector
    v_m: Vector
    total: Estimate
    contributions: Mapping[str, Estimate]
    mean: Estimate
    mean_contributions: Mapping[str, Estimate]

    @property
    def value(self) -> FloatArray:
        """Irradiance (rows, columns), W/m2."""
        return self.total.value

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of `value`, W/m2."""
        return self.total.standard_error

    @property
    def row_centres_m(self) -> FloatArray:
        """Distance of the patch centres from the lower edge, (rows,), m."""
        rows = self.value.shape[0]
        return np.asarray((np.arange(rows) + 0.5) / rows * np.linalg.norm(self.v_m))

    @property
    def column_centres_m(self) -> FloatArray:
        """Distance of the patch centres from the first edge, (columns,), m."""
        columns = self.value.shape[1]
        return np.asarray((np.arange(columns) + 0.5) / columns * np.linalg.norm(self.u_m))


@dataclass(frozen=True, slots=True)
class EnergyBalance:
    """Where the power of the photons went, W; all zero without a glossy surface, which needs none.

    ``emitted + created = absorbed + escaped + unfinished`` but for rounding; `under_horizon_w` is the part of
    `absorbed_w` that the lobe sent below the surface.
    """

    emitted_w: float
    created_w: float
    absorbed_w: float
    under_horizon_w: float
    escaped_w: float
    unfinished_w: float

    @property
    def residual(self) -> float:
        """``emitted + created - absorbed - escaped - unfinished`` relative to what was emitted."""
        if self.emitted_w == 0.0:
            return 0.0
        out = self.absorbed_w + self.escaped_w + self.unfinished_w
        return (self.emitted_w + self.created_w - out) / self.emitted_w


@dataclass(frozen=True, slots=True)
class Irradiance:
    """The result of `gonio.facade.simulate`.

    `relative_error` is held against `rel_tol`: the root mean square of the patches' standard errors over the
    mean irradiance, of the receiver where it is largest.  `converged` says whether it got there.
    """

    receivers: tuple[Receiver, ...]
    energy: EnergyBalance
    title: str
    scene_text: str
    seed: int
    rel_tol: float
    relative_error: float
    converged: bool
    rays: int
    duration_s: float
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> Receiver:
        """Return the receiver on the surface `name`; `KeyError` lists those there are."""
        for r in self.receivers:
            if r.name == name:
                return r
        raise KeyError(f"no receiver '{name}'; there are {', '.join(r.name for r in self.receivers)}")

    def table(self) -> str:
        """Return the means of the receivers, W/m2, with their standard errors, and how they were obtained."""
        head = f"{'receiver':<16}{'total':>18}" + "".join(f"{c:>17}" for c in CONTRIBUTIONS)
        lines = [head]
        for r in self.receivers:
            cells = [r.mean, *(r.mean_contributions[c] for c in CONTRIBUTIONS)]
            texts = [f"{float(e.value):.2f} ± {float(e.standard_error):.2f}" for e in cells]
            lines.append(f"{r.name:<16}{texts[0]:>18}" + "".join(f"{t:>17}" for t in texts[1:]))
        reached = "reached" if self.converged else "NOT reached"
        lines.append(
            f"W/m2, mean ± standard error; patches ± {100 * self.relative_error:.2g} % (rms, worst receiver; "
            f"{100 * self.rel_tol:g} % asked, {reached})"
        )
        lines.append(f"{self.rays:.3g} rays in {self.duration_s:.2f} s, seed {self.seed}")
        e = self.energy
        if e.emitted_w > 0.0:
            lines.append(
                f"photons: {e.emitted_w:.6g} W in + {e.created_w:.3g} W created = "
                f"{e.absorbed_w:.6g} W absorbed ({e.under_horizon_w:.3g} W of it below the horizon) "
                f"+ {e.escaped_w:.6g} W escaped "
                f"+ {e.unfinished_w:.3g} W unfinished; balance {e.residual:.0e}"
            )
        return "\n".join([*lines, *self.notes])

    def save(self, path: str | Path) -> None:
        """Write everything to an HDF5 file (NeXus groups, units on every array); an older one is replaced.

        `StoreError` if the file cannot be written; then nothing is left behind.
        """
        path = Path(path)
        part = path.with_name(path.name + ".part")
        try:
            with h5py.File(part, "w") as file:
                self._write(file)
            os.replace(part, path)
        except OSError as error:
            raise StoreError(
                f"{path}: cannot be written ({error}); check the folder and the space left"
            ) from None
        finally:
            part.unlink(missing_ok=True)

    def _write(self, file: Any) -> None:
        file.attrs["default"] = "entry"
        entry = _group(file, "entry", "NXentry", default=f"receiver_{self.receivers[0].name}")
        entry["title"] = self.title or "Facade irradiance"
        entry["experiment_type"] = "gonio facade simulation"
        process = _group(entry, "process", "NXprocess")
        process["program"], process["version"] = "gonio", __version__
        process["scene"] = self.scene_text
        for key in ("seed", "rel_tol", "relative_error", "converged", "rays", "duration_s"):
            process[key] = getattr(self, key)
        process["duration_s"].attrs["units"] = "s"
        process.create_dataset("notes", data=list(self.notes), dtype=h5py.string_dtype())
        energy = _group(process, "energy", "NXcollection")
        for key in _POWERS:
            energy[key] = getattr(self.energy, key)
            energy[key].attrs["units"] = "W"
        for number, r in enumerate(self.receivers):
            group = _group(entry, f"receiver_{r.name}", "NXdata", signal="irradiance", axes=["row", "column"])
            group.attrs["number"] = number
            group.attrs["surface"] = r.name
            for key in ("origin_m", "u_m", "v_m"):
                group.attrs[key] = getattr(r, key)
            for key, centres in (("row", r.row_centres_m), ("column", r.column_centres_m)):
                group[key] = centres
                group[key].attrs["units"] = "m"
            _put(group, "irradiance", r.total)
            _put(group, "mean_irradiance", r.mean)
            for name in CONTRIBUTIONS:
                _put(group, name, r.contributions[name])
                _put(group, f"mean_{name}", r.mean_contributions[name])


def _group(parent: Any, name: str, kind: str, **attributes: Any) -> Any:
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    for key, value in attributes.items():
        group.attrs[key] = value
    return group


def _put(group: Any, name: str, estimate: Estimate) -> None:
    for key, array in ((name, estimate.value), (f"{name}_errors", estimate.standard_error)):
        group[key] = array
        group[key].attrs["units"] = "W/m2"


def _take(group: Any, name: str) -> Estimate:
    return Estimate(np.asarray(group[name][()]), np.asarray(group[f"{name}_errors"][()]))


def load_irradiance(path: str | Path) -> Irradiance:
    """Return what `Irradiance.save` wrote.

    `StoreError` if there is no such file, or it holds no facade irradiance.
    """
    path = Path(path)
    with opened(path, "r") as file:
        try:
            return _read(file)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise StoreError(
                f"{path}: holds no facade irradiance ({error}); name a file written by gonio facade"
            ) from None


def _read(file: Any) -> Irradiance:
    entry = file["entry"]
    process = entry["process"]
    groups = [g for key, g in entry.items() if key.startswith("receiver_")]
    receivers = tuple(
        Receiver(
            name=str(g.attrs["surface"]),
            origin_m=_vector(g, "origin_m"),
            u_m=_vector(g, "u_m"),
            v_m=_vector(g, "v_m"),
            total=_take(g, "irradiance"),
            contributions={name: _take(g, name) for name in CONTRIBUTIONS},
            mean=_take(g, "mean_irradiance"),
            mean_contributions={name: _take(g, f"mean_{name}") for name in CONTRIBUTIONS},
        )
        for g in sorted(groups, key=lambda g: int(g.attrs["number"]))
    )
    return Irradiance(
        receivers=receivers,
        energy=EnergyBalance(*(float(process["energy"][key][()]) for key in _POWERS)),
        title=entry["title"].asstr()[()],
        scene_text=process["scene"].asstr()[()],
        seed=int(process["seed"][()]),
        rel_tol=float(process["rel_tol"][()]),
        relative_error=float(process["relative_error"][()]),
        converged=bool(process["converged"][()]),
        rays=int(process["rays"][()]),
        duration_s=float(process["duration_s"][()]),
        notes=tuple(process["notes"].asstr()[()]),
    )


def _vector(group: Any, key: str) -> Vector:
    x, y, z = (float(c) for c in group.attrs[key])
    return x, y, z
