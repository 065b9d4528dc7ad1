"""Reports of real files: written by the scan's own writer, fitted by the fit, saved by the facade module."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from gonio.errors import ConfigError, StoreError
from gonio.fitting import fit
from gonio.plan import Plan, parse_plan
from gonio.report import style, write_any_report, write_facade_report, write_report
from gonio.report.content import read_content
from gonio.report.write import is_facade
from gonio.rig import default_rig_text
from gonio.store import attach_csv_spectrum, load
from gonio.store.file import ScanFile
from gonio.store.records import (
    DetectorFacts,
    EventRecord,
    PositionRecord,
    ReferenceRecord,
    RigFacts,
    ScanHeader,
)

PLAN = """title = "Two incidences"
polarization = ["s", "p"]
[sample]
name = "Panel"
description = "made for a test"
[[wavelengths]]
start_nm = 500.0
stop_nm = 1100.0
step_nm = 100.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = { start = 15.0, stop = 105.0, step = 5.0 }
[[sweeps]]
theta_i_deg = 55.0
theta_mes_deg = { start = 15.0, stop = 140.0, step = 5.0 }
[reading]
averages = 1
[references]
dark = ["start", "end"]
baseline = ["start", "end"]
averages = 4
"""
DARK_V, FULL_V = 2e-4, 0.9


def write_scan(path, plan: Plan, r):
    """Write a finished scan of the readings `r`, (n, m), with small noise in the references."""
    rng = np.random.default_rng(7)
    w = plan.wavelength_nm
    m = len(w)
    good = np.zeros(m, dtype=np.uint16)
    detectors = (DetectorFacts("pmt", "PMT", 200.0, 860.0), DetectorFacts("ingaas", "InGaAs", 860.0, 1600.0))
    header = ScanHeader(
        plan_text=PLAN,
        rig_text=default_rig_text(),
        rig=RigFacts("bench", 26.0, 18.0, 95.2353, 90.0, 180.0, 0.0, 90.0, detectors),
        detector_index=(w >= 860.0).astype(np.uint8),
        devices={"stage": "Zaber", "lockin": "SR830"},
        program="gonio test",
        start_time="2026-11-22T10:00:00+00:00",
        unix_s=0.0,
    )
    file = ScanFile(path, header, plan, "x")

    def reference(kind, polarization, when, at_s):
        level = DARK_V if kind == "dark" else FULL_V * (1.004 if when == "end" else 1.0)
        noise = 1e-5 * rng.standard_normal(m)
        theta = (90.0, 180.0)
        file.add_reference(
            ReferenceRecord(
                kind, when, polarization, *theta, 4, at_s, w, level + noise, np.full(m, 2e-5),
                at_s + np.arange(m), good,
            )
        )  # fmt: skip

    reference("dark", "any", "start", 0.0)
    reference("baseline", "s", "start", 60.0)
    reference("baseline", "p", "start", 120.0)
    positions = plan.positions()
    file.add_positions(
        [
            PositionRecord(
                p.index, p.polarization, p.theta_i_deg, p.theta_mes_deg, 0.0, 1, 0.0, w,
                DARK_V + FULL_V * r[p.index] + 2e-5 * rng.standard_normal(m), np.full(m, np.nan),
                200.0 + 100.0 * p.index + np.arange(m), good,
            )
            for p in positions
        ]
    )  # fmt: skip
    file.add_event(EventRecord(500.0, 0.0, "warning", "stage", "a reply was late; asked again"))
    reference("dark", "any", "end", 40000.0)
    reference("baseline", "s", "end", 40060.0)
    reference("baseline", "p", "end", 40120.0)
    file.finish("2026-11-22T21:00:00+00:00")
    file.close()


@pytest.fixture(scope="module")
def scan_file(tmp_path_factory, model_r):
    """A finished scan with a joint fit and the fit of S alone, the sphere and the truth."""
    folder = tmp_path_factory.mktemp("files")
    path = folder / "panel.h5"
    plan = parse_plan(PLAN)
    write_scan(path, plan, model_r(plan))
    k_g = [f"{w},0.76,0.004" for w in (400.0, 800.0, 1200.0)]
    (folder / "sphere.csv").write_text("wavelength_nm,k_g,k_g_u\n" + "\n".join(k_g) + "\n")
    attach_csv_spectrum(path, "sphere", folder / "sphere.csv")
    scan = load(path)
    fit(scan, polarization="joint").save(path)
    fit(scan, polarization="s").save(path)
    return path


@pytest.fixture(scope="module")
def facade_file(tmp_path_factory, make_irradiance):
    path = tmp_path_factory.mktemp("facade") / "street.h5"
    make_irradiance().save(path)
    return path


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(style, "PNG_DPI", 30)


def test_everything_in_the_file_is_found(scan_file):
    content = read_content(scan_file)
    assert set(content.fits) == {"fit_exact_joint", "fit_exact_s"}
    assert content.main_fit().polarization == "joint"
    assert content.fit_of("s").polarization == "s"
    assert content.fit_of("p") is None
    assert content.sphere.columns["k_g"].tolist() == [0.76] * 3
    assert content.truth is None
    assert content.simulated  # by the [simulation] table of its rig file
    assert content.blind_zone_deg == 15.0
    assert content.references.kind.count("baseline") == 4
    assert content.references.signal_v.shape == (6, 7)
    assert content.events[0].message == "a reply was late; asked again"
    assert "direct beam (s) of detector ingaas changed by +0.4 %" in content.events[1].message
    assert content.provenance["Stage"] == "Zaber"
    assert content.provenance["Ended"] == "2026-11-22T21:00:00+00:00"
    assert content.problems == ()


@pytest.mark.usefixtures("quick")
def test_a_scan_with_fit_and_facade_makes_one_page(scan_file, facade_file, tmp_path):
    page = write_report(scan_file, tmp_path / "out", facade_h5=facade_file)
    assert page == tmp_path / "out" / "report.html"
    text = page.read_text(encoding="utf-8")
    for words in ("Two incidences", "Street with two facades of HPL", "a reply was late", "800–900 nm", "± "):
        assert words in text
    stems = {p.stem for p in (tmp_path / "out" / "figures").glob("*.svg")}
    assert {
        "polar_500nm",
        "polar_1100nm",
        "fit_500nm",
        "coefficients",
        "coefficients_alone",
        "index",
    } <= stems
    assert {"parameters", "residuals", "references", "facade_maps", "facade_contributions"} <= stems


@pytest.mark.usefixtures("quick")
def test_a_report_replaces_the_one_before(facade_file, tmp_path):
    first = write_facade_report(facade_file, tmp_path).read_bytes()
    second = write_any_report(facade_file, tmp_path)
    assert second.read_bytes() == first
    assert not list(tmp_path.rglob("*.part"))


def test_a_facade_result_is_told_from_a_scan(scan_file, facade_file, tmp_path):
    assert is_facade(facade_file)
    assert not is_facade(scan_file)
    with pytest.raises(ConfigError, match="is itself a facade result"):
        write_any_report(facade_file, tmp_path, facade_h5=facade_file)
    with pytest.raises(StoreError):
        write_report(facade_file, tmp_path / "none")
    with pytest.raises(StoreError):
        write_report(scan_file, tmp_path / "none", facade_h5=scan_file)
    assert not (tmp_path / "none").exists()


def test_files_that_are_no_scan_are_refused_before_anything_is_written(tmp_path):
    (tmp_path / "text.h5").write_text("not HDF5")
    (tmp_path / "empty.h5").write_bytes(b"")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = 1
    for name in ("missing.h5", "text.h5", "empty.h5", "foreign.h5"):
        with pytest.raises(StoreError, match=name):
            write_any_report(tmp_path / name, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("quick")
def test_damaged_parts_cost_only_themselves(scan_file, tmp_path):
    path = tmp_path / "damaged.h5"
    path.write_bytes(scan_file.read_bytes())
    with h5py.File(path, "r+") as file:
        del file["entry/fit_exact_s/value"]
        del file["entry/events/level"]
        del file["entry/sphere/k_g"]
    content = read_content(path)
    assert set(content.fits) == {"fit_exact_joint"}
    assert content.sphere is None
    assert content.events == ()
    assert len(content.problems) == 3
    text = write_report(path, tmp_path / "out").read_text(encoding="utf-8")
    assert "/entry/fit_exact_s cannot be shown" in text
