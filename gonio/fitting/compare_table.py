"""The printed comparison of aperture models: values with biases, quality, and a sentence on each."""

from __future__ import annotations

import textwrap
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gonio.fitting.compare import ApertureComparison, Variant

FloatArray = NDArray[np.float64]

TITLES = {
    "point": "the point formula (Eq 18)",
    "eq22": "Eq 22 with the true half-width",
    "published": "Eq 22 with the published ±13 deg, 0.0516 sr",
    "exact": "the exact integral",
}
_SPECULAR = "k_s"
_TOLD_APART = 2.0
"""AICc difference at one wavelength below which two models are as good (Burnham and Anderson 2002)."""


def comparison_table(found: ApertureComparison) -> str:
    """Return the text of `ApertureComparison.table`."""
    return "\n".join([*_values(found), "", *_quality(found), "", *_sentences(found)])


def _middle(values: FloatArray, keep: NDArray[np.bool_]) -> float:
    """Return the median over the wavelengths that count; NaN if there is no value."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of no value at all
        return float(np.nanmedian(np.where(np.isfinite(values), values, np.nan)[keep]))


def _values(found: ApertureComparison) -> list[str]:
    names = list(found.exact.values)
    against = (
        "the truth stored in this file" if found.reference_is_truth else "the exact fit (no truth is known)"
    )
    lines = [
        f"Aperture models side by side; biases against {against}, medians over the wavelengths",
        f"{'':<12}" + "".join(f"{_title(name):>11}" for name in names),
    ]
    for variant in found.variants:
        cells = [_number(_middle(variant.values[name], found.keep)) for name in names]
        lines.append(f"{variant.aperture:<12}" + "".join(f"{cell:>11}" for cell in cells))
        if variant is found.exact and not found.reference_is_truth:
            continue
        biases = [_middle(found.bias(variant.aperture, name), found.keep) for name in names]
        lines.append(f"{'  bias':<12}" + "".join(f"{_percent(bias):>11}" for bias in biases))
    if found.reference_is_truth:
        cells = [_number(_middle(found.reference[name], found.keep)) for name in names]
        lines.append(f"{'true':<12}" + "".join(f"{cell:>11}" for cell in cells))
    return lines


def _quality(found: ApertureComparison) -> list[str]:
    head = f"{'':<12}{'rms in r':>11}{'chi2/dof':>11}{'AICc':>11}{'runs p':>11}{'time':>11}"
    fitted = found.keep & np.all([np.isfinite(v.aicc) for v in found.variants], axis=0)
    lines = [head]
    for v in found.variants:
        chi2 = v.fit.chi2 / np.where(v.fit.dof > 0, v.fit.dof, np.nan)
        excess = float(np.sum((v.aicc - found.exact.aicc)[fitted]))
        lines.append(
            f"{v.aperture:<12}{_middle(v.fit.rms, found.keep):>11.2e}{_middle(chi2, found.keep):>11.4g}"
            f"{excess:>+11,.1f}{_middle(v.runs_p, found.keep):>11.2g}{v.duration_s:>9.2f} s"
        )
    lines += _wrapped(
        "rms, chi2/dof and runs p are medians; AICc is summed over the wavelengths and counted from the "
        "exact fit's, lower is better; runs p is the chance of residuals that keep their sign so long along "
        "theta_o. All four have the same weights, from the exact fit."
    )
    return lines


def _wrapped(text: str, indent: str = "") -> list[str]:
    kept = text.replace(" %", "\u00a0%").replace("± ", "±\u00a0")  # a number stays with its unit
    lines = textwrap.wrap(kept, 100, initial_indent=indent, subsequent_indent=indent)
    return [line.replace("\u00a0", " ") for line in lines]


def _sentences(found: ApertureComparison) -> list[str]:
    lines = []
    for variant in found.variants:
        if variant is found.exact and not found.reference_is_truth:
            continue
        lines += _wrapped(_sentence(found, variant))
        scale = found.scale_bias(variant.aperture)
        if abs(scale) >= 5e-4:
            ours, theirs = found.exact.solid_angle_sr, variant.solid_angle_sr
            bias = _middle(found.bias(variant.aperture, _SPECULAR), found.keep)
            shape = (1.0 + bias) / (1.0 + scale) - 1.0
            rest = f"; the shape makes the rest, {_percent(shape)} of k_s" if np.isfinite(bias) else ""
            lines += _wrapped(
                f"{_percent(scale)} of it is scale, in all three alike: it takes {theirs:.5f} sr where this "
                f"aperture has {ours:.5f} sr{rest}.",
                "  ",
            )
        if variant is not found.exact:
            lines += _wrapped(_hidden(found, variant), "  ")
    return lines


def _sentence(found: ApertureComparison, variant: Variant) -> str:
    """Say what a model does to the coefficients, beside the uncertainty that its own intervals claim."""
    beyond, within = [], []
    for name in ("k_s", "k_d", "k_g"):
        bias = _middle(found.bias(variant.aperture, name), found.keep)
        if not np.isfinite(bias):
            continue
        reference = np.abs(found.reference[name])
        claimed = _middle(
            variant.half_widths[name] / np.where(reference > 0.0, reference, np.nan), found.keep
        )
        claim = f" ± {100.0 * claimed:.2g} %" if np.isfinite(claimed) else " without an interval"
        if abs(bias) > claimed or not np.isfinite(claimed):
            beyond.append(
                f"{name} {100.0 * abs(bias):.2g} % {'high' if bias > 0.0 else 'low'} (claiming{claim})"
            )
        else:
            within.append(name)
    subject = TITLES[variant.aperture]
    subject = subject[0].upper() + subject[1:]
    alpha = _alpha(found)
    parts = []
    if beyond:
        parts.append("reads " + ", ".join(beyond))
    if within:
        parts.append(f"has {', '.join(within)} within its 95 % interval")
    if not parts:
        return f"{subject}: nothing to compare, no lobe and no diffuse part are known."
    return f"{subject} {', and '.join(parts)}{alpha}."


def _hidden(found: ApertureComparison, variant: Variant) -> str:
    """Say so where a biased model fits as well as the exact one: its residuals do not give it away."""
    bias = _middle(found.bias(variant.aperture, _SPECULAR), found.keep)
    reference = np.abs(found.reference[_SPECULAR])
    share = variant.half_widths[_SPECULAR] / np.where(reference > 0.0, reference, np.nan)
    excess = _middle(variant.aicc - found.exact.aicc, found.keep)
    if abs(bias) > _middle(share, found.keep) and excess < _TOLD_APART:
        return (
            "It fits these readings as well as the exact integral does: the residuals do not show its bias."
        )
    return ""


def _alpha(found: ApertureComparison) -> str:
    if "alpha" not in found.reference:
        return ""
    alpha = _middle(found.reference["alpha"], found.keep)
    return f" at alpha = {alpha:.3g}" if np.isfinite(alpha) else ""


def _title(name: str) -> str:
    return f"{name}(8)" if name in ("k_d", "k_s", "k_g") else name


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "-"


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "-"
    percent = 100.0 * share
    digits = 0 if abs(percent) >= 100.0 else 1 if abs(percent) >= 10.0 else 2
    return f"{percent:+.{digits}f} %" if abs(percent) >= 0.005 else "0.00 %"
