"""From bluesky's documents to the same `.h5` that `gonio scan` writes.

`NexusWriter` is a callback for the RunEngine, or for documents that somebody kept.  One run becomes one file,
written when the run has ended::

    RE.subscribe(NexusWriter("sample.h5", rig.config))

What it needs of a run: events with the axes ``theta_i`` and ``theta_mes`` and a `SpectrumDetector`
(`gonio.acquire.bluesky_devices`).  Events with the light on ``dark`` or ``direct`` are references, the others
positions in the order in which they came.  Without references r is NaN: `with_references` and `paper_scan` of
`gonio.acquire.bluesky_plans` take them.

This path has no journal: until the run ends its events are bluesky's to keep.  `gonio scan` is the one that
survives a power cut.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.acquire.session import facts_of, refuse_existing
from gonio.config import validate
from gonio.devices import FloatArray
from gonio.errors import StoreError
from gonio.plan.model import Plan, parse_plan
from gonio.plan.tables import Sample
from gonio.rig import RigConfig
from gonio.store.file import ScanFile
from gonio.store.records import EventRecord, PositionRecord, ReferenceKind, ReferenceRecord, ScanHeader

_KEYS = ("theta_i", "theta_mes", "spectrum_signal", "spectrum_light")
_DIGITS = 2  # of a degree: an axis is as near as that to where it was sent


class NexusWriter:
    """Writes one run into one file; call it with each document.

    Parameters
    ----------
    path
        The `.h5`, which must not exist.
    rig
        The rig that the run was measured on.
    """

    def __init__(self, path: str | Path, rig: RigConfig) -> None:
        self.path = Path(path)
        self._rig = rig
        self._start: Mapping[str, Any] | None = None
        self._configuration: dict[str, Any] = {}
        self._streams: set[str] = set()
        self._references: list[ReferenceRecord] = []
        self._positions: list[PositionRecord] = []
        self._before: list[int] = []  # of each reference: positions measured before it
        self._zero_s: float | None = None

    def __call__(self, name: str, document: Mapping[str, Any]) -> None:
        """Take a document; those of no interest are passed over."""
        if name == "start":
            if self._start is not None:
                raise StoreError(f"{self.path}: holds one run only; make a NexusWriter for each")
            refuse_existing(self.path)
            self._start = document
        elif name == "descriptor":
            self._descriptor(document)
        elif name == "event" and document["descriptor"] in self._streams:
            self._event(document["data"], document["time"])
        elif name == "event_page" and document["descriptor"] in self._streams:
            for row, unix_s in enumerate(document["time"]):
                self._event({key: column[row] for key, column in document["data"].items()}, unix_s)
        elif name == "stop":
            self._stop(document)

    # -- documents -------------------------------------------------------------------------------------------

    def _descriptor(self, document: Mapping[str, Any]) -> None:
        missing = [key for key in _KEYS if key not in document["data_keys"]]
        if missing:
            if "spectrum_signal" in document["data_keys"]:
                raise StoreError(
                    f"{self.path}: the events of this run lack {', '.join(missing)}; read all of "
                    "BlueskyDevices.detectors at every point"
                )
            return  # a stream of something else, a baseline of temperatures perhaps
        self._streams.add(document["uid"])
        self._configuration = document["configuration"]["spectrum"]["data"]

    def _event(self, data: Mapping[str, Any], unix_s: float) -> None:
        arrays = {
            name: np.asarray(data[f"spectrum_{name}"], dtype=np.float64)
            for name in ("signal", "signal_sd", "wavelength", "time")
        }
        if self._zero_s is None:
            self._zero_s = float(np.nanmin(arrays["time"]))
        time_s: FloatArray = arrays["time"] - self._zero_s
        quality: NDArray[np.uint16] = np.asarray(data["spectrum_quality"], dtype=np.uint16)
        averages = np.asarray(data["spectrum_averages"], dtype=np.uint32)
        theta_i, theta_mes = float(data["theta_i"]), float(data["theta_mes"])
        light = data["spectrum_light"]
        if light == "sample":
            self._positions.append(
                PositionRecord(
                    len(self._positions),
                    data["spectrum_polarization"],
                    theta_i,
                    theta_mes,
                    float(data["spectrum_polarizer_angle"]),
                    averages,
                    unix_s,
                    arrays["wavelength"],
                    arrays["signal"],
                    arrays["signal_sd"],
                    time_s,
                    quality,
                )
            )
            return
        kind: ReferenceKind = "dark" if light == "dark" else "baseline"
        self._before.append(len(self._positions))
        self._references.append(
            ReferenceRecord(
                kind,
                "",
                data["spectrum_polarization"],
                theta_i,
                theta_mes,
                averages,
                unix_s,
                arrays["wavelength"],
                arrays["signal"],
                arrays["signal_sd"],
                time_s,
                quality,
            )
        )

    def _stop(self, document: Mapping[str, Any]) -> None:
        if not self._positions:
            return  # nothing was measured, and an empty file would say otherwise
        assert self._start is not None
        refuse_existing(self.path)
        header, plan = self._header()
        ended = document["exit_status"] == "success"
        with_partial = self.path.with_name(self.path.name + ".part")
        file = ScanFile(with_partial, header, plan, "w")
        try:
            for reference, before in zip(self._references, self._before, strict=True):
                file.add_reference(self._named(reference, before))
            file.add_positions(self._positions)
            run = f"bluesky run {self._start['uid']}"
            self._tell(file, document, "info" if ended else "error", f"{run}: {document['exit_status']}")
            if reason := document.get("reason"):
                self._tell(file, document, "warning", str(reason))
            if ended:
                file.finish(_iso(document["time"]))
            file.move_to(self.path)
            file.close()
        except BaseException:
            file.abandon()
            with_partial.unlink(missing_ok=True)
            raise

    def _tell(self, file: ScanFile, document: Mapping[str, Any], level: Any, message: str) -> None:
        last_s = float(np.nanmax(self._positions[-1].time_s))
        file.add_event(EventRecord(last_s, document["time"], level, "bluesky", message))

    # -- what the file needs besides -------------------------------------------------------------------------

    def _header(self) -> tuple[ScanHeader, Plan]:
        assert self._start is not None
        found = self._configuration
        asked = parse_plan(found["spectrum_plan"], source="the plan in the run's configuration")
        title = str(self._start.get("title", asked.title))
        name = self._start.get("sample")
        sample = Sample(name=name) if isinstance(name, str) and name != asked.sample.name else asked.sample
        plan = asked.model_copy(update={"title": title, "sample": sample})
        if not self._is_as_planned(asked):
            tables = asked.model_dump(exclude={"sweeps", "positions_listed", "order", "repeats"})
            measured = [p for p in ("s", "p") if any(r.polarization == p for r in self._positions)]
            tables |= {"title": title, "sample": sample.model_dump(), "polarization": measured}
            plan = validate(Plan, tables | {"positions": [self._visited()]}, source="the plan of the run")
        header = ScanHeader(
            plan_text=plan.to_toml(),
            rig_text=self._rig.text,
            rig=facts_of(self._rig),
            detector_index=np.asarray(found["spectrum_columns_detector"], dtype=np.uint8),
            devices=dict(entry.split("=", 1) for entry in found["spectrum_devices"]),
            program=f"{found['spectrum_program']} (bluesky)",
            start_time=_iso(self._start["time"]),
            unix_s=float(self._start["time"]),
            wavelength_nm=np.asarray(found["spectrum_columns_wavelength"], dtype=np.float64),
        )
        return header, plan

    def _is_as_planned(self, plan: Plan) -> bool:
        """Say whether the run visited the positions of the plan, all and in its order."""
        planned, near_deg = plan.positions(), 2.0 * 10**-_DIGITS
        return len(planned) == len(self._positions) and all(
            at.polarization == record.polarization
            and abs(at.theta_i_deg - record.theta_i_deg) < near_deg
            and abs(at.theta_mes_deg - record.theta_mes_deg) < near_deg
            for at, record in zip(planned, self._positions, strict=True)
        )

    def _visited(self) -> dict[str, Any]:
        """Return the places in the order of the visits, as a position list.

        A plan names each place once; a further visit is set apart by a millionth of a degree.
        """
        theta_mes: list[float] = []
        visits: Counter[tuple[float, float, str]] = Counter()
        for record in self._positions:
            place = (
                round(record.theta_i_deg, _DIGITS),
                round(record.theta_mes_deg, _DIGITS),
                record.polarization,
            )
            theta_mes.append(round(place[1] + 1e-6 * visits[place], 6))
            visits[place] += 1
        return {
            "theta_i_deg": [round(record.theta_i_deg, _DIGITS) for record in self._positions],
            "theta_mes_deg": theta_mes,
            "polarization": [record.polarization for record in self._positions],
        }

    def _named(self, reference: ReferenceRecord, before: int) -> ReferenceRecord:
        """Say when a reference was taken, as a scan does."""
        if before == 0:
            when = "start"
        elif before == len(self._positions):
            when = "end"
        else:
            when = f"before {before}"
        return dataclasses.replace(reference, when=when)


def _iso(unix_s: float) -> str:
    return datetime.datetime.fromtimestamp(unix_s).astimezone().isoformat(timespec="seconds")
