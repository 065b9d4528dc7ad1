"""From readings to a `FitResult`: select, solve, weigh, solve again, and say how far it can be trusted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.aperture import APERTURE_NAMES, Aperture, ApertureName, IncidentBeam
from gonio.errors import FitError
from gonio.fitting.accepted import with_profile_intervals
from gonio.fitting.assemble import Setting, assemble
from gonio.fitting.columns import BoolArray, FitModel, FloatArray
from gonio.fitting.covariance import CommonMode
from gonio.fitting.dispersion import Dispersion, dispersion_of
from gonio.fitting.given import Given, real, uncertainty
from gonio.fitting.kinds import ModelName, model_named
from gonio.fitting.result import FitResult, IntervalMethod, PolarizationChoice, receiver_of
from gonio.fitting.robust import Loss
from gonio.fitting.shared import Detectors
from gonio.fitting.weighing import Used, WeightMethod, solve_weighed

if TYPE_CHECKING:
    from gonio.store import Scan

N2Choice = str | float | ArrayLike
"""``"free"``, a dispersion by name, one index, or one per wavelength."""

_UNTOLD_N2 = 1.5  # stands in where one incidence and polarization cannot tell it

_CHOICES: dict[str, tuple[str, ...]] = {
    "aperture": APERTURE_NAMES,
    "polarization": ("joint", "s", "p", "shared_n2"),
    "weights": ("auto", "r_sd", "none"),
    "intervals": ("wald", "profile", "nlparci"),
    "loss": ("squares", "huber", "tukey"),
}


def fit(
    scan: Scan,
    *,
    aperture: ApertureName = "exact",
    beam: bool = True,
    polarization: PolarizationChoice = "joint",
    model: ModelName = "published",
    n2: N2Choice = "free",
    weights: WeightMethod = "auto",
    loss: Loss = "squares",
    intervals: IntervalMethod = "wald",
    detector_gain_u: ArrayLike = 0.0,
    detector_offset_u: ArrayLike = 0.0,
) -> FitResult:
    """Fit a scattering model to a scan; as long as nothing is shared, each wavelength for itself.

    Parameters
    ----------
    scan
        A measured scan, `gonio.load`.  Missing, saturated and refused readings are left out.
    aperture
        ``"exact"`` integrates the scan's aperture; ``"eq22"``, ``"point"`` and ``"published"`` are the
        paper's approximations, see `gonio.aperture.Aperture.variant`.
    beam
        Whether the exact aperture is seen by the beam that the scan states, with its width and divergence;
        False takes it as a line of light.
    polarization
        ``"joint"`` fits S and P with common parameters, ``"s"`` or ``"p"`` one of them alone,
        ``"shared_n2"`` both with parameters of their own but for n2.
    model
        Its name; see `gonio.fitting.kinds`.
    n2
        ``"free"`` at every wavelength; ``"constant"``, ``"cauchy"``, ``"cauchy3"`` or ``"sellmeier"``: a
        smooth function that all wavelengths share; a number, or (m,) numbers, known beforehand and held.
    weights
        ``"auto"``: from a variance function of the residuals (`gonio.fitting.noise`), begun with `scan.r_sd`
        where it is given; ``"r_sd"``: 1/r_sd^2 as it is; ``"none"``: all alike.  The covariance is scaled by
        chi2 per degree of freedom in each case.
    loss
        ``"squares"``; ``"huber"`` and ``"tukey"`` make outliers count less (`gonio.fitting.robust`).
    intervals
        ``"wald"``: 95 % by Student's t, alpha on its logarithm, common-mode uncertainties included,
        open-ended where the data give no bound.  ``"profile"``: by profile likelihood everywhere, which a
        long tail needs and which takes some 10 ms per wavelength (`gonio.fitting.accepted`).
        ``"nlparci"``: exactly MATLAB's nlparci, which knows none of this, on unweighted residuals.
    detector_gain_u, detector_offset_u
        Standard uncertainties of each detector's gain (relative) and zero offset (in r), one for all or one
        each: priors of a gain and an offset that are fitted with the rest, ``r = g model + o``.  Zero: exact.

    Raises
    ------
    FitError
        No reading of that polarization, no wavelength with enough readings, an unknown option, or options
        that the data cannot answer.
    """
    return fit_readings(
        scan.theta_i_deg,
        scan.theta_o_deg,
        scan.polarization,
        np.where(scan.usable, scan.r, np.nan),
        instrument=scan.aperture,
        beam=scan.beam if beam else None,
        wavelength_nm=scan.wavelength_nm,
        detector_index=scan.detector_index,
        r_sd=scan.r_sd,
        gain_u=scan.gain_u,
        offset_u=scan.offset_u,
        aperture=aperture,
        polarization=polarization,
        model=model,
        n2=n2,
        weights=weights,
        loss=loss,
        intervals=intervals,
        detector_gain_u=detector_gain_u,
        detector_offset_u=detector_offset_u,
        sample_name=scan.sample_name,
    )


def fit_readings(
    theta_i_deg: ArrayLike,
    theta_o_deg: ArrayLike,
    polarization_of: ArrayLike,
    r: ArrayLike,
    *,
    instrument: Aperture,
    beam: IncidentBeam | None = None,
    wavelength_nm: ArrayLike | None = None,
    detector_index: ArrayLike | None = None,
    r_sd: ArrayLike | None = None,
    gain_u: ArrayLike | None = None,
    offset_u: ArrayLike | None = None,
    aperture: ApertureName = "exact",
    polarization: PolarizationChoice = "joint",
    model: ModelName = "published",
    n2: N2Choice = "free",
    weights: WeightMethod = "auto",
    loss: Loss = "squares",
    intervals: IntervalMethod = "wald",
    detector_gain_u: ArrayLike = 0.0,
    detector_offset_u: ArrayLike = 0.0,
    sample_name: str = "",
) -> FitResult:
    """Fit plain arrays: (n,) angles in degrees, (n,) ``"s"``/``"p"``, (n, m) readings, NaN for none.

    `instrument` and `beam` make the instrument function; without a beam the light is a line.
    `r_sd`, `gain_u`, `offset_u` broadcast to (n, m) and default to unknown; see `fit` and `gonio.store.Scan`.
    """
    asked = {
        "aperture": aperture, "polarization": polarization, "weights": weights, "intervals": intervals,
        "loss": loss,
    }  # fmt: skip
    for option, value in asked.items():
        if not isinstance(value, str) or value not in _CHOICES[option]:
            known = ", ".join(repr(x) for x in _CHOICES[option])
            raise FitError(f"{option} = {value!r} is not known; use one of {known}")
    if intervals == "nlparci":
        weights = "none"  # its covariance is mse (J'J)^-1
        if loss != "squares" or not (isinstance(n2, str) and n2 == "free"):
            raise FitError(
                "intervals = 'nlparci' are MATLAB's, of plain least squares at each wavelength; "
                "use 'wald' with a robust loss or an n2 that is given or shared"
            )
    kind = model_named(model, polarization)
    given = Given.of(theta_i_deg, theta_o_deg, polarization_of, r, wavelength_nm, detector_index, instrument)
    readings, which, theta_i, theta_o = given.r, given.polarization, given.theta_i_deg, given.theta_o_deg
    wavelength, detector = given.wavelength_nm, given.detector_index
    both = polarization in ("joint", "shared_n2")
    chosen = np.isin(which, ["s", "p"]) if both else which == polarization
    if not np.any(chosen):
        have = ", ".join(sorted(set(which.tolist()))) or "none"
        raise FitError(f"polarization '{polarization}' was not measured; the scan has: {have}")
    used = Used.of(
        readings[chosen], uncertainty(r_sd, readings, "r_sd")[chosen], weights, len(kind.parameters)
    )
    is_s = which[chosen] == "s"
    bound = kind.of(receiver_of(instrument, beam, aperture), theta_i[chosen], theta_o[chosen], is_s)
    begin = bound.start(used.y, used.start_weight(loss))
    form, begin, free, untold = _index(
        kind, n2, begin, wavelength, used.columns,
        _one_group(theta_i[chosen], is_s, used.use, separate=polarization == "shared_n2"),
    )  # fmt: skip
    common = None
    if intervals != "nlparci":
        gain, offset = (
            np.nan_to_num(uncertainty(u, readings, name)[chosen][:, used.columns])
            for u, name in ((gain_u, "gain_u"), (offset_u, "offset_u"))
        )
        common = CommonMode(gain, offset, is_s) if np.any(gain) or np.any(offset) else None
    weighed = solve_weighed(bound, used, begin, free, detector[used.columns], common, loss)
    found = assemble(
        bound,
        kind,
        weighed,
        used,
        free=free,
        untold=untold,
        common=common,
        dispersion=form,
        detectors=_detectors(detector_gain_u, detector_offset_u, detector),
        setting=Setting(
            wavelength_nm=wavelength,
            detector_index=detector,
            theta_i_deg=theta_i[chosen],
            theta_o_deg=theta_o[chosen],
            polarization_of=which[chosen],
            position=np.flatnonzero(chosen),
            model=model,
            aperture=aperture,
            polarization=polarization,
            intervals="wald" if intervals == "profile" else intervals,
            weights=used.weights,
            loss=loss,
            n2=n2 if isinstance(n2, str) else "given",
            instrument=instrument,
            beam=beam,
            sample_name=sample_name,
        ),
    )
    return with_profile_intervals(found) if intervals == "profile" else found


def _index(
    kind: type[FitModel],
    n2: N2Choice,
    begin: FloatArray,
    wavelength_nm: FloatArray,
    columns: NDArray[np.intp],
    one_group: BoolArray,
) -> tuple[Dispersion | None, FloatArray, BoolArray, BoolArray]:
    """Return the dispersion if any, where to begin, which shape parameters are free, where n2 is untold."""
    free, untold = np.ones(begin.shape, bool), np.zeros(len(begin), bool)
    chosen = n2 if isinstance(n2, str) else None
    if "n2" not in kind.shape:
        if chosen != "free":
            raise FitError(f"model '{kind.name}' has no n2 to give or to share; leave n2 = 'free'")
        return None, begin, free, untold
    at = kind.shape.index("n2")
    if chosen == "free":
        free[one_group, at], untold = False, one_group
        return None, np.where(~free, _UNTOLD_N2, begin), free, untold
    if chosen is not None:
        return dispersion_of(chosen, wavelength_nm[columns]), begin, free, untold
    values = np.asarray(np.nan if n2 is None else real(n2, "n2"))
    if values.shape not in ((), wavelength_nm.shape):
        raise FitError(f"n2 has the shape {values.shape}; give one number, or {wavelength_nm.size} of them")
    values = np.broadcast_to(values, wavelength_nm.shape)[columns]
    bad = np.flatnonzero(~((values >= kind.low[at]) & (values <= kind.high[at])))
    if bad.size:
        raise FitError(
            f"n2 = {values[bad[0]]:g} at wavelength {wavelength_nm[columns[bad[0]]]:g} nm is outside "
            f"{kind.low[at]:g}...{kind.high[at]:g}; correct it, or leave n2 = 'free'"
        )
    begin = begin.copy()
    begin[:, at], free[:, at] = values, False
    return None, begin, free, untold


def _one_group(theta_i_deg: FloatArray, is_s: BoolArray, use: BoolArray, *, separate: bool) -> BoolArray:
    """Return where all used readings share one incidence (to half a degree) and polarization, (k,).

    With `separate` surfaces for S and P their contrast tells nothing: one incidence is enough.
    """
    theta = np.where(use, theta_i_deg[:, None], np.nan)
    one_incidence = np.nanmax(theta, axis=0) - np.nanmin(theta, axis=0) < 0.5
    if separate:
        return np.asarray(one_incidence)
    s = np.sum(use & is_s[:, None], axis=0)
    return np.asarray(one_incidence & ((s == 0) | (s == np.sum(use, axis=0))))


def _detectors(gain_u: ArrayLike, offset_u: ArrayLike, detector: NDArray[np.uint8]) -> Detectors | None:
    """Return the priors of d detectors; None if all are exact."""
    count = 1 + int(detector.max(initial=0))
    arrays = []
    for name, values in (("detector_gain_u", gain_u), ("detector_offset_u", offset_u)):
        u = np.asarray(np.nan if values is None else real(values, name))
        if u.shape not in ((), (count,)):
            raise FitError(f"{name} has {u.size} numbers; give one, or one for each of {count} detectors")
        if not np.all(np.isfinite(u) & (u >= 0.0)):
            raise FitError(f"{name} = {u} must be standard uncertainties of at least 0; correct them")
        arrays.append(np.broadcast_to(u, (count,)).astype(np.float64))
    return Detectors(*arrays) if np.any(arrays) else None
