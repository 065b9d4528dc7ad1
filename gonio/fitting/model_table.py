"""The printed comparison of scattering models."""

from __future__ import annotations

import textwrap
import warnings
from typing import TYPE_CHECKING

import numpy as np

from gonio.fitting.selection import akaike_weights

if TYPE_CHECKING:
    from gonio.fitting.kinds import ModelName
    from gonio.fitting.model_comparison import Candidate, ModelComparison

_FEW_RUNS = 1e-3
"""Below this the residuals keep their sign too long for chance, all wavelengths together."""


def model_table(found: ModelComparison) -> str:
    """Return the text of `ModelComparison.table`, the best model first."""
    totals, weights = found.total_aicc, found.total_weights
    names = sorted(totals, key=lambda name: totals[name] if np.isfinite(totals[name]) else np.inf)
    at_each = akaike_weights(np.stack([c.aicc for c in found.candidates.values()]))
    fitted = np.all(np.isfinite(at_each), axis=0)
    winners = np.argmax(np.where(np.isfinite(at_each), at_each, -1.0), axis=0)[fitted]
    order = list(found.candidates)
    head = (
        f"{'model':<12}{'par.':>5}{'AICc':>12}{'weight':>9}{'best at':>9}{'rms in r':>11}{'runs p':>10}"
        f"{'all':>10}{'not recipr.':>13}{'albedo':>9}{'from':>8}{'time':>9}"
    )
    lines = [head]
    for name in names:
        c = found.candidates[name]
        best_at = int(np.sum(winners == order.index(name)))
        excess = totals[name] - totals[names[0]]
        lines.append(
            f"{name:<12}{len(c.fit.parameters):>5}{excess:>+12,.1f}{weights[name]:>9.2g}"
            f"{best_at:>9}{_median(c.fit.rms):>11.2e}{_median(c.runs_p):>10.2g}{c.runs_p_all:>10.1e}"
            f"{_check(c)}{c.duration_s:>7.2f} s"
        )
    lines += [f"{name:<12} not fitted: {reason}" for name, reason in found.refused.items()]
    lines += textwrap.wrap(_legend(found, int(np.sum(fitted))), 108)
    lines += [line for name in names for line in textwrap.wrap(_verdict(name, found, name == names[0]), 108)]
    return "\n".join(lines)


def _median(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of no value at all
        return float(np.nanmedian(values))


def _check(c: Candidate) -> str:
    if c.check is None:
        return f"{'-':>13}{'-':>9}{'-':>8}"
    begins = f"{c.check.energy_from_deg:.1f}" if np.isfinite(c.check.energy_from_deg) else "-"
    return f"{100.0 * c.check.reciprocity:>11.1f} %{c.check.albedo:>9.4f}{begins:>8}"


def _legend(found: ModelComparison, fitted: int) -> str:
    return (
        f"AICc is summed over the {fitted} wavelengths that all models fit, and counted from the best; "
        f"weight is the evidence that this model holds at all of them, best at the number where it leads. "
        f"All have the same weights, from the residuals of '{found.weights_from}'. runs p is the chance of "
        f"residuals that keep their sign so long along theta_o: the median, and all wavelengths together. "
        f"Then the worst violation of reciprocity of the fitted surface, its largest albedo, and the "
        f"incidence (deg) from which that exceeds 1."
    )


def _verdict(name: ModelName, found: ModelComparison, first: bool) -> str:
    p = found.candidates[name].runs_p_all
    if first and p < _FEW_RUNS:
        return (
            f"Even the best, '{name}', leaves residuals that keep their sign (p = {p:.1e}): none of these "
            f"models describes the readings, or positions share an error (baseline, drift)."
        )
    return ""
