"""The fit: four parameters per wavelength with intervals, from a scan or from plain arrays."""

from gonio.fitting.estimate import fit, fit_readings
from gonio.fitting.file import load_fit
from gonio.fitting.ordinary import LeastSquares, least_squares, nlparci
from gonio.fitting.result import (
    ApertureModel,
    Coefficient,
    FitResult,
    Hemispherical,
    IntervalMethod,
    PolarizationChoice,
)

__all__ = [
    "ApertureModel",
    "Coefficient",
    "FitResult",
    "Hemispherical",
    "IntervalMethod",
    "LeastSquares",
    "PolarizationChoice",
    "fit",
    "fit_readings",
    "least_squares",
    "load_fit",
    "nlparci",
]
