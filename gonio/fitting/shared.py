"""What do all wavelengths share?  A dispersion of n2, and the gain and zero offset of each detector.

    r = g_d model(rho_d, k_n, log_alpha, n2(wavelength)) + o_d

With psi = (coefficients of n2, g_d - 1, o_d) and a prior on the last two, one takes turns: each wavelength is
fitted with psi given; then a Gauss-Newton step of psi with the wavelengths' own parameters eliminated,

    N = sum over wavelengths of (G'WG - C'A^-1 C) + prior,   A = J'WJ,  C = J'WG,

J the derivatives of the readings by a wavelength's own parameters and G those by psi.  Gains alone leave the
spectrum's shape to the linear coefficients, so a gain stays at its prior unless two detectors measured the
same wavelengths: those are then fitted as one surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.errors import FitError
from gonio.fitting.columns import BoolArray, FitModel, FloatArray, jacobian, readings
from gonio.fitting.covariance import inverse
from gonio.fitting.dispersion import Dispersion
from gonio.fitting.limits import diffuse_only, is_lobe
from gonio.fitting.solve import Solution, refine
from gonio.overlap import pairs

_ITERATIONS = 60
_PRIOR_ONLY = 0.9  # of a prior's standard uncertainty: what is left of it says who told the value
_MISFIT = 1e-3
_DECREMENT = 1e-14  # of psi's step, in units of its own variance


@dataclass(frozen=True, slots=True)
class Detectors:
    """Standard uncertainties of each detector's gain (relative) and zero offset (in r), (d,); 0 is exact."""

    gain_u: FloatArray
    offset_u: FloatArray


