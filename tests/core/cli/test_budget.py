"""`gonio fit --budget`: the table, what is stored, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import gonio as package
from gonio.fitting import load_fit

from .conftest import Demo, gonio


@pytest.fixture
def folder(demo: Demo, tmp_path: Path) -> Path:
    shutil.copy(demo.folder / "hpl.h5", tmp_path / "hpl.h5")
    return tmp_path


def test_the_budget_is_printed_and_stored(folder: Path) -> None:
    done = gonio("fit", "hpl.h5", "--budget", "540", "--budget-trials", "200", cwd=folder)
    assert done.code == 0, done.err
    assert "uncertainty budget at 500 nm, k at 8 deg" in done.out
    assert "not stated in [uncertainty], taken as 0: baseline_s, baseline_p" in done.out
    assert "JCGM 101: 200 trials at 500 nm" in done.out
    stored = load_fit(folder / "hpl.h5", "exact_joint")
    plain = package.fit(package.load(folder / "hpl.h5"))
    assert "distance" in stored.mode_names
    assert np.all(stored.se[:, 0] > plain.se[:, 0])
    np.testing.assert_array_equal(stored.value, plain.value)
    assert gonio("check", "hpl.h5", cwd=folder).code == 0


def test_options_that_say_nothing_are_refused(folder: Path) -> None:
    wrong = gonio("fit", "hpl.h5", "--budget", "green", cwd=folder)
    assert wrong.code == 1
    assert "--budget green: is no wavelength in nm" in wrong.err
    alone = gonio("fit", "hpl.h5", "--budget-trials", "200", cwd=folder)
    assert alone.code == 1
    assert "give --budget too" in alone.err
