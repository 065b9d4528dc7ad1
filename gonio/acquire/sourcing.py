"""Which source of positions a scan has, what it may answer, and whether it is the one that began it."""

from __future__ import annotations

import importlib.metadata
import inspect
import re
import sys
from collections.abc import Sequence
from contextlib import suppress

from gonio.acquire.history import History
from gonio.errors import GonioError, RefusedError, StoreError
from gonio.plan.check import Refusal, refused_visit
from gonio.plan.model import MAX_POSITIONS, MAX_READINGS, Plan, Position
from gonio.plan.source import Measured, PositionSource, check_same, decide
from gonio.rig import RigConfig
from gonio.store.records import SourceFacts

_GROUP = "gonio.sources"
_BY_THE_SCRIPT = "python"
_LONGEST_TEXT = 100_000


class Asked:
    """A source whose answers are what they should be: a `PositionSource` that fails with a `GonioError`."""

    def __init__(self, source: PositionSource, plan: Plan, rig: RigConfig) -> None:
        self._source, self._plan, self._rig = source, plan, rig
        self.facts = _facts_of(source)
        self.max_positions = self.facts.max_positions

    def next(self, measured: Sequence[Measured]) -> Position | None:
        """Return what the source says; it cannot change what it is shown."""
        try:
            answer = self._source.next(tuple(measured))
        except GonioError:
            raise
        except Exception as error:
            raise RefusedError(
                f"the source of positions {self.facts.name} failed at position {len(measured) + 1} "
                f"({type(error).__name__}: {error}); mend it and resume the scan"
            ) from error
        if answer is None:
            return None
        try:
            return Position(
                int(answer.index), float(answer.theta_i_deg), float(answer.theta_mes_deg), answer.polarization
            )
        except (AttributeError, TypeError, ValueError, OverflowError):
            raise RefusedError(
                f"the source of positions {self.facts.name} gave {answer!r:.80} for position "
                f"{len(measured) + 1}; it must give a gonio.plan.Position, or None at the end"
            ) from None

    def decide(self, decided: Sequence[Position], measured: Sequence[Measured]) -> Position | None:
        """Return the next position, which the rig may visit and the references serve, or None at the end."""
        position, _ = decide(self, self._rig, decided, measured)
        if position is None:
            if not decided:
                raise RefusedError(
                    f"the source of positions {self.facts.name} asks for no position at all; there is "
                    "nothing to measure"
                )
            return None
        if position.polarization not in self._plan.polarization:
            raise RefusedError(
                f"the source of positions asks for polarization {position.polarization!r} at position "
                f"{position.index + 1}, which is not in the plan's polarization = "
                f"{list(self._plan.polarization)}, for which baselines are measured; add it there"
            )
        reason = self._refused_between_references(position)
        if reason:
            raise RefusedError(f"the source of positions asks for {Refusal(reason, position)}")
        return position

    def _refused_between_references(self, position: Position) -> str:
        references = self._plan.references
        if not (references.dark or references.baseline or references.periodic_kinds):
            return ""
        at = position.theta_i_deg, position.theta_mes_deg
        baseline = self._rig.baseline.theta_i_deg, self._rig.baseline.theta_mes_deg
        return refused_visit(self._rig, baseline, at) or refused_visit(self._rig, at, baseline)


def asked(source: PositionSource | None, plan: Plan, rig: RigConfig) -> Asked | None:
    """Return the source that is given, or that the plan names; None if the plan says what is measured.

    Raises
    ------
    RefusedError
        The plan leaves its positions to a source, and there is none of that name; or the file cannot have
        room for all that it may ask for.
    """
    if source is None and plan.source is not None:
        source = _named(plan.source.name, plan, rig)
    if source is None:
        return None
    found = Asked(source, plan, rig)
    most = min(MAX_POSITIONS, MAX_READINGS // len(plan.wavelength_nm))
    if not 1 <= found.max_positions <= most:
        raise RefusedError(
            f"the source of positions {found.facts.name} has max_positions = {found.max_positions}; give 1 "
            f"to {most} for {len(plan.wavelength_nm)} wavelengths"
        )
    return found


def must_be_same(
    source: Asked | None, begun_with: SourceFacts | None, history: History | None, *, ask_again: bool
) -> str:
    """Make sure that a scan goes on with the source that began it, and return what is to be told of it.

    Raises
    ------
    StoreError
        It is another source, or gives other positions for what was measured.
    """
    if begun_with is None or history is None:
        if source is not None:
            raise StoreError(
                "the scan was begun without a source of positions, its plan says what is measured; resume it "
                "without one"
            )
        return ""
    if source is None:
        raise StoreError(
            f"the scan was begun with the source of positions {begun_with.name}; resume it with "
            "gonio.acquire.resume_scan(path, rig, source=...)"
        )
    facts = source.facts
    if facts.max_positions > begun_with.max_positions:
        raise StoreError(
            f"the source of positions {facts.name} may ask for {facts.max_positions} positions, and the scan "
            f"was begun with room for {begun_with.max_positions}; set its max_positions to that"
        )
    is_other = (facts.name, facts.version) != (begun_with.name, begun_with.version)
    change = (
        f"source of positions {facts.name} {facts.version}".rstrip()
        + f" in place of {begun_with.name} {begun_with.version}".rstrip()
    )
    if not ask_again:
        return f"{change}, not asked again for what is measured" if is_other else ""
    if facts.name != begun_with.name:
        raise StoreError(
            f"the scan was begun with the source of positions {begun_with.name}, not with {facts.name}; "
            "resume it with that one, or with ask_again=False if there is none any more"
        )
    check_same(source, history.measured, history.decided[len(history.measured) :])
    return f"{change}, which gives the same {len(history.measured)} positions" if is_other else ""


def _named(name: str, plan: Plan, rig: RigConfig) -> PositionSource:
    """Return the installed source that a plan names; its entry point is a callable given plan and rig."""
    if name == _BY_THE_SCRIPT:
        raise RefusedError(
            f"the plan '{plan.title}' leaves its positions to the script that runs it ([source] name = "
            f'"{_BY_THE_SCRIPT}"); give Runner or resume_scan a source=...'
        )
    points = {point.name: point for point in importlib.metadata.entry_points(group=_GROUP)}
    if name not in points:
        raise RefusedError(
            f"the plan '{plan.title}' asks for the source of positions '{name}', which is not installed; "
            f"installed ({_GROUP}): {', '.join(sorted(points)) or 'none'}"
        )
    source: PositionSource = points[name].load()(plan, rig)
    return source


def _facts_of(source: PositionSource) -> SourceFacts:
    """Return what a source says of itself (`name`, `version`, `text`), or what can be found out."""
    kind = type(source)
    package = sys.modules.get(kind.__module__.partition(".")[0])
    text = getattr(source, "text", None)
    if text is None:
        text = re.sub(r" at 0x[0-9a-fA-F]+", "", repr(source))  # an address tells nothing
        with suppress(OSError, TypeError):  # typed in at a prompt
            text += "\n\n" + inspect.getsource(kind)
    given = (
        getattr(source, "name", f"{kind.__module__}.{kind.__qualname__}"),
        getattr(source, "version", getattr(package, "__version__", "")),
        str(text)[:_LONGEST_TEXT],
    )
    name, version, text = (
        str(part).replace("\x00", "\N{SYMBOL FOR NULL}").encode("utf-8", "replace").decode("utf-8")
        for part in given
    )
    return SourceFacts(name, version, text, int(source.max_positions))
