"""The simulated optical bench: what is true there, and the hardware that measures it.  It knows no wire."""

from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.bench.lockin import Lockin
from gonio_simulators.bench.monochromator import Monochromator
from gonio_simulators.bench.motor import Fault, Motor, MotorHardware

__all__ = ["Bench", "BenchConfig", "Fault", "Lockin", "Monochromator", "Motor", "MotorHardware"]
