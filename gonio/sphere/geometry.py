"""How does the sphere look at the sample, and with which coefficient of the fit must it be compared?

CIE writes ``8:di`` for light at 8 degrees, gathered over the hemisphere, the specular beam included, and
``8:de`` with the specular beam let out through a port or caught in a gloss trap.  ``di:8``, diffuse light and
a view at 8 degrees, is the same for a reciprocal surface (Helmholtz).  Colorimetry says SCI and SCE.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from gonio.errors import ConfigError

OPTION = "--sphere-geometry"
DEFAULT_THETA_I_DEG = 8.0
_LONGEST = 100
_ANGLE = r"(\d+(?:\.\d+)?)\s*(?:°|deg|degrees?)?"
_FORMS = re.compile(
    rf"^(?:{_ANGLE}\s*[:/]\s*(d[ie]|d|t|h|hemispherical)|(d[ie]|d)\s*[:/]\s*{_ANGLE}|(sc[ie]))$"
)


@dataclass(frozen=True, slots=True)
class Geometry:
    """Angle of incidence (or view), degrees, whether the specular beam is in, and whether a user said so."""

    theta_i_deg: float = DEFAULT_THETA_I_DEG
    specular: Literal["included", "excluded"] = "included"
    stated: bool = True

    @property
    def coefficient(self) -> str:
        """The fit's coefficient to compare with: ``k_g`` with the specular beam, ``k_d`` without."""
        return "k_g" if self.specular == "included" else "k_d"

    @property
    def text(self) -> str:
        """CIE's short form."""
        return f"{self.theta_i_deg:g}:d{'i' if self.specular == 'included' else 'e'}"

    def describe(self) -> str:
        """Return the geometry in words."""
        taken = "" if self.stated else f", as nothing else was stated with {OPTION}"
        return f"{self.text}, specular {self.specular}{taken}"


def parse_geometry(text: str) -> Geometry:
    """Return the geometry of ``8:di``, ``8/de``, ``di:8``, ``SCI``, ``8:h included``; `ConfigError` if none.

    A ``d`` or ``h`` alone leaves open whether the specular beam is in; then the text must say ``included`` or
    ``excluded``.
    """
    known = (
        f"write {OPTION} 8:di (specular included, compared with k_g) or 8:de (excluded, compared with k_d)"
    )
    if len(text) > _LONGEST:
        raise ConfigError(f"{len(text)} characters name no geometry of a sphere; {known}")
    rest = text.strip().lower()
    words = set(re.findall(r"included|excluded", rest))
    rest = re.sub(r"[\s,;]*(?:\bspecular\b)?[\s,;]*\b(?:included|excluded)\b", "", rest).strip(" ,;")
    found = _FORMS.match(rest)
    if found is None:
        raise ConfigError(f"'{text}' is no geometry of a sphere that is known; {known}")
    angle = found.group(1) or found.group(4)
    mode = found.group(2) or found.group(3) or found.group(5)
    said = {"i": "included", "e": "excluded"}.get(mode[-1]) if mode not in ("hemispherical",) else None
    words |= {said} if said else set()
    if len(words) != 1:
        problem = "says both" if words else "does not say"
        raise ConfigError(f"'{text}' {problem} whether the specular beam is included or excluded; {known}")
    theta = float(angle) if angle else DEFAULT_THETA_I_DEG
    if not 0.0 <= theta < 90.0:
        raise ConfigError(f"'{text}': an incidence of {theta:g} deg is not within 0...90 deg; {known}")
    return Geometry(theta, "excluded" if "excluded" in words else "included")
