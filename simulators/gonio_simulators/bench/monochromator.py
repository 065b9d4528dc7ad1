"""The monochromator: which light leaves it, now and while its mechanics move.

Every command takes bench time and starts when the previous one is done.  While the grating turns to another
wavelength the light sweeps with it; while gratings, filters or the output mirror change, no light passes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from gonio_simulators.bench.config import BandTable, MonochromatorTable
from gonio_simulators.clock import BenchClock

SLEW_NM_S = 175.0  # drive of the grating
SLEW_START_S = 0.02
GRATING_CHANGE_S = 5.0
FILTER_STEP_S = 0.8  # from one place of the wheel to the next
OUTPUT_CHANGE_S = 1.0
SHUTTER_S = 0.02
SLIT_STEP_S = 0.5
POWER_ON_S = 10.0  # the drive looks for its home

DRIVE_DECIMALS = 2
"""The drive moves in steps of 0.01 nm; where it stands is as exact as it was asked for."""

NOMINAL_SLIT_UM = 600.0
"""Slit width at which the detectors see `full_beam_v`."""

EVERYTHING_NM = (1.0, 100_000.0)


@dataclass(frozen=True, slots=True)
class Stuck:
    """Something does not do what it was told."""

    silent: bool  # the controller believes that it did
    error_code: int  # what the controller notices, -1 for nothing
    part: float = 0.0  # of the way that is made


class Notice(NamedTuple):
    """What the controller believes of its mechanics; None: what is true."""

    wavelength_nm: float | None = None
    grating: int | None = None
    filter: int | None = None
    shutter_open: bool | None = None


class LightPath(NamedTuple):
    """The state of everything between lamp and sample that the monochromator moves."""

    wavelength_nm: float
    grating: int
    filter: int
    shutter_open: bool
    output_port: int
    slit_um: float
    blocked: bool = False  # a turret, wheel or mirror is between two places


@dataclass(frozen=True, slots=True)
class _Change:
    start_s: float
    end_s: float
    before: LightPath
    after: LightPath
    dark: bool


class Monochromator:
    """Grating monochromator with an order-sorting filter wheel, a shutter and two or more output ports.

    Parameters
    ----------
    table
        Gratings and filters with the ranges they are meant for.
    output_ports
        The ports that have a detector.
    clock
        Bench time.
    before_command
        Called before each command changes the light, so that whoever integrates the past can do so first.
    """

    def __init__(
        self,
        table: MonochromatorTable,
        output_ports: Sequence[int],
        clock: BenchClock,
        before_command: Callable[[], None] | None = None,
    ) -> None:
        everything = (BandTable(number=1, range_nm=EVERYTHING_NM),)
        self.gratings: dict[int, tuple[float, float]] = {
            g.number: g.range_nm for g in table.gratings or everything
        }
        self.filters: dict[int, tuple[float, float]] = {
            f.number: f.range_nm for f in table.filters or everything
        }
        self.output_ports = tuple(output_ports)
        self.clock = clock
        self.before_command = before_command
        self.interfere: Callable[[str], Stuck | None] | None = None
        """Asked before each change of "wavelength", "grating", "filter" or "shutter" whether it sticks."""
        self._error_code = -1
        self._believes = Notice()
        grating, low = next((n, r[0]) for n, r in self.gratings.items())
        self._power_on = self._now = LightPath(
            wavelength_nm=max(low, 500.0) if low < 500.0 < self.gratings[grating][1] else low,
            grating=grating,
            filter=next(iter(self.filters)),
            shutter_open=False,
            output_port=self.output_ports[0],
            slit_um=NOMINAL_SLIT_UM,
        )
        self._changes: list[_Change] = []
        self.busy_until_s = 0.0

    def goto(self, wavelength_nm: float) -> None:
        """Turn the grating to a wavelength."""
        low, high = self.wavelength_range_nm
        if not low <= wavelength_nm <= high:
            raise ValueError(
                f"wavelength = {wavelength_nm:g} nm is outside the drive's range {low:g}...{high:g} nm"
            )
        start_nm = self._now.wavelength_nm
        target_nm = wavelength_nm = float(wavelength_nm)
        stuck = self._stuck("wavelength", start_nm != target_nm)
        self._believes = self._believes._replace(wavelength_nm=None)
        if stuck is not None:
            wavelength_nm = round(start_nm + stuck.part * (target_nm - start_nm), DRIVE_DECIMALS)
            if stuck.silent:
                self._believes = self._believes._replace(wavelength_nm=target_nm)
        distance = abs(wavelength_nm - start_nm)
        duration = SLEW_START_S + distance / SLEW_NM_S if distance > 0 else 0.0
        self._change(duration, self._now._replace(wavelength_nm=wavelength_nm), dark=False)

    def select_grating(self, number: int) -> None:
        """Turn the turret to a grating."""
        if number not in self.gratings:
            raise ValueError(f"grating {number} is not fitted ({sorted(self.gratings)} are)")
        stuck = self._stuck("grating", number != self._now.grating)
        self._believes = self._believes._replace(
            grating=number if stuck is not None and stuck.silent else None
        )
        duration = GRATING_CHANGE_S if number != self._now.grating else 0.0
        if stuck is not None:  # the drive tries for as long, with the grating still in the beam
            self._change(duration, self._now, dark=False)
        else:
            self._change(duration, self._now._replace(grating=number), dark=True)

    def select_filter(self, number: int) -> None:
        """Turn the filter wheel."""
        if number not in self.filters:
            raise ValueError(f"filter {number} is not fitted ({sorted(self.filters)} are)")
        stuck = self._stuck("filter", number != self._now.filter)
        self._believes = self._believes._replace(
            filter=number if stuck is not None and stuck.silent else None
        )
        duration = FILTER_STEP_S * abs(number - self._now.filter)
        if stuck is not None:
            self._change(duration, self._now, dark=False)
        else:
            self._change(duration, self._now._replace(filter=number), dark=True)

    def set_output_port(self, number: int) -> None:
        """Send the light to another detector's port."""
        if number not in self.output_ports:
            raise ValueError(f"output port {number} is not fitted ({list(self.output_ports)} are)")
        duration = OUTPUT_CHANGE_S if number != self._now.output_port else 0.0
        self._change(duration, self._now._replace(output_port=number), dark=True)

    def set_shutter(self, is_open: bool) -> None:
        """Open or close the shutter."""
        stuck = self._stuck("shutter", is_open != self._now.shutter_open)
        self._believes = self._believes._replace(
            shutter_open=is_open if stuck is not None and stuck.silent else None
        )
        if stuck is not None:
            is_open = self._now.shutter_open
        duration = SHUTTER_S if is_open != self._now.shutter_open else 0.0
        self._change(duration, self._now._replace(shutter_open=is_open), dark=False)

    def set_slit(self, width_um: float) -> None:
        """Set the width of the slits."""
        if not width_um > 0:
            raise ValueError(f"slit = {width_um:g} um must be above zero")
        duration = SLIT_STEP_S if width_um != self._now.slit_um else 0.0
        self._change(duration, self._now._replace(slit_um=float(width_um)), dark=False)

    def abort(self) -> None:
        """Stop the grating where it is; changes that wait for it do not happen."""
        if self.before_command is not None:
            self.before_command()
        now_s = self.clock.now_s()
        here = self.state_at(now_s)
        self._changes = [c for c in self._changes if c.end_s <= now_s]
        self._now = here._replace(blocked=False)
        self.busy_until_s = now_s

    def power_cycle(self) -> None:
        """Switch off and on: the shutter falls shut, everything goes to where it is at power-on."""
        self.abort()
        self._believes, self._error_code = Notice(), -1
        self._now = self._now._replace(shutter_open=False)
        self._change(POWER_ON_S, self._power_on, dark=True)

    def take_error(self) -> int:
        """Return what went wrong since the last look, in the controller's code; -1 for nothing."""
        code, self._error_code = self._error_code, -1
        return code

    def is_busy(self) -> bool:
        """Say whether something still moves."""
        return self.clock.now_s() < self.busy_until_s

    @property
    def wavelength_range_nm(self) -> tuple[float, float]:
        """The wavelengths the drive can go to with any grating."""
        ranges = self.gratings.values()
        return min(r[0] for r in ranges), max(r[1] for r in ranges)

    @property
    def wavelength_nm(self) -> float:
        """The centre wavelength now, as the controller knows it."""
        believed = self._believes.wavelength_nm
        if believed is not None and not self.is_busy():
            return believed
        return self.state_at(self.clock.now_s()).wavelength_nm

    @property
    def grating(self) -> int:
        """The grating in the beam, or the one that is being left."""
        believed = self._believes.grating
        return self.state_at(self.clock.now_s()).grating if believed is None else believed

    @property
    def filter(self) -> int:
        """The filter in the beam, or the one that is being left."""
        believed = self._believes.filter
        return self.state_at(self.clock.now_s()).filter if believed is None else believed

    @property
    def shutter_open(self) -> bool:
        """Whether the shutter is open, as the controller knows it."""
        believed = self._believes.shutter_open
        return self.state_at(self.clock.now_s()).shutter_open if believed is None else believed

    @property
    def output_port(self) -> int:
        """The port that has the light, or the one that is being left."""
        return self.state_at(self.clock.now_s()).output_port

    @property
    def slit_um(self) -> float:
        """The slit width."""
        return self.state_at(self.clock.now_s()).slit_um

    def state_at(self, time_s: float) -> LightPath:
        """Return the light path at a bench time, back to the last `forget_before`."""
        for change in self._changes:
            if time_s < change.start_s:
                return change.before
            if time_s < change.end_s:
                if change.dark:
                    return change.before._replace(blocked=True)
                part = (time_s - change.start_s) / (change.end_s - change.start_s)
                a, b = change.before.wavelength_nm, change.after.wavelength_nm
                return change.before._replace(wavelength_nm=round(a + (b - a) * part, DRIVE_DECIMALS))
        return self._now

    def changes_between(self, start_s: float, end_s: float) -> list[tuple[float, float]]:
        """Return the start and end of each change that overlaps an interval."""
        return [(c.start_s, c.end_s) for c in self._changes if c.end_s > start_s and c.start_s < end_s]

    def forget_before(self, time_s: float) -> None:
        """Drop the history that nobody will ask for."""
        if self._changes and self._changes[0].end_s <= time_s:
            self._changes = [c for c in self._changes if c.end_s > time_s]

    def _stuck(self, what: str, changes: bool) -> Stuck | None:
        """Say whether a change that is asked for happens; note the error that the controller sees."""
        if self.interfere is None:
            return None
        stuck = self.interfere(what) if changes else None
        self._error_code = -1 if stuck is None or stuck.silent else stuck.error_code
        return stuck

    def _change(self, duration_s: float, after: LightPath, *, dark: bool) -> None:
        if self.before_command is not None:
            self.before_command()
        start_s = max(self.clock.now_s(), self.busy_until_s)
        if duration_s > 0:
            self._changes.append(_Change(start_s, start_s + duration_s, self._now, after, dark))
            self.busy_until_s = start_s + duration_s
        self._now = after
