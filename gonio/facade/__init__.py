"""Irradiance on facades: street scenes of measured materials, sun and sky, Monte Carlo with standard errors.

>>> from gonio import facade
>>> scene = facade.load_scene("street.toml")              # doctest: +SKIP
>>> irradiance = facade.simulate(scene, rel_tol=0.01)     # doctest: +SKIP
>>> print(irradiance.table())                             # doctest: +SKIP
>>> irradiance["left"].contributions["specular"].value    # doctest: +SKIP
"""

from gonio.facade.bands import Band
from gonio.facade.geometry import Mesh, Surface, box, street
from gonio.facade.mesh import read_mesh
from gonio.facade.modules import module, panel
from gonio.facade.optics import EnergyWarning, Optics
from gonio.facade.result import (
    CONTRIBUTIONS,
    BandIrradiance,
    EnergyBalance,
    ErrorParts,
    Estimate,
    ExchangeBalance,
    Irradiance,
    Omission,
    Receiver,
    load_irradiance,
)
from gonio.facade.scene import Scene, load_scene, parse_scene
from gonio.facade.simulate import simulate
from gonio.facade.sky import Sky
from gonio.facade.sun import Sun

__all__ = [
    "CONTRIBUTIONS",
    "Band",
    "BandIrradiance",
    "EnergyBalance",
    "EnergyWarning",
    "ErrorParts",
    "Estimate",
    "ExchangeBalance",
    "Irradiance",
    "Mesh",
    "Omission",
    "Optics",
    "Receiver",
    "Scene",
    "Sky",
    "Sun",
    "Surface",
    "box",
    "load_irradiance",
    "load_scene",
    "module",
    "panel",
    "parse_scene",
    "read_mesh",
    "simulate",
    "street",
]
