"""The whole chain over the wire: what the demo leaves behind is complete and right."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.stats import binom, norm

import gonio as product
from gonio.store import read_spectrum

from .conftest import Demo, gonio


def test_the_demo_ends_well(demo: Demo) -> None:
    assert demo.outcome.code == 0, demo.outcome.err
    names = {path.name for path in demo.folder.iterdir()}
    assert {"hpl.h5", "facade.h5", "plan.toml", "rig.toml", "street.toml", "report"} <= names
    assert not [name for name in names if "journal" in name]
    assert "rho_d" in demo.outcome.out
    assert "k_g" in demo.outcome.out
    assert "specular" in demo.outcome.out


def test_every_planned_reading_is_there(demo: Demo) -> None:
    scan = product.load(demo.folder / "hpl.h5")
    assert scan.finished
    assert scan.r.shape == (292, 13)
    assert np.all(np.isfinite(scan.r))
    planned = [
        (theta_i, theta_mes, polarization)
        for polarization in "sp"
        for theta_i, stop in ((20, 105), (30, 114), (45, 126), (55, 141))
        for theta_mes in range(15, stop + 1, 3)
    ]
    measured = list(
        zip(np.round(scan.theta_i_deg), np.round(scan.theta_mes_deg), scan.polarization, strict=True)
    )
    assert sorted(measured) == sorted(planned)
    np.testing.assert_allclose(scan.theta_o_deg, scan.theta_mes_deg - scan.theta_i_deg, atol=1e-12)


def test_the_truth_lies_in_the_intervals(demo: Demo) -> None:
    path = demo.folder / "hpl.h5"
    fit = product.load_fit(path, "fit_exact_joint")
    truth = read_spectrum(path, "simulated_truth")
    true = np.column_stack(
        [np.interp(fit.wavelength_nm, truth["wavelength_nm"], truth[name]) for name in fit.parameters]
    )
    inside = (fit.lower <= true) & (true <= fit.upper)
    # 13 wavelengths, 95 % each: fewer than this many hits happen once in a thousand demos
    assert np.all(inside.sum(axis=0) >= binom.ppf(1e-3, len(true), 0.95)), inside.mean(axis=0)
    # and the intervals are worth having
    relative = (fit.upper - fit.lower) / true
    assert np.median(relative[:, 0]) < 0.01
    assert np.median(relative[:, 1]) < 0.5


def test_the_sphere_agrees(demo: Demo) -> None:
    path = demo.folder / "hpl.h5"
    fit = product.load_fit(path, "fit_exact_joint")
    k = fit.hemispherical(8.0)
    sphere = read_spectrum(path, "sphere")
    known = np.interp(fit.wavelength_nm, sphere["wavelength_nm"], sphere["k_g"])
    deviation = (k.k_g.value - known) / np.hypot(0.005 * known, k.k_g.se)
    # each bound is met but once in a thousand demos, if both uncertainties are honest
    assert np.sum(np.abs(deviation) < 2) >= binom.ppf(1e-3, len(deviation), 0.95), deviation
    assert np.all(np.abs(deviation) < norm.isf(1e-3 / (2 * len(deviation)))), deviation


def test_the_facade_adds_up(demo: Demo) -> None:
    irradiance = product.facade.load_irradiance(demo.folder / "facade.h5")
    assert [receiver.name for receiver in irradiance.receivers] == ["left", "right", "ground"]
    for receiver in irradiance.receivers:
        total = sum(part.value for part in receiver.contributions.values())
        np.testing.assert_allclose(total, receiver.value, rtol=1e-9)
        assert np.all(receiver.contributions["specular"].value >= 0)
        assert np.all(receiver.standard_error > 0)
    # W/m2: the sun lights the right facade, whose gloss sends some across the street to the left one
    assert irradiance["left"].contributions["direct"].value.max() == 0
    assert irradiance["left"].mean_contributions["specular"].value > 5


def test_the_report_is_one_page_on_its_own(demo: Demo) -> None:
    page = next((demo.folder / "report").glob("*.html")).read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)\s*=\s*[\"'](?!data:|#)", page)
    assert len(list((demo.folder / "report").rglob("*.png"))) >= 6


def test_h5py_alone_reads_the_file(demo: Demo) -> None:
    with h5py.File(demo.folder / "hpl.h5") as file:
        data = file[f"/{file.attrs['default']}/{file[file.attrs['default']].attrs['default']}"]
        assert data.attrs["NX_class"] == "NXdata"
        assert data[data.attrs["signal"]].shape == (292, 13)


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_leaves_no_process_and_can_go_on(tmp_path: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "gonio.cli", "demo", "--quick", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    journal = tmp_path / "hpl.h5.journal"
    deadline = time.monotonic() + 60
    while not (journal.exists() and journal.stat().st_size > 20_000):
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "--resume" in err
    ports = [int(port) for port in re.findall(r"127\.0\.0\.1:(\d+)", out)]
    assert len(ports) >= 4
    assert not [port for port in ports if _listening(port)]
    with h5py.File(tmp_path / "hpl.h5") as file:
        assert file["entry/data/r"].shape[1] == 13
    assert gonio("scan", "--resume", "hpl.h5", cwd=tmp_path).code == 0
    assert product.load(tmp_path / "hpl.h5").r.shape == (292, 13)


def _listening(port: int) -> bool:
    import socket

    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
