"""Is the linear budget right?  The same inputs by Monte Carlo, after JCGM 101:2008.

Every trial draws the inputs and the noise, takes the readings as they would be interpreted with those
inputs, and fits them: ``y' = y - (M(theta, x) - M(theta, x0))``.  M is the bench's own quadrature
(`gonio.fitting.misaligned`), theta what the linear budget foretells for the trial, so that the result is
right to the second order.  The noise of the references and the wavelength's slope enter to the first order.

The interval of the budget, value ± U, is then compared with the trials' 95 % interval: d_low and d_high must
not pass the numerical tolerance, half a unit of the last of `digits` significant digits of u (JCGM 101:2008,
7.9.2 and 8.1).  The trials' own ends are known to their statistical error; where that decides, the comparison
says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import FitError
from gonio.fitting.accepted import data_of, model_of
from gonio.fitting.bootstrap import FEWEST_REPLICAS
from gonio.fitting.budget import Budget
from gonio.fitting.columns import readings
from gonio.fitting.covariance import random_and_common
from gonio.fitting.misaligned import Bench, readings_on
from gonio.fitting.quantity import quantity_named
from gonio.fitting.separate import SeparateSurfaces
from gonio.fitting.solve import refine

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]
Verdict = Literal["validated", "not validated", "undecided"]

_SHARPEST_UNKNOWN = 2000.0  # alpha that the quadrature resolves where a model has none
_BLOCK = 128  # trials fitted together
_GEOMETRY = {
    "aperture_width": "width_mm", "aperture_height": "height_mm", "distance": "distance_mm",
    "arm_zero": "arm_zero_deg", "theta_i_zero": "theta_i_zero_deg", "sample_tilt": "tilt_deg",
    "sample_offset": "offset_mm",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Comparison:
    """The budget's interval of one quantity beside the trials'.

    Attributes
    ----------
    value, u, lower, upper
        Of the budget.
    mean, sd, low, high
        Of the trials; `low` and `high` leave 2.5 % of them on each side.
    d_low, d_high, tolerance
        Differences of the ends, and what they may be.
    statistical
        Standard error of the trials' ends.
    verdict
        "undecided" if a difference is within three statistical errors of the tolerance.
    """

    name: str
    value: float
    u: float
    lower: float
    upper: float
    mean: float
    sd: float
    low: float
    high: float
    d_low: float
    d_high: float
    tolerance: float
    statistical: float
    verdict: Verdict


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo:
    """Trials at one wavelength, and the comparison with the budget."""

    wavelength_nm: float
    trials: int
    seed: int
    quantities: tuple[str, ...]
    sample: FloatArray  # (trials, q)
    comparisons: tuple[Comparison, ...]
    failed: int

    def table(self) -> str:
        """Return the comparison, one line per quantity."""
        head = (
            f"{'':<10}{'budget: value':>14}{'u':>11}{'95 %':>26}{'trials: mean':>14}{'sd':>11}{'95 %':>26}"
            f"{'d_low':>10}{'d_high':>10}{'tolerance':>11}  verdict"
        )
        lines = [
            f"JCGM 101: {self.trials} trials at {self.wavelength_nm:g} nm, seed {self.seed}",
            head,
            "-" * len(head),
        ]
        lines.extend(
            f"{c.name:<10}{c.value:>14.6g}{c.u:>11.3g}{f'{c.lower:.6g} ... {c.upper:.6g}':>26}"
            f"{c.mean:>14.6g}{c.sd:>11.3g}{f'{c.low:.6g} ... {c.high:.6g}':>26}"
            f"{c.d_low:>10.2g}{c.d_high:>10.2g}{c.tolerance:>11.2g}  {c.verdict}"
            for c in self.comparisons
        )
        failing = [c.name for c in self.comparisons if c.verdict == "not validated"]
        if failing:
            lines.append(
                f"the linear budget does not hold for {', '.join(failing)}: use the trials' interval there"
            )
        return "\n".join(lines)


def monte_carlo(
    budget: Budget,
    wavelength_nm: float | None = None,
    *,
    trials: int = 2000,
    seed: int = 0,
    digits: int = 1,
) -> MonteCarlo:
    """Return the distribution of the results at one wavelength, and how the budget compares.

    Parameters
    ----------
    budget
        The linear budget, `gonio.fitting.budget.budget`.
    wavelength_nm
        The measured wavelength next to it is taken; the one in the middle without.
    trials
        How many; the ends of an interval of 2000 are known to 6 % of u, of 10 000 to 3 %.
    seed
        Of the random numbers.
    digits
        Significant digits of u that are to be right, 1 or 2.

    Raises
    ------
    FitError
        Too few trials, or no lobe at that wavelength.
    """
    if trials < FEWEST_REPLICAS:
        raise FitError(f"trials = {trials} are too few; ask for at least {FEWEST_REPLICAS}, better 2000")
    k = budget.at(wavelength_nm)
    fit = budget.fit
    own = tuple(name for name in fit.mode_names if name.startswith("shared"))
    part = fit.only(np.arange(len(fit.wavelength_nm)) == k)
    if not np.all(np.isfinite(part.basic)):
        raise FitError(
            f"at {fit.wavelength_nm[k]:g} nm the fit has {part.notes[0]}: there is no lobe to move; "
            "its budget is linear"
        )
    pick = [g for g, name in enumerate(part.mode_names) if name in own]
    plain = replace(part, modes=part.modes[pick], mode_names=own)
    trial = _Trials(budget, plain, k)
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    found, failed = [], 0
    for first in range(0, trials, _BLOCK):
        values, missed = trial.run(rng, _BLOCK)
        found.append(values[: trials - first])
        failed += int(np.sum(missed[: trials - first]))
    sample = np.concatenate(found)
    comparisons = tuple(
        _compared(budget, k, q, name, sample[:, q], digits) for q, name in enumerate(budget.quantities)
    )
    return MonteCarlo(
        float(fit.wavelength_nm[k]), trials, seed, budget.quantities, sample, comparisons, failed
    )


class _Trials:
    """One wavelength's readings and how they are interpreted with drawn inputs."""

    def __init__(self, budget: Budget, part: FitResult, k: int) -> None:
        self.budget, self.fit, self.k = budget, part, k
        self.data = data_of(part, model_of(part))
        self.kind = part.kind
        self.linear = len(self.kind.linear)
        self.is_s = part.polarization_of == "s"
        self.used = self.data.w[:, 0] > 0.0
        self.expected = readings(self.data.model, self.data.basic)
        self.quantities = [quantity_named(self.kind, name, budget.theta_i_deg) for name in budget.quantities]
        shapes = dict(zip(self.kind.shape, self.data.basic[0, self.linear :], strict=True))
        steep = [np.exp(value) for name, value in shapes.items() if name.startswith("log_alpha")]
        self.sharpness = float(max(steep, default=_SHARPEST_UNKNOWN))
        self.names = budget.fit.mode_names
        self.modes = np.nan_to_num(budget.fit.modes[:, k])
        stated = {given.name for given in budget.inputs if given.u}
        self.crossed = None
        if stated & {"polarizer_angle", "polarizer_extinction"}:
            instrument = part.instrument
            self.crossed = self.kind.of(instrument, part.theta_i_deg, part.theta_o_deg, ~self.is_s)
        # what the quadrature misses, at the horizon, and an approximate receiver too, is not the inputs'
        self.quadrature_error = self._seen(Bench.nominal(part.instrument), self.data.basic) - self.expected
        self.linear_shift = self._linear_shift()

    def _linear_shift(self) -> FloatArray:
        """Return a root (p, p') of the covariance that is not drawn through readings."""
        basic_covariance = np.nan_to_num(self.fit.basic_covariance[0])
        held = np.isnan(np.diagonal(self.fit.basic_covariance, axis1=1, axis2=2))
        held[:, self.linear :] |= ~self.data.free
        unit, _ = random_and_common(self.data.model, self.data.basic, self.data.w, held, None)
        through = [
            g for g, name in enumerate(self.names) if not name.startswith("shared") and name != "wavelength"
        ]
        rest = basic_covariance - self.data.scale[0] * np.nan_to_num(unit[0])
        rest = rest - self.modes[through].T @ self.modes[through]
        size = np.sqrt(np.maximum(np.diag(basic_covariance), 0.0))
        safe = np.where(size > 0.0, size, 1.0)
        value, vector = np.linalg.eigh(rest / np.outer(safe, safe))
        return np.asarray(safe[:, None] * vector * np.sqrt(np.maximum(value, 0.0)))

    def run(self, rng: np.random.Generator, count: int) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the quantities of `count` trials, (count, q), and which searches failed."""
        drawn = {given.name: given.draw(rng, count) for given in self.budget.inputs}
        noise = np.zeros((self.used.size, count))
        sd = np.sqrt(self.data.scale[0] / self.data.w[self.used, 0])
        noise[self.used] = sd[:, None] * rng.standard_normal((int(np.sum(self.used)), count))
        w, free = np.repeat(self.data.w, count, axis=1), np.repeat(self.data.free, count, axis=0)
        basic = np.repeat(self.data.basic, count, axis=0)
        for given in self.budget.inputs:  # the even ones are a second order of their own
            if given.u and not given.even:
                mode = self.modes[self.names.index(given.name)]
                basic = basic + (drawn[given.name] / given.u)[:, None] * mode
        basic = self._in_range(basic)
        through = self._interpreted(drawn, basic) - readings(self.data.model, basic)
        y = self.expected + noise - through
        found = refine(self.data.model, y, w, basic[:, self.linear :], free=free)
        shifted = found.basic + rng.standard_normal((count, basic.shape[1])) @ self.linear_shift.T
        shifted = self._in_range(shifted)
        return np.stack([quantity.of(shifted) for quantity in self.quantities], axis=1), ~found.converged

    def _in_range(self, basic: FloatArray) -> FloatArray:
        result = basic.copy()
        result[:, self.linear :] = np.clip(result[:, self.linear :], self.kind.low, self.kind.high)
        return result

    def _interpreted(self, drawn: dict[str, FloatArray], basic: FloatArray) -> FloatArray:
        """Return what a bench with the drawn inputs reads of the surfaces, (n, count)."""
        r = self._seen(self._bench(drawn), basic) - self.quadrature_error
        if self.crossed is not None:
            other = readings(self.crossed, basic)
            leak = drawn["polarizer_extinction"]
            r = (r + leak * other) / (1.0 + leak)
            r = r + np.sin(np.deg2rad(drawn["polarizer_angle"])) ** 2 * (other - r)
        own = np.where(self.is_s[:, None], drawn.get("baseline_s", 0.0), drawn.get("baseline_p", 0.0))
        r = r * (1.0 + drawn["baseline"]) * (1.0 + own) + drawn["zero_offset"]
        return np.asarray(r * (1.0 + drawn["nonlinearity"] * np.log10(np.maximum(np.abs(r), 1e-12))))

    def _bench(self, drawn: dict[str, FloatArray]) -> Bench:
        nominal = Bench.nominal(self.fit.instrument)
        return replace(
            nominal,
            **{field: np.asarray(getattr(nominal, field)) + drawn[name] for name, field in _GEOMETRY.items()},
        )

    def _seen(self, bench: Bench, basic: FloatArray) -> FloatArray:
        """Return the quadrature's readings, (n, count)."""
        published = self.kind.published(basic)
        if issubclass(self.kind, SeparateSurfaces):
            surfaces = self.kind.surfaces(published)
        else:
            surfaces = (self.kind.scattering(published),) * 2
        at = (self.fit.theta_i_deg, self.fit.theta_o_deg)
        return readings_on(bench, surfaces, *at, self.is_s, sharpness=self.sharpness)


