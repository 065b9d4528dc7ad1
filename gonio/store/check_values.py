"""Do the values of a scan agree with each other, with the plan, and with the references?

Only asked of a file whose form is right.  Positions are read a thousand at a time, however many there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.devices import Quality
from gonio.errors import ConfigError
from gonio.plan.model import Plan, parse_plan
from gonio.store.findings import Findings
from gonio.store.records import ReferenceRecord
from gonio.store.reduction import Reduction

_BLOCK = 1024
_KNOWN_BITS = np.uint16(sum(bit.value for bit in Quality))
_NO_VALUE = np.uint16(Quality.REFUSED | Quality.NOT_MEASURED | Quality.SKIPPED)
_FARTHEST_DEG = 1.0
"""Between an angle set and read back; a drive that stops farther away has failed."""
_ONLY_BY_HAND = "only an edit can have done this; restore the file from a copy"


def check_values(found: Findings, n: int, m: int, k: int, events: int, *, finished: bool) -> None:
    """Note every contradiction in the values of n positions, m wavelengths, k references and the events."""
    parts = found.parts
    wavelength_nm = parts.numbers("entry/data/wavelength", 1, "f")
    detector_index = parts.numbers("entry/data/detector_index", 1, "u")
    names = parts.texts("entry/data/detector_names")
    if not np.all(np.isfinite(wavelength_nm) & (wavelength_nm > 0)):
        found.add("entry/data/wavelength", "holds values that are not positive", _ONLY_BY_HAND)
    elif detector_index.max(initial=0) >= len(names):
        found.add("entry/data/detector_index", f"reaches {detector_index.max()}, {len(names)} are named")
    elif np.any((np.diff(wavelength_nm) <= 0) & (np.diff(detector_index.astype(int)) == 0)):
        found.add("entry/data/wavelength", "does not ascend within each detector", _ONLY_BY_HAND)
    measured = _check_positions(found, n)
    _check_plan(found, n, measured, finished=finished)
    references = _references(found, k) if k else []
    _check_references(found, references, n)
    levels = parts.texts("entry/events/level", 10_000_000) if events else ()
    if unknown := sorted(set(levels) - {"info", "warning", "error"}):
        found.add("entry/events/level", f"holds {', '.join(unknown)}", "use info, warning or error")
    if not found.found:
        reduction = Reduction(references, detector_index) if finished and references else None
        for low in range(0, n, _BLOCK):
            _check_block(found, slice(low, min(low + _BLOCK, n)), measured, reduction)


def _check_positions(found: Findings, n: int) -> NDArray[np.bool_]:
    """Check the columns of positions and return which were measured, (n,)."""
    column = {
        name: found.parts.numbers(f"entry/data/{name}", 1, "f", (n,))
        for name in ("theta_i", "theta_mes", "theta_o", "theta_i_set", "theta_mes_set", "time")
    }
    measured: NDArray[np.bool_] = np.isfinite(column["time"])
    reached = measured.copy()  # all but those that were skipped after faults, which have no angles
    quality = found.parts.group("entry/data")["quality"]
    for row in np.flatnonzero(measured & ~np.isfinite(column["theta_i"] + column["theta_mes"])).tolist():
        reached[row] = not np.all(quality[row] & np.uint16(Quality.SKIPPED))

    def note(name: str, wrong: NDArray[np.bool_], problem: str) -> None:
        if np.any(wrong):
            rows = np.flatnonzero(wrong)
            more = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
            found.add(f"entry/data/{name}", f"{problem} at position {rows[0]}{more}", _ONLY_BY_HAND)

    for axis in ("theta_i", "theta_mes"):
        note(axis, reached & ~np.isfinite(column[axis]), "has no angle")
        away = np.abs(column[axis] - column[f"{axis}_set"])
        note(axis, reached & (away > _FARTHEST_DEG), f"is more than {_FARTHEST_DEG:g} deg from {axis}_set")
        note(axis, np.abs(column[axis]) > 360.0, "is beyond 360 deg")
    difference = np.abs(column["theta_o"] - (column["theta_mes"] - column["theta_i"]))
    note("theta_o", reached & ~(difference <= 1e-9), "is not theta_mes - theta_i")
    position = found.parts.numbers("entry/data/position", 1, "i", (n,))
    note("position", position != np.arange(n), "is not the number of its row")
    polarization = found.parts.numbers("entry/data/polarization", 1, "S", (n,))
    asked_for = measured | ("source" not in found.parts.group("entry")) | np.isfinite(column["theta_i_set"])
    note("polarization", asked_for & ~np.isin(polarization, (b"s", b"p")), "is neither s nor p")
    times = column["time"][measured]
    wrong = np.zeros(n, dtype=np.bool_)
    wrong[np.flatnonzero(measured)[1:]] = np.diff(times) <= 0
    note("time", wrong, "does not ascend")
    return measured


def _check_block(
    found: Findings, rows: slice, measured: NDArray[np.bool_], reduction: Reduction | None
) -> None:
    data = found.parts.group("entry/data")

    def block(name: str) -> NDArray[Any]:
        return np.asarray(data[name][rows])

    def note(name: str, wrong: NDArray[np.bool_], problem: str) -> None:
        if np.any(wrong):
            row, column = np.argwhere(wrong)[0]
            more = f" and {int(wrong.sum()) - 1} more" if wrong.sum() > 1 else ""
            found.add(
                f"entry/data/{name}",
                f"{problem} at position {rows.start + row}, column {column}{more}",
                _ONLY_BY_HAND,
            )

    quality = block("quality")
    here = measured[rows, None]
    none = (quality & _NO_VALUE) != 0
    note("quality", (quality & ~_KNOWN_BITS) != 0, "has unknown bits")
    note("quality", here & ((quality & np.uint16(Quality.NOT_MEASURED)) != 0), "says not measured, but it is")
    raw, dark, baseline, r = (block(name) for name in ("raw_signal", "dark", "baseline", "r"))
    note("raw_signal", here & ~none & ~np.isfinite(raw), "has no value, and quality does not say why")
    note("raw_signal", ~here & np.isfinite(raw), "has a value that was never measured")
    full = baseline - dark
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = np.where(full > 0, (raw - dark) / full, np.nan)
        agrees = np.abs(r - expected) <= 1e-9 * np.abs(expected) + 1e-12
    note(
        "r", ~(agrees | (np.isnan(r) & np.isnan(expected))), "is not (raw_signal - dark) / (baseline - dark)"
    )
    for name in ("r_errors", "gain_uncertainty", "offset_uncertainty", "raw_signal_sd"):
        note(name, block(name) < 0, "is negative")
    note("averages", here & ~none & (block("averages") == 0), "is zero")
    if reduction is None:
        return
    polarization = [text.decode() for text in block("polarization").tolist()]
    again = reduction.apply(
        raw, block("raw_signal_sd"), block("averages"), block("reading_time"), polarization
    )
    for name, stored, value in (("dark", dark, again.dark_v), ("baseline", baseline, again.baseline_v)):
        off = np.abs(stored - value) > 1e-9 * np.abs(value) + 1e-15
        note(name, here & ~none & off, "does not follow from /entry/references")


def _check_plan(found: Findings, n: int, measured: NDArray[np.bool_], *, finished: bool) -> None:
    parts = found.parts
    try:
        plan: Plan = parse_plan(parts.text("entry/plan"), source="/entry/plan")
    except ConfigError as error:
        found.add("entry/plan", f"cannot be read ({error})", _ONLY_BY_HAND)
        return
    if "source" not in parts.group("entry") and plan.n_positions != n:  # else a source chose them
        found.add("entry/data", f"has {n} positions, the plan {plan.n_positions}", _ONLY_BY_HAND)
        return
    if finished and not np.all(measured):
        row = int(np.flatnonzero(~measured)[0])
        found.add("entry/data", f"is finished without position {row}", _ONLY_BY_HAND)


def _references(found: Findings, k: int) -> list[ReferenceRecord]:
    parts, where = found.parts, "entry/references"
    group = parts.group(where)
    column = {
        name: group[name][...]
        for name in (
            "averages",
            "theta_i",
            "theta_mes",
            "time",
            "signal",
            "signal_sd",
            "wavelength_readback",
            "quality",
        )
    }
    texts = {name: parts.texts(f"{where}/{name}", k) for name in ("kind", "when", "polarization")}
    return [
        ReferenceRecord(
            kind=texts["kind"][i],  # type: ignore[arg-type]
            when=texts["when"][i],
            polarization=texts["polarization"][i],
            theta_i_deg=float(column["theta_i"][i]),
            theta_mes_deg=float(column["theta_mes"][i]),
            averages=int(column["averages"][i]),
            unix_s=0.0,
            wavelength_nm=column["wavelength_readback"][i],
            signal_v=column["signal"][i],
            signal_sd_v=column["signal_sd"][i],
            time_s=column["time"][i],
            quality=column["quality"][i].astype(np.uint16),
        )
        for i in range(k)
    ]


def _check_references(found: Findings, references: list[ReferenceRecord], n: int) -> None:
    where = "entry/references"
    kinds = {(r.kind, r.polarization) for r in references}
    if unknown := sorted(
        f"{a} {b}" for a, b in kinds - {("dark", "any"), ("baseline", "s"), ("baseline", "p")}
    ):
        found.add(where, f"holds {', '.join(unknown)}", _ONLY_BY_HAND)
    times = np.array([np.nanmin(r.time_s) if np.any(np.isfinite(r.time_s)) else np.nan for r in references])
    if len(times) and not np.all(np.diff(times) > 0):
        found.add(f"{where}/time", "does not ascend", _ONLY_BY_HAND)
    measured = found.parts.numbers("entry/data/time", 1, "f", (n,))
    polarization = found.parts.numbers("entry/data/polarization", 1, "S", (n,))[np.isfinite(measured)]
    needed = {("baseline", text.decode()) for text in set(polarization.tolist())}
    if len(polarization):
        needed.add(("dark", "any"))
    for kind, beam in sorted(needed - kinds):
        found.add(
            where,
            f"has no {kind} ({beam}), so r cannot be told",
            f"measure again with {kind} among the plan's [references]",
        )
