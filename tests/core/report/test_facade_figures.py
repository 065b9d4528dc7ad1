from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gonio.report import maps, style
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


def test_bars_are_the_means_with_one_standard_error(make_irradiance):
    receivers = make_irradiance().receivers
    axes = maps.draw_contributions(receivers).figure.axes[0]
    assert axes.get_xlabel() == "mean irradiance on the receiver / (W/m²)"
    bars = [c for c in axes.containers if hasattr(c, "patches")]
    assert len(bars) == 4
    for container, name in zip(bars, maps.CONTRIBUTIONS, strict=True):
        assert container.get_label() == maps.LABELS[name]
        means = [float(r.mean_contributions[name].value) for r in receivers]
        assert [p.get_width() for p in container.patches] == pytest.approx(means)
        segments = container.errorbar.lines[2][0].get_segments()
        half = [(s[1, 0] - s[0, 0]) / 2 for s in segments]
        errors = [float(r.mean_contributions[name].standard_error) for r in receivers]
        assert half == pytest.approx(errors)


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
    for drawing in (maps.draw_maps([dark]), maps.draw_contributions([dark])):
        assert style.png_bytes(drawing.figure).startswith(b"\x89PNG")


def test_a_tolerance_that_was_not_reached_is_said(make_irradiance, tmp_path):
    irradiance = dataclasses.replace(make_irradiance(), converged=False, relative_error=0.034)
    file = tmp_path / "street.h5"
    file.write_bytes(b"")
    page = facade_page(irradiance, file, make_folder(tmp_path / "out"))
    assert len(page.warnings) == 1
    assert "(1 %) was not reached" in page.warnings[0]
    assert "3.4 %" in page.warnings[0]
