"""Which parameters do the data hardly tell apart?  Condition, correlations, worst direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.limits import is_lobe
from gonio.fitting.quantity import quantity_named

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]

_PART = 0.3  # of the largest component, above which a parameter belongs to a direction
_CONSTANT = 0.1  # of the strength's relative change: what changes less along a direction is held by the data
_TOLD = 10.0  # condition number below which nothing need be said


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """How well the parameters of m wavelengths are told apart.

    Attributes
    ----------
    names
        Of p parameters.
    condition
        (m,) condition number of their correlation matrix; inf where one is not determined, NaN without a fit.
    correlation
        (m, p, p)
    direction
        (m, p) relative changes of the parameters by one standard uncertainty of the combination that the data
        tell least: the first axis of the correlation matrix; NaN where a parameter is not determined.
    text
        m sentences, empty where the condition number is below 10.
    """

    names: tuple[str, ...]
    condition: FloatArray
    correlation: FloatArray
    direction: FloatArray
    text: tuple[str, ...]


def identifiability(fit: FitResult) -> Identifiability:
    """Return how well a fit's parameters are told apart, at each wavelength.

    Notes
    -----
    Along the eigenvector v of the correlation matrix with the largest eigenvalue l the parameters move by
    ``sqrt(l) se_i v_i`` for one standard uncertainty of that combination.  What stays constant meanwhile,
    though its factors do not, is what the data tell: rho_s R rather than rho_s and n2.
    """
    m, p = fit.value.shape
    variance = np.diagonal(fit.covariance, axis1=1, axis2=2)
    whole = np.all(np.isfinite(fit.value) & np.isfinite(variance), axis=1)
    varied = np.where(whole[:, None], variance > 0.0, False)  # a given n2 has no uncertainty
    sd = np.sqrt(np.where(varied, variance, 1.0))
    both = varied[:, :, None] & varied[:, None, :]
    correlation = np.where(both, np.nan_to_num(fit.covariance) / (sd[:, :, None] * sd[:, None, :]), 0.0)
    fitted = np.isfinite(fit.value[:, 0])
    eigenvalue, axes = np.linalg.eigh(correlation + np.where(varied, 0.0, 1.0)[:, :, None] * np.eye(p))
    condition = eigenvalue[:, -1] / np.maximum(eigenvalue[:, 0], np.finfo(float).tiny)
    condition = np.where(whole, condition, np.where(fitted, np.inf, np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = np.sqrt(eigenvalue[:, -1:]) * np.where(varied, sd, 0.0) * axes[:, :, -1] / fit.value
    direction = np.where(whole[:, None], direction, np.nan)
    correlation = np.where(whole[:, None, None], correlation, np.nan)
    text = tuple(
        _sentence(fit, k, float(condition[k]), axes[k, :, -1], direction[k], varied[k]) for k in range(m)
    )
    return Identifiability(fit.parameters, condition, correlation, direction, text)


def _sentence(
    fit: FitResult,
    k: int,
    condition: float,
    axis: FloatArray,
    direction: FloatArray,
    varied: NDArray[np.bool_],
) -> str:
    if np.isnan(condition):
        return ""
    if np.isinf(condition):
        missing = [
            name
            for name, value, se in zip(fit.parameters, fit.value[k], fit.se[k], strict=True)
            if not (np.isfinite(value) and np.isfinite(se))
        ]
        return f"{_joined(missing)} {'is' if len(missing) == 1 else 'are'} not determined by these data"
    if condition < _TOLD:
        return ""
    part = np.flatnonzero((np.abs(axis) > _PART * np.max(np.abs(axis))) & varied)
    if part.size < 2:
        return ""
    names = [fit.parameters[i] for i in part]
    changes = ", ".join(f"{fit.parameters[i]} {100.0 * direction[i]:+.2g} %" for i in part)
    return (
        f"condition number {condition:.3g}: {_joined(names)} move together ({changes} for one standard "
        "uncertainty of what is told least)" + _told_best(fit, k, direction)
    )


def _told_best(fit: FitResult, k: int, direction: FloatArray) -> str:
    """Return which product of a strength and R changes least along a direction, at a measured incidence."""
    strengths = [i for i, name in enumerate(fit.parameters) if is_lobe(name)]
    if not strengths or "n2" not in fit.parameters or not np.all(np.isfinite(fit.basic[k])):
        return ""
    here = fit.basic[k : k + 1]
    step = np.linalg.solve(fit.kind.published_jacobian(here)[0], direction * fit.value[k])
    changes = []
    for theta_i_deg in fit.incidences_deg:
        k_s = quantity_named(fit.kind, "k_s_published", theta_i_deg)
        changes.append(float(k_s.slopes(here)[0] @ step) / float(k_s.of(here)[0]))
    least = int(np.argmin(np.abs(changes)))
    if abs(changes[least]) > _CONSTANT * max(abs(direction[i]) for i in strengths):
        return ""
    return (
        f", while {fit.parameters[strengths[0]]} R at {fit.incidences_deg[least]:g} deg changes by "
        f"{100.0 * changes[least]:+.1g} %"
    )


def _joined(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