@dataclass(frozen=True, slots=True)
class Shared:
    """What the wavelengths have in common, and each wavelength's own part.

    Attributes
    ----------
    names, value, covariance
        Of psi, (g,), (g, g).
    solution
        Each wavelength's optimum; chi2 against the readings as they are.
    random
        Covariance of the basic parameters with psi given, (m, p, p).
    modes
        (g, m, p), shifts of the basic parameters by one standard uncertainty of each of g independent
        combinations of psi.
    gain, offset
        Of every wavelength's detector, (m,).
    remarks
        What a person must know of it, a sentence each.
    """

    names: tuple[str, ...]
    value: FloatArray
    covariance: FloatArray
    solution: Solution
    random: FloatArray
    modes: FloatArray
    gain: FloatArray
    offset: FloatArray
    remarks: tuple[str, ...]

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Names of the independent combinations, each after the coefficient that it brings in."""
        return tuple(f"shared {name}" for name in self.names)


def fit_shared(
    model: FitModel,
    y: FloatArray,
    w: FloatArray,
    separate: Solution,
    *,
    free: BoolArray,
    lobe: BoolArray,
    n2_se: FloatArray,
    dof: FloatArray,
    wavelength_nm: FloatArray,
    detector_index: NDArray[np.integer],
    dispersion: Dispersion | None,
    detectors: Detectors,
) -> Shared:
    """Return the joint optimum over m wavelengths.

    Parameters
    ----------
    y, w
        Readings and weights, (n, m).
    separate
        The optimum of each wavelength for itself.
    free
        Shape parameters that a wavelength is free to choose, (m, k).
    lobe
        Where a lobe is seen, (m,); elsewhere there is none, and no index to share.
    n2_se, dof
        Standard errors of the separate indices and degrees of freedom, (m,).
    """
    if dispersion is not None and not np.any(lobe):
        raise FitError(
            f"n2 = '{dispersion.name}' has nothing to be told by: no lobe is seen at any wavelength; fit "
            "n2 = 'free', or model 'lambert'"
        )
    return _Joint(
        model, y, w, free, lobe, wavelength_nm, detector_index, dispersion, detectors, separate, dof
    ).solve(separate, n2_se)


class _Joint:
    """One joint problem; the methods pass psi about."""

    def __init__(
        self,
        model: FitModel,
        y: FloatArray,
        w: FloatArray,
        free: BoolArray,
        lobe: BoolArray,
        wavelength_nm: FloatArray,
        detector_index: NDArray[np.integer],
        dispersion: Dispersion | None,
        detectors: Detectors,
        separate: Solution,
        dof: FloatArray,
    ) -> None:
        self.model, self.y, self.raw_w, self.dof = model, y, w, dof
        self.um = np.where(np.isfinite(wavelength_nm), wavelength_nm, 1000.0) / 1000.0
        self.form = dispersion
        self.detector = detector_index.astype(np.intp)
        self.lobe = lobe
        self.free = free & lobe[:, None]
        self.n2_at = len(model.linear) + list(model.shape).index("n2") if "n2" in model.shape else -1
        if dispersion is not None:
            self.free[:, list(model.shape).index("n2")] = False
        self.gains = np.flatnonzero(detectors.gain_u > 0.0)
        self.offsets = np.flatnonzero(detectors.offset_u > 0.0)
        own = 0 if dispersion is None else len(dispersion.coefficients)
        self.own = own
        self.names = (
            *(() if dispersion is None else dispersion.coefficients),
            *(f"gain[{d}]" for d in self.gains),
            *(f"offset[{d}]" for d in self.offsets),
        )
        u = np.concatenate([detectors.gain_u[self.gains], detectors.offset_u[self.offsets]])
        self.prior = np.concatenate([np.zeros(own), u**-2.0])
        tied = pairs(wavelength_nm, detector_index) if self.gains.size or self.offsets.size else []
        self.first = np.array([a for a, _ in tied], np.intp)
        self.second = np.array([b for _, b in tied], np.intp)
        self.w = self._scaled(separate.chi2)

    def _scaled(self, chi2: FloatArray) -> FloatArray:
        """Return weights in units of the variance that the residuals show."""
        scale = chi2 / np.maximum(self.dof, 1.0)
        floor = 1e-24 * np.sum(self.raw_w * self.y**2, axis=0) / np.maximum(self.dof, 1.0)
        return np.asarray(self.raw_w / np.maximum(np.maximum(scale, floor), np.finfo(float).tiny))

    def split(self, psi: FloatArray) -> tuple[FloatArray | None, FloatArray, FloatArray]:
        """Return n2 (m,), gain (m,) and offset (m,)."""
        n2 = None if self.form is None else self.form.value(psi[: self.own], self.um)
        count = 1 + int(self.detector.max(initial=0))
        gain, offset = np.ones(count), np.zeros(count)
        gain[self.gains] += psi[self.own : self.own + self.gains.size]
        offset[self.offsets] = psi[self.own + self.gains.size :]
        return n2, gain[self.detector], offset[self.detector]

    def allowed(self, psi: FloatArray) -> bool:
        """Whether every n2 lies in the model's range and every gain is positive."""
        n2, gain, _ = self.split(psi)
        if not np.all(gain > 0.0):
            return False
        if n2 is None:
            return True
        column = list(self.model.shape).index("n2")
        low, high = self.model.low[column], self.model.high[column]
        return bool(np.all((n2 >= low) & (n2 <= high)))

    def each(self, psi: FloatArray, begin: FloatArray) -> tuple[Solution, float]:
        """Return each wavelength's optimum with psi given, and the whole chi2 with the prior."""
        n2, gain, offset = self.split(psi)
        y, w = (self.y - offset) / gain, self.w * gain**2
        begin = begin.copy()
        if n2 is not None:
            begin[:, list(self.model.shape).index("n2")] = n2
        if self.first.size:  # one surface, measured twice
            a, b = self.first, self.second
            together = w[:, a] + w[:, b]
            mean = (w[:, a] * y[:, a] + w[:, b] * y[:, b]) / np.where(together > 0.0, together, 1.0)
            y, w = y.copy(), w.copy()
            y[:, a] = y[:, b] = mean
            w[:, a] = w[:, b] = together
            begin[b] = begin[a]
        found = refine(self.model, y, w, begin, free=self.free)
        flat = ~self.lobe
        if np.any(flat):
            found.basic[flat] = diffuse_only(self.model, y[:, flat], w[:, flat], found.basic[flat])
        residual = self.residual(psi, found.basic)
        chi2 = np.sum(self.w * residual**2, axis=0)
        total = float(np.sum(chi2) + np.sum(self.prior * psi**2))
        return Solution(found.basic, chi2, found.converged), total

    def residual(self, psi: FloatArray, basic: FloatArray) -> FloatArray:
        """Return the readings minus what is expected of them, (n, m)."""
        _, gain, offset = self.split(psi)
        return self.y - gain * readings(self.model, basic) - offset

    def normal(
        self, psi: FloatArray, basic: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return N (g, g), its right side (g,), each A^-1 (m, p, p) and dbasic/dpsi (m, p, g)."""
        _, gain, _ = self.split(psi)
        own = jacobian(self.model, basic)
        shared = np.zeros((*own.shape[:2], len(self.names)))
        if self.form is not None:
            slope = self.form.slope(psi[: self.own], self.um)
            shared[:, :, : self.own] = (gain[:, None] * own[:, :, self.n2_at])[:, :, None] * slope[:, None, :]
        expected = readings(self.model, basic).T
        for k, d in enumerate(self.gains):
            shared[:, :, self.own + k] = np.where(self.detector == d, 1.0, 0.0)[:, None] * expected
        for k, d in enumerate(self.offsets):
            shared[:, :, self.own + self.gains.size + k] = np.where(self.detector == d, 1.0, 0.0)[:, None]
        own = own * gain[:, None, None]
        held = np.zeros(basic.shape, bool)
        held[:, len(self.model.linear) :] = ~self.free
        held[~self.lobe] |= np.array([is_lobe(name) for name in (*self.model.linear, *self.model.shape)])
        weight = self.w.T[:, :, None]
        size = np.sqrt(np.sum(weight * own**2, axis=1))
        there = ~held & (size > 1e-9 * np.max(size, axis=1, keepdims=True))
        unit = np.where(there, size, 1.0)
        own = np.where(there, 1.0 / unit, 0.0)[:, None, :] * own
        a = np.swapaxes(own, 1, 2) @ (weight * own)
        c = np.swapaxes(own, 1, 2) @ (weight * shared)
        error = self.residual(psi, basic).T[:, :, None]
        pull_own = np.swapaxes(own, 1, 2) @ (weight * error)
        whole = np.sum(np.swapaxes(shared, 1, 2) @ (weight * shared), axis=0)
        pull = np.sum(np.swapaxes(shared, 1, 2) @ (weight * error), axis=0)[:, 0]
        counted = np.ones(len(basic), bool)
        if self.first.size:  # in units of the first, whose parameters they are
            ratio = unit[self.first] / unit[self.second]
            i, j = self.first, self.second
            a[i] += a[j] / ratio[:, :, None] / ratio[:, None, :]
            c[i] += c[j] / ratio[:, :, None]
            pull_own[i] += pull_own[j] / ratio[:, :, None]
            counted[j] = False
        a_inverse = np.nan_to_num(inverse(a + np.where(there, 0.0, 1.0)[:, :, None] * np.eye(a.shape[1])))
        answer = a_inverse @ c
        whole = whole - np.sum(np.swapaxes(c, 1, 2)[counted] @ answer[counted], axis=0)
        pull = pull - np.sum(np.swapaxes(answer, 1, 2)[counted] @ pull_own[counted], axis=0)[:, 0]
        known = np.where(there, 1.0 / unit, 0.0)
        random = a_inverse * known[:, :, None] * known[:, None, :]
        response = -answer * known[:, :, None]
        if self.form is not None:
            response[:, self.n2_at, : self.own] = self.form.slope(psi[: self.own], self.um)
        if self.first.size:
            random[self.second], response[self.second] = random[self.first], response[self.first]
        return whole + np.diag(self.prior), pull - self.prior * psi, random, response

    def solve(self, separate: Solution, n2_se: FloatArray) -> Shared:
        """Return the joint optimum, begun at the separate ones."""
        psi = np.zeros(len(self.names))
        if self.form is not None:
            psi[: self.own] = self._begin(separate, n2_se)
        begin = separate.basic[:, len(self.model.linear) :]
        found, total = self.each(psi, begin)
        for rescaled in (False, True):
            found, psi, total = self._descend(found, psi, total)
            if not rescaled:  # the residuals of the joint optimum, not of the separate ones, say how noisy
                scaled = np.sum(self.raw_w * self.residual(psi, found.basic) ** 2, axis=0)
                self.w = self._scaled(scaled)
                found, total = self.each(psi, found.basic[:, len(self.model.linear) :])
        matrix, _, random, response = self.normal(psi, found.basic)
        covariance = _inverse_of(matrix)
        root = np.linalg.cholesky(covariance + 1e-14 * np.diag(np.diag(covariance)))
        _, gain, offset = self.split(psi)
        chi2 = np.sum(self.raw_w * self.residual(psi, found.basic) ** 2, axis=0)
        return Shared(
            self.names,
            psi,
            covariance,
            Solution(found.basic, chi2, found.converged),
            random,
            np.moveaxis(response @ root, 2, 0),
            gain,
            offset,
            (*self._values(psi, covariance), *self._misfit(separate, chi2)),
        )

    def _values(self, psi: FloatArray, covariance: FloatArray) -> list[str]:
        """Return psi in words."""
        said = []
        for k, (name, value, se) in enumerate(
            zip(self.names, psi.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True)
        ):
            gain = name.startswith("gain")
            text = f"{name} = {value + gain:.6g} ± {se:.2g} (standard uncertainty)"
            if k >= self.own and se > _PRIOR_ONLY * self.prior[k] ** -0.5:
                text += ", as stated beforehand: the readings do not tell it"
            said.append(text)
        return said

    def _misfit(self, separate: Solution, chi2: FloatArray) -> list[str]:
        """Say whether the shared index costs more than chance: an F test of joint against separate fits."""
        if self.form is None:
            return []
        use = np.any(self.free, axis=1) & separate.converged
        extra = int(np.sum(use)) - self.own
        dof = float(np.sum(self.dof[use]))
        scale = separate.chi2[use] / np.maximum(self.dof[use], 1.0)
        if extra <= 0 or not np.all(scale > 0.0):
            return []
        rise = float(np.sum(chi2[use] / scale - self.dof[use]))
        chance = float(special.fdtrc(float(extra), dof, rise / extra)) if rise > 0.0 else 1.0
        if chance > _MISFIT:
            return []
        return [
            f"n2 = '{self.form.name}' does not follow the wavelengths: chi2 rises by {rise:.0f} where chance "
            f"adds {extra} (p = {chance:.1g}), and the intervals do not know it; use a form with more "
            "coefficients, or 'free'"
        ]

    def _begin(self, separate: Solution, n2_se: FloatArray) -> FloatArray:
        """Return coefficients of n2 from the separate indices, or from the best single index."""
        assert self.form is not None
        known = np.isfinite(n2_se) & (n2_se > 0.0) & separate.converged
        candidates = []
        n2 = separate.basic[:, self.n2_at]
        if np.sum(known) >= self.own:
            weight = np.where(known, 1.0 / np.where(known, n2_se, 1.0) ** 2, 0.0)
            candidates.append(self.form.begin(n2, weight, self.um))
        candidates += [
            self.form.begin(np.full(n2.shape, index), np.ones(n2.shape), self.um)
            for index in (1.05, 1.2, 1.35, 1.5, 1.7, 2.0, 3.0)
        ]
        begin = separate.basic[:, len(self.model.linear) :]
        tried = []
        for own in candidates:
            psi = np.zeros(len(self.names))
            psi[: self.own] = own
            if self.allowed(psi):
                tried.append((self.each(psi, begin)[1], own))
        return min(tried, key=lambda pair: pair[0])[1]

    def _descend(self, found: Solution, psi: FloatArray, total: float) -> tuple[Solution, FloatArray, float]:
        for _ in range(_ITERATIONS):
            matrix, pull, _, _ = self.normal(psi, found.basic)
            step = _inverse_of(matrix) @ pull
            if float(step @ pull) < _DECREMENT * max(total, 1.0):
                return found, psi, total
            length = 1.0
            while length > 1e-6:
                trial = psi + length * step
                if self.allowed(trial):
                    new, value = self.each(trial, found.basic[:, len(self.model.linear) :])
                    if value < total * (1.0 + 1e-13):
                        break
                length *= 0.5
            else:
                if self.form is not None and not self.allowed(psi + 1e-3 * step):
                    low, high = self.model.low[-1], self.model.high[-1]
                    raise FitError(
                        f"n2 = '{self.form.name}' leaves the range {low:g}...{high:g} at some wavelength: "
                        "these data do not follow that form; fit n2 = 'constant', or 'free'"
                    )
                return found, psi, total
            done = total - value <= 1e-12 * max(total, 1.0) and length == 1.0
            found, psi, total = new, trial, value
            if done:
                return found, psi, total
        return found, psi, total


def _inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric matrix, scaled to a unit diagonal first.

    Raises
    ------
    FitError
        A direction of psi that no reading tells.
    """
    size = np.sqrt(np.diag(matrix))
    if np.all(size > 0.0):
        scaled = matrix / np.outer(size, size)
        if np.linalg.cond(scaled) < 1e14:
            return np.asarray(np.linalg.inv(scaled) / np.outer(size, size))
    raise FitError(
        "the readings do not tell what the wavelengths are to share (no lobe, or one incidence and "
        "polarization only): fit each wavelength for itself, or give n2"
    )
