"""Any use of polarizer, monochromator and lock-in in any order, on bad lines and with power cuts: what is
reported as a reading was measured as it says.
"""

from __future__ import annotations

from collections.abc import Callable

import hypothesis.strategies as st
import numpy as np
from hypothesis import note
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from gonio.devices import Quality
from gonio.errors import GonioError

from .machines import RECOVERIES, run_machine
from .world import World

TROUBLES = ("lost request", "lost reply", "late 1.5", "late 3", "late 6", "noise before", "cut", "split")
"""No changed bits: nothing on these lines tells one digit from another."""

LIMIT_OF_SETTLING = 2e-4  # relative: what 12 time constants leave is far less, but a drive may end late
RESOLUTION_V = 4e-5  # of the coarsest range


class OpticsMachine(RuleBasedStateMachine):
    """Polarizer and spectrometer with their simulators; the stage stands."""

    def __init__(self) -> None:
        super().__init__()
        self.world: World | None = None

    @initialize(seed=st.integers(0, 2**16))
    def begin(self, seed: int) -> None:
        self.world = world = World(seed=seed)
        self._installed = world.installed()
        self._installed.__enter__()
        try:
            self.rig = world.open_rig()
        except BaseException:
            self._installed.__exit__(None, None, None)
            self.world = None  # nothing to close
            raise
        self.rig.move_to(20.0, 60.0)

    def teardown(self) -> None:
        if self.world is not None:
            self.rig.close()
            self._installed.__exit__(None, None, None)

    @rule(polarization=st.sampled_from(("s", "p")))
    def select(self, polarization: str) -> None:
        assert self.world is not None
        got: list[float] = []
        if self.attempt(lambda: got.append(self.rig.polarizer.select(polarization))) is None:
            wanted_deg = {"s": 0.0, "p": 90.0}[polarization]
            true_deg = self.world.bench.polarizer.angle_deg()
            assert abs(got[0] - wanted_deg) <= 0.1
            assert abs(true_deg - got[0]) <= 0.01, (
                f"{polarization} reads {got[0]} deg and stands at {true_deg}"
            )

    @rule(
        wavelength_nm=st.floats(200.0, 1600.0)
        | st.sampled_from((200.0, 380.0, 700.0, 860.0, 859.9999, 1600.0)),
        beam=st.sampled_from(("sample", "direct", "dark")),
    )
    def measure(self, wavelength_nm: float, beam: str) -> None:
        """One wavelength; the value is what the detector gives with the light path that was asked for."""
        assert self.world is not None
        bench = self.world.bench
        wavelengths = np.array([wavelength_nm])
        detector = self.rig.config.detector_for(wavelengths)
        got: list[object] = []
        measure = self.rig.spectrometer.measure_spectrum
        if self.attempt(lambda: got.append(measure(wavelengths, detector, beam=beam))) is not None:
            return
        reading = got[0]
        path = bench.monochromator.state_at(self.world.time.now_s)
        mono = self.rig.config.spectrometer.monochromator
        assert path.shutter_open is (beam != "dark")
        assert path.output_port == detector[0] + 1
        assert path.grating == mono.grating_for(wavelength_nm)
        assert path.filter == mono.filter_for(wavelength_nm)
        assert abs(path.wavelength_nm - wavelength_nm) <= mono.tolerance_nm
        assert abs(reading.wavelength_nm[0] - path.wavelength_nm) <= 0.01
        if not reading.quality[0] & Quality.OVER_RANGE:
            true_v = bench.detector_signal(self.world.time.now_s).mean_v
            error_v = abs(reading.signal_v[0] - true_v)
            assert error_v <= LIMIT_OF_SETTLING * abs(true_v) + RESOLUTION_V, (reading.signal_v[0], true_v)

    @rule(wavelength_nm=st.sampled_from((np.nan, np.inf, -1.0, 0.0, 199.9, 1600.1, 1e300)))
    def measure_where_nothing_is(self, wavelength_nm: float) -> None:
        measure = self.rig.spectrometer.measure_spectrum
        index = np.zeros(1, dtype=np.uint8)
        assert self.attempt(lambda: measure(np.array([wavelength_nm]), index)) is not None

    @rule()
    def close_shutter(self) -> None:
        assert self.world is not None
        if self.attempt(self.rig.spectrometer.close_shutter) is None:
            self.world.time.advance(1.0)
            assert not self.world.bench.monochromator.shutter_open

    @rule()
    def recover(self) -> None:
        self.attempt(self.rig.spectrometer.recover)
        self.attempt(self.rig.polarizer.recover)

    @rule(duration_s=st.floats(0.0, 20.0))
    def time_passes(self, duration_s: float) -> None:
        assert self.world is not None
        self.world.time.advance(duration_s)

    @rule(
        role=st.sampled_from(("polarizer", "monochromator", "lockin")),
        troubles=st.lists(st.sampled_from((*TROUBLES, *[""] * 6)), max_size=6),
    )
    def line_goes_bad(self, role: str, troubles: list[str]) -> None:
        assert self.world is not None
        self.world.cables[role].troubles.extend(troubles)

    @rule(
        role=st.sampled_from(("polarizer", "monochromator", "lockin")),
        delay_s=st.floats(0.0, 2.0),
        duration_s=st.floats(0.0, 20.0),
    )
    def cable_is_pulled(self, role: str, delay_s: float, duration_s: float) -> None:
        assert self.world is not None
        cable = self.world.cables[role]
        self.world.time.at(delay_s, lambda: cable.unplug(duration_s))

    @rule(role=st.sampled_from(("polarizer", "monochromator", "lockin")), delay_s=st.floats(0.0, 2.0))
    def power_fails_for_a_moment(self, role: str, delay_s: float) -> None:
        assert self.world is not None
        cable = self.world.cables[role]

        def cut() -> None:
            cable.instrument.power_cycle()  # type: ignore[attr-defined]
            cable.restart()

        self.world.time.at(delay_s, cut)

    @rule()
    def everything_is_well_again(self) -> None:
        """After the worst, with the causes gone, recovering works and the next reading is right."""
        assert self.world is not None
        self.world.time.advance(60.0)
        for cable in self.world.cables.values():
            cable.troubles.clear()
        self.world.time.advance(10.0)
        for device in (self.rig.spectrometer, self.rig.polarizer):
            for _ in range(RECOVERIES):
                if (error := self.attempt(device.recover)) is None:
                    break
                self.world.time.advance(5.0)
            assert error is None, error
        self.select("p")
        self.measure(550.0, "sample")

    def attempt(self, action: Callable[[], object]) -> GonioError | None:
        """Call a driver: it may fail, but only by an error that a user can act on."""
        try:
            action()
        except GonioError as error:
            note(f"   {type(error).__name__}: {error}")
            return error
        return None


def test_optics() -> None:
    run_machine(OpticsMachine, max_examples=15)
