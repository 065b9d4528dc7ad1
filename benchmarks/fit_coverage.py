"""Is the fit unbiased, as precise as the data allow, and do 95 % intervals cover 95 %?  Against known truths.

    python benchmarks/fit_coverage.py [--cases 100] [--each 100] [--polarization joint s p] [--corners]
                                  [--intervals wald|profile] [--alone] [--common] [--strata]

Truths are drawn at random: alpha 10...2000 and rho_s 0.2...2 on their logarithms, n2 1.2...1.8, rho_d
0.05...0.9, noise 0.1...5 % of a white panel's reading on its logarithm; or with `--corners` all 16 corners of
that range with rho_d 0.72.  Readings come from the simulated bench's two-dimensional quadrature, with a noise
of a floor, a shot part and a proportional part in the mixture of a good instrument, of which the fit is told
nothing.

bias/se      mean of (estimate - truth)/sd over the cases; alpha on its logarithm, as its interval is made
var/CRB      variance of the estimates over the Cramér-Rao bound with the true weights, from central
             differences of the quadrature's readings: nothing of the fit's Jacobian
covered      share of 95 % intervals that hold the truth; an open end holds all beyond the other end

Behind each its standard error.  Where a case has scans whose interval is open or missing for a quantity, it
has no variance to speak of: such cases are left out of the first two columns, and counted under "open".
`--alone` fits every scan for itself, without neighbours to learn the noise from; `--common` adds a baseline
error of 0.1 % per polarization and a dark error of 1e-5 to each scan, which the fit is told (coverage only).
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import _one_core
import numpy as np
from _fit_scans import ARTA, COEFFICIENTS, PARAMETERS, Simulator, coefficients, paper_positions
from numpy.typing import NDArray

from gonio.fitting import fit_readings

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

QUANTITIES = (*PARAMETERS, *COEFFICIENTS)
ALPHA = QUANTITIES.index("alpha")
WHITE_R = 0.72 / np.pi * 0.0509
GAIN_U, OFFSET_U = 1e-3, 1e-5
STRATA = (0.1, 0.37, 1.36, 5.0)  # noise in %


@dataclass(frozen=True)
class Case:
    """A truth (rho_d, rho_s, alpha, n2) and a noise, relative at a white panel's reading."""

    truth: tuple[float, float, float, float]
    noise: float

    def sd(self, r: FloatArray) -> FloatArray:
        """Return the standard deviation of readings r."""

        def mixture(x: FloatArray | float) -> FloatArray:
            return np.sqrt(2e-5**2 + 4e-4**2 * np.asarray(x) + (2e-3 * np.asarray(x)) ** 2)

        return self.noise * WHITE_R * mixture(r) / mixture(WHITE_R)

    def known(self) -> FloatArray:
        """Return the true `QUANTITIES`, alpha as its logarithm."""
        known = np.array([*self.truth, *coefficients(*self.truth)])
        known[ALPHA] = np.log(known[ALPHA])
        return known


def draw(rng: np.random.Generator, count: int) -> list[Case]:
    def log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return [
        Case(
            (
                float(rng.uniform(0.05, 0.9)), log_uniform(0.2, 2.0), log_uniform(10.0, 2000.0),
                float(rng.uniform(1.2, 1.8)),
            ),
            log_uniform(1e-3, 5e-2),
        )
        for _ in range(count)
    ]  # fmt: skip


def corners() -> list[Case]:
    ends = ((0.2, 2.0), (10.0, 2000.0), (1.2, 1.8), (1e-3, 5e-2))
    return [Case((0.72, *truth), noise) for *truth, noise in itertools.product(*ends)]


_STEPS = (1e-3, 1e-3, 1e-4, 1e-5)  # of rho_d and rho_s, in which r is linear, of log alpha and of n2


def moved(truth: tuple[float, float, float, float], column: int, step: float) -> tuple[float, ...]:
    values = list(truth)
    values[column] = values[column] * np.exp(step) if column == 2 else values[column] + step
    return tuple(values)


