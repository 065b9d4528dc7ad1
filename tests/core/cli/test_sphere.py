"""`gonio fit --sphere`: an instrument's file beside a scan, from the command line to the stored group."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gonio.sphere import read_sphere
from gonio.store import read_spectrum

from .conftest import Demo, gonio


@pytest.fixture(scope="module")
def folder(demo: Demo, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's scan, and its sphere as a Lambda's software would write it."""
    folder = tmp_path_factory.mktemp("sphere")
    shutil.copy(demo.folder / "hpl.h5", folder / "hpl.h5")
    sphere = read_spectrum(demo.folder / "hpl.h5", "sphere")
    header = [""] * 89
    header[0] = "PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00"
    header[2], header[3], header[11], header[24] = "HPL.asc", "26/11/24", "Lambda 950", "150mm sphere"
    header[43], header[78], header[79], header[80] = "860.8", "#GR", "nm", "%R"
    header[85] = str(len(sphere["k_g"]))
    rows = [f"{w:.6f}\t{100 * k:.6f}" for w, k in zip(sphere["wavelength_nm"], sphere["k_g"], strict=True)]
    for name, scale in (("hpl.asc", 1.0), ("high.asc", 1.1)):
        text = [f"{row.split()[0]}\t{scale * float(row.split()[1]):.6f}" for row in reversed(rows)]
        (folder / name).write_text("\r\n".join([*header, "#DATA", *text, ""]), encoding="latin-1")
    return folder


def test_the_whole_way(folder: Path) -> None:
    stated = ("--sphere-u", "1 % relative, k=2", "--sphere-geometry", "8:di")
    done = gonio("fit", "hpl.h5", "--sphere", "hpl.asc", *stated, cwd=folder)
    assert done.code == 0, done.err
    assert "against the integrating sphere (hpl.asc): k_g at 8 deg" in done.out
    assert "fit and sphere agree" in done.out
    assert re.search(r"^300-800 +pmt ", done.out, re.MULTILINE)
    assert re.search(r"^900-1500 +ingaas ", done.out, re.MULTILINE)
    assert "U_sphere: 1 % relative, k = 2" in done.out
    stored = read_sphere(folder / "hpl.h5")
    np.testing.assert_allclose(stored.standard, 0.005 * stored.value, rtol=1e-12)
    assert stored.detector_change_nm == (860.8,)
    again = gonio("fit", "hpl.h5", cwd=folder)  # what is stored is compared again
    assert "against the integrating sphere (hpl.asc)" in again.out
    assert gonio("check", "hpl.h5", cwd=folder).code == 0


def test_the_pages_example_works(folder: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "sphere.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", block], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "against the integrating sphere (hpl.asc)" in done.stdout


def test_a_disagreement_is_said(folder: Path) -> None:
    done = gonio("fit", "hpl.h5", "--sphere", "high.asc", "--sphere-u", "0.5 % relative, k=1", cwd=folder)
    assert done.code == 0, done.err
    said = " ".join(done.out.split())
    assert re.search(r"the fit is 9\.\d % \(relative\) low, .* beyond both uncertainties", said)
    assert "what may cause it:" in done.out


def test_refusals_come_before_the_fit_and_leave_the_file(folder: Path) -> None:
    before = (folder / "hpl.h5").read_bytes()
    for options, message in (
        (["--sphere", "hpl.asc"], "its uncertainty is not stated"),
        (["--sphere", "hpl.asc", "--sphere-u", "1 %"], "relative or absolute and with which coverage?"),
        (
            ["--sphere", "hpl.asc", "--sphere-u", "1 % relative, k=2", "--sphere-geometry", "8:d"],
            "does not say whether",
        ),
        (["--sphere", "no.asc", "--sphere-u", "1 % relative, k=2"], "there is no such file"),
        (["--sphere", "hpl.h5", "--sphere-u", "1 % relative, k=2"], "which no text has"),
        (["--sphere", "hpl.asc", "--sphere-u", "1 % relative, k=2", "--sphere-nm", "all"], "is no range"),
        (["--sphere-u", "1 % relative, k=2"], "--sphere-u is said of no file; give it with --sphere FILE"),
    ):
        done = gonio("fit", "hpl.h5", *options, cwd=folder)
        assert done.code == 1, done.out
        assert message in done.err
        assert done.out == ""
    assert (folder / "hpl.h5").read_bytes() == before
