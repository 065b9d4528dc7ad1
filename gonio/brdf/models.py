"""Which scattering models are there?  Each family has a module of its own; this one names them all."""

from __future__ import annotations

from gonio.brdf.coupled import CoupledDiffuse
from gonio.brdf.lambert import Lambert
from gonio.brdf.lobe import (
    cosine_power,
    lobe_above_horizon,
    lobe_above_horizon_dlog_alpha,
    lobe_brdf,
    lobe_brdf_albedo,
    lobe_dsf,
)
from gonio.brdf.microfacet import GGX
from gonio.brdf.phong import ModifiedPhong
from gonio.brdf.protocol import ScatteringModel
from gonio.brdf.published import PublishedLobe
from gonio.brdf.quantities import brdf_from_dsf, dsf_from_brdf, reflectance_factor_from_brdf
from gonio.brdf.reciprocal import ReciprocalLobe

__all__ = [
    "GGX",
    "CoupledDiffuse",
    "Lambert",
    "ModifiedPhong",
    "PublishedLobe",
    "ReciprocalLobe",
    "ScatteringModel",
    "brdf_from_dsf",
    "cosine_power",
    "dsf_from_brdf",
    "lobe_above_horizon",
    "lobe_above_horizon_dlog_alpha",
    "lobe_brdf",
    "lobe_brdf_albedo",
    "lobe_dsf",
    "reflectance_factor_from_brdf",
]
