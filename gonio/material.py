"""What the rest of the program needs to know of a surface: the four parameters over wavelength.

A `Material` comes from a fit (`Material.from_file`, `Material.from_fit`), from an albedo
(`Material.lambert`), or from numbers.  `Material.band` makes one entry of a band, for simulations that carry
one spectral band at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from gonio import fresnel
from gonio.brdf import PublishedLobe
from gonio.errors import GonioError
from gonio.fresnel import Polarization

if TYPE_CHECKING:
    from gonio.fitting import FitResult

FloatArray = NDArray[np.float64]
Weight = Callable[[FloatArray], ArrayLike]

_ANY_ALPHA, _ANY_N2 = 1.0, 1.5  # stand-ins where there is no lobe; they multiply rho_s = 0


@dataclass(frozen=True, slots=True)
class Material:
    """Four parameters of the published lobe at each wavelength.

    Parameters
    ----------
    name
        For messages and files.
    wavelength_nm
        (m,) ascending; a single NaN means "the same at every wavelength".
    rho_d, rho_s, alpha, n2
        (m,) each, as in `gonio.brdf.PublishedLobe`; finite, rho_d >= 0, rho_s >= 0, alpha >= 0, n2 >= 1.
    theta_i_deg
        Incidences at which the parameters were measured; `band` conserves the reflection there.

    Raises
    ------
    GonioError
        A parameter that is not a number or outside its range, at the wavelength named.
    """

    name: str
    wavelength_nm: FloatArray
    rho_d: FloatArray
    rho_s: FloatArray
    alpha: FloatArray
    n2: FloatArray
    theta_i_deg: tuple[float, ...] = (20.0, 30.0, 45.0, 55.0)

    def __post_init__(self) -> None:
        wavelength = np.atleast_1d(np.asarray(self.wavelength_nm, np.float64))
        object.__setattr__(self, "wavelength_nm", wavelength)
        for key, least in (("rho_d", 0.0), ("rho_s", 0.0), ("alpha", 0.0), ("n2", 1.0)):
            value = np.array(np.broadcast_to(np.asarray(getattr(self, key), np.float64), wavelength.shape))
            bad = np.flatnonzero(~(np.isfinite(value) & (value >= least)))
            if bad.size:
                at = f" at {wavelength[bad[0]]:g} nm" if np.isfinite(wavelength[bad[0]]) else ""
                raise GonioError(
                    f"material '{self.name}': {key} = {value[bad[0]]:g}{at} must be a number "
                    f"of at least {least:g}; leave that wavelength out or correct it"
                )
            object.__setattr__(self, key, value)

    @classmethod
    def lambert(cls, albedo: float, name: str = "Lambert") -> Self:
        """Return a perfectly diffuse material of one albedo, 0...1, at every wavelength."""
        if not 0.0 <= albedo <= 1.0:
            raise GonioError(f"material '{name}': albedo = {albedo:g} must lie between 0 and 1; correct it")
        at = np.full(1, np.nan)
        rho_d, rho_s, alpha, n2 = (np.full(1, x) for x in (albedo, 0.0, _ANY_ALPHA, _ANY_N2))
        return cls(name, at, rho_d, rho_s, alpha, n2)

    @classmethod
    def from_fit(cls, fit: FitResult, name: str | None = None) -> Self:
        """Return the material of a fit; wavelengths that could not be fitted are left out.

        Where the fit found no lobe, rho_s is 0 and alpha and n2 are placeholders.  A negative rho_d or rho_s,
        as noise may give, is set to 0: a surface cannot reflect less than nothing.
        """
        if fit.model != "published" or fit.polarization == "shared_n2":
            raise GonioError(
                f"no material from a fit of model '{fit.model}', polarization '{fit.polarization}': a "
                "material is one published lobe for S and P; fit with model 'published' and polarization "
                "'joint', 's' or 'p'"
            )
        fit = fit.only(fit.home)  # one value where two detectors measured a wavelength
        rho_d, rho_s, alpha, n2 = fit.value.T
        # a lobe whose rho_s and n2 cannot be told apart has no reflection at other incidences
        undetermined = np.isfinite(rho_d) & ~np.isfinite(rho_s)
        if np.any(undetermined):
            k = int(np.argmax(undetermined))
            raise GonioError(f"no material at {fit.wavelength_nm[k]:g} nm, whose fit says: {fit.notes[k]}")
        lobe = np.isfinite(alpha) & np.isfinite(n2)
        use = np.isfinite(rho_d)
        if not np.any(use):
            raise GonioError(
                "the fit has no wavelength with a result; look at its notes, and fit another scan"
            )
        return cls(
            fit.sample_name if name is None else name,
            fit.wavelength_nm[use],
            np.maximum(rho_d, 0.0)[use],
            np.where(lobe, np.maximum(rho_s, 0.0), 0.0)[use],
            np.where(lobe, alpha, _ANY_ALPHA)[use],
            np.where(lobe, n2, _ANY_N2)[use],
            fit.incidences_deg,
        )

    @classmethod
    def from_file(cls, path: Path | str, fit: str | None = None) -> Self:
        """Return the material of a fit stored in a scan file.

        Parameters
        ----------
        path
            The scan, an `.h5` with at least one ``/entry/fit_*``.
        fit
            Its name, such as ``"exact_joint"``; None takes the exact joint fit, or else the newest.

        Raises
        ------
        StoreError
            No such file, or no such fit in it.
        """
        from gonio.fitting import load_fit  # the fit writes materials too

        return cls.from_fit(load_fit(path, fit))

    @property
    def model(self) -> PublishedLobe:
        """The scattering model with these parameters, (m,) each."""
        return PublishedLobe(self.rho_d, self.rho_s, self.alpha, self.n2)

    def dsf(
        self, theta_i_deg: float, theta_o_deg: float, polarization: Polarization, azimuth_deg: float = 0.0
    ) -> FloatArray:
        """Return the differential scattering function at one pair of directions, (m,), 1/sr."""
        return self.model.dsf(theta_i_deg, theta_o_deg, polarization, azimuth_deg)

    def k_d(self) -> FloatArray:
        """Return the diffuse hemispherical coefficient, (m,)."""
        return self.rho_d

    def k_s(self, theta_i_deg: float, polarization: Polarization = "unpolarized") -> FloatArray:
        """Return the specular hemispherical coefficient, (m,): the lobe's energy above the horizon."""
        return self.model.specular_albedo(theta_i_deg, polarization)

    def k_g(self, theta_i_deg: float, polarization: Polarization = "unpolarized") -> FloatArray:
        """Return the global hemispherical coefficient, (m,): ``k_d + k_s``."""
        return self.model.directional_albedo(theta_i_deg, polarization)

    def band(self, low_nm: float, high_nm: float, weight: Weight | None = None) -> Material:
        """Return one entry that stands for the wavelengths from `low_nm` to `high_nm`.

        Parameters
        ----------
        low_nm, high_nm
            Both included.
        weight
            Relative spectral weight as a function of wavelength in nm (solar, photopic); None weighs all
            alike.

        Notes
        -----
        Averages are by the trapezoidal rule.  Four numbers cannot conserve everything; these do, in this
        order: `rho_d` is the mean, so k_d is conserved; `n2` gives the best least-squares match of the mean
        ``rho_s R_x`` at the measured incidences for S and P, relative to their size; `rho_s` makes the sum
        over those incidences and polarizations exact; ``1/(alpha + 2)``, the lobe's mean ``1 -
        cos(theta_s)``, is the energy-weighted mean.

        Raises
        ------
        GonioError
            No wavelength of the material lies in the band, or the weight is nowhere positive.
        """
        if not low_nm < high_nm:
            raise GonioError(
                f"band {low_nm:g}...{high_nm:g} nm: the first limit must be below the second; swap them"
            )
        if self.wavelength_nm.size == 1 and np.isnan(self.wavelength_nm[0]):
            return self
        use = (self.wavelength_nm >= low_nm) & (self.wavelength_nm <= high_nm)
        if not np.any(use):
            raise GonioError(
                f"material '{self.name}' has no wavelength from {low_nm:g} to {high_nm:g} nm; it was "
                f"measured from {self.wavelength_nm.min():g} to {self.wavelength_nm.max():g} nm: "
                "choose a band inside"
            )
        at = self.wavelength_nm[use]
        step = np.gradient(at) if at.size > 1 else np.ones(1)
        if at.size > 1:
            step[[0, -1]] *= 0.5  # the ends of the trapezoidal rule
        share = np.zeros(self.wavelength_nm.size)
        share[use] = step if weight is None else step * np.asarray(weight(at), np.float64)
        if not (np.all(np.isfinite(share)) and np.all(share >= 0.0) and np.sum(share) > 0.0):
            raise GonioError(
                f"band {low_nm:g}...{high_nm:g} nm: the weight must be a number of at least 0 at every "
                f"wavelength of material '{self.name}' and positive somewhere; give one that covers the band"
            )
        return self.averaged(share, f"{self.name}, {low_nm:g}-{high_nm:g} nm")

    def averaged(self, share: ArrayLike, name: str) -> Material:
        """Return one entry that stands for all wavelengths in the proportions of `share`, (m,) >= 0.

        What is conserved: see `band`.  `gonio.spectral.band_weights` gives the shares of a spectral weight.
        """
        parts = np.asarray(share, np.float64)
        use = parts > 0.0
        parts = parts[use] / np.sum(parts[use])
        rho_s, n2, alpha = self._band_lobe(use, parts)
        return Material(
            name,
            np.array([np.sum(parts * self.wavelength_nm[use])]),
            np.array([np.sum(parts * self.rho_d[use])]),
            np.array([rho_s]),
            np.array([alpha]),
            np.array([n2]),
            self.theta_i_deg,
        )

    def _band_lobe(self, use: NDArray[np.bool_], share: FloatArray) -> tuple[float, float, float]:
        """Return rho_s, n2, alpha of the mean lobe."""
        incidence = np.asarray(self.theta_i_deg)[:, None]

        def both(function: Callable[..., FloatArray], n2: ArrayLike) -> FloatArray:
            return np.concatenate([function(n2, incidence, "s"), function(n2, incidence, "p")])

        each = self.rho_s[use] * both(fresnel.reflectance, self.n2[use])
        mean = each @ share
        total = float(np.sum(mean))
        if total == 0.0:
            return 0.0, _ANY_N2, _ANY_ALPHA

        def mismatch(n2: float) -> float:
            shape = both(fresnel.reflectance_ratio, n2)[:, 0]
            return float(np.sum((mean - shape * total / np.sum(shape)) ** 2)) / total**2

        low, high = float(self.n2[use].min()), float(self.n2[use].max())
        n2 = low
        if high > low:
            n2 = float(optimize.minimize_scalar(mismatch, bounds=(low, high), options={"xatol": 1e-9}).x)
        n2 = max(n2, 1.0 + 1e-9)
        rho_s = total / float(np.sum(both(fresnel.reflectance, n2)))
        energy = share * np.sum(each, axis=0)
        width = float(np.sum(energy / (self.alpha[use] + 2.0)) / np.sum(energy))
        return rho_s, n2, 1.0 / width - 2.0
