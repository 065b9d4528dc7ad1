"""Where is the least-squares optimum?  Global start on a grid, then Newton steps, all wavelengths at once.

`rho_d` and `k_n` enter linearly and are eliminated (variable projection), so the search is over (log_alpha,
n2) alone. `start` evaluates the projected chi2 on a grid that covers the whole range: nothing depends on a
starting value. `refine` takes damped Newton steps with the exact Hessian of the projected problem, which
converge quadratically also where residuals are large; steps end at the bounds of the range, and a variable
that pushes against its bound rests there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.lobe_table import ALPHA_MAX, ALPHA_MIN
from gonio.fitting.problem import N2_MAX, N2_MIN, BoolArray, Problem

FloatArray = NDArray[np.float64]

LOW = np.array([np.log(ALPHA_MIN), N2_MIN])
HIGH = np.array([np.log(ALPHA_MAX), N2_MAX])

_GRID_LOG_ALPHA = np.linspace(LOW[0], HIGH[0], 49)
_GRID_N2 = 1.0 + np.geomspace(N2_MIN - 1.0, N2_MAX - 1.0, 10)
_GRID_N2 = np.unique(np.concatenate([_GRID_N2, np.arange(1.1, 2.05, 0.08), [2.3, 3.0, 4.0]]))
_ITERATIONS = 80
_QUADRATIC = 1e-7  # a Newton step this small leaves an error of its square
_BLOCK = 256  # wavelengths worked on together: scratch arrays stay in the cache


@dataclass(frozen=True, slots=True)
class Solution:
    """Optimum of each of m wavelengths."""

    basic: FloatArray  # (m, 4)
    chi2: FloatArray  # (m,) weighted sum of squared residuals
    converged: BoolArray  # (m,)


def start(problem: Problem, y: FloatArray, w: FloatArray) -> FloatArray:
    """Return the best grid point (log_alpha, n2) of each wavelength, (m, 2).

    Incidences closer than half a degree share one Fresnel ratio here, so the cost is that of a few sums per
    group.

    Parameters
    ----------
    y, w
        Readings and weights, (n, m); a reading of weight 0 is not used.
    """
    keys = {(round(2.0 * theta), s) for theta, s in problem.groups}
    groups = sorted(keys)
    member = np.array([groups.index((round(2.0 * theta), s)) for theta, s in problem.groups])[
        problem.incidence
    ]
    ratio = np.empty((len(groups), _GRID_N2.size))
    for g in range(len(groups)):
        first = int(np.flatnonzero(member == g)[0])
        ratio[g] = problem.ratio(_GRID_N2)[first]
    (lobe,) = problem.lobe.evaluate(_GRID_LOG_ALPHA)
    d = problem.diffuse[:, None]
    best = np.empty((y.shape[1], 2))
    for at in range(0, y.shape[1], _BLOCK):
        yb, wb = y[:, at : at + _BLOCK], w[:, at : at + _BLOCK]
        dd, dy = np.sum(wb * d**2, axis=0), np.sum(wb * d * yb, axis=0)
        sums = np.empty((3, len(groups), _GRID_LOG_ALPHA.size, yb.shape[1]))
        for g in range(len(groups)):
            rows = member == g
            part = lobe[rows].T
            sums[0, g] = part**2 @ wb[rows]
            sums[1, g] = part @ (wb[rows] * d[rows])
            sums[2, g] = part @ (wb[rows] * yb[rows])
        ss = np.tensordot(ratio.T**2, sums[0], 1)  # (n2, alpha, m)
        ds, sy = (np.tensordot(ratio.T, x, 1) for x in sums[1:])
        det = ss - ds**2 / dd
        gain = np.where(det > 1e-10 * ss, (sy - ds * dy / dd) ** 2 / np.where(det > 0.0, det, 1.0), 0.0)
        index = np.argmax(gain.reshape(-1, yb.shape[1]), axis=0)
        n2, alpha = np.unravel_index(index, gain.shape[:2])
        best[at : at + _BLOCK] = np.stack([_GRID_LOG_ALPHA[alpha], _GRID_N2[n2]], axis=1)
    return best


def refine(
    problem: Problem,
    y: FloatArray,
    w: FloatArray,
    begin: FloatArray,
    *,
    free: tuple[bool, bool] = (True, True),
) -> Solution:
    """Return the local optimum reached from `begin`, (m, 2), of (log_alpha, n2).

    `free` holds log_alpha or n2 at its given value, for profiles and for data that cannot determine it.
    """
    parts = [
        _refine_block(
            problem, y[:, at : at + _BLOCK], w[:, at : at + _BLOCK], begin[at : at + _BLOCK], np.array(free)
        )
        for at in range(0, y.shape[1], _BLOCK)
    ]
    return Solution(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _refine_block(
    problem: Problem, y: FloatArray, w: FloatArray, begin: FloatArray, free: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    x = np.clip(begin, LOW, HIGH)
    state = _Projected.at(problem, y, w, x)
    damping = np.zeros(len(x))
    done = np.zeros(len(x), bool)
    for _ in range(_ITERATIONS):
        todo = np.flatnonzero(~done)
        if not todo.size:
            break
        here = state.of(todo)
        step = here.step(x[todo], damping[todo], free)
        trial = np.clip(x[todo] + step, LOW, HIGH)
        moved = np.max(np.abs(trial - x[todo]), axis=1)
        new = _Projected.at(problem, y[:, todo], w[:, todo], trial)
        small = moved < _QUADRATIC
        better = (new.chi2 < here.chi2) | small
        x[todo[better]] = trial[better]
        state.put(todo[better], new.of(np.flatnonzero(better)))
        damping[todo] = np.where(
            better,
            np.where(damping[todo] > 1e-5, damping[todo] / 10.0, 0.0),
            np.maximum(10.0 * damping[todo], 1e-3),
        )
        # an undamped Newton step below _QUADRATIC has landed; a damped one that small cannot be improved on
        done[todo] = small
    basic = np.stack([state.rho_d, state.k_n, x[:, 0], x[:, 1]], axis=1)
    return basic, state.chi2, done


@dataclass(slots=True)
class _Projected:
    """chi2/2 with the linear unknowns eliminated: value, gradient and Hessian in (log_alpha, n2)."""

    rho_d: FloatArray
    k_n: FloatArray
    chi2: FloatArray
    gradient: FloatArray  # (m, 2)
    hessian: FloatArray  # (m, 2, 2)
    scale: FloatArray  # (m, 2) Gauss-Newton curvature before projection, the natural unit of damping

    @classmethod
    def at(cls, problem: Problem, y: FloatArray, w: FloatArray, x: FloatArray) -> _Projected:
        lobe, lobe_a, lobe_aa = problem.lobe.evaluate(x[:, 0], derivatives=2)
        q, q_n, q_nn = problem.ratio(x[:, 1]), problem.ratio_dn2(x[:, 1]), problem.ratio_d2n2(x[:, 1])
        d = problem.diffuse
        s, s_a, s_n = q * lobe, q * lobe_a, q_n * lobe
        ws = w * s
        dd, ds, ss = d**2 @ w, d @ ws, np.sum(ws * s, axis=0)
        dy, sy = d @ (w * y), np.sum(ws * y, axis=0)
        # solved in the residual of the diffuse-only fit, which keeps digits when the lobe is small
        det = ss - ds**2 / dd
        usable = det > 1e-13 * ss
        det = np.where(usable, det, 1.0)
        k = np.where(usable, (sy - ds * dy / dd) / det, 0.0)
        rho = (dy - k * ds) / dd
        residual = y - d[:, None] * rho - k * s
        # one correction of the linear unknowns removes the rounding of the normal equations
        dr, sr = d @ (w * residual), np.sum(ws * residual, axis=0)
        dk = np.where(usable, (sr - ds * dr / dd) / det, 0.0)
        drho = (dr - dk * ds) / dd
        rho, k = rho + drho, k + dk
        residual = residual - d[:, None] * drho - dk * s
        wr = w * residual
        r_a, r_n = np.sum(wr * s_a, axis=0), np.sum(wr * s_n, axis=0)
        gradient = -k[:, None] * np.stack([r_a, r_n], axis=1)
        aa, nn, an = np.sum(w * s_a**2, axis=0), np.sum(w * s_n**2, axis=0), np.sum(w * s_a * s_n, axis=0)
        h = np.empty((k.size, 2, 2))
        h[:, 0, 0] = k**2 * aa - k * np.sum(wr * q * lobe_aa, axis=0)
        h[:, 1, 1] = k**2 * nn - k * np.sum(wr * q_nn * lobe, axis=0)
        h[:, 0, 1] = h[:, 1, 0] = k**2 * an - k * np.sum(wr * q_n * lobe_a, axis=0)
        # Schur complement: what the linear unknowns take up.  Rows: (rho_d, k_n); columns: (log_alpha, n2).
        rho_row = k[:, None] * np.stack([d @ (w * s_a), d @ (w * s_n)], axis=1)
        k_row = k[:, None] * np.stack([np.sum(ws * s_a, axis=0), np.sum(ws * s_n, axis=0)], axis=1)
        k_row = k_row - np.stack([r_a, r_n], axis=1) - (ds / dd)[:, None] * rho_row
        h -= rho_row[:, :, None] * rho_row[:, None, :] / dd[:, None, None]
        h -= np.where(usable, 1.0 / det, 0.0)[:, None, None] * k_row[:, :, None] * k_row[:, None, :]
        tiny = np.finfo(float).tiny
        scale = np.maximum(k[:, None] ** 2 * np.stack([aa, nn], axis=1), tiny)
        return cls(rho, k, np.sum(wr * residual, axis=0), gradient, h, scale)

    def of(self, rows: NDArray[np.intp]) -> _Projected:
        """Return the part of some wavelengths."""
        return _Projected(
            self.rho_d[rows],
            self.k_n[rows],
            self.chi2[rows],
            self.gradient[rows],
            self.hessian[rows],
            self.scale[rows],
        )

    def put(self, rows: NDArray[np.intp], other: _Projected) -> None:
        """Replace the part of some wavelengths."""
        for name in ("rho_d", "k_n", "chi2", "gradient", "hessian", "scale"):
            getattr(self, name)[rows] = getattr(other, name)

    def step(self, x: FloatArray, damping: FloatArray, free: BoolArray) -> FloatArray:
        """Return the damped Newton step (m, 2), zero in variables that are held or push against a bound."""
        unit = np.sqrt(self.scale)
        g = self.gradient / unit
        h = self.hessian / (unit[:, :, None] * unit[:, None, :])
        held = ~free | ((x <= LOW) & (g > 0.0)) | ((x >= HIGH) & (g < 0.0))
        g = np.where(held, 0.0, g)
        a, b = np.where(held[:, 0], 1.0, h[:, 0, 0]), np.where(held[:, 1], 1.0, h[:, 1, 1])
        c = np.where(np.any(held, axis=1), 0.0, h[:, 0, 1])
        smallest = 0.5 * (a + b) - np.hypot(0.5 * (a - b), c)
        shift = damping + np.where(smallest <= 1e-12, 1e-6 - 2.0 * smallest, 0.0)
        a, b = a + shift, b + shift
        det = a * b - c**2
        step = -np.stack([b * g[:, 0] - c * g[:, 1], a * g[:, 1] - c * g[:, 0]], axis=1) / det[:, None] / unit
        longest = np.stack([np.full(len(x), 1.0), 0.3 + 0.5 * (x[:, 1] - 1.0)], axis=1)
        return np.asarray(step / np.maximum(1.0, np.max(np.abs(step) / longest, axis=1))[:, None])
