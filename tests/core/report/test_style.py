from __future__ import annotations

import numpy as np
import pytest

from gonio.report import style


def test_a_curve_is_broken_at_the_detector_change_and_nowhere_else():
    x = np.arange(300.0, 901.0, 100.0)
    broken_x, (y,) = style.broken(x, x.copy(), at=(555.0, 2000.0))
    assert broken_x.tolist() == [300, 400, 500, 555, 600, 700, 800, 900]
    assert np.flatnonzero(np.isnan(y)).tolist() == [3]


def test_a_curve_given_out_of_order_is_drawn_in_order():
    x, (y,) = style.broken(np.array([3.0, 1.0, 2.0]), np.array([30.0, 10.0, 20.0]))
    assert x.tolist() == [1, 2, 3]
    assert y.tolist() == [10, 20, 30]


def test_a_value_between_two_gaps_gets_a_marker_of_its_own():
    nan = np.nan
    assert style.alone(np.array([1.0, nan, 2.0, nan, 3.0, 4.0])).tolist() == [
        True,
        False,
        True,
        False,
        False,
        False,
    ]
    axes = style.new_figure(3, 2).add_subplot()
    y = np.array([1.0, nan, 2.0])
    style.draw_spectrum(axes, np.array([1.0, 2.0, 3.0]), y, lower=y - 0.5, upper=y + 0.25)
    bars = axes.containers[0]
    assert bars.lines[0].get_ydata().tolist() == [1.0, 2.0]
    assert bars.lines[2][0].get_segments()[0][:, 1].tolist() == [0.5, 1.25]


def test_a_band_without_a_bound_leaves_the_axis_instead_of_disappearing():
    axes = style.new_figure(3, 2).add_subplot()
    y = np.array([1.5, 1.5, 1.5])
    style.draw_spectrum(
        axes, np.arange(3.0), y, lower=np.array([1.4, 1.4, 1.4]), upper=np.array([1.6, np.inf, 1.6])
    )
    top = axes.collections[0].get_paths()[0].vertices[:, 1].max()
    assert top >= 1e5
    assert style.limits(y, bands=[np.array([1.4, np.inf, 1.4])])[1] < 2.0


def test_one_failed_wavelength_does_not_flatten_the_others_and_is_counted():
    y = 0.7 + 0.01 * np.sin(np.arange(100.0))
    y[50] = 40.0
    low, high = style.limits(y)
    assert 0.6 < low < 0.69
    assert 0.71 < high < 0.8
    axes = style.new_figure(3, 2).add_subplot()
    axes.set_ylim(low, high)
    assert style.beyond(axes, y) == 1
    assert axes.texts[0].get_text() == "1 value outside the axis"


def test_limits_of_a_steep_but_smooth_spectrum_show_all_of_it():
    y = 0.72 - 0.5 * np.exp(-np.arange(121.0) / 6.0)
    low, high = style.limits(y)
    assert low <= y.min()
    assert high >= y.max()


@pytest.mark.parametrize("values", [np.array([]), np.full(3, np.nan), np.array([np.inf])])
def test_limits_of_nothing_are_none(values):
    assert style.limits(values) is None


def test_many_colours_are_all_different():
    for count in (1, 4, 6, 7, 20):
        assert len({tuple(np.atleast_1d(c).tolist()) for c in style.colours(count)}) == count


def test_a_dollar_sign_in_a_name_is_drawn_as_it_is():
    figure = style.new_figure(2, 1)
    figure.add_subplot().set_title(style.plain("price $5 and $x^$"))
    assert style.png_bytes(figure).startswith(b"\x89PNG")


def test_files_are_the_same_for_the_same_data_and_carry_no_date():
    def picture():
        figure = style.new_figure(3, 2)
        figure.add_subplot().plot([0, 1], [1, 0])
        return style.png_bytes(figure), style.svg_bytes(figure)

    assert picture() == picture()
    assert b"<dc:date>" not in picture()[1]


def test_png_is_160_dots_per_inch():
    figure = style.new_figure(3, 2)
    figure.add_subplot()
    png = style.png_bytes(figure)
    width, height = int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")
    assert (width, height) == (480, 320)


def test_the_callers_own_settings_come_back():
    import matplotlib

    before = matplotlib.rcParams["axes.spines.top"]
    with style.styled():
        assert matplotlib.rcParams["font.size"] == 9.0
    assert matplotlib.rcParams["axes.spines.top"] == before