def _compared(budget: Budget, k: int, q: int, name: str, sample: FloatArray, digits: int) -> Comparison:
    value, u = float(budget.estimate[k, q]), float(budget.combined[k, q])
    half = float(budget.expanded[k, q])
    lower, upper = value - half, value + half
    log_name = f"log_{name}"
    if log_name in budget.fit.kind.shape:  # the fit's interval of alpha is one of its logarithm
        factor = float(np.exp(half / value))
        lower, upper = value / factor, value * factor
    ordered = np.sort(sample)
    cut = round(0.025 * (sample.size + 1)) - 1
    low, high = float(ordered[cut]), float(ordered[-1 - cut])
    sd = float(np.std(sample, ddof=1))
    # density of a normal distribution at its 2.5 % quantile
    statistical = float(np.sqrt(0.025 * 0.975 / sample.size)) / 0.05845 * sd
    tolerance = 0.5 * 10.0 ** (np.floor(np.log10(u)) - (digits - 1)) if u > 0.0 else 0.0
    d_low, d_high = abs(lower - low), abs(upper - high)
    worst = max(d_low, d_high)
    verdict: Verdict = "validated" if worst <= tolerance else "not validated"
    if abs(worst - tolerance) < 3.0 * statistical:
        verdict = "undecided"
    return Comparison(
        name, value, u, lower, upper, float(np.mean(sample)), sd, low, high, d_low, d_high, float(tolerance),
        statistical, verdict,
    )  # fmt: skip
