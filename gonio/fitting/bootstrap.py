"""How would the estimates scatter if the fitted surface were measured again and again?

A parametric bootstrap: readings are drawn about the fit with the variance function that weighed them, and
fitted again; the noise scale of each replica is itself drawn, ``s^2 dof / chi2(dof)``, so that few degrees of
freedom widen the interval as Student's t does.  Two intervals follow (Davison & Hinkley, Bootstrap Methods,
1997, chapter 5): **percentile**, between the quantiles of the replicas, and **basic**, the same mirrored at
the estimate, which moves the interval against a bias instead of along it.  alpha, and the strength rho_s
where it is positive in all that counts, are mirrored on their logarithm.

Replicas are made in tiles of 256 of one wavelength, each with a random stream of its own, so that a replica
is the same number whatever else is asked for, and memory does not grow with the number of wavelengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import FitError
from gonio.fitting.accepted import data_of, model_of
from gonio.fitting.columns import BoolArray, FitModel, FloatArray, readings
from gonio.fitting.covariance import random_and_common
from gonio.fitting.kinds import coefficients
from gonio.fitting.limits import is_lobe
from gonio.fitting.pulled import Data
from gonio.fitting.solve import refine

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

TILE = 256
FEWEST_REPLICAS = 199
"""The 2.5 % quantile is then the fifth smallest; fewer tell little of a 95 % interval."""

_COMMON = 2**32 - 1  # stream of what all wavelengths share
_TAIL = 0.025


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Ends of 95 % intervals, (m, q) each; infinite where the replicas know no bound."""

    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Bootstrap:
    """What the replicas say of q quantities at m wavelengths.

    Attributes
    ----------
    names
        The model's parameters, then k_d, k_s, k_g at `theta_i_deg`.
    estimate
        (m, q) of the fit.
    mean, sd
        (m, q) of the replicas; NaN where one of them is infinite.
    percentile, basic
        The two kinds of intervals.
    failed
        (m,) replicas whose search did not converge; they are counted as they are.
    sample
        (replicas, m, q), or None if it was not to be kept.
    """

    names: tuple[str, ...]
    theta_i_deg: float
    wavelength_nm: FloatArray
    replicas: int
    seed: int
    estimate: FloatArray
    mean: FloatArray
    sd: FloatArray
    percentile: Intervals
    basic: Intervals
    failed: NDArray[np.int64]
    sample: FloatArray | None


