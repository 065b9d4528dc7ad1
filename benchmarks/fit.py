"""Speed and error of the fit, beside scipy and lmfit fitting the same model to the same readings, one by one.

    python benchmarks/fit.py [--peers 12]

121 wavelengths, S and P, 292 positions, exact aperture, 0.5 % noise, unweighted so that all have the same
optimum. The peers get the tabulated lobe integral too, an analytic Jacobian (scipy), and start at the truth.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio.fitting import fit_readings
from gonio.fitting.columns import jacobian, readings
from gonio.fitting.problem import Problem

FloatArray = NDArray[np.float64]
ARTA = Aperture(26.0, 18.0, 95.2353)


def paper_plan() -> tuple[FloatArray, FloatArray, NDArray[np.str_]]:
    theta_i, theta_o = [], []
    for incidence, end in ((20.0, 105.0), (30.0, 114.0), (45.0, 126.0), (55.0, 141.0)):
        arm = np.arange(15.0, end + 1e-9, 3.0)
        theta_i += [incidence] * arm.size
        theta_o += list(arm - incidence)
    n = len(theta_i)
    return np.array(theta_i * 2), np.array(theta_o * 2), np.array(["s"] * n + ["p"] * n)


def basic_of(published: FloatArray) -> FloatArray:
    """Return (rho_d, k_n, log_alpha, n2), (1, 4)."""
    rho_d, rho_s, alpha, n2 = published
    return np.array([[rho_d, rho_s * ((n2 - 1.0) / (n2 + 1.0)) ** 2, np.log(alpha), n2]])


def with_scipy(problem: Problem, y: FloatArray, truth: FloatArray) -> FloatArray:
    from scipy.optimize import least_squares

    def residual(p: FloatArray) -> FloatArray:
        return readings(problem, basic_of(p))[:, 0] - y

    def jacobian(p: FloatArray) -> FloatArray:
        basic = basic_of(p)
        return jacobian(problem, basic)[0] @ np.linalg.inv(problem.published_jacobian(basic)[0])

    return least_squares(
        residual, truth, jac=jacobian, x_scale=truth, xtol=1e-14, ftol=1e-14, gtol=1e-14, method="lm"
    ).x


def with_lmfit(problem: Problem, y: FloatArray, truth: FloatArray) -> FloatArray:
    import lmfit

    names = ("rho_d", "rho_s", "alpha", "n2")
    parameters = lmfit.create_params(**dict(zip(names, map(float, truth), strict=True)))

    def residual(p: lmfit.Parameters) -> FloatArray:
        return readings(problem, basic_of(np.array([p[name].value for name in names])))[:, 0] - y

    result = lmfit.minimize(residual, parameters, xtol=1e-14, ftol=1e-14)
    return np.array([result.params[name].value for name in names])


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument(
        "--peers", type=int, default=12, help="wavelengths given to the peers; time is scaled to 121"
    )
    options.add_argument("--many", type=int, default=2000, help="wavelengths of the scaling row")
    chosen = options.parse_args()
    theta_i, theta_o, polarization = paper_plan()
    problem = Problem.of(ARTA, theta_i, theta_o, polarization == "s")
    m = 121
    truth = np.stack(
        [np.full(m, 0.72), np.full(m, 1.0), np.linspace(40.0, 400.0, m), np.linspace(1.55, 1.45, m)], 1
    )
    rng = np.random.default_rng(1)
    exact = np.concatenate([readings(problem, basic_of(t)) for t in truth], axis=1)
    y = exact * (1.0 + 0.005 * rng.standard_normal(exact.shape))
    at = (theta_i, theta_o, polarization)

    def ours(readings: FloatArray, **how: str) -> tuple[float, FloatArray]:
        best = np.inf
        for _ in range(5):
            start = time.perf_counter()
            fit = fit_readings(*at, readings, instrument=ARTA, **how)  # type: ignore[arg-type]
            best = min(best, time.perf_counter() - start)
        return best, fit.value

    print("                                  s for 121    largest error against      largest difference")
    print("                                wavelengths        truth, alpha, %   from gonio's optimum")
    _, noiseless = ours(exact)
    seconds, value = ours(y, weights="none")
    error = np.abs(value / truth - 1.0).max(axis=0)
    rows = [("gonio, unweighted", seconds, error[2], 0.0)]
    seconds, weighted = ours(y)
    rows.append(
        ("gonio, weights from residuals", seconds, np.abs(weighted / truth - 1.0)[:, 2].max(), np.nan)
    )
    for name, peer in (("scipy least_squares, each", with_scipy), ("lmfit, each", with_lmfit)):
        pick = np.linspace(0, m - 1, chosen.peers).astype(int)
        start = time.perf_counter()
        found = np.stack([peer(problem, y[:, k], truth[k]) for k in pick])
        seconds = (time.perf_counter() - start) * m / chosen.peers
        rows.append(
            (
                name,
                seconds,
                np.abs(found / truth[pick] - 1.0)[:, 2].max(),
                np.abs(found / value[pick] - 1.0).max(),
            )
        )
    for name, seconds, alpha_error, difference in rows:
        print(f"{name:<32}{seconds:>10.3f}{100 * alpha_error:>22.2f}{difference:>24.1e}")
    print(f"noiseless: largest relative error of a parameter {np.abs(noiseless / truth - 1.0).max():.1e}")
    many = np.tile(y, (1, -(-chosen.many // m)))[:, : chosen.many]
    start = time.perf_counter()
    fit_readings(*at, many, instrument=ARTA)
    seconds = time.perf_counter() - start
    print(f"{chosen.many} wavelengths, weighted: {seconds:.2f} s, {1e3 * seconds / chosen.many:.2f} ms each")


if __name__ == "__main__":
    main()
