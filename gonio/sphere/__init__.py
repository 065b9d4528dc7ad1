"""The integrating sphere: read its spectrum, state its uncertainty and geometry, compare the fit with it."""

from __future__ import annotations

from gonio.sphere.compare import Part, SphereComparison, compare
from gonio.sphere.e_n import e_n
from gonio.sphere.file import SphereFile, read_sphere_file
from gonio.sphere.geometry import Geometry, parse_geometry
from gonio.sphere.stored import Sphere, attach_sphere, read_sphere, sphere_of, sphere_of_columns
from gonio.sphere.uncertainty import SphereUncertainty, parse_uncertainty

__all__ = [
    "Geometry",
    "Part",
    "Sphere",
    "SphereComparison",
    "SphereFile",
    "SphereUncertainty",
    "attach_sphere",
    "compare",
    "e_n",
    "parse_geometry",
    "parse_uncertainty",
    "read_sphere",
    "read_sphere_file",
    "sphere_of",
    "sphere_of_columns",
]
