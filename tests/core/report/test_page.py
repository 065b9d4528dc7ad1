from __future__ import annotations

import base64
import dataclasses
import html.parser
import re

import numpy as np
import pytest

from gonio.errors import StoreError
from gonio.report import style
from gonio.report.content import Event
from gonio.report.page import make_folder, with_uncertainty, write_page
from gonio.report.scan_page import _counted, scan_page


class Elements(html.parser.HTMLParser):
    """All tags with their attributes, the text, and whether every tag is closed in order."""

    VOID = ("meta", "img", "br", "link", "hr")

    def __init__(self, text):
        super().__init__()
        self.tags, self.after, self.words, self.open = [], [], [], []
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.after.append("")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("style", "script"):
            self.words.append(data)
            if self.after:
                self.after[-1] += data

    @property
    def text(self):
        return re.sub(r"\s+", " ", "".join(self.words))

    def all(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]


def rows_of(page):
    """Return the texts of the cells of every table row."""
    rows = []
    for (tag, _), words in zip(page.tags, page.after, strict=True):
        if tag == "tr":
            rows.append([])
        elif tag == "td":
            rows[-1].append(words.strip())
    return rows


def written(content, folder):
    file = folder / "hpl.h5"
    file.write_bytes(b"data")
    content = dataclasses.replace(content, scan=dataclasses.replace(content.scan, path=file))
    page = scan_page(content, make_folder(folder / "report"))
    path = write_page(page, folder / "report" / "report.html")
    return Elements(path.read_text(encoding="utf-8")), path.parent


@pytest.fixture
def render(tmp_path, monkeypatch):
    """Return what writes the page of a content with its figures built but not drawn."""
    monkeypatch.setattr(style, "png_bytes", lambda figure: b"\x89PNG")
    monkeypatch.setattr(style, "svg_bytes", lambda figure: b"<svg/>")
    return lambda content: written(content, tmp_path)


@pytest.fixture
def draw(tmp_path, monkeypatch):
    """Return what writes the page of a content with every figure drawn, coarsely and as PNG alone."""
    monkeypatch.setattr(style, "PNG_DPI", 30)
    monkeypatch.setattr(style, "svg_bytes", lambda figure: b"<svg/>")
    return lambda content: written(content, tmp_path)


@pytest.fixture(scope="module")
def whole(make_content, make_scan, make_references, tmp_path_factory):
    """The page and the folder of a complete report, everything drawn as it is for a user."""
    content = make_content(make_scan(wavelength_nm=np.arange(300.0, 1501.0, 50.0)))
    content = dataclasses.replace(content, references=make_references(content.scan))
    with style.styled():
        return written(content, tmp_path_factory.mktemp("whole"))


def test_the_page_needs_no_network_and_no_other_file(whole):
    page, folder = whole
    pictures = page.all("img")
    assert len(pictures) == 10
    for picture in pictures:
        kind, data = picture["src"].split(",", 1)
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
        assert picture["alt"]
    assert not page.all("script")
    assert not page.all("link")
    assert all(a["href"].startswith("#") for a in page.all("a"))
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"(src|href|url|@import)\s*[=(]?\s*[\"']?\s*(https?:)?//", text)


def test_every_figure_is_there_as_png_and_svg_and_nothing_else(whole):
    _, folder = whole
    names = {
        "polar_550nm", "polar_1200nm", "fit_550nm", "fit_1200nm", "coefficients", "coefficients_alone",
        "index", "parameters", "residuals", "references",
    }  # fmt: skip
    files = {p.name for p in (folder / "figures").iterdir()}
    assert files == {f"{n}.{kind}" for n in names for kind in ("png", "svg")}
    assert all(b"<svg" in (folder / "figures" / f"{n}.svg").read_bytes() for n in names)


def test_links_of_the_page_lead_to_its_sections(content, render):
    page, _ = render(content)
    anchors = {attrs["id"] for _, attrs in page.tags if "id" in attrs}
    assert {a["href"].removeprefix("#") for a in page.all("a")} <= anchors


