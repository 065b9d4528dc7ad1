"""How do a fit's covariances and intervals change when causes that all wavelengths share are added?"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]


def with_modes(fit: FitResult, modes: FloatArray, names: tuple[str, ...]) -> FitResult:
    """Return a fit with more modes in its covariance, standard uncertainties and intervals.

    Parameters
    ----------
    modes, names
        (g, m, p), (g,): shifts of the basic parameters by one standard uncertainty of each cause.

    Notes
    -----
    Each half width of an interval becomes the root of its square and that of t times the added uncertainty,
    for alpha on its logarithm; an open end stays open.
    """
    if not names:
        return fit
    kind = fit.kind
    known = np.where(np.isfinite(fit.basic), fit.basic, 1.5)
    transform = kind.published_jacobian(known)
    added = np.einsum("mab,gmb->gma", transform, modes)
    basic_covariance = fit.basic_covariance + np.einsum("gma,gmb->mab", modes, modes)
    covariance = fit.covariance + np.einsum("gma,gmb->mab", added, added)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    half = fit.quantile[:, None] * np.sqrt(np.sum(added**2, axis=0))
    lower, upper = (
        fit.value - np.hypot(fit.value - fit.lower, half),
        fit.value + np.hypot(fit.upper - fit.value, half),
    )
    for shape, name in enumerate(kind.shape):
        if name.startswith("log_"):
            column, at = kind.parameters.index(name.removeprefix("log_")), len(kind.linear) + shape
            log_half = fit.quantile * np.sqrt(np.sum(modes[:, :, at] ** 2, axis=0))
            value = fit.value[:, column]
            with np.errstate(divide="ignore", invalid="ignore"):
                down, up = np.log(value / fit.lower[:, column]), np.log(fit.upper[:, column] / value)
            lower[:, column] = value * np.exp(-np.hypot(down, log_half))
            upper[:, column] = value * np.exp(np.hypot(up, log_half))
    return replace(
        fit,
        basic_covariance=basic_covariance,
        covariance=covariance,
        se=np.sqrt(variance),
        lower=lower,
        upper=upper,
        modes=np.concatenate([fit.modes, modes]),
        mode_names=(*fit.mode_names, *names),
    )
