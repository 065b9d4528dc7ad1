"""What is a spectral quantity averaged over a band, and how much of the band's weight did the scan cover?

    <k> = sum_j a_j k_j,    a_j = ∫ w(l) h_j(l) dl / ∫ w dl over what is covered

k is taken as linear between measured wavelengths (the trapezoidal rule), `h_j` being the hat of wavelength j;
the weight w keeps its own resolution, for AM1.5G has lines much narrower than a scan's steps.  Over a flat
weight this is the trapezoidal rule itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import GonioError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
WeightName = Literal["am15g", "photopic", "flat"]
Weight = WeightName | Callable[[FloatArray], ArrayLike]
WEIGHTS: tuple[WeightName, ...] = get_args(WeightName)

LEAST_COVERAGE = 0.95
"""Share of the band's weight that a scan must cover; less is refused, for the rest would be invented."""

_JUMP = 3.0  # a step so much longer than both its neighbours is a gap, not a coarse part of the plan
_CALLABLE_STEP_NM = 0.5  # at which a weight given as a function is read

_PHOTOPIC_NM = np.arange(380.0, 780.1, 5.0)
_PHOTOPIC = np.array([
    3.9e-5, 6.4e-5, 1.2e-4, 2.17e-4, 3.96e-4, 6.4e-4, 1.21e-3, 2.18e-3, 4.0e-3, 7.3e-3, 1.16e-2, 1.684e-2,
    2.3e-2, 2.98e-2, 3.8e-2, 4.8e-2, 6.0e-2, 7.39e-2, 9.098e-2, 0.1126, 0.13902, 0.1693, 0.20802, 0.2586,
    0.323, 0.4073, 0.503, 0.6082, 0.71, 0.7932, 0.862, 0.91485, 0.954, 0.9803, 0.99495, 1.0, 0.995, 0.9786,
    0.952, 0.9154, 0.87, 0.8163, 0.757, 0.6949, 0.631, 0.5668, 0.503, 0.4412, 0.381, 0.321, 0.265, 0.217,
    0.175, 0.1382, 0.107, 8.16e-2, 6.1e-2, 4.458e-2, 3.2e-2, 2.32e-2, 1.7e-2, 1.192e-2, 8.21e-3, 5.723e-3,
    4.102e-3, 2.929e-3, 2.091e-3, 1.484e-3, 1.047e-3, 7.4e-4, 5.2e-4, 3.611e-4, 2.492e-4, 1.719e-4, 1.2e-4,
    8.48e-5, 6.0e-5, 4.24e-5, 3.0e-5, 2.12e-5, 1.499e-5,
])  # fmt: skip


def photopic(wavelength_nm: ArrayLike) -> FloatArray:
    """Return V(lambda), CIE 1924 photopic luminous efficiency; 0 outside 380...780 nm.

    Linear between the values of ISO/CIE 11664-1 every 5 nm; what lies outside is 3e-6 of the whole.
    """
    at = np.asarray(wavelength_nm, np.float64)
    return np.asarray(np.interp(at, _PHOTOPIC_NM, _PHOTOPIC, left=0.0, right=0.0))


def am15g(wavelength_nm: ArrayLike) -> FloatArray:
    """Return the AM1.5 global tilted spectral irradiance of ASTM G173-03, W/m2/nm; 0 outside 280...4000 nm.

    The table is pvlib's; linear between its entries (0.5 nm apart below 400 nm, 1 nm to 1700 nm, then 5 nm).
    """
    nm, value = _am15g_table()
    return np.asarray(np.interp(np.asarray(wavelength_nm, np.float64), nm, value, left=0.0, right=0.0))