def bound(simulator: Simulator, case: Case, rows: BoolArray) -> FloatArray:
    """Return the Cramér-Rao bounds of `QUANTITIES`, (7,)."""
    r = simulator.readings(*case.truth)
    j, k = np.empty((r.size, 4)), np.empty((3, 4))
    for column, step in enumerate(_STEPS):
        up, down = moved(case.truth, column, step), moved(case.truth, column, -step)
        j[:, column] = (simulator.readings(*up) - simulator.readings(*down)) / (2.0 * step)
        k[:, column] = (np.array(coefficients(*up)) - np.array(coefficients(*down))) / (2.0 * step)
    scaled = (j / case.sd(r)[:, None])[rows]
    unit = np.linalg.norm(scaled, axis=0)
    inverse = np.linalg.inv(np.linalg.qr(scaled / unit)[1]) / unit[:, None]
    covariance = inverse @ inverse.T
    return np.concatenate([np.diag(covariance), np.einsum("ka,ab,kb->k", k, covariance, k)])


@dataclass(frozen=True)
class Outcome:
    """Estimates and intervals of `QUANTITIES`, (cases, each, 7); truth and bounds (cases, 7)."""

    value: FloatArray
    lower: FloatArray
    upper: FloatArray
    truth: FloatArray
    bound: FloatArray
    noise: FloatArray

    def part(self, pick: BoolArray) -> Outcome:
        """Return some of the cases."""
        return Outcome(*(x[pick] for x in (
            self.value, self.lower, self.upper, self.truth, self.bound, self.noise
        )))  # fmt: skip


def run(
    simulator: Simulator,
    cases: list[Case],
    each: int,
    polarization: str,
    *,
    alone: bool,
    common: bool,
    intervals: str,
) -> Outcome:
    at = simulator.at
    shape = (len(cases), each, len(QUANTITIES))
    value, lower, upper = np.empty(shape), np.empty(shape), np.empty(shape)
    bounds = np.empty((len(cases), len(QUANTITIES)))
    for number, case in enumerate(cases):
        rng = np.random.default_rng([7, number])
        r = simulator.readings(*case.truth)
        y = r[:, None] + case.sd(r)[:, None] * rng.standard_normal((r.size, each))
        options = {}
        if common:
            for which in ("s", "p"):
                y[at.polarization == which] *= 1.0 + GAIN_U * rng.standard_normal(each)
            y += OFFSET_U * rng.standard_normal(each)
            options = {"gain_u": GAIN_U, "offset_u": OFFSET_U}
        fit = fit_readings(
            *at.arguments(), y, instrument=ARTA, polarization=polarization, intervals=intervals,
            detector_index=np.arange(each) % 2 if alone else None, **options,
        )  # fmt: skip
        k = fit.hemispherical(8.0)
        for array, name in ((value, "value"), (lower, "lower"), (upper, "upper")):
            array[number, :, :4] = getattr(fit, name)
            for column, coefficient in enumerate((k.k_d, k.k_s, k.k_g), start=4):
                array[number, :, column] = getattr(coefficient, name)
        bounds[number] = bound(simulator, case, at.only(polarization))
    with np.errstate(divide="ignore"):
        for array in (value, lower, upper):
            array[:, :, ALPHA] = np.log(np.maximum(array[:, :, ALPHA], 0.0))
    truth = np.array([case.known() for case in cases])
    return Outcome(value, lower, upper, truth, bounds, np.array([100.0 * c.noise for c in cases]))


def summary(found: Outcome, column: int) -> tuple[float, ...]:
    """Return bias, var/CRB, coverage with their standard errors, shares of open and of missing intervals."""
    value, truth = found.value[:, :, column], found.truth[:, column][:, None]
    low, high = found.lower[:, :, column], found.upper[:, :, column]
    missing = np.isnan(low) | np.isnan(high)
    at_bound = (high == np.inf) | (low == -np.inf) | ((column == 3) & (low <= 1.0))
    closed = ~np.any(missing | at_bound, axis=1)
    covered = ((low <= truth) & (truth <= high))[~missing]
    share = float(np.mean(covered)) if covered.size else np.nan
    result = [np.nan] * 4
    if np.any(closed):
        off = value[closed] - truth[closed]
        each = off.shape[1]
        sd = np.std(off, axis=1, ddof=1)
        result[0] = float(np.mean(np.mean(off, axis=1) / sd))
        result[1] = 1.0 / np.sqrt(off.size)
        ratio = sd**2 / found.bound[closed, column]
        result[2], result[3] = float(np.mean(ratio)), float(np.sqrt(2.0 / (each - 1.0) / ratio.size))
    share_se = np.sqrt(0.95 * 0.05 / max(covered.size, 1))
    return (*result, share, share_se, 1.0 - float(np.mean(closed)), float(np.mean(missing)))