def test_text_from_the_file_cannot_become_markup(content, make_scan, render):
    evil = '<img src="http://example.invalid/x.png"> & <script>alert(1)</script>'
    scan = make_scan(title=evil, sample_name=evil, plan_text=evil, rig_text=evil, detector_names=(evil, "b"))
    content = dataclasses.replace(
        content,
        scan=scan,
        events=[Event(1.0, "warning", "stage", evil)],
        provenance={"Sample": evil},
        problems=[evil],
    )
    page, _ = render(content)
    assert not page.all("script")
    assert all(p["src"].startswith("data:") for p in page.all("img"))
    assert page.text.count("alert(1)") >= 5


def test_simulated_data_are_called_so_and_real_data_are_not(content, make_scan, render):
    page, _ = render(content)
    assert "simulated bench, not from a real sample" in page.text
    real = make_scan(rig_text="[stage.theta_mes]\nblind_zone_deg = 15.0\n")
    page, _ = render(dataclasses.replace(content, scan=real, truth=None))
    assert "simulated" not in page.text


def test_the_summary_says_where_the_sample_stands_against_the_sphere(content, render):
    page, _ = render(content)
    assert "Against the integrating sphere" in page.text
    assert "of 121" in page.text
    assert "no correlation between the two" in page.text
    assert "k at 8° incidence, mean of S and P" in page.text
    assert "detector change (850–860 nm)" in page.text


def test_without_a_fit_the_page_shows_raw_curves_and_how_to_make_one(make_content, render):
    page, folder = render(make_content(fits=()))
    assert {p.stem for p in (folder / "figures").glob("*.png")} == {"polar_550nm", "polar_1200nm"}
    assert "No fit is stored" in page.text
    assert "gonio fit hpl.h5" in page.text


def test_an_unfinished_scan_says_how_far_it_is(make_scan, make_content, render):
    scan = make_scan(finished=False, n_planned=400)
    page, _ = render(make_content(scan))
    assert "292 of 400 positions are measured" in page.text
    assert "gonio scan --resume hpl.h5" in page.text


def test_missing_and_saturated_readings_are_counted(make_scan, make_content, render):
    scan = make_scan()
    scan.r[0, 0] = np.nan
    scan.quality[5, 7:10] = 1
    page, _ = render(make_content(scan))
    assert f"4 of {scan.r.size} readings are missing or flagged (3 over range)" in page.text


def test_events_are_listed_with_their_time(make_content, render):
    events = [Event(12.0, "info", "runner", "scan began"), Event(3456.7, "warning", "stage", "retried once")]
    page, _ = render(make_content(events=events))
    assert ["3457", "warning", "stage", "retried once"] in rows_of(page)
    page, _ = render(make_content())
    assert "No event was recorded" in page.text


def test_a_flood_of_events_shows_the_serious_ones(make_content, render):
    events = [Event(float(i), "info", "runner", f"position {i}") for i in range(1000)]
    events[700] = Event(700.0, "error", "stage", "stalled")
    page, _ = render(make_content(events=events))
    assert "stalled" in page.text
    assert "999 further events" in page.text


def test_remarks_of_the_fit_are_said_once_with_their_wavelengths(make_scan, make_fit, make_content, render):
    scan = make_scan()
    fit = make_fit(scan)
    notes = [""] * 121
    for i in (0, 1, 2, 50):
        notes[i] = f"rho_s = {1.2 + i:.3g} is above 1, unphysical; alpha is not determined"
    fit.notes = tuple(notes)
    page, _ = render(dataclasses.replace(make_content(scan), fits={"exact_joint": fit}))
    assert page.text.count("unphysical") == 1
    assert "300–320, 800 nm: rho_s = 1.2 is above 1, unphysical (at 300 nm)" in page.text
    assert "300–320, 800 nm: alpha is not determined" in page.text


# -- hard cases: nothing fails, everything is drawn


FEW = np.arange(300.0, 1501.0, 100.0)
TWO = ((20.0, 105.0), (55.0, 141.0))


def one_incidence(make_scan, make_content):
    return make_content(make_scan(wavelength_nm=FEW, sweeps=((20.0, 105.0),)))


def one_polarization(make_scan, make_content):
    return make_content(make_scan(wavelength_nm=FEW, sweeps=TWO, polarizations=("p",)), fits=("p",))


def one_wavelength(make_scan, make_content):
    return make_content(make_scan(wavelength_nm=[632.8], sweeps=TWO))


def two_wavelengths_on_two_detectors(make_scan, make_content):
    return make_content(make_scan(wavelength_nm=[632.8, 1064.0], sweeps=TWO))


