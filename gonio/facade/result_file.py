"""How is a result kept?  One HDF5 file that any NeXus viewer opens at the first receiver's map.

    /entry NXentry             title, default = first receiver
      process NXprocess        program, version, date, versions, options, scene, seed, tolerance, notes
        energy, exchange       accounts, W
        omissions, levels      what the planner chose, with bounds
        state                  arrays with which the run goes on
      receiver_NAME NXdata     irradiance and its contributions, each with its errors; means
      bands NXdata             means by band and receiver

Every number declares its quantity and unit.  Reading trusts nothing in the file: see `gonio.store.checked`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gonio import __version__
from gonio.errors import StoreError
from gonio.facade.geometry import Vector
from gonio.facade.result import (
    CONTRIBUTIONS,
    BandIrradiance,
    EnergyBalance,
    Estimate,
    ExchangeBalance,
    Irradiance,
    Omission,
    Receiver,
)
from gonio.store.checked import Checked
from gonio.store.read import opened

FACADE_TYPE = "gonio facade simulation"
_POWERS = ("emitted_w", "created_w", "absorbed_w", "under_horizon_w", "escaped_w", "unfinished_w", "handed_w")
_EXCHANGE = ("emitted_w", "received_w", "escaped_w", "standard_error_w", "solver_residual")
_WITHOUT_UNIT = "1"


def save(irradiance: Irradiance, path: Path) -> None:
    """Write a result; `StoreError` if it cannot be written, and then an older file is left as it was."""
    with replacing(path) as part, h5py.File(part, "w") as file:
        _write(file, irradiance)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the name of a part file that takes the place of `path` when it has been written to the end."""
    part = path.with_name(path.name + ".part")
    try:
        yield part
        with part.open("rb+") as written:
            os.fsync(written.fileno())  # a power cut must not leave the new name on an empty file
        os.replace(part, path)
    except OSError as error:
        raise StoreError(
            f"{path}: cannot be written ({error}); check the folder and the space left"
        ) from None
    finally:
        part.unlink(missing_ok=True)


# -- writing


def _write(file: Any, result: Irradiance) -> None:
    file.attrs["default"] = "entry"
    names = group_names([r.name for r in result.receivers])
    entry = _group(file, "entry", "NXentry", default=names[0] if names else "process")
    entry["title"] = result.title or "Facade irradiance"
    entry["experiment_type"] = FACADE_TYPE
    _write_process(_group(entry, "process", "NXprocess"), result)
    for number, (name, receiver) in enumerate(zip(names, result.receivers, strict=True)):
        _write_receiver(entry, name, number, receiver)
    if result.bands:
        _write_bands(entry, result)


def _write_process(process: Any, result: Irradiance) -> None:
    process["program"], process["version"] = "gonio", __version__
    process["date"] = result.date
    process["scene"] = result.scene_text
    process["method"] = result.method
    for key in ("converged", "interrupted"):
        process[key] = bool(getattr(result, key))
    for key in ("seed", "rays"):
        process[key] = int(getattr(result, key))
    for key in ("rel_tol", "relative_error", "duration_s", "floor_w_m2"):
        process[key] = float(getattr(result, key))
    _declare(process["duration_s"], "time", "s")
    _declare(process["floor_w_m2"], "irradiance", "W/m2")
    for key in ("rel_tol", "relative_error"):
        _declare(process[key], "relative standard error", _WITHOUT_UNIT)
    _texts(process, "notes", result.notes)
    _write_mapping(process, "versions", "program", "version", result.versions)
    _write_mapping(process, "options", "option", "value", result.options)
    _write_mapping(process, "levels", "material", "level", result.levels)
    energy = _group(process, "energy", "NXcollection")
    for key in _POWERS:
        energy[key] = float(getattr(result.energy, key))
        _declare(energy[key], "power", "W")
    if result.exchange is not None:
        exchange = _group(process, "exchange", "NXcollection")
        for key in _EXCHANGE:
            exchange[key] = float(getattr(result.exchange, key))
            _declare(exchange[key], *(("power", "W") if key.endswith("_w") else ("ratio", _WITHOUT_UNIT)))
    if result.omissions:
        omissions = _group(process, "omissions", "NXcollection")
        _texts(omissions, "what", [o.what for o in result.omissions])
        _texts(omissions, "receiver", [o.receiver for o in result.omissions])
        omissions["bound"] = np.array([o.bound_w_m2 for o in result.omissions], np.float64)
        _declare(omissions["bound"], "irradiance", "W/m2")
        omissions["bound_percent"] = np.array([o.bound_percent for o in result.omissions], np.float64)
        _declare(omissions["bound_percent"], "relative irradiance", "%")
    if result.state is not None:
        state = _group(process, "state", "NXcollection")
        for key, array in result.state.items():
            state[key] = array
            _declare(state[key], "state of the estimator", "any")