def print_table(found: Outcome, title: str, common: bool) -> list[str]:
    """Print the table; return what is not met by more than three standard errors of the estimate."""
    failed = []
    print(f"\n{title}: {found.value.shape[0]} cases of {found.value.shape[1]} scans")
    print(f"{'':>7}{'bias/se':>18}{'var/CRB':>18}{'covered %':>18}{'open cases %':>14}{'no interval %':>15}")
    for column, name in enumerate(QUANTITIES):
        bias, bias_se, ratio, ratio_se, share, share_se, opened, missing = summary(found, column)
        met = (
            (np.isnan(bias) or abs(bias) <= 0.1)
            and (common or np.isnan(ratio) or ratio <= 1.05)
            and abs(share - 0.95) <= 0.01
        )
        sure = (
            abs(bias) - 0.1 > 3.0 * bias_se
            or (not common and ratio - 1.05 > 3.0 * ratio_se)
            or abs(share - 0.95) - 0.01 > 3.0 * share_se
        )
        print(
            f"{name:>7}{f'{bias:+.3f} ± {bias_se:.3f}':>18}"
            + (f"{'':>18}" if common else f"{f'{ratio:.3f} ± {ratio_se:.3f}':>18}")
            + f"{f'{100.0 * share:.2f} ± {100.0 * share_se:.2f}':>18}"
            + f"{100.0 * opened:>14.1f}{100.0 * missing:>15.2f}"
            + ("" if met else "   FAILS" if sure else "   misses, within the noise of this run")
        )
        if not met and sure:
            failed.append(f"{title}: {name}")
    return failed


def parts(found: Outcome, cases: list[Case], *, corners: bool, strata: bool) -> Iterator[tuple[str, Outcome]]:
    """Yield titles and parts of the outcome: every corner, or the cases by noise."""
    if corners:
        for number, case in enumerate(cases):
            rho_d, rho_s, alpha, n2 = case.truth
            title = f"rho_d {rho_d:g}, rho_s {rho_s:g}, alpha {alpha:g}, n2 {n2:g}, noise {case.noise:.1%}"
            yield title, found.part(np.arange(len(cases)) == number)
    for low, high in itertools.pairwise(STRATA) if strata else ():
        yield f"noise {low:g}...{high:g} %", found.part((found.noise >= low) & (found.noise < high))


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--cases", type=int, default=100, help="truths")
    options.add_argument("--each", type=int, default=100, help="scans of each truth")
    options.add_argument("--seed", type=int, default=2022)
    options.add_argument("--polarization", nargs="+", default=["joint", "s", "p"])
    options.add_argument("--corners", action="store_true", help="one table for each corner of the range")
    options.add_argument("--intervals", choices=["wald", "profile"], default="wald")
    options.add_argument("--alone", action="store_true", help="each scan without neighbours")
    options.add_argument("--common", action="store_true", help="baseline and dark errors too")
    options.add_argument("--strata", action="store_true", help="by noise level too")
    chosen = options.parse_args()
    simulator = Simulator(paper_positions())
    cases = corners() if chosen.corners else draw(np.random.default_rng(chosen.seed), chosen.cases)
    alphas = np.array([c.truth[2] for c in cases])
    simulator.prepare(np.concatenate([alphas, alphas * np.exp(_STEPS[2]), alphas * np.exp(-_STEPS[2])]))
    print("wanted: |bias| <= 0.1 se, variance <= 1.05 CRB, 94 % <= covered <= 96 %")
    failed = []
    for polarization in chosen.polarization:
        found = run(
            simulator,
            cases,
            chosen.each,
            polarization,
            alone=chosen.alone,
            common=chosen.common,
            intervals=chosen.intervals,
        )
        failed += print_table(found, polarization, chosen.common)
        for title, part in parts(found, cases, corners=chosen.corners, strata=chosen.strata):
            failed += print_table(part, f"{polarization}, {title}", chosen.common)
    print(f"\n{_one_core.machine()}")
    print("not met:\n  " + "\n  ".join(failed) if failed else "all criteria met, to the noise of this run")


if __name__ == "__main__":
    main()
