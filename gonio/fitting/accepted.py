"""Which values of a parameter or coefficient does a fit accept?  Profiles of a `FitResult`, in words too."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from gonio.errors import FitError
from gonio.fitting.columns import BoolArray, FitModel, FloatArray, readings
from gonio.fitting.covariance import random_and_common
from gonio.fitting.limits import is_lobe
from gonio.fitting.profile import Ends, profile_curve, profile_ends
from gonio.fitting.pulled import Data, coordinate_slopes, delta_variance
from gonio.fitting.quantity import Quantity, quantity_named

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

_EXACT = 1e-11  # residuals of this part of the readings are rounding, and the profile of rounding is none
_NO_VARIANCE = 1e-9  # of the total: a parameter whose own random variance is less was held
_BEYOND = 0.25  # of the interval, that the curve shows on either side


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Profile likelihood of one quantity at m wavelengths.

    Attributes
    ----------
    name
        Of the quantity.
    wavelength_nm
        (m,)
    estimate, lower, upper
        (m,) each; ±inf where the data give no bound, NaN where the quantity is undefined.
    threshold
        (m,), rise of chi2 at the ends of the interval of the random part, ``t^2 s^2``.
    value, chi2
        (points, m) the curve; `chi2` is the rise above the minimum.
    """

    name: str
    wavelength_nm: FloatArray
    estimate: FloatArray
    lower: FloatArray
    upper: FloatArray
    threshold: FloatArray
    value: FloatArray
    chi2: FloatArray

    def text(self, k: int) -> str:
        """Return the interval at wavelength number k as people say it: "alpha >= 900 (95 %)"."""
        at, low, high = (float(x[k]) for x in (self.estimate, self.lower, self.upper))
        if np.isnan(at):
            return f"{self.name} is undefined"
        if np.isinf(low) and np.isinf(high):
            return f"{self.name} is not determined"
        if np.isinf(high):
            return f"{self.name} >= {low:.4g} (95 %)"
        if np.isinf(low):
            return f"{self.name} <= {high:.4g} (95 %)"
        return f"{self.name} = {at:.6g}, {low:.6g} ... {high:.6g} (95 %)"


def profile(
    fit: FitResult,
    name: str,
    wavelength_nm: ArrayLike | None = None,
    *,
    theta_i_deg: float = 8.0,
    points: int = 41,
) -> Profile:
    """Return the profile likelihood of a parameter or coefficient.

    Parameters
    ----------
    name
        See `gonio.fitting.quantity.quantity_named`: rho_d, rho_s, alpha, n2, k_n, k_d, k_s, k_g, ...
    wavelength_nm
        Wavelengths of the fit, nm (both columns where two detectors measured one); None takes all.
    theta_i_deg
        Incidence of k_d, k_s, k_g, degrees.
    points
        Of the curve; 0 for the interval alone.

    Raises
    ------
    FitError
        An unknown quantity, or a fit with a robust loss, whose optimum is not that of chi2.

    Notes
    -----
    The curve and the threshold are those of the random part.  The interval's ends include the uncertainty
    that readings share (baseline, dark, shared n2, budget): on each side the square root of the sum of the
    squares of the profile's half width and t times that uncertainty, for alpha on its logarithm.  Where no
    lobe is seen the fit is linear, and the interval of k_d is its own; there is no curve, nor is there one of
    a parameter that was given.
    """
    if fit.loss != "squares":
        raise FitError(
            f"loss = '{fit.loss}' has no profile of chi2, for its optimum is another; use 'wald', or fit "
            "with loss = 'squares'"
        )
    if wavelength_nm is not None:
        wanted = np.atleast_1d(np.asarray(wavelength_nm, np.float64))
        fit = fit.only(np.isin(fit.wavelength_nm, wanted))
    quantity = quantity_named(fit.kind, name, theta_i_deg)
    m = len(fit.wavelength_nm)
    ends = Ends(np.full(m, np.nan), np.full(m, np.nan))
    estimate, threshold = np.full(m, np.nan), np.full(m, np.nan)
    value, rise = np.full((points, m), np.nan), np.full((points, m), np.nan)
    defined, no_lobe = _defined(fit, quantity), _without_lobe(fit)
    rows = np.flatnonzero(no_lobe & _is_diffuse(name))
    if rows.size:
        own = _of_fit(fit, name, theta_i_deg)
        estimate[rows], ends.lower[rows], ends.upper[rows] = (x[rows] for x in own)
    rows = np.flatnonzero(defined & ~no_lobe)
    if rows.size:
        keep = np.zeros(m, bool)
        keep[rows] = True
        part = fit.only(keep)
        data = data_of(part)
        found = profile_ends(data, quantity, common_variance(data, quantity, part.basic_covariance))
        estimate[rows], threshold[rows] = quantity.of(data.basic), data.quantile**2 * data.scale
        ends.lower[rows], ends.upper[rows] = found.lower, found.upper
        if points:
            low, high = _shown(estimate[rows], found)
            value[:, rows], chi2 = profile_curve(data, quantity, low, high, points)
            given = np.zeros(rows.size, bool) if quantity.shape is None else ~data.free[:, quantity.shape]
            rise[:, rows] = np.where(given, np.nan, chi2 - data.chi2)
    return Profile(name, fit.wavelength_nm, estimate, ends.lower, ends.upper, threshold, value, rise)


