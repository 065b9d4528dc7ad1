"""Whatever a file holds: a spectrum within its bounds, or one message; never anything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from perkinelmer_files import asc, sp

from gonio.errors import GonioError, StoreError
from gonio.sphere import SphereFile, read_sphere_file
from gonio.sphere.points import MARGIN

POINTS = [(900.0, 78.5), (890.0, 78.0), (880.0, 77.25), (870.0, 76.0)]
WHOLE = {
    "csv": b"# HPL\nnm,%R,%R_u\n870,76,0.1\n880,77.25,0.1\n890,78,0.1\n900,78.5,0.2\n",
    "asc": asc(POINTS).encode(),
    "sp": sp([y for _, y in POINTS], 900.0, -10.0),
}
MANY = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(folder: Path, data: bytes) -> SphereFile | None:
    path = folder / "file.dat"
    path.write_bytes(data)
    try:
        found = read_sphere_file(path)
    except GonioError as error:
        said = str(error)
    else:
        said = ""
    if said:
        assert "file.dat" in said
        assert len(said) < 2000
        return None
    assert found.wavelength_nm.shape == found.reflectance.shape
    assert np.all(np.diff(found.wavelength_nm) > 0.0)
    assert np.all((found.reflectance >= -MARGIN) & (found.reflectance <= 1.0 + MARGIN))
    assert all(isinstance(text, str) and len(text) <= 500 for text in found.facts.values())
    assert all(values.shape == found.wavelength_nm.shape for values in found.columns.values())
    return found


@MANY
@given(data=st.binary(max_size=400))
def test_garbage(tmp_path: Path, data: bytes) -> None:
    assert data == b"" or read(tmp_path, data) is None or b"\n" in data


@MANY
@given(text=st.text(alphabet="nm%RT,;\t .0123456789-+eE\"#\n\r'kgN_au", max_size=300))
def test_texts_that_look_like_csv(tmp_path: Path, text: str) -> None:
    read(tmp_path, b"nm,%R\n" + text.encode())
    read(tmp_path, text.encode())


@pytest.mark.parametrize("kind", WHOLE)
@MANY
@given(data=st.data())
def test_bytes_changed_in_a_whole_file(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    changed = bytearray(WHOLE[kind])
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(changed) - 1))
        how = data.draw(st.sampled_from(["replace", "delete", "insert", "cut"]))
        if how == "replace":
            changed[at] = data.draw(st.integers(0, 255))
        elif how == "insert":
            changed[at:at] = data.draw(st.binary(min_size=1, max_size=8))
        elif how == "delete":
            del changed[at : at + data.draw(st.integers(1, 8))]
        else:
            del changed[max(at, 1) :]
        if not changed:
            break
    read(tmp_path, bytes(changed))


@MANY
@given(
    first=st.floats(200.0, 2000.0),
    interval=st.floats(0.05, 20.0),
    values=st.lists(st.floats(-1.0, 101.0), min_size=2, max_size=60),
    down=st.booleans(),
)
def test_sp_comes_back_to_the_last_bit(
    tmp_path: Path, first: float, interval: float, values: list[float], down: bool
) -> None:
    step = -interval if down and first - len(values) * interval > 150.0 else interval
    found = read(tmp_path, sp(values, first, step))
    assert found is not None
    x, y = first + step * np.arange(len(values)), np.array(values) * 0.01
    order = slice(None, None, 1 if step > 0 else -1)
    np.testing.assert_array_equal(found.wavelength_nm, x[order])
    np.testing.assert_array_equal(found.reflectance, y[order])


@MANY
@given(
    points=st.dictionaries(st.integers(2000, 25000), st.floats(-1.0, 101.0), min_size=2, max_size=60),
    comma=st.booleans(),
    end=st.sampled_from(["\n", "\r\n"]),
    down=st.booleans(),
)
def test_asc_and_csv_come_back_to_the_written_decimals(
    tmp_path: Path, points: dict[int, float], comma: bool, end: str, down: bool
) -> None:
    pairs = [(w / 10.0, points[w]) for w in sorted(points, reverse=down)]
    decimal = "," if comma else "."
    whole = asc(pairs, end=end, point=decimal)
    rows = [f"{w:.1f};{y:.6f}".replace(".", decimal) for w, y in pairs]
    for text in (whole, end.join(["nm;%R", *rows])):
        found = read(tmp_path, text.encode())
        assert found is not None
        ordered = sorted(pairs)
        np.testing.assert_allclose(found.wavelength_nm, [w for w, _ in ordered], rtol=1e-14)
        np.testing.assert_allclose(found.reflectance, [y / 100.0 for _, y in ordered], atol=1e-8)


def test_lengths_that_lie_take_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "file.sp"
    for size in (2**31 - 8, 2**31 - 1, -1, -(2**31), 2**20):
        path.write_bytes(sp([78.0, 77.0], 900.0, -10.0, size=size))
        with pytest.raises(StoreError, match=r"the values, at byte \d+, declare"):
            read_sphere_file(path)
