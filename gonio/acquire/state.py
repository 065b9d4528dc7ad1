"""Where a scan stands: the states of a `Runner` and the snapshots that it publishes."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from gonio.devices import Polarization


class State(enum.Enum):
    """State of a `Runner`.

    ::

        idle --run()--> preparing --> running --> done
         ^                  |          |   ^
         |                  |  pause() |   | resume()
         |                  |  a fault v   |
         |                  |        paused
         |                  v          |
         +------------- aborting <-----+   (stop() or Ctrl-C, from preparing, running or paused)

        preparing, running, paused --any error--> failed

    A stopped runner is idle again, and `run()` then continues where it was stopped; so does `run()` of a
    failed one.  A fault leads to *paused* only if the policy says so; before that the step is tried again in
    *running*.
    """

    IDLE = "idle"
    PREPARING = "preparing"
    RUNNING = "running"
    PAUSED = "paused"
    ABORTING = "aborting"
    FAILED = "failed"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What a progress bar or a window shows; published by the thread that runs the scan.

    Attributes
    ----------
    done, total : positions that are safe on the disk, and all of the plan
    readings_done, readings_total : readings at one wavelength, references included
    elapsed_s : instrument seconds since the scan began
    left_s : estimated instrument seconds to its end, from the plan's model and the pace so far
    position : number of the position being measured, between two of the last; None during references
    theta_i_deg, theta_mes_deg, polarization, wavelength_nm : what is being measured, None before it is known
    message : what is being done, or why the scan ended
    """

    state: State
    done: int
    total: int
    readings_done: int
    readings_total: int
    elapsed_s: float
    left_s: float
    position: int | None = None
    theta_i_deg: float | None = None
    theta_mes_deg: float | None = None
    polarization: Polarization | None = None
    wavelength_nm: float | None = None
    message: str = ""
