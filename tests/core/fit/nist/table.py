"""How many digits of the certified values does the least-squares core reproduce?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gonio.fitting import least_squares
from gonio.fitting.columns import jacobian
from gonio.fitting.covariance_of import inverse_gram
from gonio.fitting.solve import refine_boldly

from .problems import FloatArray, Problem, Separated, problems


@dataclass(frozen=True, slots=True)
class Agreement:
    """Of one problem from one start: log relative errors, the worst of all parameters."""

    value: float
    se: float
    rss: float
    relative_se: float
    """Of the standard errors in units of the residual standard deviation: what the Jacobian alone gives."""
    converged: bool


def digits(found: FloatArray | float, certified: FloatArray | float) -> float:
    """Return -log10 of the largest relative error; NIST prints 11 digits, so about 11 is all."""
    error = float(np.max(np.abs(np.asarray(found) / np.asarray(certified) - 1.0)))
    return 16.0 if error == 0.0 else -float(np.log10(error))


def _agreement(p: Problem, value: FloatArray, se: FloatArray, rss: float, converged: bool) -> Agreement:
    return Agreement(
        digits(value, p.value),
        digits(se, p.se),
        digits(rss, p.rss),
        digits(se / np.sqrt(rss), p.se / np.sqrt(p.rss)),
        converged,
    )


def ordinary(p: Problem, start: int) -> Agreement:
    """All parameters at once, through the public function, derivatives by complex step."""
    found = least_squares(p.predicted, p.starts[start], p.jacobian, y=p.y)
    return _agreement(p, found.value, found.se, found.rss, found.converged)


def separable(p: Problem, start: int) -> Agreement:
    """Linear parameters eliminated, with the exact Hessian; only the nonlinear ones have a start."""
    model = Separated(p, p.linear)
    y = p.y[:, None]
    begin = p.starts[start][list(model.nonlinear)][None]
    found = refine_boldly(model, y, np.ones_like(y), begin)
    rss = float(found.chi2[0])
    covariance = rss / (p.y.size - p.value.size) * inverse_gram(jacobian(model, found.basic))[0]
    back = np.argsort(model.order)
    se = np.sqrt(np.diag(covariance))
    return _agreement(p, found.basic[0][back], se[back], rss, bool(found.converged[0]))


def rows() -> Iterator[tuple[Problem, str, int, Agreement]]:
    """Yield every problem from both starts, in both ways."""
    for p in problems().values():
        for start in (0, 1):
            yield p, "ordinary", start, ordinary(p, start)
            if p.linear:
                yield p, "separable", start, separable(p, start)
