"""Scans and fits with the attributes of the real ones, made from simple formulas: something to draw."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gonio.aperture import Aperture
from gonio.facade import EnergyBalance, Estimate, Irradiance, Receiver
from gonio.overlap import home
from gonio.report import style
from gonio.report.content import Content, References, Spectrum
from gonio.store.scan import Scan

OMEGA_SR = 0.0509
RIG = """name = "arta-simulated"
[stage.theta_mes]
blind_zone_deg = 15.0
[simulation]
seed = 1
"""
SWEEPS = ((20.0, 105.0), (30.0, 114.0), (45.0, 126.0), (55.0, 141.0))


def truth(wavelength_nm):
    x = (wavelength_nm - 300.0) / 1200.0
    rho_d = 0.72 * (1 - 0.8 * np.exp(-((wavelength_nm - 280.0) / 70.0))) - 0.08 * np.clip(x - 0.6, 0, 1)
    return rho_d, np.ones_like(x), 70.0 + 40.0 * x, 1.52 - 0.03 * x


def fresnel(n2, theta_i_deg, polarization):
    ci = np.cos(np.radians(theta_i_deg))
    ct = np.sqrt(1 - (np.sin(np.radians(theta_i_deg)) / n2) ** 2)
    if polarization == "s":
        return ((ci - n2 * ct) / (ci + n2 * ct)) ** 2
    return ((ct - n2 * ci) / (ct + n2 * ci)) ** 2


def model(value, theta_i_deg, theta_o_deg, polarization):
    """r, (n, m), of a small aperture."""
    rho_d, rho_s, alpha, n2 = np.asarray(value).T
    ti, to = np.broadcast_arrays(np.asarray(theta_i_deg, float), np.asarray(theta_o_deg, float))
    ti, to = ti.reshape(-1, 1), to.reshape(-1, 1)
    p = np.broadcast_to(np.asarray(polarization), (len(to),)).reshape(-1, 1)
    reflectance = np.where(p == "s", fresnel(n2, ti, "s"), fresnel(n2, ti, "p"))
    lobe = (alpha + 1) / (2 * np.pi) * np.maximum(np.cos(np.radians(to - ti)), 0.0) ** alpha
    return OMEGA_SR * (rho_d / np.pi * np.cos(np.radians(to)) + rho_s * reflectance * lobe)


def build_scan(
    wavelength_nm=None, sweeps=SWEEPS, polarizations=("s", "p"), mismatch=-0.03, seed=1, **changed
):
    wavelength_nm = (
        np.arange(300.0, 1501.0, 10.0) if wavelength_nm is None else np.asarray(wavelength_nm, float)
    )
    rng = np.random.default_rng(seed)
    ti, tm, pol = [], [], []
    for theta_i, stop in sweeps:
        for p in polarizations:
            mes = np.arange(15.0, stop + 0.1, 3.0)
            ti += [theta_i] * len(mes)
            tm += list(mes)
            pol += [p] * len(mes)
    ti, tm, pol = np.array(ti), np.array(tm), np.array(pol)
    detector = (wavelength_nm >= 860.0).astype(np.uint8)
    r = model(np.array(truth(wavelength_nm)).T, ti, tm - ti, pol) * np.where(detector == 0, 1 + mismatch, 1.0)
    sd = np.hypot(2.5e-5, 0.004 * r)
    r = r + sd * rng.standard_normal(r.shape)
    fields = {
        "path": Path("hpl.h5"),
        "title": "White HPL cladding",
        "sample_name": "HPL white",
        "wavelength_nm": wavelength_nm,
        "detector_index": detector,
        "detector_names": ("pmt", "ingaas"),
        "theta_i_deg": ti,
        "theta_mes_deg": tm,
        "theta_o_deg": tm - ti,
        "polarization": pol,
        "r": r,
        "r_sd": sd,
        "raw_signal_v": 0.9 * r,
        "dark_v": np.full(r.shape, 2e-4),
        "baseline_v": np.full(r.shape, 0.9),
        "gain_u": np.full(r.shape, 0.001),
        "offset_u": np.full(r.shape, 2e-6),
        "quality": np.zeros(r.shape, dtype=np.uint16),
        "time_s": np.arange(len(ti)) * 130.0,
        "aperture": Aperture(width_mm=26.0, height_mm=18.0, distance_mm=95.2353),
        "position": np.arange(len(ti)),
        "n_planned": len(ti),
        "finished": True,
        "plan_text": 'title = "White HPL cladding"\n',
        "rig_text": RIG,
        "start_time": "2026-11-22T10:00:00+00:00",
    }
    return Scan(**{**fields, **changed})


@dataclass
class FakeCoefficient:
    value: np.ndarray
    se: np.ndarray

    @property
    def lower(self):
        return self.value - 1.97 * self.se

    @property
    def upper(self):
        return self.value + 1.97 * self.se


@dataclass
class FakeFit:
    """The true parameters with some scatter, drawn like a fit."""

    wavelength_nm: np.ndarray
    value: np.ndarray
    se: np.ndarray
    theta_i_deg: np.ndarray
    theta_o_deg: np.ndarray
    polarization_of: np.ndarray
    sigma: np.ndarray
    detector_index: np.ndarray
    aperture: str = "exact"
    polarization: str = "joint"
    instrument: Aperture = field(
        default_factory=lambda: Aperture(width_mm=26, height_mm=18, distance_mm=95.2353)
    )
    modes: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 4)))
    mode_names: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ("rho_d", "rho_s", "alpha", "n2")
    notes: tuple[str, ...] = ()

    @property
    def home(self):
        return home(self.wavelength_nm, self.detector_index)

    def only(self, columns):
        part = {
            name: getattr(self, name)[columns] for name in ("wavelength_nm", "detector_index", "value", "se")
        }
        return replace(self, **part, sigma=self.sigma[:, columns])

    @property
    def quantile(self):
        return np.full(len(self.wavelength_nm), 1.97)

    @property
    def dof(self):
        return np.full(len(self.wavelength_nm), 288)

    @property
    def chi2(self):
        return 4.0 * self.dof  # twice the noise that the weights stood for

    @property
    def lower(self):
        return self.value - 1.97 * self.se

    @property
    def upper(self):
        return self.value + 1.97 * self.se

    def predict(self, theta_i_deg, theta_o_deg, polarization):
        return model(self.value, theta_i_deg, theta_o_deg, polarization)

    def hemispherical(self, theta_i_deg=8.0):
        rho_d, rho_s, _, n2 = self.value.T
        k_s = rho_s * 0.5 * (fresnel(n2, theta_i_deg, "s") + fresnel(n2, theta_i_deg, "p"))
        se_s = 0.03 * np.abs(k_s)
        return SimpleNamespace(
            k_d=FakeCoefficient(rho_d, self.se[:, 0]),
            k_s=FakeCoefficient(k_s, se_s),
            k_g=FakeCoefficient(rho_d + k_s, np.hypot(self.se[:, 0], se_s)),
        )


def build_fit(scan, polarization="joint", seed=2, mismatch=-0.03):
    rng = np.random.default_rng(seed)
    value = np.array(truth(scan.wavelength_nm)).T
    value[:, :2] *= np.where(scan.detector_index == 0, 1 + mismatch, 1.0)[:, None]
    wide = {"joint": 1.0, "s": 6.0, "p": 3.0}[polarization]
    se = np.array([0.002, 0.02 * wide, 1.5, 0.008 * wide]) * np.ones_like(value)
    kept = np.isin(scan.polarization, ("s", "p") if polarization == "joint" else (polarization,))
    return FakeFit(
        wavelength_nm=scan.wavelength_nm,
        value=value + se * rng.standard_normal(value.shape),
        se=se,
        theta_i_deg=scan.theta_i_deg[kept],
        theta_o_deg=scan.theta_o_deg[kept],
        polarization_of=scan.polarization[kept],
        sigma=np.full((int(kept.sum()), len(value)), 1e-4),
        detector_index=scan.detector_index,
        polarization=polarization,
    )


def build_spectra(wavelength_nm):
    rho_d, rho_s, alpha, n2 = truth(wavelength_nm)
    k_s = rho_s * 0.5 * (fresnel(n2, 8.0, "s") + fresnel(n2, 8.0, "p"))
    true = Spectrum(
        wavelength_nm,
        {
            "rho_d": rho_d,
            "rho_s": rho_s,
            "alpha": alpha,
            "n2": n2,
            "k_d": rho_d,
            "k_s": k_s,
            "k_g": rho_d + k_s,
        },
    )
    rng = np.random.default_rng(3)
    k = (rho_d + k_s) * (1.002 + 0.002 * rng.standard_normal(len(k_s)))
    return true, Spectrum(wavelength_nm, {"k_g": k, "k_g_u": 0.005 * k})


def build_content(scan=None, fits=("joint", "s", "p"), **changed):
    scan = build_scan() if scan is None else scan
    true, sphere = build_spectra(scan.wavelength_nm)
    fields = {
        "scan": scan,
        "fits": {f"exact_{p}": build_fit(scan, p) for p in fits},
        "truth": true,
        "sphere": sphere,
    }
    return Content(**{**fields, **changed})


def build_receiver(name, width_m, height_m, rows, columns, direct, v_m=None, seed=5):
    rng = np.random.default_rng(seed)
    up = (np.arange(rows)[:, None] + 0.5) / rows * np.ones((rows, columns))
    parts = {
        "direct": direct * (up > 0.3),
        "sky": 60 + 20 * up,
        "diffuse": 80 - 10 * up + rng.normal(0, 1, up.shape),
        "specular": 25 * np.exp(-(((up - 0.5) / 0.3) ** 2)) + rng.normal(0, 0.5, up.shape),
    }
    errors = {"direct": 0.0, "sky": 0.2, "diffuse": 0.4, "specular": 0.15}
    total = sum(parts.values())
    return Receiver(
        name=name,
        origin_m=(0.0, 0.0, 0.0),
        u_m=(width_m, 0.0, 0.0),
        v_m=(0.0, 0.0, height_m) if v_m is None else v_m,
        total=Estimate(total, 0.01 * total),
        contributions={k: Estimate(v, 0.01 * v) for k, v in parts.items()},
        mean=Estimate(total.mean(), np.float64(0.5)),
        mean_contributions={k: Estimate(v.mean(), np.float64(errors[k])) for k, v in parts.items()},
    )


def build_irradiance(count=3):
    every = (
        build_receiver("left", 60.0, 18.0, 12, 40, 500.0),
        build_receiver("right", 60.0, 18.0, 12, 40, 0.0),
        build_receiver("ground", 60.0, 12.0, 8, 40, 300.0, v_m=(0.0, 12.0, 0.0)),
    )
    receivers = tuple(every[i % 3] for i in range(count))
    return Irradiance(
        receivers=receivers,
        energy=EnergyBalance(1000.0, 0.0, 700.0, 1.2, 300.0, 0.0),
        title="Street with two facades of HPL",
        scene_text='title = "Street"\n',
        seed=0,
        rel_tol=0.01,
        relative_error=0.0095,
        converged=True,
        rays=1_200_000,
        duration_s=3.4,
        notes=("sun: azimuth 120 deg, elevation 38 deg",),
    )


def build_references(scan, drift=0.004):
    base = 0.9 * np.exp(-(((scan.wavelength_nm - 900.0) / 600.0) ** 2))
    dark = np.full_like(base, 2e-4)
    return References(
        kind=("dark", "baseline", "baseline", "dark", "baseline", "baseline"),
        polarization=("any", "s", "p") * 2,
        time_s=np.array([0.0, 60.0, 200.0, 36000.0, 36100.0, 37000.0]),
        signal_v=np.array([dark, base, base, 1.05 * dark, (1 + drift) * base, (1 + drift) * base]),
    )


@pytest.fixture(scope="session")
def model_r():
    """Return what makes noiseless readings of a plan, (n, m)."""

    def readings(plan):
        at = plan.positions()
        theta_i = np.array([p.theta_i_deg for p in at])
        theta_o = np.array([p.theta_mes_deg for p in at]) - theta_i
        return model(np.array(truth(plan.wavelength_nm)).T, theta_i, theta_o, [p.polarization for p in at])

    return readings


@pytest.fixture(scope="session")
def make_scan():
    return build_scan


@pytest.fixture(scope="session")
def make_fit():
    return build_fit


@pytest.fixture(scope="session")
def make_content():
    return build_content


@pytest.fixture(scope="session")
def make_irradiance():
    return build_irradiance


@pytest.fixture(scope="session")
def make_references():
    return build_references


@pytest.fixture(scope="session")
def content():
    """A whole scan, all three fits, sphere and truth."""
    return build_content()


@pytest.fixture(autouse=True)
def _house_style():
    with style.styled():
        yield
