"""Speed against error of the fit: ours, scipy and lmfit on the same model, and the paper's procedure.

    python benchmarks/fit.py [--peers 13] [--most 10000] [--no-models]

121 wavelengths, S and P: 292 positions, alpha 40...400 and n2 1.55...1.45 over the spectrum, 0.5 % noise, one
core.  Readings come from the simulated bench's two-dimensional quadrature.  scipy and lmfit fit the same
model to the same readings, wavelength by wavelength, with alpha on its logarithm; all start at the middle of
the spectrum's truth.  They get our tabulated integral, but for the row "integral each time", where every step
integrates the aperture anew.  Times are the processor's, so that other programs count little.

The paper's procedure is written as a MATLAB user would: Eq 22 by the trapezoidal rule with two points per
degree, Gauss-Newton steps with a Jacobian from forward differences, until the step or the sum of squares
changes by less than 1e-6, then the intervals of nlparci.

error        largest over the wavelengths, against the truth, in %
off optimum  largest relative difference of a parameter from the converged optimum of the same sum of squares,
             which Gauss-Newton steps by QR in the whole parameter space find from the truth, to rounding;
             of the paper's procedure from gonio's fit of Eq 22
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import _one_core
import numpy as np
from _fit_scans import ARTA, PARAMETERS, Positions, Simulator, paper_positions
from numpy.typing import NDArray
from scipy import special

from gonio.aperture import ApertureName
from gonio.fitting import fit_readings
from gonio.fitting.columns import jacobian, readings
from gonio.fitting.kinds import ModelName
from gonio.fitting.problem import Problem

FloatArray = NDArray[np.float64]
Fitted = tuple[float, FloatArray]  # seconds for all wavelengths, values (m, 4)

M = 121
NOISE = 0.005


def basic_of(published: FloatArray) -> FloatArray:
    """Return (rho_d, k_n, log_alpha, n2), (m, 4), from (rho_d, rho_s, alpha, n2), (m, 4)."""
    rho_d, rho_s, alpha, n2 = np.atleast_2d(published).T
    return np.stack([rho_d, rho_s * ((n2 - 1.0) / (n2 + 1.0)) ** 2, np.log(alpha), n2], axis=1)


def jacobian_of(problem: Problem, published: FloatArray) -> FloatArray:
    """Return the derivatives of the readings by (rho_d, rho_s, alpha, n2), (n, 4)."""
    basic = basic_of(published)
    return np.asarray(jacobian(problem, basic)[0] @ np.linalg.inv(Problem.published_jacobian(basic)[0]))


def converged(problem: Problem, y: FloatArray, root: FloatArray, begin: FloatArray) -> FloatArray:
    """Return the optimum of ``|root (y - model)|^2`` of each wavelength, (m, 4)."""
    found = begin.copy()
    for k in range(len(begin)):
        for _ in range(100):
            residual = root[:, k] * (y[:, k] - readings(problem, basic_of(found[k]))[:, 0])
            j = root[:, k, None] * jacobian_of(problem, found[k]) * found[k]
            step = np.linalg.lstsq(j, residual, rcond=None)[0]
            found[k] = found[k] * (1.0 + step)
            if np.max(np.abs(step)) < 1e-13:
                break
    return found


def with_scipy(problem: Problem, y: FloatArray, begin: FloatArray) -> FloatArray:
    from scipy.optimize import least_squares

    def residual(x: FloatArray) -> FloatArray:
        return readings(problem, basic_of(with_exponent(x)))[:, 0] - y

    def slopes(x: FloatArray) -> FloatArray:
        p = with_exponent(x)
        return jacobian_of(problem, p) * np.array([1.0, 1.0, p[2], 1.0])

    x = with_logarithm(begin)
    found = least_squares(residual, x, jac=slopes, x_scale=x, xtol=1e-14, ftol=1e-14, gtol=1e-14, method="lm")
    return with_exponent(found.x)


def with_lmfit(problem: Problem, y: FloatArray, begin: FloatArray) -> FloatArray:
    import lmfit

    names = ("rho_d", "rho_s", "log_alpha", "n2")
    parameters = lmfit.create_params(**dict(zip(names, map(float, with_logarithm(begin)), strict=True)))

    def values(p: lmfit.Parameters) -> FloatArray:
        return with_exponent(np.array([p[name].value for name in names]))

    def residual(p: lmfit.Parameters) -> FloatArray:
        return readings(problem, basic_of(values(p)))[:, 0] - y

    return values(lmfit.minimize(residual, parameters, xtol=1e-14, ftol=1e-14).params)


def with_lmfit_and_integral(at: Positions, y: FloatArray, begin: FloatArray) -> FloatArray:
    """As `with_lmfit`, the lobe integrated at every step as a user without a table would do."""
    import lmfit

    names = ("rho_d", "rho_s", "log_alpha", "n2")
    parameters = lmfit.create_params(**dict(zip(names, map(float, with_logarithm(begin)), strict=True)))
    diffuse = ARTA.diffuse_integral(at.theta_o_deg)
    half, delta = len(y) // 2, at.theta_i_deg - at.theta_o_deg  # S and P at the same angles
    cosine = np.cos(np.deg2rad(at.theta_i_deg))

    def residual(p: lmfit.Parameters) -> FloatArray:
        rho_d, rho_s, log_alpha, n2 = (p[name].value for name in names)
        lobe = np.tile(ARTA.lobe_integral(np.exp(log_alpha), delta[:half], at.theta_o_deg[:half]), 2)
        q = np.sqrt(n2**2 - 1.0 + cosine**2)
        r_s, r_p = ((cosine - q) / (cosine + q)) ** 2, ((n2**2 * cosine - q) / (n2**2 * cosine + q)) ** 2
        return rho_d * diffuse + rho_s * np.where(at.polarization == "s", r_s, r_p) * lobe - y

    found = lmfit.minimize(residual, parameters, xtol=1e-14, ftol=1e-14).params
    return with_exponent(np.array([found[name].value for name in names]))


def with_logarithm(p: FloatArray) -> FloatArray:
    return np.array([p[0], p[1], np.log(p[2]), p[3]])


def with_exponent(x: FloatArray) -> FloatArray:
    return np.array([x[0], x[1], np.exp(x[2]), x[3]])


@dataclass
class PaperProcedure:
    """Eq 22 with ±half_deg and a solid angle, Gauss-Newton, nlparci; keeps the intervals it found."""

    at: Positions
    half_deg: float
    solid_angle_sr: float

    def __post_init__(self) -> None:
        self.theta_i = np.deg2rad(self.at.theta_i_deg)
        count = round(4.0 * self.half_deg) + 1  # two points per degree
        inside = np.deg2rad(np.linspace(-self.half_deg, self.half_deg, count))
        self.weight = np.full(count, 1.0 / (count - 1.0))
        self.weight[[0, -1]] *= 0.5
        self.theta = np.deg2rad(self.at.theta_o_deg)[:, None] + inside
        self.above = np.abs(self.theta) < np.pi / 2.0
        self.mirror = np.clip(np.cos(self.theta - self.theta_i[:, None]), 0.0, None)
        self.intervals: list[FloatArray] = []

    def model(self, p: FloatArray) -> FloatArray:
        """Return the readings, (n,)."""
        rho_d, rho_s, alpha, n2 = p
        c = np.cos(self.theta_i)
        root = np.sqrt(1.0 - (np.sin(self.theta_i) / n2) ** 2)
        r_s = ((c - n2 * root) / (c + n2 * root)) ** 2  # Eq 11
        r_p = ((root - n2 * c) / (root + n2 * c)) ** 2  # Eq 12
        fresnel = np.where(self.at.polarization == "s", r_s, r_p)[:, None]
        f = rho_d / np.pi * np.cos(self.theta) + rho_s * fresnel * (alpha + 1.0) / (2.0 * np.pi) * (
            self.mirror**alpha
        )
        return np.asarray(np.where(self.above, f, 0.0) @ self.weight * self.solid_angle_sr)

    def jacobian(self, p: FloatArray, f: FloatArray) -> FloatArray:
        """Return forward differences from the readings f at p, (n, 4)."""
        steps = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs(p), 1e-3)
        return np.stack([(self.model(p + d) - f) / d.sum() for d in np.diag(steps)], axis=1)

    def fit(self, y: FloatArray, begin: FloatArray) -> FloatArray:
        """Return (rho_d, rho_s, alpha, n2) and keep their intervals."""
        p, f = begin.copy(), self.model(begin)
        for _ in range(200):
            residual = y - f
            step = np.linalg.lstsq(self.jacobian(p, f), residual, rcond=None)[0]
            size = 1.0
            while size > 1e-6:  # half the step until the sum of squares falls
                trial = p + size * step
                if trial[2] > 0.0 and trial[3] > 1.0:
                    new = self.model(trial)
                    if np.sum((y - new) ** 2) <= np.sum(residual**2):
                        break
                size *= 0.5
            else:
                break
            fall = 1.0 - np.sum((y - new) ** 2) / np.sum(residual**2)
            small = np.linalg.norm(trial - p) < 1e-6 * (1.0 + np.linalg.norm(p))
            p, f = trial, new
            if small or fall < 1e-6:
                break
        self.intervals.append(self.nlparci(p, y - f, self.jacobian(p, f)))
        return p

    @staticmethod
    def nlparci(p: FloatArray, residual: FloatArray, j: FloatArray) -> FloatArray:
        """Return lower and upper ends, (2, 4)."""
        v = residual.size - p.size
        inverse = np.linalg.inv(np.linalg.qr(j)[1])
        se = np.sqrt(np.sum(residual**2) / v * np.sum(inverse**2, axis=1))
        half = special.stdtrit(v, 0.975) * se
        return np.stack([p - half, p + half])


def each(one: Callable[[FloatArray, FloatArray], FloatArray], y: FloatArray, begin: FloatArray) -> Fitted:
    """Fit some wavelengths one by one from one start, (4,); the time is scaled to all `M`."""
    start = time.process_time()
    found = np.stack([one(column, begin) for column in y.T])
    return (time.process_time() - start) * M / len(found), found


def best_of(repeats: int, work: Callable[[], object]) -> float:
    """Return the shortest time of several runs, s."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return float(best)