def one_reading(make_scan, make_content):
    scan = make_scan(wavelength_nm=[632.8], sweeps=((20.0, 15.0),), polarizations=("s",))
    return make_content(scan, fits=())


def nothing_usable(make_scan, make_content):
    scan = make_scan(wavelength_nm=FEW, sweeps=TWO)
    scan.r[:] = np.nan
    return make_content(scan)


def nothing_but_negative(make_scan, make_content):
    scan = make_scan(wavelength_nm=FEW, sweeps=TWO)
    scan.r[:] = -1e-4
    return make_content(scan)


def fit_without_value(make_scan, make_content):
    content = make_content(make_scan(wavelength_nm=FEW, sweeps=TWO))
    fit = content.fits["exact_joint"]
    fit.value[:] = np.nan
    fit.se[:] = np.nan
    return content


def fit_without_bounds(make_scan, make_content):
    content = make_content(make_scan(wavelength_nm=FEW, sweeps=TWO))
    for fit in content.fits.values():
        fit.se[:, 1:] = np.inf
    return content


def every_second_wavelength_failed(make_scan, make_content):
    content = make_content(make_scan(wavelength_nm=FEW, sweeps=TWO))
    for fit in content.fits.values():
        fit.value[::2] = np.nan
    return content


def no_sphere_no_truth(make_scan, make_content):
    return dataclasses.replace(
        make_content(make_scan(wavelength_nm=FEW, sweeps=TWO)), sphere=None, truth=None
    )


def sphere_elsewhere(make_scan, make_content):
    content = make_content(make_scan(wavelength_nm=FEW, sweeps=TWO))
    sphere = dataclasses.replace(content.sphere, wavelength_nm=content.sphere.wavelength_nm + 5000.0)
    return dataclasses.replace(content, sphere=sphere)


def many_incidences(make_scan, make_content):
    return make_content(
        make_scan(wavelength_nm=FEW, sweeps=tuple((a, 100.0 + a) for a in np.arange(5.0, 61.0, 5.0)))
    )


def three_detectors(make_scan, make_content):
    w = np.arange(300.0, 1501.0, 100.0)
    index = np.digitize(w, [650.0, 1050.0]).astype(np.uint8)
    return make_content(
        make_scan(wavelength_nm=w, sweeps=TWO, detector_index=index, detector_names=("a", "b", "c"))
    )


@pytest.mark.parametrize(
    "case",
    [
        one_incidence,
        one_polarization,
        one_wavelength,
        two_wavelengths_on_two_detectors,
        one_reading,
        nothing_usable,
        nothing_but_negative,
        fit_without_value,
        fit_without_bounds,
        every_second_wavelength_failed,
        no_sphere_no_truth,
        sphere_elsewhere,
        many_incidences,
        three_detectors,
    ],
    ids=lambda f: f.__name__,
)
def test_hard_cases_make_a_whole_page(case, make_scan, make_content, draw):
    page, folder = draw(case(make_scan, make_content))
    assert "Instrument and provenance" in page.text
    assert not re.search(r"\b(nan|inf)\b", page.text)
    assert not list(folder.rglob("*.part"))


# -- numbers and files


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (0.72134, 0.0012, "0.7213 ± 0.0012"),
        (72.134, 0.12, "72.13 ± 0.12"),
        (-0.5, 0.034, "−0.500 ± 0.034"),
        (105.3, 23.0, "105 ± 23"),
        (1.5, float("inf"), "1.5 (no bound)"),
        (1.5, float("nan"), "1.5 (no bound)"),
        (float("nan"), 0.1, "–"),
        (0.25, 0.0, "0.25"),
    ],
)
def test_values_carry_two_digits_of_their_uncertainty(value, half, text):
    assert with_uncertainty(value, half) == text


def test_a_folder_that_cannot_be_made_is_one_clear_message(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(
        StoreError, match=r"taken: the report's folder cannot be made .* choose another with -o"
    ):
        make_folder(tmp_path / "taken")


@pytest.mark.parametrize(("within", "marked"), [(56, False), (52, False), (48, True), (0, True)])
def test_agreement_is_marked_only_where_chance_does_not_explain_it(within, marked):
    assert ("bad" in _counted(within, 56)) is marked