def _write_mapping(process: Any, name: str, key: str, value: str, mapping: Mapping[str, str]) -> None:
    group = _group(process, name, "NXcollection")
    _texts(group, key, list(mapping))
    _texts(group, value, list(mapping.values()))


def _write_receiver(entry: Any, name: str, number: int, r: Receiver) -> None:
    axes = ["face"] if r.is_mesh else ["row", "column"]
    group = _group(entry, name, "NXdata", signal="irradiance", axes=axes, title=r.name)
    group.attrs["number"] = number
    group.attrs["surface"] = r.name
    if r.vertices_m is not None and r.faces is not None:
        group["face"] = np.arange(len(r.faces))
        _declare(group["face"], "index", _WITHOUT_UNIT)
        group["vertices"] = np.asarray(r.vertices_m, np.float64)
        _declare(group["vertices"], "position", "m")
        group["faces"] = np.asarray(r.faces, np.int64)
        _declare(group["faces"], "index of three vertices", _WITHOUT_UNIT)
    else:
        for key in ("origin_m", "u_m", "v_m"):
            group.attrs[key] = getattr(r, key)
        for key, centres in (("row", r.row_centres_m), ("column", r.column_centres_m)):
            group[key] = centres
            _declare(group[key], "length", "m")
    _put(group, "irradiance", r.total)
    _put(group, "mean_irradiance", r.mean)
    for part in CONTRIBUTIONS:
        _put(group, part, r.contributions[part])
        _put(group, f"mean_{part}", r.mean_contributions[part])
    group["discretisation"] = float(r.discretisation_w_m2)
    _declare(group["discretisation"], "irradiance", "W/m2")


def _write_bands(entry: Any, result: Irradiance) -> None:
    group = _group(
        entry, "bands", "NXdata", signal="irradiance", axes=["band", "receiver"], title="Means by band"
    )
    group["band"] = np.array([0.5 * (b.low_nm + b.high_nm) for b in result.bands])
    group["limits"] = np.array([(b.low_nm, b.high_nm) for b in result.bands], np.float64)
    for key in ("band", "limits"):
        _declare(group[key], "wavelength", "nm")
    for key in ("dni", "dhi"):
        group[key] = np.array([getattr(b, f"{key}_w_m2") for b in result.bands], np.float64)
        _declare(group[key], "irradiance", "W/m2")
    names = [r.name for r in result.receivers]
    group["receiver"] = np.arange(len(names))
    _declare(group["receiver"], "index", _WITHOUT_UNIT)
    _texts(group, "receiver_name", names)
    table = [[b.means[n] for n in names] for b in result.bands]
    values = np.array([[float(e.value) for e in row] for row in table])
    errors = np.array([[float(e.standard_error) for e in row] for row in table])
    _put(group, "irradiance", Estimate(values, errors))


def group_names(names: Sequence[str]) -> list[str]:
    """Return the HDF5 group of each receiver: all different, without what HDF5 reads as a path."""
    found: list[str] = []
    for name in names:
        plain = "receiver_" + re.sub(r"[^\w.\-]", "_", name)
        unique, number = plain, 1
        while unique in found:
            number += 1
            unique = f"{plain}_{number}"
        found.append(unique)
    return found


def _group(parent: Any, name: str, kind: str, **attributes: Any) -> Any:
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    for key, value in attributes.items():
        group.attrs[key] = value
    return group


def _texts(group: Any, name: str, texts: Sequence[str]) -> None:
    group.create_dataset(name, data=list(texts), dtype=h5py.string_dtype(), shape=(len(texts),))


