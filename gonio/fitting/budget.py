"""What does each cause contribute to the uncertainty of k_d, k_s, k_g, alpha and n2?  A GUM budget.

Every stated input shifts all readings together; the fit follows with ``-(J'WJ)^-1 J'W dr``, which is the
change of the result when another value of the input is used for the same readings (JCGM 100:2008, 5.1.3).
These shifts are the **modes** of a fit: they are no scatter, more positions or wavelengths do not average
them out.  The combined uncertainty adds their squares to those of the noise and of the baseline and dark
readings; it is expanded by Student's t for its effective degrees of freedom (Welch-Satterthwaite, JCGM
100:2008, G.4).

An input whose effect is even has no first order: its line is the root mean square of the effect, ``sqrt(E
x^4) r'' / 2``, which holds the bias that is not corrected too (JCGM 100:2008, note to 5.1.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.errors import FitError
from gonio.fitting.accepted import data_of, model_of
from gonio.fitting.budget_table import budget_table
from gonio.fitting.changes import Seen, changes
from gonio.fitting.covariance import random_and_common, shifts
from gonio.fitting.inputs import Input, inputs_of
from gonio.fitting.pulled import Data
from gonio.fitting.quantity import quantity_named
from gonio.fitting.widen import with_modes
from gonio.rig.uncertainty import UncertaintyConfig

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]

_COEFFICIENTS = ("k_d", "k_s", "k_g")


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """The budget of a fit at m wavelengths.

    Attributes
    ----------
    fit
        With the modes in its covariance and intervals.
    inputs
        g, stated or not; those not stated contribute nothing and are named in the table.
    quantities
        q names: k_d, k_s, k_g at `theta_i_deg`, then the parameters of the model.
    estimate
        (m, q)
    contribution
        (g, m, q), by one standard uncertainty of each input, with its sign; even inputs have none that means
        anything.
    noise, references
        (m, q) standard uncertainties: of the readings' noise, and of the baseline and dark readings of the
        scan.  What the fit has estimated for all wavelengths together (a shared n2) is in `shared`.
    shared
        (m, q)
    combined, coverage, dof
        (m, q) standard uncertainty, factor for 95 %, effective degrees of freedom.
    """

    fit: FitResult
    inputs: tuple[Input, ...]
    quantities: tuple[str, ...]
    theta_i_deg: float
    estimate: FloatArray
    contribution: FloatArray
    noise: FloatArray
    references: FloatArray
    shared: FloatArray
    combined: FloatArray
    coverage: FloatArray
    dof: FloatArray

    @property
    def expanded(self) -> FloatArray:
        """Expanded uncertainty, 95 %, (m, q)."""
        return self.coverage * self.combined

    @property
    def not_stated(self) -> tuple[str, ...]:
        """Names of the inputs that nothing was said about."""
        return tuple(given.name for given in self.inputs if given.u is None)

    def dominant(self, k: int, quantity: str) -> str:
        """Return the name of the largest contribution at wavelength number k."""
        q = self.quantities.index(quantity)
        named = {given.name: abs(self.contribution[g, k, q]) for g, given in enumerate(self.inputs)}
        named |= {
            "noise of the readings": self.noise[k, q],
            "baseline and dark readings": self.references[k, q],
        }
        named["shared by the wavelengths"] = self.shared[k, q]
        return max(named, key=lambda name: float(np.nan_to_num(named[name])))

    def table(self, wavelength_nm: float | None = None) -> str:
        """Return the budget at the measured wavelength next to the one given; in the middle without one."""
        return budget_table(self, self.at(wavelength_nm))

    def at(self, wavelength_nm: float | None) -> int:
        """Return the number of the wavelength with a result next to the one given."""
        known = np.flatnonzero(np.isfinite(self.estimate[:, 0]))
        if not known.size:
            raise FitError("the fit has no wavelength with a result, and so no budget; look at its notes")
        nm = self.fit.wavelength_nm[known]
        if wavelength_nm is None or not np.all(np.isfinite(nm)):
            return int(known[known.size // 2])
        return int(known[np.argmin(np.abs(nm - wavelength_nm))])


def budget(fit: FitResult, stated: UncertaintyConfig | None, *, theta_i_deg: float = 8.0) -> Budget:
    """Return the uncertainty budget of a fit.

    Parameters
    ----------
    fit
        Without modes of a budget already.
    stated
        ``[uncertainty]`` of the rig file (`gonio.fitting.inputs.stated_in`), None if there was none.
    theta_i_deg
        Incidence of the coefficients.

    Raises
    ------
    FitError
        The fit holds a budget already, or no wavelength has a result.

    Notes
    -----
    The changes of the readings are those of the exact aperture, whatever approximation was fitted, of a line
    of light.  The shift by a wrong wavelength is the slope of the fitted parameters over the wavelengths of
    one detector, by central differences.
    """
    if any(not name.startswith("shared") for name in fit.mode_names):
        raise FitError(
            "this fit's uncertainties hold a budget already; make the budget of the fit as it was made"
        )
    inputs = inputs_of(stated, fit.instrument)
    kind, m = fit.kind, len(fit.wavelength_nm)
    rows = np.flatnonzero(np.isfinite(fit.basic[:, 0]) & np.isfinite(fit.quantile))
    if not rows.size:
        raise FitError("the fit has no wavelength with a result, and so no budget; look at its notes")
    part = fit.only(np.isin(np.arange(m), rows))
    data = data_of(part, model_of(fit))
    is_s = fit.polarization_of == "s"
    seen = Seen(kind, fit.instrument, fit.theta_i_deg, fit.theta_o_deg, is_s, data.basic)
    held = _held(part, data)
    if fit.polarization != "joint" or np.all(is_s) or not np.any(is_s):
        inputs = tuple(given for given in inputs if _is_seen(given.name, is_s))
    modes = np.zeros((len(inputs), m, data.basic.shape[1]))
    moved = -shifts(data.model, data.basic, data.w, held, changes(seen, inputs))
    for g, given in enumerate(inputs):
        if given.name == "wavelength" and given.u:
            moved[g] = -given.u * np.nan_to_num(_slope(part)) * ~held
    modes[:, rows] = moved
    used = [g for g, given in enumerate(inputs) if given.u]
    widened = with_modes(fit, modes[used], tuple(inputs[g].name for g in used))
    return _assembled(fit, widened, part, data, held, inputs, modes, rows, theta_i_deg)


def _held(fit: FitResult, data: Data) -> NDArray[np.bool_]:
    """Return the basic parameters, (m, p), that no reading moves: given, undefined, or without a bound."""
    linear = len(data.model.linear)
    held = ~np.isfinite(np.diagonal(fit.basic_covariance, axis1=1, axis2=2))
    held[:, linear:] |= ~data.free
    return np.asarray(held)


def _is_seen(name: str, is_s: NDArray[np.bool_]) -> bool:
    """Whether an input means anything to these polarizations."""
    return (name != "baseline_s" or bool(np.any(is_s))) and (name != "baseline_p" or bool(np.any(~is_s)))


def _slope(fit: FitResult) -> FloatArray:
    """Return d basic / d wavelength, (m, p), 1/nm, within each detector; NaN for a wavelength by itself."""
    slope = np.full(fit.basic.shape, np.nan)
    for detector in np.unique(fit.detector_index):
        rows = np.flatnonzero((fit.detector_index == detector) & np.isfinite(fit.wavelength_nm))
        if rows.size > 1:
            slope[rows] = np.gradient(fit.basic[rows], fit.wavelength_nm[rows], axis=0)
    return slope


def _assembled(
    fit: FitResult,
    widened: FitResult,
    part: FitResult,
    data: Data,
    held: NDArray[np.bool_],
    inputs: tuple[Input, ...],
    modes: FloatArray,
    rows: NDArray[np.intp],
    theta_i_deg: float,
) -> Budget:
    names = (*_COEFFICIENTS, *fit.parameters)
    m, q = len(fit.wavelength_nm), len(names)
    h = fit.hemispherical(theta_i_deg)
    estimate = np.concatenate(
        [np.stack([getattr(h, c).value for c in _COEFFICIENTS], axis=1), fit.value], axis=1
    )
    u_fit = np.concatenate([np.stack([getattr(h, c).se for c in _COEFFICIENTS], axis=1), fit.se], axis=1)
    contribution = np.zeros((len(inputs), m, q))
    noise, shared = np.full((m, q), np.nan), np.full((m, q), np.nan)
    unit, _ = random_and_common(data.model, data.basic, data.w, held, None)
    for number, name in enumerate(names):
        gradient = np.where(held, 0.0, quantity_named(fit.kind, name, theta_i_deg).slopes(data.basic))
        contribution[:, rows, number] = np.einsum("gma,ma->gm", modes[:, rows], gradient)
        own = np.einsum("ma,mab,mb->m", gradient, np.nan_to_num(unit), gradient)
        noise[rows, number] = np.sqrt(data.scale * own)
        whole = quantity_named(fit.kind, name, theta_i_deg).slopes(data.basic)
        shared[rows, number] = np.sqrt(
            np.sum(np.einsum("gma,ma->gm", np.nan_to_num(part.modes), whole) ** 2, axis=0)
        )
    known = np.isfinite(estimate) & np.isfinite(u_fit)
    noise, shared = np.where(known, np.minimum(noise, u_fit), np.nan), np.where(known, shared, np.nan)
    references = np.sqrt(np.maximum(u_fit**2 - noise**2 - shared**2, 0.0))
    contribution = np.where(known, contribution, np.nan)
    combined = np.sqrt(u_fit**2 + np.sum(contribution**2, axis=0))
    dof = np.where(fit.dof > 0, fit.dof, 1).astype(np.float64)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        effective = dof * (combined / noise) ** 4
        coverage = special.stdtrit(np.minimum(effective, 1e12), 0.975)
    return Budget(
        widened, inputs, names, theta_i_deg, estimate, contribution, noise, references, shared, combined,
        np.asarray(coverage), effective,
    )  # fmt: skip
