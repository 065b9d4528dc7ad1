"""The scattering models that can be fitted beside the published lobe (`gonio.fitting.problem`)."""

from gonio.fitting.columns import FitModel
from gonio.fitting.models.coupled import FitCoupled
from gonio.fitting.models.half_vector import FitGGX, FitReciprocal
from gonio.fitting.models.lambert import FitLambert
from gonio.fitting.models.phong import FitPhong

FIT_MODELS: dict[str, type[FitModel]] = {
    "phong": FitPhong,
    "reciprocal": FitReciprocal,
    "lambert": FitLambert,
    "ggx": FitGGX,
    "coupled": FitCoupled,
}
"""By the names of the command line."""

__all__ = ["FIT_MODELS", "FitCoupled", "FitGGX", "FitLambert", "FitPhong", "FitReciprocal"]
