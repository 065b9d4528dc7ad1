"""The truth behind the foreign devices: a signal that anybody can compute by hand."""

from __future__ import annotations

from collections.abc import Callable

DARK_V = 1.25e-3
FULL_V = 0.8


def reflectance(theta_i_deg: float, theta_mes_deg: float, polarization: str) -> float:
    """Reflected over incident power; linear in the angles."""
    return 0.05 + 1e-3 * theta_i_deg + 5e-4 * theta_mes_deg + (0.01 if polarization == "s" else 0.0)


def lamp(wavelength_nm: float) -> float:
    """Of the full beam."""
    return 0.25 + wavelength_nm / 2000.0


class ForeignBench:
    """Asks the devices where they stand, at the moment at which the lock-in looks."""

    def __init__(self) -> None:
        self.theta_i_deg: Callable[[], float] = lambda: 0.0
        self.theta_mes_deg: Callable[[], float] = lambda: 180.0
        self.polarizer_deg: Callable[[], float] = lambda: 0.0
        self.wavelength_nm: Callable[[], float] = lambda: 500.0
        self.is_open: Callable[[], bool] = lambda: True

    def signal_v(self) -> float:
        if not self.is_open():
            return DARK_V
        theta_i_deg, theta_mes_deg = self.theta_i_deg(), self.theta_mes_deg()
        power = FULL_V * lamp(self.wavelength_nm())
        if abs(theta_i_deg - 90.0) < 0.5 and abs(theta_mes_deg - 180.0) < 0.5:
            return DARK_V + power  # the direct beam
        polarization = "s" if abs(self.polarizer_deg()) < 1.0 else "p"
        return DARK_V + power * reflectance(theta_i_deg, theta_mes_deg, polarization)
