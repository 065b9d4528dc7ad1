"""Which scattering model do the readings prefer?  Several, fitted to the same readings with the same weights.

With weights of its own a model that fits badly takes its errors for noise.  So every model is fitted once
with the weights of its own residuals; the variances of the one that makes the readings most probable are
everybody's weights in a second fit, and only that one is compared.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.aperture import Aperture
from gonio.brdf import ModelCheck, check_model
from gonio.errors import FitError
from gonio.fitting.estimate import fit_readings
from gonio.fitting.kinds import ModelName
from gonio.fitting.result import FitResult, PolarizationChoice
from gonio.fitting.selection import akaike, akaike_weights, combined_runs_probability, runs_probability

if TYPE_CHECKING:
    from gonio.store import Scan

FloatArray = NDArray[np.float64]

MODEL_NAMES: tuple[ModelName, ...] = get_args(ModelName)

_CHECKED = 3  # wavelengths whose fitted surface is checked for energy and reciprocity


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A model with the common weights.

    Attributes
    ----------
    fit
        Its result.
    aicc
        (m,), comparable among candidates alone; NaN where there is no fit.
    runs_p
        (m,), probability of as few runs of one sign along theta_o by chance.
    runs_p_all
        The same of all wavelengths together.
    check
        The worst reciprocity and the largest albedo of the fitted surface over a few wavelengths, for
        unpolarized light; None where nothing could be checked.
    duration_s
        Seconds this fit took.
    """

    fit: FitResult
    aicc: FloatArray
    runs_p: FloatArray
    runs_p_all: float
    check: ModelCheck | None
    duration_s: float


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison:
    """Models side by side.

    Attributes
    ----------
    candidates
        By name of the command line.
    refused
        Models that could not be fitted, with the reason.
    weights_from
        The model whose residuals gave the weights.
    """

    candidates: Mapping[ModelName, Candidate]
    refused: Mapping[ModelName, str]
    weights_from: ModelName

    @property
    def total_aicc(self) -> dict[ModelName, float]:
        """AICc of every model summed over the wavelengths that all of them could fit."""
        values = np.stack([c.aicc for c in self.candidates.values()])
        common = np.all(np.isfinite(values), axis=0)
        totals = np.sum(values[:, common], axis=1) if np.any(common) else np.full(len(values), np.nan)
        return dict(zip(self.candidates, totals.tolist(), strict=True))

    @property
    def total_weights(self) -> dict[ModelName, float]:
        """Akaike weights of the sums: the evidence if one model holds at all wavelengths."""
        totals = self.total_aicc
        weights = akaike_weights(np.array(list(totals.values())))
        return dict(zip(totals, weights.tolist(), strict=True))

    @property
    def weights(self) -> FloatArray:
        """Akaike weights at each wavelength, (models, m), in the order of `candidates`."""
        return akaike_weights(np.stack([c.aicc for c in self.candidates.values()]))

    @property
    def best(self) -> ModelName:
        """The model with the least summed AICc."""
        totals = self.total_aicc
        return min(totals, key=lambda name: totals[name] if np.isfinite(totals[name]) else np.inf)

    def table(self) -> str:
        """Return the printable comparison."""
        from gonio.fitting.model_table import model_table

        return model_table(self)


def compare_models(
    scan: Scan,
    models: Sequence[ModelName] = MODEL_NAMES,
    *,
    polarization: PolarizationChoice = "joint",
    beam: bool = True,
    **options: Any,
) -> ModelComparison:
    """Fit several scattering models to a scan and compare them.

    Parameters
    ----------
    scan
        A measured scan, `gonio.load`.
    models
        Names, see `gonio.fitting.kinds`.
    polarization, beam, options
        As `gonio.fit`, the same for all models.

    Raises
    ------
    FitError
        No model could be fitted.
    """
    return compare_readings(
        scan.theta_i_deg,
        scan.theta_o_deg,
        scan.polarization,
        np.where(scan.usable, scan.r, np.nan),
        instrument=scan.aperture,
        models=models,
        beam=scan.beam if beam else None,
        polarization=polarization,
        wavelength_nm=scan.wavelength_nm,
        detector_index=scan.detector_index,
        r_sd=scan.r_sd,
        gain_u=scan.gain_u,
        offset_u=scan.offset_u,
        sample_name=scan.sample_name,
        **options,
    )