def bootstrap(
    fit: FitResult,
    *,
    replicas: int = 1999,
    seed: int = 0,
    common: bool = False,
    wavelength_nm: ArrayLike | None = None,
    theta_i_deg: float = 8.0,
    keep_sample: bool = False,
) -> Bootstrap:
    """Return intervals of the parameters and of k_d, k_s, k_g from simulated repetitions.

    Parameters
    ----------
    replicas
        Repetitions per wavelength, at least `FEWEST_REPLICAS`.
    seed
        Of the random streams; the same seed gives the same numbers.
    common
        Whether the errors that readings share (baseline, dark, the budget's modes) are drawn too.  They move
        the parameters along their first-order shifts; what wavelengths share moves them together.
    wavelength_nm
        Wavelengths of the fit, nm; None takes all.
    theta_i_deg
        Incidence of the coefficients.
    keep_sample
        Whether to return every replica, ``8 * replicas * m * q`` bytes.

    Raises
    ------
    FitError
        Too few replicas, or a fit with a robust loss: replicas are fitted by squares.

    Notes
    -----
    The weights are those of the fit, a shared or given n2 is held and moved by its own uncertainty.  An
    estimate at the end of its range counts as infinite (n2: as 1), and rho_s with it.  Where no lobe is seen
    the fit is linear, and its own interval of the diffuse part is returned.
    """
    if replicas < FEWEST_REPLICAS:
        raise FitError(
            f"replicas = {replicas} are too few for a 95 % interval; ask for at least {FEWEST_REPLICAS}"
        )
    if fit.loss != "squares":
        raise FitError(
            f"replicas of a fit with loss = '{fit.loss}' would be fitted by squares, and scatter less; "
            "fit with loss = 'squares'"
        )
    if wavelength_nm is not None:
        fit = fit.only(np.isin(fit.wavelength_nm, np.atleast_1d(np.asarray(wavelength_nm, np.float64))))
    kind = fit.kind
    names = (*kind.parameters, "k_d", "k_s", "k_g")
    m, q = len(fit.wavelength_nm), len(names)
    h = fit.hemispherical(theta_i_deg)
    own = (h.k_d, h.k_s, h.k_g)
    estimate = np.concatenate([fit.value, np.stack([c.value for c in own], axis=1)], axis=1)
    ends = [
        np.concatenate([of_fit, np.stack([getattr(c, end) for c in own], axis=1)], axis=1)
        for of_fit, end in ((fit.lower, "lower"), (fit.upper, "upper"))
    ]
    percentile, mirrored = (Intervals(*(end.copy() for end in ends)) for _ in range(2))
    mean, sd = np.full((m, q), np.nan), np.full((m, q), np.nan)
    failed = np.zeros(m, np.int64)
    sample = np.full((replicas, m, q), np.nan) if keep_sample else None
    rows = np.flatnonzero(np.all(np.isfinite(fit.basic), axis=1) & np.isfinite(fit.quantile))
    if rows.size:
        model = model_of(fit)
        ratio = np.array([_is_on_log(kind, name) for name in names])
        for row in rows:
            part = fit.only(np.arange(m) == row)  # alone, so that its sums are rounded as ever
            data = data_of(part, model)
            shift = _Shifts.of(part, data, common)
            found, missed = _replicas(data, shift, _key(fit, int(row)), replicas, seed, theta_i_deg)
            failed[row] = missed
            ordered = np.sort(found, axis=0)
            first = int(np.floor((replicas + 1) * _TAIL)) - 1
            low, high = ordered[first], ordered[-1 - first]
            percentile.lower[row], percentile.upper[row] = low, high
            at = estimate[row]
            with np.errstate(divide="ignore", invalid="ignore"):
                on_log = ratio & (low > 0.0) & (at > 0.0)
                mirrored.lower[row] = np.where(on_log, at**2 / high, 2.0 * at - high)
                mirrored.upper[row] = np.where(on_log, at**2 / low, 2.0 * at - low)
                mean[row], sd[row] = _moments(found)
            if sample is not None:
                sample[:, row] = found
    return Bootstrap(
        names, theta_i_deg, fit.wavelength_nm, replicas, seed, estimate, mean, sd, percentile, mirrored,
        failed, sample,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Shifts:
    """First-order shifts of the basic parameters that are added to each replica.

    Attributes
    ----------
    together
        (g, m, p) by one standard uncertainty of causes that wavelengths share.
    apart
        (m, p, p): a square root of the covariance of the rest, independent from wavelength to wavelength.
    """

    together: FloatArray
    apart: FloatArray

    @classmethod
    def of(cls, fit: FitResult, data: Data, common: bool) -> _Shifts:
        """Take what belongs to the fit (a shared n2) always, the rest if asked for."""
        wanted = [common or name.startswith("shared") for name in fit.mode_names]
        together = np.nan_to_num(fit.modes[np.array(wanted, bool)])
        apart = np.zeros(fit.basic_covariance.shape)
        if common:
            held = np.isnan(np.diagonal(fit.basic_covariance, axis1=1, axis2=2))
            held[:, len(data.model.linear) :] |= ~data.free
            unit, _ = random_and_common(data.model, data.basic, data.w, held, None)
            modes = np.nan_to_num(fit.modes)
            rest = np.nan_to_num(fit.basic_covariance) - np.einsum("gma,gmb->mab", modes, modes)
            rest -= data.scale[:, None, None] * np.nan_to_num(unit)
            # in units of the parameters' own uncertainty; rounding may leave a direction slightly negative
            unit_of = np.sqrt(
                np.maximum(np.diagonal(np.nan_to_num(fit.basic_covariance), axis1=1, axis2=2), 0.0)
            )
            safe = np.where(unit_of > 0.0, unit_of, 1.0)
            value, vector = np.linalg.eigh(rest / (safe[:, :, None] * safe[:, None, :]))
            apart = safe[:, :, None] * vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]
        return cls(together, apart)


