"""Instrument control, BRDF fit and facade irradiance for goniospectrophotometers.

>>> import gonio
>>> scan = gonio.load("hpl.h5")                                    # doctest: +SKIP
>>> fit = gonio.fit(scan, aperture="exact", polarization="joint")  # doctest: +SKIP
>>> print(fit.table())                                             # doctest: +SKIP

The names below are loaded on first use, so that `import gonio` stays quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gonio import facade
    from gonio.aperture import Aperture
    from gonio.fitting import FitResult, fit, load_fit
    from gonio.material import Material
    from gonio.plan import Plan, load_plan
    from gonio.rig import RigConfig, load_rig, open_rig
    from gonio.store import Scan, load

__version__ = "0.1.0"

__all__ = [
    "Aperture",
    "FitResult",
    "Material",
    "Plan",
    "RigConfig",
    "Scan",
    "__version__",
    "facade",
    "fit",
    "load",
    "load_fit",
    "load_plan",
    "load_rig",
    "open_rig",
]

_HOME = {
    "Aperture": "gonio.aperture",
    "FitResult": "gonio.fitting",
    "Material": "gonio.material",
    "Plan": "gonio.plan",
    "RigConfig": "gonio.rig",
    "Scan": "gonio.store",
    "fit": "gonio.fitting",
    "load": "gonio.store",
    "load_fit": "gonio.fitting",
    "load_plan": "gonio.plan",
    "load_rig": "gonio.rig",
    "open_rig": "gonio.rig",
}


def __getattr__(name: str) -> Any:
    if name == "facade":
        return importlib.import_module("gonio.facade")
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'gonio' has no attribute '{name}'")