def _put(group: Any, name: str, estimate: Estimate) -> None:
    group[name] = np.asarray(estimate.value, np.float64)
    _declare(group[name], "irradiance", "W/m2")
    group[f"{name}_errors"] = np.asarray(estimate.standard_error, np.float64)
    _declare(group[f"{name}_errors"], "standard error of irradiance", "W/m2")


def _declare(dataset: Any, quantity: str, units: str) -> None:
    dataset.attrs["quantity"] = quantity
    dataset.attrs["units"] = units


# -- reading


class _Parts(Checked):
    def foreign(self, what: str) -> StoreError:
        return StoreError(
            f"{self.path}: holds no facade irradiance: {what}; name a file written by gonio facade"
        )

    def flag(self, name: str) -> bool:
        return bool(self._single(name, "b"))

    def count(self, name: str) -> int:
        return int(self._single(name, "iu"))

    def _single(self, name: str, kinds: str) -> Any:
        dataset = self.dataset(name)
        if dataset.shape != () or dataset.dtype.kind not in kinds:
            raise self.foreign(f"/{name} is {dataset.dtype} of shape {dataset.shape}")
        return dataset[()]

    def lines(self, name: str) -> tuple[str, ...]:
        return () if self.dataset(name).shape == (0,) else self.texts(name, 1_000_000)

    def mapping(self, name: str, key: str, value: str) -> dict[str, str]:
        """Return what `_write_mapping` wrote; files before gonio kept it have nothing."""
        if not self.has(name):
            return {}
        keys, values = self.lines(f"{name}/{key}"), self.lines(f"{name}/{value}")
        if len(keys) != len(values):
            raise self.foreign(f"/{name} has {len(keys)} names and {len(values)} values")
        return dict(zip(keys, values, strict=True))

    def estimate(self, place: str, name: str, shape: tuple[int, ...]) -> Estimate:
        names = (f"{place}/{name}", f"{place}/{name}_errors")
        if shape == ():
            value, error = (np.asarray(self.scalar(n)) for n in names)
        else:
            value, error = (self.numbers(n, len(shape), "f", shape) for n in names)
        return Estimate(value, error)

    def optional(self, name: str) -> float:
        return self.scalar(name) if self.has(name) else 0.0


def load(path: Path) -> Irradiance:
    """Return the result in a file; `StoreError` says why there is none."""
    with opened(path, "r") as file:
        parts = _Parts(path, file)
        try:
            return _read(parts)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise parts.foreign(str(error)) from None


def _read(parts: _Parts) -> Irradiance:
    p = "entry/process"
    if not (parts.has("entry") and parts.has("entry/process") and parts.has("entry/process/energy")):
        raise parts.foreign("/entry/process/energy is missing")
    names = [name for name in parts.group("entry") if name.startswith("receiver_")]
    places = sorted((f"entry/{name}" for name in names), key=lambda at: _integer(parts, at, "number"))
    receivers = tuple(_read_receiver(parts, at) for at in places)
    return Irradiance(
        receivers=receivers,
        energy=EnergyBalance(*(parts.optional(f"{p}/energy/{key}") for key in _POWERS)),
        title=parts.text("entry/title"),
        scene_text=parts.text(f"{p}/scene"),
        seed=parts.count(f"{p}/seed"),
        rel_tol=parts.scalar(f"{p}/rel_tol"),
        relative_error=parts.scalar(f"{p}/relative_error"),
        converged=parts.flag(f"{p}/converged"),
        rays=parts.count(f"{p}/rays"),
        duration_s=parts.scalar(f"{p}/duration_s"),
        notes=parts.lines(f"{p}/notes"),
        omissions=_read_omissions(parts, f"{p}/omissions"),
        method=parts.text(f"{p}/method") if parts.has(f"{p}/method") else "paths",
        levels=parts.mapping(f"{p}/levels", "material", "level"),
        bands=_read_bands(parts, "entry/bands"),
        exchange=(
            ExchangeBalance(*(parts.scalar(f"{p}/exchange/{key}") for key in _EXCHANGE))
            if parts.has(f"{p}/exchange")
            else None
        ),
        interrupted=parts.has(f"{p}/interrupted") and parts.flag(f"{p}/interrupted"),
        state=_read_state(parts, f"{p}/state"),
        floor_w_m2=parts.optional(f"{p}/floor_w_m2"),
        versions=parts.mapping(f"{p}/versions", "program", "version"),
        options=parts.mapping(f"{p}/options", "option", "value"),
        date=parts.text(f"{p}/date") if parts.has(f"{p}/date") else "",
    )


