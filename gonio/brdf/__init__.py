"""Scattering models, their energy and reciprocity, and the integrals of a cosine lobe."""

from gonio.brdf.checks import ModelCheck, check_model, integrated_albedo
from gonio.brdf.models import (
    GGX,
    CoupledDiffuse,
    Lambert,
    ModifiedPhong,
    PublishedLobe,
    ReciprocalLobe,
    ScatteringModel,
    brdf_from_dsf,
    dsf_from_brdf,
    lobe_above_horizon,
    lobe_brdf_albedo,
    lobe_dsf,
    reflectance_factor_from_brdf,
)

__all__ = [
    "GGX",
    "CoupledDiffuse",
    "Lambert",
    "ModelCheck",
    "ModifiedPhong",
    "PublishedLobe",
    "ReciprocalLobe",
    "ScatteringModel",
    "brdf_from_dsf",
    "check_model",
    "dsf_from_brdf",
    "integrated_albedo",
    "lobe_above_horizon",
    "lobe_brdf_albedo",
    "lobe_dsf",
    "reflectance_factor_from_brdf",
]
