from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gonio.facade import BandIrradiance, Estimate, ExchangeBalance, Omission, Receiver
from gonio.report import contributions, maps, mesh_view, style, unfolded
from gonio.report.facade_page import facade_page
from gonio.report.page import make_folder


def meshes(axes):
    return [c for c in axes.collections if c.get_array() is not None]


def test_maps_show_total_and_specular_of_every_receiver_in_metres(make_irradiance):
    receivers = make_irradiance().receivers
    figure = maps.draw_maps(receivers).figure
    panels = figure.axes[:6]
    for row, receiver in enumerate(receivers):
        for column, values in enumerate((receiver.value, receiver.contributions["specular"].value)):
            axes = panels[2 * row + column]
            assert np.asarray(meshes(axes)[0].get_array()) == pytest.approx(values)
            assert axes.get_title().startswith(receiver.name)
            assert axes.get_xlabel() == "along / m"
            assert axes.get_xlim() == pytest.approx((0.0, 60.0))
    assert [panels[i].get_ylabel() for i in (0, 2, 4)] == ["height / m", "height / m", "across / m"]
    assert panels[0].get_ylim() == pytest.approx((0.0, 18.0))
    labels = [axes.get_ylabel() for axes in figure.axes[6:]]
    assert labels == ["total irradiance / (W/m²)", "specular contribution / (W/m²)"]


def test_one_colour_scale_for_all_receivers_from_zero(make_irradiance):
    receivers = make_irradiance().receivers
    figure = maps.draw_maps(receivers).figure
    for column, values in enumerate(
        ([r.value for r in receivers], [r.contributions["specular"].value for r in receivers])
    ):
        found = {meshes(figure.axes[2 * row + column])[0].norm for row in range(3)}
        assert len(found) == 1
        norm = found.pop()
        assert norm.vmin <= 0.0
        assert norm.vmax == pytest.approx(max(v.max() for v in values))


def test_many_receivers_go_to_several_figures_with_the_same_scale(make_irradiance):
    receivers = make_irradiance(count=6).receivers
    first, second = maps.draw_maps(receivers, first=0), maps.draw_maps(receivers, first=4)
    assert (first.name, second.name) == ("facade_maps_1", "facade_maps_2")
    assert len(meshes(second.figure.axes[0])) == 1
    assert second.figure.axes[0].get_title() == "right: total irradiance"
    assert meshes(first.figure.axes[0])[0].norm.vmax == meshes(second.figure.axes[0])[0].norm.vmax


def test_the_error_maps_are_the_standard_errors(make_irradiance):
    receivers = make_irradiance().receivers
    figure = maps.draw_errors(receivers).figure
    for row, receiver in enumerate(receivers):
        shown = (receiver.standard_error, receiver.contributions["specular"].standard_error)
        for column, values in enumerate(shown):
            assert np.asarray(meshes(figure.axes[2 * row + column])[0].get_array()) == pytest.approx(values)
    labels = [axes.get_ylabel() for axes in figure.axes[6:]]
    assert labels == ["standard error of the total / (W/m²)", "standard error of the specular part / (W/m²)"]


def test_stacked_bars_are_the_means_with_one_standard_error_each(make_irradiance):
    receivers = make_irradiance().receivers
    axes = contributions.draw_contributions(receivers).figure.axes[0]
    assert axes.get_xlabel() == "mean irradiance on the receiver / (W/m²)"
    bars = [c for c in axes.containers if hasattr(c, "patches")]
    assert [c.get_label() for c in bars] == [maps.LABELS[name] for name in maps.CONTRIBUTIONS]
    ends = np.zeros(3)
    for container, name in zip(bars, maps.CONTRIBUTIONS, strict=True):
        means = np.array([float(r.mean_contributions[name].value) for r in receivers])
        assert [p.get_x() for p in container.patches] == pytest.approx(ends)
        ends += means
        assert [p.get_width() for p in container.patches] == pytest.approx(means)
        (lines,) = [c for c in axes.collections if c.get_gid() == f"errors_{name}"]
        half = [(s[1, 0] - s[0, 0]) / 2 for s in lines.get_segments()]
        middle = [(s[1, 0] + s[0, 0]) / 2 for s in lines.get_segments()]
        assert half == pytest.approx([float(r.mean_contributions[name].standard_error) for r in receivers])
        assert middle == pytest.approx(ends)
    assert [t.get_text() for t in axes.texts] == [maps.estimate_text(r.mean) for r in receivers]