def _read_receiver(parts: _Parts, at: str) -> Receiver:
    mesh = parts.has(f"{at}/faces")
    shape = parts.declared_shape(f"{at}/irradiance", 1 if mesh else 2)
    vertices = faces = None
    vectors: list[Vector] = [(0.0, 0.0, 0.0)] * 3
    if mesh:
        vertices = parts.numbers(f"{at}/vertices", 2, "f")
        faces = parts.numbers(f"{at}/faces", 2, "i", (shape[0], 3)).astype(np.int64)
        if vertices.shape[1] != 3 or (faces.size and not 0 <= faces.min() <= faces.max() < len(vertices)):
            raise parts.foreign(f"/{at}/faces names vertices that are not there")
    else:
        vectors = [_vector(parts, at, key) for key in ("origin_m", "u_m", "v_m")]
    return Receiver(
        name=parts.attribute(at, "surface"),
        origin_m=vectors[0],
        u_m=vectors[1],
        v_m=vectors[2],
        total=parts.estimate(at, "irradiance", shape),
        contributions={name: parts.estimate(at, name, shape) for name in CONTRIBUTIONS},
        mean=parts.estimate(at, "mean_irradiance", ()),
        mean_contributions={name: parts.estimate(at, f"mean_{name}", ()) for name in CONTRIBUTIONS},
        discretisation_w_m2=parts.optional(f"{at}/discretisation"),
        vertices_m=vertices,
        faces=faces,
    )


def _read_omissions(parts: _Parts, at: str) -> tuple[Omission, ...]:
    if not parts.has(at):
        return ()
    what = parts.lines(f"{at}/what")
    receivers = parts.lines(f"{at}/receiver")
    bounds, percents = (parts.numbers(f"{at}/{key}", 1, "f") for key in ("bound", "bound_percent"))
    return tuple(
        Omission(text, float(bound), float(percent), receiver)
        for text, bound, percent, receiver in zip(what, bounds, percents, receivers, strict=True)
    )


def _read_bands(parts: _Parts, at: str) -> tuple[BandIrradiance, ...]:
    if not parts.has(at):
        return ()
    names = parts.lines(f"{at}/receiver_name")
    limits = parts.numbers(f"{at}/limits", 2, "f")
    dni, dhi = (parts.numbers(f"{at}/{key}", 1, "f", (len(limits),)) for key in ("dni", "dhi"))
    means = parts.estimate(at, "irradiance", (len(limits), len(names)))
    return tuple(
        BandIrradiance(
            float(low), float(high), float(dni[i]), float(dhi[i]),
            {
                name: Estimate(np.asarray(means.value[i, k]), np.asarray(means.standard_error[i, k]))
                for k, name in enumerate(names)
            },
        )
        for i, (low, high) in enumerate(limits)
    )  # fmt: skip


def _read_state(parts: _Parts, at: str) -> dict[str, Any] | None:
    if not parts.has(at):
        return None
    state: dict[str, Any] = {}
    for key in parts.group(at):
        dataset = parts.dataset(f"{at}/{key}")
        kind = dataset.dtype.kind
        if kind not in "biuf":
            raise parts.foreign(f"/{at}/{key} holds {dataset.dtype}")
        if dataset.shape == ():
            state[key] = np.asarray(dataset[()])
        else:
            values = parts.numbers(f"{at}/{key}", len(dataset.shape), kind)
            state[key] = values.astype(dataset.dtype, copy=False)
    return state


def _integer(parts: _Parts, at: str, key: str) -> int:
    return int(parts.group(at).attrs[key])


def _vector(parts: _Parts, at: str, key: str) -> Vector:
    x, y, z = (float(c) for c in parts.group(at).attrs[key])
    return x, y, z
