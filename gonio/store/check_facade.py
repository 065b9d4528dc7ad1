"""Is a facade result what docs/facade.md says?  Receivers, errors, contributions that add up, accounts.

Results of older versions, without bands, meshes or what was left out, are whole too.
"""

from __future__ import annotations

import h5py
import numpy as np

from gonio.store.findings import Findings

CONTRIBUTIONS = ("direct", "sky", "diffuse", "specular")
_ANEW = "simulate the scene again with gonio facade"
_SUM = 1e-6  # relative, of the contributions against the total; their rounding is 1e-16
_ACCOUNT = 1e-9


def check_facade(found: Findings, entry: h5py.Group) -> bool:
    """Check a facade result; return whether it was interrupted and can go on."""
    parts = found.parts
    receivers = [str(name) for name in entry if str(name).startswith("receiver_")]
    if not receivers:
        found.add("entry", "holds no receiver", _ANEW)
    found.attribute("", "default", "entry")
    found.group("entry/process", "NXprocess")
    for name in receivers:
        _check_receiver(found, f"entry/{name}")
    if not parts.has("entry/process"):
        return False
    _check_account(found, "entry/process/energy")
    _check_omissions(found, "entry/process/omissions")
    if not parts.has("entry/process/interrupted"):
        return False
    flag = found.get(parts.dataset, "entry/process/interrupted")
    interrupted = flag is not None and flag.shape == () and flag.dtype.kind == "b" and bool(flag[()])
    if interrupted and not parts.has("entry/process/state"):
        found.add("entry/process", "is interrupted, and the points to go on with are missing", _ANEW)
    return interrupted


def _check_receiver(found: Findings, place: str) -> None:
    parts = found.parts
    if found.group(place, "NXdata") is None:
        return
    if parts.attribute(place, "signal"):
        found.attribute(place, "signal", "irradiance")
    mesh = parts.has(f"{place}/faces")
    dimensions = 1 if mesh else 2
    total = found.get(parts.numbers, f"{place}/irradiance", dimensions, "f")
    if total is None:
        return
    if mesh:
        _check_mesh(found, place, total.shape[0])
    everything = {"irradiance": total}
    for name in ("irradiance", *CONTRIBUTIONS):
        if not parts.has(f"{place}/{name}"):
            continue  # `load_irradiance` says so; a viewer needs the total only
        for part in (name, f"{name}_errors"):
            values = found.get(parts.numbers, f"{place}/{part}", dimensions, "f", total.shape)
            if values is None:
                continue
            everything[part] = values
            found.attribute(f"{place}/{part}", "units", "W/m2")
            if not np.all(np.isfinite(values) & (values >= 0.0)):
                found.add(f"{place}/{part}", "holds values that are no irradiance", _ANEW)
                return
    if all(name in everything for name in CONTRIBUTIONS):
        added = sum(everything[name] for name in CONTRIBUTIONS)
        if not np.allclose(added, total, rtol=_SUM, atol=_SUM * float(np.max(total, initial=0.0))):
            found.add(f"{place}/irradiance", "is not the sum of its contributions", _ANEW)


def _check_mesh(found: Findings, place: str, count: int) -> None:
    faces = found.get(found.parts.numbers, f"{place}/faces", 2, "i", (count, 3))
    vertices = found.get(found.parts.numbers, f"{place}/vertices", 2, "f")
    if faces is None or vertices is None:
        return
    found.attribute(f"{place}/vertices", "units", "m")
    if vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
        found.add(f"{place}/vertices", "are no points in space", _ANEW)
    elif faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        found.add(f"{place}/faces", "names vertices that are not there", _ANEW)


def _check_account(found: Findings, place: str) -> None:
    """Check that what the photons carried is all accounted for."""
    parts = found.parts
    if not parts.has(place):
        return
    names = ("emitted_w", "created_w", "absorbed_w", "escaped_w", "unfinished_w")
    values = [found.get(parts.scalar, f"{place}/{name}") for name in names]
    if None in values:
        return
    emitted, created, *out = values
    if parts.has(f"{place}/handed_w"):
        out.append(found.get(parts.scalar, f"{place}/handed_w") or 0.0)
    if not abs(emitted + created - sum(out)) <= _ACCOUNT * max(emitted, created):
        found.add(place, f"does not balance: {emitted + created:g} W in, {sum(out):g} W out", _ANEW)


def _check_omissions(found: Findings, place: str) -> None:
    parts = found.parts
    if not parts.has(place):
        return
    what = found.get(parts.texts, f"{place}/what", 1_000_000)
    bounds = found.get(parts.numbers, f"{place}/bound", 1, "f")
    if what is None or bounds is None:
        return
    found.attribute(f"{place}/bound", "units", "W/m2")
    if len(what) != len(bounds) or not np.all(np.isfinite(bounds) & (bounds >= 0.0)):
        found.add(f"{place}/bound", "holds no bound for each of what was left out", _ANEW)