def data_of(fit: FitResult, model: FitModel | None = None) -> Data:
    """Return the least-squares problems that a fit has solved, at all its wavelengths.

    `model` is the fit's own, if it is at hand (`model_of`): to tabulate a lobe takes time.
    Where a shape parameter has no value it stands at 1.5 (n2) or 0; where it was held it is not free.
    """
    kind = fit.kind
    linear = len(kind.linear)
    used = np.isfinite(fit.residual) & np.isfinite(fit.sigma)
    w = np.where(used, 1.0 / np.where(used, fit.sigma, 1.0) ** 2, 0.0)
    basic = fit.basic.copy()
    known = np.isfinite(basic)
    basic = np.where(known, basic, [0.0] * linear + [1.5 if name == "n2" else 0.0 for name in kind.shape])
    model = model_of(fit) if model is None else model
    y = np.where(used, np.nan_to_num(fit.residual), 0.0)
    expected = readings(model, basic)
    y = np.where(used, y + expected, 0.0)
    chi2 = np.sum(w * np.where(used, y - expected, 0.0) ** 2, axis=0)
    dof = np.where(fit.dof > 0, fit.dof, 1).astype(np.float64)
    rounding = fit.rms < _EXACT * np.max(np.abs(y), axis=0)
    return Data(model, y, w, basic, chi2, _free(fit), np.where(rounding, 0.0, chi2 / dof), fit.quantile)


def model_of(fit: FitResult) -> FitModel:
    """Return the model at the fit's positions, through its receiver."""
    from gonio.fitting.result import receiver_of

    receiver = receiver_of(fit.instrument, fit.beam, fit.aperture)
    return fit.kind.of(receiver, fit.theta_i_deg, fit.theta_o_deg, fit.polarization_of == "s")


def _free(fit: FitResult) -> BoolArray:
    """Return the shape parameters, (m, k), that each wavelength chose for itself."""
    linear = len(fit.kind.linear)
    total = np.diagonal(fit.basic_covariance, axis1=1, axis2=2)[:, linear:]
    own = total - np.sum(np.nan_to_num(fit.modes) ** 2, axis=0)[:, linear:]
    held = own <= _NO_VARIANCE * np.abs(total)  # False where the variance is not known: an open end
    return np.asarray(np.isfinite(fit.basic[:, linear:]) & ~held)


def _defined(fit: FitResult, quantity: Quantity) -> BoolArray:
    """Return where a quantity has a value, (m,), if there is a lobe."""
    kind, name = fit.kind, quantity.name
    names = (*kind.linear, *kind.shape)
    if name in kind.parameters:
        value = fit.value[:, kind.parameters.index(name)]
    elif name in names:
        value = fit.basic[:, names.index(name)]
    else:
        value = fit.basic[:, 0] if name == "k_d" else np.sum(fit.basic, axis=1)
    known = np.isfinite(value) & np.isfinite(fit.basic[:, 0]) & np.isfinite(fit.quantile)
    has_lobe = any(is_lobe(which) for which in kind.linear)
    return np.asarray(known & (has_lobe | _is_diffuse(name)))


def _without_lobe(fit: FitResult) -> BoolArray:
    lobes = [k for k, which in enumerate(fit.kind.linear) if is_lobe(which)]
    return np.asarray(np.all(fit.basic[:, lobes] == 0.0, axis=1) & bool(lobes))


def _is_diffuse(name: str) -> bool:
    """Whether a quantity has a value without a lobe."""
    return name.startswith(("rho_d", "k_d", "k_g"))


def _of_fit(fit: FitResult, name: str, theta_i_deg: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return value and ends of the fit's own interval."""
    if name in fit.parameters:
        column = fit.parameters.index(name)
        return fit.value[:, column], fit.lower[:, column], fit.upper[:, column]
    c = getattr(fit.hemispherical(theta_i_deg), name)
    return c.value, c.lower, c.upper


def common_variance(data: Data, quantity: Quantity, covariance: FloatArray) -> FloatArray:
    """Return the part of a quantity's variance that is not random, (m,), on the scale that profiles widen.

    `covariance` (m, p, p) is the whole one of the basic parameters, NaN where one is unknown.
    """
    linear = len(data.model.linear)
    held = np.isnan(np.diagonal(covariance, axis1=1, axis2=2))
    known = np.where(held, 0.0, coordinate_slopes(quantity, data.basic))
    held[:, linear:] |= ~data.free
    unit, _ = random_and_common(data.model, data.basic, data.w, held, None)
    own = delta_variance(np.where(held, 0.0, known), unit)
    return np.maximum(delta_variance(known, covariance) - data.scale * own, 0.0)


def _shown(estimate: FloatArray, ends: Ends) -> tuple[FloatArray, FloatArray]:
    """Return the range of the curve: the interval and a quarter more; where it is open, as the estimate."""
    low, high = estimate - ends.lower, ends.upper - estimate
    size = np.maximum(np.abs(estimate), 1e-3)
    below = np.where(np.isfinite(low), low, 0.9 * size / (1.0 + _BEYOND))
    above = np.where(np.isfinite(high), high, 4.0 * size)
    return estimate - (1.0 + _BEYOND) * below, estimate + (1.0 + _BEYOND) * above


def with_profile_intervals(fit: FitResult) -> FitResult:
    """Return a fit whose parameters have the intervals of their profiles, open ends included.

    Where a profile does not exist (no lobe, nothing fitted) the fit's own interval stays.
    """
    lower, upper = fit.lower.copy(), fit.upper.copy()
    for column, name in enumerate(fit.parameters):
        found = profile(fit, name, points=0)
        known = ~np.isnan(found.lower) & ~np.isnan(found.upper)
        lower[known, column], upper[known, column] = found.lower[known], found.upper[known]
        if name == "n2":  # without a lower bound is without one but 1
            lower[:, column] = np.where(np.isneginf(lower[:, column]), 1.0, lower[:, column])
        elif f"log_{name}" in fit.kind.shape:
            lower[:, column] = np.where(np.isneginf(lower[:, column]), 0.0, lower[:, column])
    return replace(fit, lower=lower, upper=upper, intervals="profile")
