"""How many requests a poll, a move and a reading take: counted on the lines themselves.

`benchmarks/wire.py` prints the same figures beside the time of each request.
"""

from __future__ import annotations

import numpy as np
import pytest

from gonio_drivers.lines import Line
from gonio_drivers.zaber import ZaberDrive


def stage_line(rig) -> Line:
    line = rig.stage._line
    return line if isinstance(line, Line) else line.line


def test_round_trips_of_a_poll_and_of_moves(instant_stage_bench):
    """One request to see whether it may start, one command (Modbus: target, then start), one poll, and one
    look at the end that the count is true (its encoder, or what a restart forgets).

    A move that lasts longer than the first poll takes another one: on a slower clock it depends on the
    machine how many there are.
    """
    with instant_stage_bench.open() as rig:
        axis, statistics = rig.stage.theta_i, stage_line(rig).statistics

        def cost(target_deg: float) -> int:
            before = statistics.replies
            axis.start(target_deg)
            axis.wait()
            return statistics.replies - before

        command = 1 if isinstance(axis._drive, ZaberDrive) else 2
        one_leg, two_legs = 1 + command + 1 + 1, 1 + 2 * (command + 1) + 1
        inward = outward = 100
        for _ in range(8):  # the fewest of several: a process held up between two polls needs one more
            cost(80.0)
            inward = min(inward, *(cost(target_deg) for target_deg in range(78, 62, -2)))
            outward = min(outward, *(cost(target_deg) for target_deg in range(66, 80, 2)))
            if (inward, outward) == (one_leg, two_legs):
                break
        assert (inward, outward) == (one_leg, two_legs)
        assert cost(78.0) == 1, "it stands there already"
        before = statistics.replies
        axis._drive.state()
        assert statistics.replies == before + 1


def test_a_reading_is_one_request_to_each_instrument(bench):
    """What a pass costs besides, it costs once: so it is the difference of two lengths that counts."""
    with bench.open() as rig:
        spectrometer = rig.spectrometer
        lines = spectrometer._monochromator.line, spectrometer._lockin.line

        def cost(n: int) -> list[int]:
            before = [line.statistics.replies for line in lines]
            wavelength_nm = np.linspace(450.0, 540.0, n)
            spectrometer.measure_spectrum(wavelength_nm, np.zeros(n, dtype=np.uint8), beam="direct")
            return [line.statistics.replies - count for line, count in zip(lines, before, strict=True)]

        cost(10)  # finds grating, filter, port, shutter and range
        short, long = cost(10), cost(40)
        assert [b - a for a, b in zip(short, long, strict=True)] == [30, 30]
        assert [count - 10 for count in short] == pytest.approx([0, 0], abs=6), "once per pass"
