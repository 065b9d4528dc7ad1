"""A sphere's spectrum from CSV, .asc and .sp: what is read, and every mistake with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from perkinelmer_files import asc, sp

from gonio.errors import ConfigError, GonioError, StoreError
from gonio.sphere import read_sphere_file
from gonio.sphere.ordinate import ordinate_of

DOWN = [(900.0, 78.5), (890.0, 78.0), (880.0, 77.25)]  # as an instrument measures


@pytest.fixture
def give(tmp_path: Path):  # type: ignore[no-untyped-def]
    """Write a file and read it."""

    def give(content: str | bytes, name: str = "hpl.csv", **options: object):  # type: ignore[no-untyped-def]
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
        return read_sphere_file(path, **options)

    return give


CSVS = {
    "plain": "nm,%R\n880,77.25\n890,78\n900,78.5\n",
    "space after the comma, as the instrument's software writes": "nm, %R\n880, 77.25\n890, 78\n900, 78.5\n",
    "descending": "nm,%R\n900,78.5\n890,78\n880,77.25\n",
    "decimal comma": "nm;%R\n880;77,25\n890;78,0\n900;78,5\n",
    "decimal comma in quotes": 'nm,%R\n"880","77,25"\n"890","78,0"\n"900","78,5"\n',
    "tabulators": "Wavelength (nm)\tReflectance (%)\n880\t77.25\n890\t78\n900\t78.5\n",
    "fraction": "wavelength_nm,k_g\n880,0.7725\n890,0.78\n900,0.785\n",
    "fraction in the header": "nm;R [1]\n880;0,7725\n890;0,78\n900;0,785\n",
    "exponents": "nm,%R\n8.8e2,7.725e1\n8.9e2,7.8E+1\n9e2,785e-1\n",
    "title above": '"Created as New Dataset"\nnm,%R\n880,77.25\n890,78\n900,78.5\n',
    "comments, empty lines, no end": "# HPL white\n\nnm,%R\n880,77.25\n\n890,78\n# and\n900,78.5",
    "CRLF": "nm,%R\r\n880,77.25\r\n890,78\r\n900,78.5\r\n",
    "old Macintosh": "nm,%R\r880,77.25\r890,78\r900,78.5\r",
    "byte-order mark": "\ufeffnm,%R\n880,77.25\n890,78\n900,78.5\n",
    "open end": "nm;%R;\n880;77.25;\n890;78;\n900;78.5;\n",
    "micrometres": "wavelength (µm),%R\n0.88,77.25\n0.89,78\n0.9,78.5\n",
    "sample's name": "nm,HPL white.Sample %R\n880,77.25\n890,78\n900,78.5\n",
}


@pytest.mark.parametrize("text", CSVS.values(), ids=CSVS.keys())
def test_every_dialect_is_the_same_spectrum(give, text: str) -> None:
    found = give(text)
    np.testing.assert_allclose(found.wavelength_nm, [880.0, 890.0, 900.0], rtol=1e-14)
    np.testing.assert_allclose(found.reflectance, [0.7725, 0.78, 0.785], rtol=1e-14)


def test_texts_of_other_encodings(give) -> None:
    for content in (
        "# panneau laqué\nnm,%R\n500,70\n510,71\n".encode("latin-1"),
        "# panneau laqué\nnm,%R\n500,70\n510,71\n".encode("utf-16"),
        "# panneau laqué\nnm,%R\n500,70\n510,71\n".encode(),
    ):
        assert give(content).facts["description"] == "panneau laqué"


def test_columns_beside_the_reflectance_are_kept_in_the_order_of_the_wavelengths(give) -> None:
    found = give("wavelength_nm,k_g,k_g_u\n900,0.8,0.003\n890,0.7,\n880,0.6,0.001\n")
    np.testing.assert_array_equal(found.columns["k_g_u"], [0.001, np.nan, 0.003])
    two = "nm,front %R,back %R\n500,70,60\n510,71,61\n"
    np.testing.assert_allclose(give(two, column="back %R").reflectance, [0.6, 0.61])
    with pytest.raises(StoreError, match=r"line 1: .*'front %R', 'back %R'; choose with --sphere-column"):
        give(two)
    with pytest.raises(StoreError, match="has no column 'side', but front %R, back %R"):
        give(two, column="side")


LABELS = {
    "%R": ("reflectance", 0.01), "R (%)": ("reflectance", 0.01), "R [%]": ("reflectance", 0.01),
    "Reflectance / %": ("reflectance", 0.01), "Reflexion [%]": ("reflectance", 0.01),
    "reflectance_percent": ("reflectance", 0.01), "reflectance_fraction": ("reflectance", 1.0),
    "R [1]": ("reflectance", 1.0), "R (-)": ("reflectance", 1.0), "k_d": ("reflectance", 1.0),
    "R": ("reflectance", None), "Reflectance (1)": ("reflectance", None), "%T": ("transmittance", 0.01),
    "Transmission": ("transmittance", None), "A": ("absorbance", None), "Absorbance": ("absorbance", None),
    "log(1/R)": ("absorbance", None), "HPL white": ("unknown", None), "raw": ("unknown", None),
    "Probe A %R": ("reflectance", 0.01), "%": ("unknown", 0.01), "": ("unknown", None),
}  # fmt: skip


@pytest.mark.parametrize(("label", "meaning"), LABELS.items())
def test_what_a_label_says(label: str, meaning: tuple[str, float | None]) -> None:
    found = ordinate_of(label)
    assert (found.quantity, found.factor) == meaning


def test_percent_or_fraction_is_never_guessed_from_the_values(give) -> None:
    black = "nm,R\n500,0.9\n510,0.8\n"  # a black in percent, or a white as a fraction
    with pytest.raises(StoreError, match=r"line 1: .*0\.5 means 50 % or 0\.5 %; state --sphere-reads %R"):
        give(black)
    np.testing.assert_allclose(give(black, reads="%R").reflectance, [0.009, 0.008])
    np.testing.assert_allclose(give(black, reads="R").reflectance, [0.9, 0.8])
    with pytest.raises(StoreError, match="'%R', percent, but --sphere-reads R was stated"):
        give(black.replace("R", "%R"), reads="R")
    with pytest.raises(StoreError, match="does not say what the values are"):
        give("nm,HPL\n500,70\n510,70\n")


def test_other_ordinates_are_no_reflectance(give) -> None:
    with pytest.raises(StoreError, match=r"an absorbance: .* export the spectrum again as %R"):
        give("nm,A\n500,0.1\n510,0.1\n", reads="%R")
    through = "nm, %T\n500,70\n510,71\n"
    with pytest.raises(StoreError, match="a transmittance, which says nothing of reflectance"):
        give(through)
    stated = give(through, reads="%R")
    np.testing.assert_allclose(stated.reflectance, [0.7, 0.71])
    assert stated.remarks == ("the file says '%T'; the user states that it is reflectance",)


MISTAKES = {
    "empty": ("", "is empty"),
    "blank": ("\n \n", "holds no line that begins with a number"),
    "no numbers": ("nm,%R\nhigh,low\n", "holds no line that begins with a number"),
    "no header": ("500,70\n510,71\n", "line 1: begins with numbers, and no header says what they are"),
    "one point": ("nm,%R\n500,70\n", "holds 1 point, and a spectrum has two or more"),
    "no unit": ("x,%R\n500,70\n510,70\n", "line 1: the first column is 'x'; it must be the wavelength"),
    "wavenumbers": ("cm-1,%R\n500,70\n510,70\n", "the first column is 'cm-1'"),
    "one column": ("nm\n500\n510\n", "has no tabulator, semicolon or comma"),
    "decimal commas between commas": (
        "nm,%R\n500,70,5\n510,70,5\n", "line 2: 3 values under 2 names; correct that line; decimal commas"),
    "comma and point": ("nm;%R\n500;70,5\n510;70.5\n", "line 2 has a decimal comma, line 3 a decimal point"),
    "thousands": ("nm;%R\n500;70\n1,000.5;70\n", "line 3: nm = '1,000.5' is not a number"),
    "word": ("nm,%R\n500,70\n\n510,high\n", "line 4: %R = 'high' is not a number"),
    "not a number": ("nm,%R\n500,70\n510,nan\n520,70\n", "line 3: the value at 510 nm is nan, not a number"),
    "infinite": ("nm,%R\n500,70\n510,inf\n", "line 3: the value at 510 nm is inf"),
    "empty cell": ("nm,%R\n500,70\n510,\n520,70\n", "line 3: %R = '' is not a number"),
    "digits of another script": ("nm,%R\n500,70\n510,٧٠\n", "line 3: %R = '٧٠' is not a number"),
    "twice": ("nm,%R\n500,70\n510,71\n510,72\n520,73\n", "line 4: 510 nm is there a second time"),
    "there and back": ("nm,%R\n500,70\n510,71\n505,72\n520,73\n", "line 4: 505 nm does not ascend from 510"),
    "back and there": ("nm,%R\n520,70\n510,71\n515,72\n500,73\n", "line 4: 515 nm does not descend from 510"),
    "second scan below": ("nm,%R\n500,70\n510,71\n500,70\n510,71\n", "line 4: 500 nm is there a second time"),
    "too low": ("nm,%R\n500,-2.5\n510,71\n", "line 2: the value at 500 nm is -2.5 %, no reflectance (-2..."),
    "too high": ("nm,k_g\n500,0.5\n510,1.05\n", "line 3: the value at 510 nm is 1.05, no reflectance (-0.02"),
    "micrometres as nm": ("nm,%R\n0.5,70\n0.51,71\n", "line 2: the wavelength is 0.5 nm, not within 150..."),
    "nul": ("nm,%R\n500,7\x000\n", "line 2: holds the byte 0x00, which no text has"),
    "name twice": ("nm,%R,%R\n500,70,70\n510,70,70\n", "a column name is there twice"),
    "quote not closed": ('nm,%R\n500,"70\n510,71\n', "line 2: cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_named_with_its_place(give, text: str, message: str) -> None:
    with pytest.raises(StoreError) as caught:
        give(text)
    assert message in str(caught.value)
    assert "hpl.csv" in str(caught.value)


def test_noise_at_the_ends_can_be_left_out_but_is_not_by_itself(give) -> None:
    text = "nm,%R\n280,-15\n300,70\n310,71\n2600,140\n"
    with pytest.raises(StoreError, match="2 of 4 values are outside"):
        give(text)
    found = give(text, only_nm=(300.0, 1500.0))
    np.testing.assert_array_equal(found.wavelength_nm, [300.0, 310.0])
    with pytest.raises(StoreError, match=r"holds 1 point within 290\.\.\.305 nm"):
        give(text, only_nm=(290.0, 305.0))
    with pytest.raises(ConfigError, match="1500-300 nm is no range"):
        give(text, only_nm=(1500.0, 300.0))


# -- PerkinElmer .asc


def test_asc_with_what_its_header_says(give) -> None:
    found = give(asc(DOWN), "hpl.asc")
    np.testing.assert_array_equal(found.wavelength_nm, [880.0, 890.0, 900.0])
    np.testing.assert_allclose(found.reflectance, [0.7725, 0.78, 0.785], rtol=1e-14)
    assert found.detector_change_nm == (860.8,)
    assert found.ordinate == "%R"
    expected = {
        "instrument": "Lambda 950", "date": "26/11/03", "accessory": "RBeamAtt,SBeamAtt,150mm sphere",
        "slit_nm": "3350/servo 860.8/2", "title": "HPL white.Sample.Raw.asc", "depolarizer": "off",
    }  # fmt: skip
    assert expected.items() <= found.facts.items()
    assert "polarizer_deg" not in found.facts  # its line is empty
    assert give(asc(DOWN, {48: "90"}), "hpl.asc").facts["polarizer_deg"] == "90"


@pytest.mark.parametrize(
    ("line", "changes"),
    [
        ("820.8", (820.8,)),
        ("860.9", (860.9,)),
        ("1800.8 860.8", (860.8, 1800.8)),
        ("0", ()),
        ("", ()),
        ("860,8", (860.8,)),
    ],
)
def test_asc_detector_change_is_read_and_not_assumed(give, line: str, changes: tuple[float, ...]) -> None:
    assert give(asc(DOWN, {43: line}), "hpl.asc").detector_change_nm == changes


@pytest.mark.parametrize("variant", [{"end": "\r\n"}, {"point": ","}, {"end": "\r\n", "point": ","}])
def test_asc_of_other_systems(give, variant: dict[str, str]) -> None:
    found = give(asc(DOWN, **variant).encode("latin-1"), "HPL.ASC")
    np.testing.assert_allclose(found.reflectance, [0.7725, 0.78, 0.785], rtol=1e-14)


def test_asc_in_latin_1_and_under_another_name(give) -> None:
    found = give(asc(DOWN, {7: "Zoé"}).encode("latin-1"), "spectrum.txt")
    assert found.facts["analyst"] == "Zoé"
    assert found.format.startswith("PerkinElmer .asc")


def test_asc_with_a_description_of_two_lines_does_not_believe_what_follows(give) -> None:
    lines = asc(DOWN).split("\n")
    lines.insert(9, "second line of the description")
    found = give("\n".join(lines), "hpl.asc")
    np.testing.assert_allclose(found.reflectance, [0.7725, 0.78, 0.785], rtol=1e-14)
    assert found.detector_change_nm == ()
    assert "instrument" not in found.facts
    assert found.facts["title"] == "HPL white.Sample.Raw.asc"
    assert "#GR stands in line 80, not 79" in found.remarks[0]


ASC_MISTAKES = {
    "cut short in the header": (asc(DOWN)[:300], "has no line #DATA"),
    "cut short in the data": (asc(DOWN)[:-21], "line 86 promises 3 points, and 2 stand below"),
    "cut short within the last value": (asc(DOWN)[:-4], "line 93: .* ends the file within a number"),
    "cut short within a line": (asc(DOWN, {85: "0"})[:-30] + "\n890.0", "is not a wavelength and a value"),
    "lines missing": ("\n".join(asc(DOWN).split("\n")[20:]).join(["PE UV SUBTECH PEDS 4.00\n", ""]),
                      "#DATA comes after 70 header lines"),
    "other version": (asc(DOWN, {0: "PE UV SPECTRUM ASCII PEDS 1.60"}), "line 1: .* announces another"),
    "infrared": (asc(DOWN, {0: "PE IR SPECTRUM ASCII PEDS 4.00"}), "line 1: .* announces another format"),
    "wavenumbers": (asc(DOWN, {79: "cm-1"}), "line 80: the abscissa is in 'cm-1', not in nm"),
    "absorbance": (asc(DOWN, {80: "A"}), "line 81: the ordinate is 'A', an absorbance"),
    "transmittance": (asc(DOWN, {80: "%T"}), "line 81: the ordinate is '%T', a transmittance"),
    "no ordinate": (asc(DOWN, {80: ""}), "line 81: the ordinate is '', which does not say what"),
    "lie about the number": (asc(DOWN, {85: "2000000000"}), "line 86 promises 2e\\+09 points, and 3 stand"),
    "scale": (asc(DOWN, {81: "2.0"}), "line 82: the ordinate has scale 2, where every known file has 1"),
    "word": (asc(DOWN).replace("78.000000", "servo"), "line 92: '890.000000 servo' is not a wavelength and"),
    "nan": (asc(DOWN).replace("78.000000", "nan"), "line 92: the value at 890 nm is nan"),
    "twice": (asc([*DOWN, DOWN[-1]]), "line 94: 880 nm is there a second time"),
    "noise": (asc([*DOWN, (870.0, -451.6)]), "line 94: the value at 870 nm is -451.6 %, no reflectance"),
    "no points": (asc([]), "holds 0 points"),
    "something behind": (asc(DOWN) + "#MORE\n", "line 94: '#MORE' is not a wavelength"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), ASC_MISTAKES.values(), ids=ASC_MISTAKES.keys())
def test_asc_mistakes_are_named_with_their_line(give, text: str, message: str) -> None:
    with pytest.raises(StoreError, match=message):
        give(text, "hpl.asc")


# -- PerkinElmer .sp

VALUES = [78.5, 78.0, 77.25]


def test_sp_with_what_its_history_says(give) -> None:
    found = give(sp(VALUES, 900.0, -10.0), "hpl.sp")
    np.testing.assert_array_equal(found.wavelength_nm, [880.0, 890.0, 900.0])
    np.testing.assert_array_equal(found.reflectance, [77.25 * 0.01, 78.0 * 0.01, 78.5 * 0.01])
    assert found.detector_change_nm == (860.8,)
    assert found.facts == {
        "title": "HPL white", "instrument": "Lambda 950", "serial_number": "950L0000001",
        "slit_nm": "3350/servo 860.8/2", "accessory": "RBeamAtt,SBeamAtt,150mm sphere",
        "date": "tue nov 03 10:12:30 2026", "detector_change_nm": "860.8",
    }  # fmt: skip
    np.testing.assert_array_equal(give(sp(VALUES, 880.0, 10.0)).wavelength_nm, [880.0, 890.0, 900.0])
    fraction = give(sp([0.1, 0.2], 300.0, 2.5, ordinate="R"), reads="R")
    np.testing.assert_array_equal(fraction.wavelength_nm, [300.0, 302.5])


SP_MISTAKES = {
    "wrong magic": (b"PEPX" + sp(VALUES, 900.0, -10.0)[4:], "begins with b'PEPX2D const', not with PEPE"),
    "magic alone": (b"PEPE", "holds no block 120"),
    "wavenumbers": (sp(VALUES, 900.0, -10.0, unit="cm-1"), "the abscissa is in 'cm-1'"),
    "absorbance": (sp(VALUES, 900.0, -10.0, ordinate="A"), "the ordinate is 'A', an absorbance"),
    "transmittance": (sp(VALUES, 900.0, -10.0, ordinate="%T"), "the ordinate is '%T', a transmittance"),
    "lie about the points": (sp(VALUES, 900.0, -10.0, count=1_000_000), "is 1000000, and there are 3 values"),
    "lie about the bytes": (sp(VALUES, 900.0, -10.0, size=2**31 - 8), "declare 2147483640 bytes and have 24"),
    "negative bytes": (sp(VALUES, 900.0, -10.0, size=-8), "declare -8 bytes"),
    "range and interval": (sp(VALUES, 900.0, -10.0, last=300.0), "do not end at 300 nm"),
    "range the other way": (sp(VALUES, 900.0, 10.0, last=880.0), "do not end at 880 nm"),
    "no interval": (sp(VALUES, 900.0, 0.0), "in steps of 0 nm"),
    "nan interval": (sp(VALUES, 900.0, float("nan")), "in steps of nan nm"),
    "no values": (sp(VALUES, 900.0, -10.0, leave_out=[11]), "the values is missing|the values .* missing"),
    "no label": (sp(VALUES, 900.0, -10.0, leave_out=[7]), "label of the ordinate is missing"),
    "nan": (sp([78.0, float("nan"), 77.0], 900.0, -10.0), "point 2: the value at 890 nm is nan"),
    "noise": (sp([78.0, 777.0], 900.0, -10.0), "point 2: the value at 890 nm is 777 %, no reflectance"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "message"), SP_MISTAKES.values(), ids=SP_MISTAKES.keys())
def test_sp_mistakes_are_named_with_their_field(give, content: bytes, message: str) -> None:
    with pytest.raises(StoreError, match=message):
        give(content, "hpl.sp")


def test_sp_cut_anywhere_is_refused(give) -> None:
    whole = sp(VALUES, 900.0, -10.0)
    for length in range(4, len(whole)):
        with pytest.raises(StoreError):
            give(whole[:length], "hpl.sp")


# -- files


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no such file"):
        read_sphere_file(tmp_path / "none.asc")
    with pytest.raises(StoreError, match="is not a file"):
        read_sphere_file(tmp_path)
    (tmp_path / "a.sp").write_bytes(sp(VALUES, 900.0, -10.0))
    with pytest.raises(GonioError, match="has no named columns"):
        read_sphere_file(tmp_path / "a.sp", column="k_g")


def test_ten_million_lines_are_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.write(b"nm,%R\n")
        file.write(b"500,70\n" * 10_000_000)
    with pytest.raises(StoreError, match="is larger than 20 MB"):
        read_sphere_file(path)
    path.write_bytes(b"nm,%R\n" + b"500,7\n" * 600_000)
    with pytest.raises(StoreError, match="holds 600000 lines of numbers, more than 500000"):
        read_sphere_file(path)
