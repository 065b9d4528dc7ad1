"""Where do the fitted coefficients stand against the integrating sphere?

What the report shows of `gonio.sphere.compare`: the sphere stored beside the scan, and a fit beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import StoreError
from gonio.report.content import Content
from gonio.sphere import Sphere, SphereComparison, sphere_of_columns
from gonio.sphere import compare as compare_with_sphere

if TYPE_CHECKING:
    from gonio.fitting import FitResult

SPHERE_THETA_I_DEG = 8.0
"""Incidence of the coefficients that a page shows where no sphere says another."""


def sphere_of(content: Content) -> Sphere | None:
    """Return the sphere's spectrum with what was stated of it, or ``None`` if the file has none."""
    found = content.sphere
    if found is None:
        return None
    try:
        return sphere_of_columns({"wavelength_nm": found.wavelength_nm, **found.columns}, found.facts)
    except StoreError:
        return None  # `Content.problems` names it


def compare(content: Content, fit: FitResult) -> SphereComparison | None:
    """Return the comparison of a fit with the sphere; ``None`` without a sphere."""
    sphere = sphere_of(content)
    if sphere is None:
        return None
    return compare_with_sphere(fit, sphere, detector_names=content.scan.detector_names)


def uncertain(sphere: Sphere) -> bool:
    """Say whether the sphere's uncertainty is known anywhere; without one there is no E_n."""
    return bool(np.any(np.isfinite(sphere.standard)))
