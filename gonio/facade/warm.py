"""Compile the kernels once, at installation, so that the first street does not wait for the compiler.

    python -m gonio.facade.warm

numba keeps the compiled code beside the source (or in the user's cache folder, where that is not writable).
"""

from __future__ import annotations

from gonio.facade.scene import parse_scene
from gonio.facade.simulate import simulate

_SCENE = """
title = "Every kernel once"
[site]
latitude_deg = 45.0
longitude_deg = 0.0
time = 2022-06-21T12:00:00+00:00
[irradiance]
dni_w_m2 = 800.0
dhi_w_m2 = 100.0
[sky]
model = "isotropic"
[materials.glossy]
rho_d = 0.7
rho_s = 1.0
alpha = 80.0
n2 = 1.5
[street]
azimuth_deg = 0.0
width_m = 10.0
length_m = 10.0
height_left_m = 10.0
height_right_m = 10.0
left = "glossy"
right = "glossy"
ground = "glossy"
[[receivers]]
surface = "left"
rows = 1
columns = 1
"""


def compile_kernels() -> None:
    """Run a street of one receiver, which needs every kernel."""
    simulate(parse_scene(_SCENE), rel_tol=0.5)


if __name__ == "__main__":
    compile_kernels()