def _replicas(
    data: Data, shift: _Shifts, key: tuple[int, int], replicas: int, seed: int, theta_i_deg: float
) -> tuple[FloatArray, int]:
    """Return (replicas, q) estimates of the one wavelength of `data`, and how many searches failed."""
    model, linear = data.model, len(data.model.linear)
    expected = readings(model, data.basic)
    use = data.w > 0.0
    w = np.repeat(data.w, TILE, axis=1)
    sd = np.where(use, np.sqrt(data.scale / np.where(use, data.w, 1.0)), 0.0)
    dof = float(np.sum(use) - linear - np.sum(data.free))
    parts, failed = [], 0
    for tile in range(-(-replicas // TILE)):
        rng = _stream(seed, *key, tile)
        y = expected + sd * rng.standard_normal((expected.size, TILE)) * np.sqrt(
            dof / rng.chisquare(dof, TILE)
        )
        free = np.repeat(data.free, TILE, axis=0)
        begin = np.repeat(data.basic[:, linear:], TILE, axis=0)
        if not np.all(data.free):
            found = refine(model, y, w, begin, free=free)
        else:
            found = refine(model, y, w, model.start(y, w))
        count = min(TILE, replicas - tile * TILE)
        failed += int(np.sum(~found.converged[:count]))
        at_low = found.basic[:, linear:] <= model.low
        at_high = found.basic[:, linear:] >= model.high
        basic = found.basic + rng.standard_normal((TILE, found.basic.shape[1])) @ shift.apart[0].T
        if shift.together.size:
            z = _stream(seed, _COMMON, 0, tile).standard_normal((TILE, len(shift.together)))
            basic = basic + z @ shift.together[:, 0]
        values = _values(type(model), basic, at_low & data.free, at_high & data.free, theta_i_deg)
        parts.append(values[:count])
    return np.concatenate(parts), failed


def _values(
    kind: type[FitModel], basic: FloatArray, at_low: BoolArray, at_high: BoolArray, theta_i_deg: float
) -> FloatArray:
    """Return parameters and coefficients, (r, q); what stands at an end of its range has no bound there."""
    linear = len(kind.linear)
    inside = basic.copy()
    for a, name in enumerate(kind.shape):
        if name == "n2":  # a shift may carry an index below 1
            inside[:, linear + a] = np.maximum(inside[:, linear + a], kind.low[a])
    published = kind.published(inside)
    k = coefficients(kind, inside, theta_i_deg)
    for a, name in enumerate(kind.shape):
        if name.startswith("log_"):
            column = kind.parameters.index(name.removeprefix("log_"))
            published[at_high[:, a], column], published[at_low[:, a], column] = np.inf, 0.0
        elif name == "n2":
            column = kind.parameters.index(name)
            published[at_high[:, a], column], published[at_low[:, a], column] = np.inf, 1.0
            for strength in (i for i, x in enumerate(kind.parameters) if is_lobe(x)):
                rows = at_low[:, a]
                published[rows, strength] = np.copysign(np.inf, published[rows, strength])
    return np.concatenate([published, np.stack([k[0], k[1], k[0] + k[1]], axis=1)], axis=1)


def _moments(found: FloatArray) -> tuple[FloatArray, FloatArray]:
    finite = np.all(np.isfinite(found), axis=0)
    safe = np.where(finite, found, 0.0)
    return (
        np.where(finite, np.mean(safe, axis=0), np.nan),
        np.where(finite, np.std(safe, axis=0, ddof=1), np.nan),
    )


def _is_on_log(kind: type[FitModel], name: str) -> bool:
    return f"log_{name}" in kind.shape or (name in kind.parameters and is_lobe(name))


def _key(fit: FitResult, k: int) -> tuple[int, int]:
    """Return what names a wavelength whatever others are there: picometres and detector, or its number."""
    nm = float(fit.wavelength_nm[k])
    return (round(1000.0 * nm), int(fit.detector_index[k])) if np.isfinite(nm) else (k, 2**16)


def _stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
