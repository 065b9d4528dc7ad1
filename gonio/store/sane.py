"""Is a record from the disk what its type says?

A checksum tells that a record is as it was written, not by whom: one made by hand must be refused as clearly
as a damaged one.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any, get_args

import numpy as np

from gonio.aperture import Aperture
from gonio.devices import Polarization
from gonio.errors import ConfigError
from gonio.plan.model import MAX_POSITIONS
from gonio.store.records import (
    DecisionRecord,
    Level,
    Record,
    ReferenceKind,
    RigFacts,
    ScanHeader,
    SourceFacts,
)

_WORDS: dict[str, tuple[str, ...]] = {
    "ReferenceKind": get_args(ReferenceKind),
    "Level": get_args(Level),
    "Polarization": get_args(Polarization),
}
_ARRAYS = {
    "FloatArray": "f",
    "NDArray[np.uint16]": "u",
    "NDArray[np.uint8]": "u",
    "NDArray[np.integer]": "iu",
}
_DETECTOR = re.compile(r"[\w.+-]*\w[\w.+-]*")
_LARGEST = 2**31


def refuse_nonsense(record: Record, header: ScanHeader) -> None:
    """Raise `ValueError` if a field of a record is not of its type, or not for the header's wavelengths."""
    m = int(np.size(header.detector_index))
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        kinds = [kind.strip() for kind in str(field.type).split("|")]
        if not any(_is(kind, value, m) for kind in kinds):
            shown = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"{value!r:.60}"
            raise ValueError(f"{field.name} is {shown}, expected {field.type}")
    if record is header:
        try:
            Aperture(header.rig.width_mm, header.rig.height_mm, header.rig.distance_mm)
            _ = header.rig.beam
        except ConfigError as error:
            raise ValueError(str(error)) from None
    if record is header and header.detector_index.max(initial=0) >= len(header.rig.detectors):
        raise ValueError("detector_index names a detector that the rig has not")
    if isinstance(record, DecisionRecord):
        if header.source is None:
            raise ValueError("a decision, but the scan was begun without a source of positions")
        if not np.all(np.isfinite([record.theta_i_deg, record.theta_mes_deg])):
            raise ValueError("a decision for no angle")
        if record.index >= header.source.max_positions:
            raise ValueError(f"a decision beyond max_positions = {header.source.max_positions}")


def _is(kind: str, value: Any, m: int) -> bool:
    if kind in _ARRAYS:
        return isinstance(value, np.ndarray) and value.shape == (m,) and value.dtype.kind in _ARRAYS[kind]
    if kind in _WORDS:
        return isinstance(value, str) and value in _WORDS[kind]
    if isinstance(value, bool):
        return False
    match kind:
        case "None":
            return value is None
        case "str":
            return isinstance(value, str) and "\x00" not in value
        case "int":
            return isinstance(value, int) and 0 <= value < _LARGEST
        case "float":
            return isinstance(value, float) or (isinstance(value, int) and abs(value) < _LARGEST)
        case "dict[str, str]":
            return isinstance(value, dict) and all(
                _is("str", text, m) for pair in value.items() for text in pair
            )
        case "RigFacts":
            return isinstance(value, RigFacts) and _is_rig(value, m)
        case "SourceFacts":
            return isinstance(value, SourceFacts) and _is_source(value, m)
    return False


def _is_rig(rig: RigFacts, m: int) -> bool:
    parts: list[Any] = [rig, *rig.detectors]
    right = all(
        any(_is(kind.strip(), getattr(part, field.name), m) for kind in str(field.type).split("|"))
        for part in parts
        for field in dataclasses.fields(part)
        if field.name != "detectors"
    )
    return right and all(_DETECTOR.fullmatch(detector.name) for detector in rig.detectors)


def _is_source(source: SourceFacts, m: int) -> bool:
    """Say whether there can be such a source; the file has room for all that it may ask for."""
    texts = all(_is("str", text, m) for text in (source.name, source.version, source.text))
    return texts and _is("int", source.max_positions, m) and 1 <= source.max_positions <= MAX_POSITIONS
