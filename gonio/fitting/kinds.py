"""Which models can be fitted, by name, and what is asked of a fitted surface whatever its model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from gonio.brdf import ScatteringModel
from gonio.errors import FitError
from gonio.fitting.columns import FitModel, FloatArray
from gonio.fitting.models import FIT_MODELS
from gonio.fitting.problem import Problem
from gonio.fitting.separate import SeparateSurfaces, separate_surfaces
from gonio.fresnel import Polarization

if TYPE_CHECKING:
    from gonio.fitting.result import PolarizationChoice

ModelName = Literal["published", "phong", "reciprocal", "lambert", "ggx", "coupled"]

_KINDS: dict[str, type[FitModel]] = {"published": Problem, **FIT_MODELS}


def model_named(name: str, polarization: PolarizationChoice = "joint") -> type[FitModel]:
    """Return the model class of a name; with surfaces of their own for S and P if that was chosen.

    Raises
    ------
    FitError
        An unknown name, or a model without the index that S and P are to share.
    """
    if name not in _KINDS:
        raise FitError(f"model = {name!r} is not known; use one of {', '.join(_KINDS)}")
    kind = _KINDS[name]
    return separate_surfaces(kind) if polarization == "shared_n2" else kind


def coefficients(kind: type[FitModel], basic: FloatArray, theta_i_deg: float) -> FloatArray:
    """Return k_d, k_s above the horizon and k_s as published, (3, m), the mean of S and P (Eq 19-21).

    Parameters
    ----------
    basic
        (m, p), all finite.
    theta_i_deg
        Incidence.
    """
    published = kind.published(basic)
    surfaces: tuple[ScatteringModel, ScatteringModel]
    if issubclass(kind, SeparateSurfaces):
        surfaces = kind.surfaces(published)
    else:
        surfaces = (kind.scattering(published),) * 2
    return 0.5 * (_of(surfaces[0], theta_i_deg, "s") + _of(surfaces[1], theta_i_deg, "p"))


def _of(surface: ScatteringModel, theta_i_deg: float, polarization: Polarization) -> FloatArray:
    k_d = surface.diffuse_albedo(theta_i_deg, polarization)
    k_s = surface.specular_albedo(theta_i_deg, polarization)
    published = surface.published_albedo(theta_i_deg, polarization) - k_d
    return np.stack(np.broadcast_arrays(k_d, k_s, published)).astype(np.float64)


def coefficient_slopes(kind: type[FitModel], basic: FloatArray, theta_i_deg: float) -> FloatArray:
    """Return the derivatives of `coefficients` by the basic parameters, (3, m, p), by central differences.

    The step of 1e-5 in a shape parameter leaves 1e-9 of the slope; at an end of its range it is
    stepped beyond it.
    """
    slopes = np.empty((3, *basic.shape))
    for a in range(basic.shape[1]):
        step = 1e-5 * np.maximum(np.abs(basic[:, a]), 0.1)
        if a < len(kind.linear):
            step = np.ones(len(basic))  # exact: the coefficients are linear in these
        elif kind.shape[a - len(kind.linear)] == "n2":
            step = 1e-5 * (basic[:, a] - 1.0)  # never below 1
        moved = np.zeros_like(basic)
        moved[:, a] = step
        up = coefficients(kind, basic + moved, theta_i_deg)
        down = coefficients(kind, basic - moved, theta_i_deg)
        slopes[:, :, a] = (up - down) / (2.0 * step)
    return slopes
