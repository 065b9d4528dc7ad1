"""What values of a quantity do the data accept?  Profile likelihood, with open ends where there is no bound.

    P(v) = min of chi2 over all parameters with g(parameters) = v

The 95 % interval is where ``P(v) - min chi2 <= t^2 s^2``, t Student's quantile and s^2 the variance of the
residuals (Bates & Watts, Nonlinear Regression Analysis, 1988, section 6.1); for a quantity that is linear in
the data it is the usual interval.

`gonio.fitting.pulled` makes the fits; the search for the ends is one of a single variable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.columns import BoolArray, FloatArray
from gonio.fitting.pulled import PULL, Data, Held, IndexArray, Mover, mover_of
from gonio.fitting.quantity import Quantity
from gonio.fitting.solve import refine

_STEEP = 100.0  # a strength that changes so fast over the range of a shape has no bound at the range's end
_EXPANSIONS, _STEPS = 60, 40
_SETTLED = 1e-8  # of t


@dataclass(frozen=True, slots=True)
class Ends:
    """Ends of the interval, (m,) each; ±inf where the data accept every value on that side."""

    lower: FloatArray
    upper: FloatArray


def profile_ends(data: Data, quantity: Quantity, common: FloatArray | None = None) -> Ends:
    """Return the ends of the 95 % interval of a quantity at m wavelengths.

    Parameters
    ----------
    common
        (m,) variance from causes that readings share, of the strength or of the shape parameter that the
        quantity is a function of; its t-fold root is added to each half width in quadrature.

    An end is open where the data accept the end of the range of a shape parameter, ``chi2 - min <= t^2 s^2``
    with that parameter held there, and the quantity has no bound there: a shape parameter itself, or rho_s as
    n2 approaches 1.

    Notes
    -----
    The search starts at the optimum and goes outwards, each fit from the one before.  Its ends solve ``P(v) =
    min + t^2 s^2`` to 1e-7 of t.
    """
    mover, at, width = mover_of(data, quantity)
    m = at.size
    ends = {-1.0: np.full(m, np.nan), 1.0: np.full(m, np.nan)}
    # without noise, and for a shape that the fit was given, there is no interval but what is common
    known = ~(data.scale > 0.0)
    if quantity.shape is not None:
        known |= ~data.free[:, quantity.shape]
    is_open = _open_sides(data, quantity)
    for side, end in ends.items():
        end[known] = at[known]
        end[is_open[side]] = side * np.inf
        rows = np.flatnonzero(~is_open[side] & np.isfinite(at) & ~known)
        if rows.size:
            end[rows] = _walk(data, mover, at[rows], side * width[rows], rows)
    low, high = ends[-1.0], ends[1.0]
    if common is not None:
        more = data.quantile * np.sqrt(common)
        low, high = at - np.hypot(at - low, more), at + np.hypot(high - at, more)
    if quantity.shape is None:
        return Ends(low, high)
    a = quantity.shape
    low = np.where(low < data.model.low[a], -np.inf, low)
    high = np.where(high > data.model.high[a], np.inf, high)
    one, two = _through(data, quantity, low), _through(data, quantity, high)
    return Ends(np.minimum(one, two), np.maximum(one, two))


def profile_curve(
    data: Data, quantity: Quantity, lower: FloatArray, upper: FloatArray, points: int
) -> tuple[FloatArray, FloatArray]:
    """Return values (points, m) from `lower` to `upper`, (m,) finite, and the profile P there, (points, m).

    The values are those reached; near an end of the range of a shape parameter they may stop short.
    """
    mover, at, _ = mover_of(data, quantity)
    rows = np.arange(at.size)
    if quantity.shape is not None:
        lower, upper = (_coordinate(data, quantity, x) for x in (lower, upper))
    target = lower + (upper - lower) * np.linspace(0.0, 1.0, points)[:, None]
    value, chi2 = np.empty(target.shape), np.empty(target.shape)
    x0 = data.basic[:, len(data.model.linear) :]
    half = points // 2
    for order in (range(half, points), range(half - 1, -1, -1)):
        x = x0
        for i in order:
            pulled = target[i]
            if quantity.shape is None:  # what is reached falls short by one part in the pull
                pulled = at + (pulled - at) * (1.0 + 1.0 / PULL)
            value[i], chi2[i], x = mover(pulled, x, rows)
    if quantity.shape is not None:
        value = np.stack([_through(data, quantity, row) for row in value])
    return value, chi2


def _open_sides(data: Data, quantity: Quantity) -> dict[float, BoolArray]:
    """Return where a side is open, (m,) each."""
    m, linear = len(data.basic), len(data.model.linear)
    result = {-1.0: np.zeros(m, bool), 1.0: np.zeros(m, bool)}
    x0 = data.basic[:, linear:]
    allowed = data.chi2 + data.quantile**2 * data.scale
    for a in range(x0.shape[1]) if quantity.shape is None else [quantity.shape]:
        rows = np.flatnonzero(data.free[:, a])
        if not rows.size:
            continue
        hold = Held(data, a)
        span = float(data.model.high[a] - data.model.low[a])
        for side, bound in ((-1.0, data.model.low[a]), (1.0, data.model.high[a])):
            at = np.full(rows.size, float(bound))
            if quantity.shape is None:
                steep = _steepness(data, quantity, a, at, x0[rows]) * span > _STEEP
                if not np.any(steep):
                    continue
                rows_here, at = rows[steep], at[steep]
            else:
                rows_here = rows
            _, chi2, x = hold(at, x0[rows_here], rows_here)
            accepted = chi2 <= allowed[rows_here]
            if quantity.shape is not None:
                result[side][rows_here] |= accepted
                continue
            there = refine(
                data.model, data.y[:, rows_here], data.w[:, rows_here], x, free=[False] * x.shape[1]
            )
            towards = np.sign(quantity.of(there.basic))
            for way in (-1.0, 1.0):
                result[way][rows_here] |= accepted & (towards == way)
    return result


def _steepness(data: Data, quantity: Quantity, a: int, at: FloatArray, x: FloatArray) -> FloatArray:
    """Return the largest logarithmic slope of the factors by shape parameter a at one end of its range."""
    here = x.copy()
    here[:, a] = at
    factors, first, _ = quantity.factor_slopes(here)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.abs(first[:, :, a]) / np.abs(factors)
    return np.asarray(np.max(np.where(factors != 0.0, slope, 0.0), axis=1))


def _walk(data: Data, mover: Mover, at: FloatArray, step: FloatArray, rows: IndexArray) -> FloatArray:
    """Return the coordinate where the profile has risen by t^2 s^2, to the side of `step`."""
    t, chi2_min, scale = data.quantile[rows], data.chi2[rows], data.scale[rows]
    x = data.basic[rows, len(data.model.linear) :].copy()
    x_in = x.copy()

    def rise(chi2: FloatArray, pick: IndexArray) -> FloatArray:
        return np.sqrt(np.maximum(chi2 - chi2_min[pick], 0.0) / scale[pick]) - t[pick]

    inside, z_in, g_in = at.copy(), -t, at.copy()
    outside, z_out, g_out = np.full(at.size, np.nan), np.full(at.size, np.nan), np.full(at.size, np.nan)
    reach = step.copy()
    todo = np.arange(at.size)
    for _ in range(_EXPANSIONS):
        if not todo.size:
            break
        target = at[todo] + reach[todo]
        reached, chi2, found = mover(target, x_in[todo], rows[todo])
        z = rise(chi2, todo)
        out = z >= 0.0
        hit, miss = todo[out], todo[~out]
        outside[hit], z_out[hit], g_out[hit] = target[out], z[out], reached[out]
        inside[miss], z_in[miss], g_in[miss], x_in[miss] = target[~out], z[~out], reached[~out], found[~out]
        ratio = t[miss] / np.maximum(z_in[miss] + t[miss], 0.1 * t[miss])
        reach[miss] *= np.clip(1.05 * ratio, 1.05, 4.0)
        # a shape parameter that stands at the end of its range goes no further
        stuck = (reached[~out] - target[~out]) * np.sign(step[miss]) < -0.5 * np.abs(reach[miss])
        todo = miss[~stuck]
    end = np.where(np.isnan(outside), np.sign(step) * np.inf, g_out)
    todo = np.flatnonzero(~np.isnan(outside))
    kept = np.zeros(at.size, int)  # which side did not move last, for Illinois' halving
    for _ in range(_STEPS):
        if not todo.size:
            break
        share = z_in[todo] / (z_in[todo] - z_out[todo])
        target = inside[todo] + np.clip(share, 0.01, 0.99) * (outside[todo] - inside[todo])
        reached, chi2, found = mover(target, x_in[todo], rows[todo])
        z = rise(chi2, todo)
        out = z >= 0.0
        end[todo] = reached
        hit, miss = todo[out], todo[~out]
        outside[hit], z_out[hit], g_out[hit] = target[out], z[out], reached[out]
        inside[miss], z_in[miss], g_in[miss], x_in[miss] = target[~out], z[~out], reached[~out], found[~out]
        z_in[hit] *= np.where(kept[hit] == 1, 0.5, 1.0)
        z_out[miss] *= np.where(kept[miss] == -1, 0.5, 1.0)
        kept[hit], kept[miss] = 1, -1
        narrow = np.abs(outside[todo] - inside[todo]) <= 1e-9 * np.abs(outside[todo] - at[todo])
        todo = todo[(np.abs(z) > _SETTLED * t[todo]) & ~narrow]
    return end


def _through(data: Data, quantity: Quantity, coordinate: FloatArray) -> FloatArray:
    """Return a function of a shape parameter from the parameter, (m,); open ends stay open."""
    assert quantity.shape is not None
    column = len(data.model.linear) + quantity.shape
    basic = data.basic.copy()
    basic[:, column] = np.where(np.isfinite(coordinate), coordinate, basic[:, column])
    value = quantity.of(basic)
    rising = quantity.slopes(data.basic)[:, column] > 0.0
    return np.where(np.isinf(coordinate), np.where(rising, coordinate, -coordinate), value)


def _coordinate(data: Data, quantity: Quantity, value: FloatArray) -> FloatArray:
    """Return the shape parameter that belongs to a value, (m,), by bisection of the monotonic function."""
    assert quantity.shape is not None
    column = len(data.model.linear) + quantity.shape
    low = np.full(value.shape, float(data.model.low[quantity.shape]))
    high = np.full(value.shape, float(data.model.high[quantity.shape]))
    basic = data.basic.copy()
    rising = quantity.slopes(data.basic)[:, column] > 0.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        basic[:, column] = middle
        below = (quantity.of(basic) < value) == rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))