def test_a_street_is_unfolded_foot_to_foot(make_irradiance):
    receivers = make_irradiance().receivers
    street = unfolded.street_of(receivers)
    assert [r.name for r in street] == ["left", "ground", "right"]
    axes = unfolded.draw_street(street).figure.axes
    profiles, plans = axes[:3], axes[3:6]
    assert profiles[0].get_xlim() == pytest.approx((18.0, 0.0))  # its foot beside the ground
    assert profiles[1].get_xlim() == pytest.approx((0.0, 12.0))
    assert profiles[2].get_xlim() == pytest.approx((0.0, 18.0))
    for profile, plan, receiver in zip(profiles, plans, street, strict=True):
        (total,) = [p for p in profile.patches if p.get_gid() == "total"]
        assert total.get_data().values == pytest.approx(receiver.value.mean(axis=1))
        assert np.asarray(meshes(plan)[0].get_array()) == pytest.approx(receiver.value.T)
    assert len({meshes(plan)[0].norm for plan in plans}) == 1
    assert axes[6].get_ylabel() == "total irradiance / (W/m²)"


def test_other_receivers_are_no_street(make_irradiance):
    left, right, ground = make_irradiance().receivers
    assert unfolded.street_of([left, right]) is None
    assert unfolded.street_of([left, right, dataclasses.replace(ground, u_m=(50.0, 0.0, 0.0))]) is None
    assert unfolded.street_of([left, right, dataclasses.replace(ground, v_m=(0.0, 0.0, 9.0))]) is None


def test_an_endless_street_has_no_map(make_irradiance):
    def narrow(estimate):
        return dataclasses.replace(
            estimate, value=estimate.value[:, :1], standard_error=estimate.standard_error[:, :1]
        )

    receivers = [
        dataclasses.replace(
            r, total=narrow(r.total), contributions={k: narrow(e) for k, e in r.contributions.items()}
        )
        for r in make_irradiance().receivers
    ]
    assert len(unfolded.draw_street(unfolded.street_of(receivers)).figure.axes) == 3


@pytest.fixture(scope="module")
def pyramid():
    """A pyramid on a square base, whose faces look south, east, north, west and (two) down."""
    vertices = np.array(
        [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 2.0]]
    )
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [0, 2, 1], [0, 3, 2]])
    values = np.array([700.0, 400.0, 100.0, 200.0, 5.0, 6.0])

    def estimate(share):
        return Estimate(share * values, 0.01 * share * values)

    def mean(share):
        return Estimate(np.asarray(share * values.mean()), np.asarray(1.0))

    return Receiver.on_mesh(
        "roof", vertices, faces, total=estimate(1.0), mean=mean(1.0),
        contributions={name: estimate(0.25) for name in maps.CONTRIBUTIONS},
        mean_contributions={name: mean(0.25) for name in maps.CONTRIBUTIONS},
    )  # fmt: skip


def test_a_mesh_shows_the_faces_that_look_at_the_viewer(pyramid):
    axes = mesh_view.draw_mesh(pyramid).figure.axes
    for at, values in ((0, pyramid.value), (2, pyramid.standard_error)):
        for column, faces in ((0, [0, 1]), (1, [2, 3])):  # from the south-east, from the north-west
            (drawn,) = [c for c in axes[at + column].collections if c.get_array() is not None]
            shown = np.ma.compressed(drawn.get_array())
            assert sorted(shown) == pytest.approx(sorted(values[faces]))
    assert "from the south-east" in axes[0].get_title()
    right, up, towards = mesh_view.projected(np.array([[1.0, 1.0, 0.0]]), 135.0, 30.0)[0]
    assert (right, up, towards) == pytest.approx((np.sqrt(2.0), 0.0, 0.0))  # north-east is on the right


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (13.0021, 0.15, "13.00 ± 0.15"),
        (446.156, 3.4, "446.2 ± 3.4"),
        (12345.0, 120.0, "12345 ± 120"),
        (0.0, 0.0, "0"),
        (33.3, np.nan, "33.3"),
        (np.nan, 1.0, "not known"),
    ],
)
def test_an_estimate_is_written_with_two_digits_of_its_error(value, error, text):
    assert maps.value_text(value, error) == text


