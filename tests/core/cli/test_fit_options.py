"""`gonio fit`'s options, from the command line to the arguments of `gonio.fit`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gonio.cli.fit_options import FitRequest
from gonio.cli.main import build_parser
from gonio.errors import ConfigError

NM = np.array([400.0, 500.0, 600.0])


class _Scan:
    wavelength_nm = NM


def request(*arguments: str) -> FitRequest:
    from gonio.cli.fit_options import fit_request

    return fit_request(build_parser().parse_args(["fit", "scan.h5", *arguments]))


def test_without_options_the_fit_is_the_usual_one() -> None:
    plain = request()
    assert plain.arguments(_Scan()) == {  # type: ignore[arg-type]
        "aperture": "exact", "polarization": "joint", "model": "published", "n2": "free", "loss": "squares",
        "intervals": "wald", "detector_gain_u": 0.0, "detector_offset_u": 0.0,
    }  # fmt: skip
    assert plain.title == "aperture 'exact', polarization 'joint'"


def test_an_index_is_a_form_a_number_or_a_table(tmp_path: Path) -> None:
    assert request("--n2", "cauchy").arguments(_Scan())["n2"] == "cauchy"  # type: ignore[arg-type]
    assert request("--n2", "1.49").arguments(_Scan())["n2"] == 1.49  # type: ignore[arg-type]
    table = tmp_path / "n2.csv"
    table.write_text("# PMMA\nwavelength_nm, n2\n300, 1.52\n700,1.48\n", encoding="utf-8-sig")
    found = request("--n2", str(table)).arguments(_Scan())["n2"]  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [1.51, 1.50, 1.49])
    assert "n2" in request("--n2", str(table)).title


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nm,index\n300,1.5\n", "the first line must be 'wavelength_nm,n2'"),
        ("wavelength_nm,n2\n300,1.5\n450,x\n", "line 3: '450,x' are not two numbers"),
        ("wavelength_nm,n2\n300,1.5\n450\n", "line 3"),
        ("wavelength_nm,n2\n700,1.5\n300,1.5\n", "must be numbers that ascend"),
        ("wavelength_nm,n2\n450,1.5\n700,1.5\n", "holds 450...700 nm, but the scan has 400...600 nm"),
        ("wavelength_nm,n2\n", "must be numbers that ascend"),
        ("", "the first line must be"),
    ],
)
def test_a_table_that_is_none_is_refused_by_line(tmp_path: Path, text: str, words: str) -> None:
    table = tmp_path / "n2.csv"
    table.write_text(text)
    with pytest.raises(ConfigError, match=words):
        request("--n2", str(table)).arguments(_Scan())  # type: ignore[arg-type]


def test_an_index_that_is_nothing_known_is_refused() -> None:
    with pytest.raises(ConfigError, match="neither a number, nor one of 'free', 'constant'"):
        request("--n2", "conrady").arguments(_Scan())  # type: ignore[arg-type]
