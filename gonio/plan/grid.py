"""A list of values in a plan, written out or as start, stop and step."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gonio.devices import FloatArray

MAX_VALUES = 100_000
"""Longest list of angles or wavelengths; a longer one is a slip of the step and would only fill memory."""

_DECIMALS = 9  # far below any read-back, and 300 + 0.1 * 3 is 300.3 again


def explain_grid(
    values: Sequence[float] | None,
    start: float | None,
    stop: float | None,
    step: float | None,
    *,
    what: str,
    unit: str,
    suffix: str,
) -> str | None:
    """Return what is wrong with a list or a range, or None.

    Parameters
    ----------
    what
        Name of one value in messages, such as ``wavelength``.
    unit
        Unit of the values.
    suffix
        Ending of the keys, such as ``_nm``.
    """
    keys = f"start{suffix}, stop{suffix} and step{suffix}"
    if values is not None:
        if start is not None or stop is not None or step is not None:
            return f"give either a list of values or {keys}, not both"
        if len(values) == 0:
            return f"the list of {what}s is empty; give at least one"
        if len(values) > MAX_VALUES:
            return f"lists {len(values)} {what}s, more than {MAX_VALUES}; divide the plan"
        return None
    if start is None or stop is None or step is None:
        return f"give a list of values, or all of {keys}"
    if step <= 0:
        return f"step{suffix} = {step:g} {unit} must be positive; the values are measured in ascending order"
    if stop < start:
        return f"start{suffix} = {start:g} {unit} is above stop{suffix} = {stop:g} {unit}; swap them"
    count = (
        math.floor((stop - start) / step + 1e-9) + 1
        if (stop - start) / step < 1e15
        else (stop - start) / step
    )
    if count > MAX_VALUES:
        return (
            f"{start:g} to {stop:g} {unit} in steps of {step:g} {unit} makes {count:.10g} {what}s, more than "
            f"{MAX_VALUES}; take a larger step"
        )
    return None


def grid_values(
    values: Sequence[float] | None, start: float | None, stop: float | None, step: float | None
) -> FloatArray:
    """Return the values of a list or range that `explain_grid` accepted, (k,) float64.

    A range holds start, start + step, ... up to and including `stop` where the steps meet it.
    """
    if values is not None:
        return np.asarray(values, dtype=np.float64)
    if start is None or stop is None or step is None:
        raise ValueError("a range needs start, stop and step")
    count = math.floor((stop - start) / step + 1e-9) + 1
    grid: FloatArray = np.round(start + step * np.arange(count, dtype=np.float64), _DECIMALS)
    return grid