def compare_readings(
    theta_i_deg: ArrayLike,
    theta_o_deg: ArrayLike,
    polarization_of: ArrayLike,
    r: ArrayLike,
    *,
    instrument: Aperture,
    models: Sequence[ModelName] = MODEL_NAMES,
    polarization: PolarizationChoice = "joint",
    **options: Any,
) -> ModelComparison:
    """Compare models on plain arrays; arguments as `gonio.fitting.fit_readings`."""

    def run(model: ModelName, options: Mapping[str, Any]) -> FitResult:
        return fit_readings(
            theta_i_deg,
            theta_o_deg,
            polarization_of,
            r,
            instrument=instrument,
            model=model,
            polarization=polarization,
            **options,
        )

    refused: dict[ModelName, str] = {}
    first: dict[ModelName, FitResult] = {}
    for model in models:
        try:
            first[model] = run(model, options)
        except FitError as error:
            refused[model] = str(error)
    if not first:
        reasons = "; ".join(f"{model}: {reason}" for model, reason in refused.items())
        raise FitError(f"none of the models {', '.join(models) or '(none)'} could be fitted: {reasons}")
    chosen = min(first, key=lambda model: _surprise(first[model]))
    sd = np.full(np.atleast_2d(np.asarray(r, np.float64)).shape, np.nan)
    which = np.asarray(polarization_of, np.str_)
    rows = which == polarization if polarization in ("s", "p") else np.isin(which, ["s", "p"])
    sd[rows] = first[chosen].sigma
    same = {**options, "r_sd": sd, "weights": "r_sd"}
    candidates = {}
    for model in first:
        start = time.perf_counter()
        candidates[model] = _candidate(run(model, same), start)
    return ModelComparison(candidates, refused, chosen)


def _surprise(result: FitResult) -> float:
    """Return -2 log of the probability of the readings by a fit with its own variances, less a constant."""
    n = np.sum(np.isfinite(result.residual), axis=0).astype(np.float64)
    good = (n > 0.0) & (result.chi2 > 0.0)
    if not np.any(good):
        return np.inf
    scale = n[good] * np.log(result.chi2[good] / n[good])
    return float(np.sum(scale) + 2.0 * np.nansum(np.log(result.sigma[:, good])))


def _candidate(result: FitResult, start: float) -> Candidate:
    is_s = result.polarization_of == "s"
    at = (result.theta_i_deg, result.theta_o_deg, is_s)
    residual = result.residual / result.sigma
    duration_s = time.perf_counter() - start
    return Candidate(
        result,
        akaike(result),
        runs_probability(residual, *at),
        combined_runs_probability(residual, *at),
        _worst(result),
        duration_s,
    )


def _worst(result: FitResult) -> ModelCheck | None:
    """Return the worst of both kinds over a few wavelengths, spread over those with all parameters known."""
    if result.polarization == "shared_n2":
        return None  # two surfaces, and no unpolarized light on either
    value = result.value.copy()
    for k, name in enumerate(result.parameters):  # without a lobe its shape does not matter
        if not name.startswith(("rho_d", "rho_s")):
            none = value[:, result.parameters.index("rho_s")] == 0.0
            value[none, k] = 1.5 if name == "n2" else 1.0
    known = np.flatnonzero(np.all(np.isfinite(value), axis=1))
    if not known.size:
        return None
    picked = known[np.unique(np.linspace(0, known.size - 1, _CHECKED).round().astype(int))]
    checks = []
    for row in picked:
        surface = result.kind.scattering(value[row : row + 1])
        one = type(surface)(*(float(x) for x in value[row]))
        checks.append(check_model(one))
    worst = max(checks, key=lambda c: c.reciprocity)
    top = max(checks, key=lambda c: c.albedo)
    return ModelCheck(
        worst.model,
        worst.polarization,
        worst.reciprocity,
        worst.reciprocity_at_deg,
        top.albedo,
        top.albedo_at_deg,
        top.energy_from_deg,
    )