def test_patches_without_a_value_and_dark_scenes_are_drawn(make_irradiance):
    receiver = make_irradiance(count=1).receivers[0]
    nothing = np.full(receiver.value.shape, np.nan)
    dark = dataclasses.replace(
        receiver,
        name="dark $ side",
        total=dataclasses.replace(receiver.total, value=nothing * 0.0, standard_error=nothing),
        contributions={
            k: dataclasses.replace(e, value=0.0 * e.value) for k, e in receiver.contributions.items()
        },
        mean_contributions={
            k: dataclasses.replace(e, value=np.float64(0.0)) for k, e in receiver.mean_contributions.items()
        },
    )
    drawings = (maps.draw_maps([dark]), maps.draw_errors([dark]), contributions.draw_contributions([dark]))
    for drawing in drawings:
        assert style.png_bytes(drawing.figure).startswith(b"\x89PNG")


def test_a_tolerance_that_was_not_reached_is_said(make_irradiance, tmp_path):
    irradiance = dataclasses.replace(make_irradiance(), converged=False, relative_error=0.034)
    file = tmp_path / "street.h5"
    file.write_bytes(b"")
    page = facade_page(irradiance, file, make_folder(tmp_path / "out"))
    assert len(page.warnings) == 1
    assert "(1 %) was not reached" in page.warnings[0]
    assert "3.4 %" in page.warnings[0]


def text_of(page):
    found = []
    for block in (b for section in page.sections for b in section.blocks):
        if block.kind == "text":
            found.append(str(block.html))
        elif block.kind == "table":
            found += [" ".join(map(str, row)) for row in (block.head, *block.rows)]
    return "\n".join(found)


def test_the_page_tells_what_was_left_out_and_how_it_was_made(make_irradiance, pyramid, tmp_path):
    plain = make_irradiance()
    names = [r.name for r in plain.receivers] + ["roof"]
    half = {name: Estimate(np.asarray(12.5), np.asarray(0.5)) for name in names}
    irradiance = dataclasses.replace(
        plain,
        receivers=(*plain.receivers, pyramid),
        omissions=(Omission("the lobe of the ground", 1.25, 0.4, "left"),),
        levels={"hpl": "lobe", "ground": "diffuse"},
        bands=(BandIrradiance(380.0, 500.0, 200.0, 40.0, half), BandIrradiance(500.0, 740.0, 1.0, 2.0, half)),
        exchange=ExchangeBalance(9000.0, 6000.0, 2990.0, 12.0, 2e-15),
        method="rows",
        interrupted=True,
        date="2026-11-24T21:00:00+00:00",
        versions={"gonio": "1.2", "numba": "0.61"},
    )
    file = tmp_path / "street.h5"
    file.write_bytes(b"")
    page = facade_page(irradiance, file, make_folder(tmp_path / "out"))
    text = text_of(page)
    for words in ("the lobe of the ground left 1.25 0.4", "hpl: lobe, ground: diffuse",
                  "380–500 200 40 12.50 ± 0.50",
                  "difference 10 ± 12 W", "gonio 1.2, numba 0.61", "2026-11-24T21:00"):  # fmt: skip
        assert words in text, words
    assert "gonio facade --resume street.h5" in page.warnings[0]
    assert "transport rows" in page.lead
    drawn = {path.stem for path in (tmp_path / "out" / "figures").iterdir()}
    assert drawn >= {"facade_maps", "facade_errors", "facade_contributions", "facade_street", "facade_mesh"}
