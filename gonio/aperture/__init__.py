"""How much of the light that the sample sends out makes a reading: aperture, beam, and approximations."""

from gonio.aperture.approximations import InPlaneAverage, PointReceiver
from gonio.aperture.beam import IncidentBeam
from gonio.aperture.instrument import InstrumentFunction
from gonio.aperture.leaving_out import LeftOut, leaving_out
from gonio.aperture.receiver import APERTURE_NAMES, ApertureName, Receiver
from gonio.aperture.rectangle import WIDEST_HALF_ANGLE_DEG, Aperture

__all__ = [
    "APERTURE_NAMES",
    "WIDEST_HALF_ANGLE_DEG",
    "Aperture",
    "ApertureName",
    "InPlaneAverage",
    "IncidentBeam",
    "InstrumentFunction",
    "LeftOut",
    "PointReceiver",
    "Receiver",
    "leaving_out",
]