@cache
def _am15g_table() -> tuple[FloatArray, FloatArray]:
    from pvlib.spectrum import get_reference_spectra  # slow to import, and few ask for it

    table = get_reference_spectra(standard="ASTM G173-03")
    return table.index.to_numpy(np.float64), table["global"].to_numpy(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BandWeights:
    """How much each measured wavelength counts in a band.

    Attributes
    ----------
    share : (m,), sums to 1; 0 for wavelengths that do not take part
    covered : part of the weight between the band's limits that the scan covers, 0...1
    of_whole : part of the whole weight (the whole solar spectrum, all of V) that lies in the covered part
    longest_step_nm : longest distance between neighbouring wavelengths that was bridged by a straight line
    """

    share: FloatArray
    covered: float
    of_whole: float
    longest_step_nm: float

    def text(self, low_nm: float, high_nm: float, weight: Weight) -> str:
        """Return a sentence on what the average stands for."""
        name = weight if isinstance(weight, str) else "the weight"
        return (
            f"{low_nm:g}-{high_nm:g} nm, {name}: {100.0 * self.covered:.1f} % of the band's weight and "
            f"{100.0 * self.of_whole:.1f} % of the whole are covered by {int(np.sum(self.share != 0.0))} "
            f"wavelengths, at most {self.longest_step_nm:g} nm apart"
        )


def band_weights(
    wavelength_nm: ArrayLike,
    low_nm: float,
    high_nm: float,
    weight: Weight = "flat",
    *,
    use: ArrayLike | None = None,
    least_coverage: float = LEAST_COVERAGE,
) -> BandWeights:
    """Return the share of each measured wavelength in the average over a band.

    Parameters
    ----------
    wavelength_nm
        (m,) measured wavelengths in any order, nm, each once (see `gonio.overlap.home`) among those used.
    low_nm, high_nm
        The band; its limits need not be measured wavelengths.
    weight
        ``"am15g"``, ``"photopic"`` (V of an equal-energy light), ``"flat"``, or a function of the wavelength
        in nm (m,) that returns a relative weight >= 0.
    use
        (m,) mask of the wavelengths with a result; None takes all.  No straight line is drawn across a
        wavelength without one: what lies between its neighbours is not covered.
    least_coverage
        Share of the band's weight that must be covered.

    Raises
    ------
    GonioError
        Limits in the wrong order, a wavelength that is not known or there twice, an unknown or useless
        weight, or a band that the scan covers too little of.
    """
    if weight not in WEIGHTS and not callable(weight):
        known = ", ".join(repr(x) for x in WEIGHTS)
        raise GonioError(f"weight = {weight!r} is not known; use one of {known}, or a function of nm")
    nm = np.asarray(wavelength_nm, np.float64)
    good = np.ones(nm.shape, bool) if use is None else np.asarray(use, bool)
    if not (np.isfinite(low_nm) and np.isfinite(high_nm) and 0.0 < low_nm < high_nm):
        raise GonioError(
            f"band {low_nm:g}...{high_nm:g} nm: two wavelengths in ascending order are needed; correct them"
        )
    if not np.all(np.isfinite(nm)):
        raise GonioError(
            "a band average needs the wavelengths, which this fit was not given; give them to it"
        )
    order = np.argsort(nm, kind="stable")
    at, good = nm[order], good[order]
    kept = np.concatenate([[True], np.diff(at) > 0.0]) if at.size else np.zeros(0, bool)
    if not np.all(kept):
        raise GonioError(
            f"wavelength {at[~kept][0]:g} nm is there twice; keep one of them (gonio.overlap.home)"
        )
    bridged = _bridged(at, good)
    knots = _knots(weight, low_nm, high_nm, at)
    value = _weight_at(weight, knots)
    whole, in_band = _whole(weight), float(np.sum(0.5 * np.diff(knots) * (value[1:] + value[:-1])))
    if not in_band > 0.0:
        raise GonioError(
            f"band {low_nm:g}...{high_nm:g} nm: the weight {_name(weight)} is zero there; choose another band"
        )
    share, covered = _integrated(at, bridged, knots, value)
    part = covered / in_band
    if not part >= least_coverage:
        have = "no neighbouring wavelengths with a result"
        if np.any(bridged):
            starts, ends = at[:-1][bridged], at[1:][bridged]
            have = f"{starts.min():g}...{ends.max():g} nm" + (
                " with gaps" if np.any(~bridged & (at[:-1] >= starts.min()) & (at[1:] <= ends.max())) else ""
            )
        raise GonioError(
            f"band {low_nm:g}...{high_nm:g} nm: the results ({have}) cover {100.0 * max(part, 0.0):.1f} % of "
            f"the weight {_name(weight)} there, less than the {100.0 * least_coverage:g} % required; choose "
            "a band inside, or give a smaller least_coverage and state it"
        )
    inside = bridged & (at[1:] > low_nm) & (at[:-1] < high_nm)
    spread = np.zeros(nm.shape)
    spread[order] = share / covered
    return BandWeights(
        spread,
        float(min(part, 1.0)),
        float(covered / whole) if whole is not None else float("nan"),
        float(np.max(np.diff(at)[inside])),
    )


def _bridged(at: FloatArray, good: BoolArray) -> BoolArray:
    """Return between which neighbours, (m - 1,), a straight line may be drawn."""
    if at.size < 2:
        return np.zeros(max(at.size - 1, 0), bool)
    step = np.diff(at)
    left, right = np.concatenate([[0.0], step[:-1]]), np.concatenate([step[1:], [0.0]])
    neighbour = np.maximum(left, right)
    gap = (step > _JUMP * neighbour) & (neighbour > 0.0)
    return np.asarray(good[:-1] & good[1:] & ~gap)


def _knots(weight: Weight, low_nm: float, high_nm: float, at: FloatArray) -> FloatArray:
    """Return where the weight or the hats may bend, from one limit of the band to the other."""
    if weight == "am15g":
        own = _am15g_table()[0]
    elif weight == "photopic":
        own = _PHOTOPIC_NM
    elif weight == "flat":
        own = np.zeros(0)
    else:
        own = np.linspace(low_nm, high_nm, int(np.ceil((high_nm - low_nm) / _CALLABLE_STEP_NM)) + 1)
    knots = np.unique(np.concatenate([own, at, [low_nm, high_nm]]))
    return np.asarray(knots[(knots >= low_nm) & (knots <= high_nm)])


def _weight_at(weight: Weight, nm: FloatArray) -> FloatArray:
    if weight == "am15g":
        return am15g(nm)
    if weight == "photopic":
        return photopic(nm)
    if weight == "flat":
        return np.ones_like(nm)
    value = np.array(np.broadcast_to(np.asarray(weight(nm), np.float64), nm.shape))
    if not np.all(np.isfinite(value) & (value >= 0.0)):
        bad = int(np.argmax(~(np.isfinite(value) & (value >= 0.0))))
        raise GonioError(
            f"the weight is {value[bad]:g} at {nm[bad]:g} nm; it must be a number of at least 0 all over "
            "the band"
        )
    return value


def _whole(weight: Weight) -> float | None:
    """Return the integral of the weight over all wavelengths, None where it has no end."""
    if weight == "am15g":
        nm, value = _am15g_table()
    elif weight == "photopic":
        nm, value = _PHOTOPIC_NM, _PHOTOPIC
    else:
        return None
    return float(np.sum(0.5 * np.diff(nm) * (value[1:] + value[:-1])))


def _integrated(
    at: FloatArray, bridged: BoolArray, knots: FloatArray, value: FloatArray
) -> tuple[FloatArray, float]:
    """Return ∫ w h_j (m,) over the covered part and their sum; w is linear between knots, Simpson exact."""
    share = np.zeros(at.size)
    if at.size < 2 or knots.size < 2:
        return share, 0.0
    middle = 0.5 * (knots[1:] + knots[:-1])
    segment = np.clip(np.searchsorted(at, middle) - 1, 0, at.size - 2)
    covered = bridged[segment] & (middle > at[0]) & (middle < at[-1])
    width, left = np.diff(knots), at[segment]
    span = at[segment + 1] - left
    up = [(x - left) / span for x in (knots[:-1], middle, knots[1:])]
    w = (value[:-1], 0.5 * (value[:-1] + value[1:]), value[1:])
    rising = width / 6.0 * (w[0] * up[0] + 4.0 * w[1] * up[1] + w[2] * up[2])
    whole = width / 6.0 * (w[0] + 4.0 * w[1] + w[2])
    np.add.at(share, segment[covered], (whole - rising)[covered])
    np.add.at(share, segment[covered] + 1, rising[covered])
    return share, float(np.sum(whole[covered]))


def _name(weight: Weight) -> str:
    return f"'{weight}'" if isinstance(weight, str) else "given"
