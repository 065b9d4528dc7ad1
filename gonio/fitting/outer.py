"""How does chi2 depend on parameters that wavelengths share, when each one's own parameters follow?

An outer search over shared parameters needs chi2 with everything else at its best: with g and H the gradient
and the exact Hessian of the problem without linear coefficients, s the shared and o a wavelength's own ones,

    gradient  g_s,      curvature  H_ss - H_so H_oo^-1 H_os  (Schur complement),

since g_o = 0 at the optimum.  Sums over the wavelengths are the outer problem's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.separable import Rows, Separable, project
from gonio.fitting.solve import blocks

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_SINGULAR = 1e-12  # of the largest curvature: own parameters that no reading tells do not follow


@dataclass(frozen=True, slots=True)
class Outer:
    """chi2 of each of m wavelengths as a function of s shared parameters.

    Attributes
    ----------
    coefficients
        The linear coefficients at this point, (m, L).
    chi2
        (m,)
    gradient, hessian
        (m, s) and (m, s, s), of chi2 itself, with all else following.
    response
        Change of a wavelength's own nonlinear parameters by the shared ones, (m, k, s); 1 for the shared
        parameters themselves, 0 for held ones and ones that rest at a bound.
    """

    coefficients: FloatArray
    chi2: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    response: FloatArray


def outer(
    model: Separable,
    y: FloatArray,
    w: FloatArray,
    x: FloatArray,
    shared: Sequence[int],
    *,
    free: BoolArray | bool = True,
) -> Outer:
    """Return chi2 as a function of the nonlinear parameters `shared`, by their numbers, at x, (m, k).

    x must be an optimum over the other parameters, such as that of `refine` with the shared ones held.  A
    model without second derivatives gives the Hessian of Gauss and Newton.  `free` (m, k) are the parameters
    that follow; shared ones need not be among them.
    """
    (m, k), s = x.shape, list(shared)
    may = np.broadcast_to(np.asarray(free, np.bool_), (m, k)).copy()
    may[:, s] = False
    parts = [_block(model, y[:, b], w[:, b], x[b], may[b], s) for b in blocks(*y.shape)]
    return Outer(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _block(
    model: Separable, y: FloatArray, w: FloatArray, x: FloatArray, may: BoolArray, shared: list[int]
) -> tuple[FloatArray, ...]:
    rows = Rows.of(y, w)
    state = project(model, rows, x)
    g, h = state.gradient, state.hessian
    own = may & ~((x <= model.low) & (g > 0.0)) & ~((x >= model.high) & (g < 0.0))
    unit = np.where(own & (state.scale > 0.0), 1.0 / np.where(state.scale > 0.0, state.scale, 1.0), 0.0)
    inner = h * unit[:, :, None] * unit[:, None, :]
    inverse = np.linalg.pinv(inner, rcond=_SINGULAR, hermitian=True) * unit[:, :, None] * unit[:, None, :]
    cross = h[:, :, shared]
    response = -inverse @ cross
    for j, a in enumerate(shared):
        response[:, a, j] += 1.0
    curvature = h[:, shared][:, :, shared] - np.swapaxes(cross, 1, 2) @ inverse @ cross
    weight = 2.0 * (rows.size * rows.heaviest) ** 2
    bad = ~np.isfinite(state.chi2) | ~rows.known
    values = (
        state.coefficients * rows.size[:, None],
        0.5 * weight * state.chi2,
        weight[:, None] * g[:, shared],
        weight[:, None, None] * curvature,
        response,
    )
    for value in values:
        value[bad] = np.nan
    return values