def compare(at: Positions, y: FloatArray, truth: FloatArray, peers: int) -> None:
    """Print the table of speed against error."""
    problem = Problem.of(ARTA, at.theta_i_deg, at.theta_o_deg, at.polarization == "s")
    pick = np.linspace(0, M - 1, peers).round().astype(int)
    rows: list[tuple[str, float, FloatArray, FloatArray | None]] = []
    covered: list[str] = []
    for name, weights in (("gonio, unweighted", "none"), ("gonio, weights from the data", "auto")):
        fit = fit_readings(*at.arguments(), y, instrument=ARTA, weights=weights)
        seconds = best_of(7, lambda w=weights: fit_readings(*at.arguments(), y, instrument=ARTA, weights=w))
        optimum = converged(problem, y, 1.0 / fit.sigma, truth)
        rows.append((name, seconds, fit.value / truth, fit.value / optimum))
        share = np.mean((fit.lower <= truth) & (truth <= fit.upper), axis=0)
        covered.append(f"{name} {_shares(share)}")
        if weights == "none":
            unweighted = optimum
    for name, one in (("scipy least_squares, one by one", with_scipy), ("lmfit, one by one", with_lmfit)):
        seconds, found = each(lambda r, b, f=one: f(problem, r, b), y[:, pick], truth[M // 2])
        rows.append((name, seconds, found / truth[pick], found / unweighted[pick]))
    few = pick[:: max(1, peers // 4)]
    seconds, found = each(lambda r, b: with_lmfit_and_integral(at, r, b), y[:, few], truth[M // 2])
    rows.append(("lmfit, integral each time", seconds, found / truth[few], found / unweighted[few]))
    eq22: tuple[tuple[str, ApertureName, float, float], ...] = (
        ("the paper's: Eq 22, ±13 deg", "published", 13.0, 0.0516),
        ("the same, ±7.77 deg", "eq22", ARTA.half_angles_deg[0], ARTA.solid_angle_sr),
    )
    for name, aperture, half, solid_angle in eq22:
        paper = PaperProcedure(at, half, solid_angle)
        seconds, found = each(paper.fit, y[:, pick], truth[M // 2])
        average = fit_readings(
            *at.arguments(), y[:, pick], instrument=ARTA, aperture=aperture, weights="none"
        )
        rows.append((name, seconds, found / truth[pick], found / average.value))
        low, high = np.swapaxes(np.array(paper.intervals), 0, 1)
        covered.append(f"{name} {_shares(np.mean((low <= truth[pick]) & (truth[pick] <= high), axis=0))}")
    reference = rows[0][1]
    head = f"{'':<34}{'s for 121':>10}{'ratio':>8}" + "".join(f"{name:>9}" for name in PARAMETERS)
    print(f"{'':<52}{'largest error, %':>36}\n{head}{'off optimum':>14}")
    for name, seconds, against_truth, against_optimum in rows:
        errors = 100.0 * np.max(np.abs(against_truth - 1.0), axis=0)
        off = "" if against_optimum is None else f"{np.max(np.abs(against_optimum - 1.0)):>14.1e}"
        cells = "".join(f"{error:>9.2f}" for error in errors)
        print(f"{name:<34}{seconds:>10.3f}{seconds / reference:>8.1f}{cells}{off}")
    print(f"peers: {peers} of the wavelengths, time scaled to {M}, errors of these alone\n")
    print("share of the 95 % intervals that hold the truth (rho_d, rho_s, alpha, n2):")
    print("".join(f"  {line}\n" for line in covered))


def _shares(share: FloatArray) -> str:
    return ", ".join(f"{100.0 * x:.0f} %" for x in share)


def scale(at: Positions, y: FloatArray, most: int) -> None:
    """Print time and memory against the number of wavelengths."""
    print("wavelengths   s, unweighted   s, weighted   ms each   memory beyond the result's, MB")
    for m in (M, *(x for x in (500, 2000, 5000, 10000) if x <= most)):
        many = np.tile(y, (1, -(-m // M)))[:, :m]
        times = [
            best_of(2, lambda w=w, r=many: fit_readings(*at.arguments(), r, instrument=ARTA, weights=w))
            for w in ("none", "auto")
        ]
        tracemalloc.start()
        fit = fit_readings(*at.arguments(), many, instrument=ARTA)
        held, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        del fit
        print(
            f"{m:>11}{times[0]:>16.3f}{times[1]:>14.3f}{1e3 * times[1] / m:>10.3f}"
            f"{(peak - held) / 1e6:>33.0f}"
        )
    print()


def other_models(at: Positions, y: FloatArray) -> None:
    """Print the time of every model on these readings, its tables included."""
    print("model          s for 121, tables included   converged   median chi2/dof")
    for name in get_args(ModelName):
        start = time.process_time()
        fit = fit_readings(*at.arguments(), y, instrument=ARTA, model=name, r_sd=NOISE * y, weights="r_sd")
        seconds = time.process_time() - start
        share = np.mean(["did not converge" not in note for note in fit.notes])
        print(
            f"{name:<15}{seconds:>26.3f}{f'{100.0 * share:.0f} %':>12}{np.median(fit.chi2 / fit.dof):>18.3g}"
        )
    print()


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--peers", type=int, default=13, help="wavelengths given to the peers")
    options.add_argument("--most", type=int, default=10000, help="most wavelengths of the scaling")
    options.add_argument("--no-models", action="store_true", help="leave out the other models")
    chosen = options.parse_args()
    at = paper_positions()
    truth = np.stack(
        [np.full(M, 0.72), np.full(M, 1.0), np.linspace(40.0, 400.0, M), np.linspace(1.55, 1.45, M)], axis=1
    )
    simulator = Simulator(at)
    simulator.prepare(truth[:, 2])
    r = np.stack([simulator.readings(*t) for t in truth.tolist()], axis=1)
    y = r * (1.0 + NOISE * np.random.default_rng(1).standard_normal(r.shape))
    fit = fit_readings(*at.arguments(), r, instrument=ARTA)
    off = np.max(np.abs(fit.value / truth - 1.0))
    print(f"without noise: largest relative error of a parameter {off:.1e}\n")
    compare(at, y, truth, chosen.peers)
    scale(at, y, chosen.most)
    if not chosen.no_models:
        other_models(at, y)
    print(_one_core.machine())


if __name__ == "__main__":
    main()
