"""Rig files of benches made of foreign devices only."""

from __future__ import annotations

from collections.abc import Mapping

from gonio.rig import RigConfig, parse_rig

ZABER_STAGE = """
[stage]
driver = "zaber"
address = "{stage}"
theta_i = {{ device = 1, axis = 1, steps_per_deg = 1000.0, limits_deg = [0.0, 95.0], speed_deg_s = 400.0, \
acceleration_deg_s2 = 1e5 }}
theta_mes = {{ device = 1, axis = 2, steps_per_deg = -1000.0, zero_deg = 180.0, limits_deg = [15.0, 180.0], \
blind_zone_deg = 15.0, speed_deg_s = 400.0, acceleration_deg_s2 = 1e5 }}
"""

SERVO_STAGE = """
[stage]
driver = "applied-motion"
address = "{stage}"
word_order = "{word_order}"
theta_i = {{ device = 1, steps_per_deg = 400.0, steps_per_rev = 10000.0, limits_deg = [0.0, 95.0], \
speed_deg_s = 300.0, acceleration_deg_s2 = 1e4 }}
theta_mes = {{ device = 2, steps_per_deg = -400.0, steps_per_rev = 10000.0, zero_deg = 180.0, \
limits_deg = [15.0, 180.0], blind_zone_deg = 15.0, speed_deg_s = 300.0, acceleration_deg_s2 = 1e4 }}
"""

_REST = """
name = "foreign"
[aperture]
width_mm = 26.0
height_mm = 18.0
distance_mm = 95.0
[polarizer]
driver = "elliptec"
address = "{polarizer}"
device = "a"
s_deg = 0.0
p_deg = 90.0
[spectrometer]
driver = "scanning"
detectors = [
    {{ name = "pmt", type = "PMT", range_nm = [300.0, 860.0] }},
    {{ name = "ingaas", type = "InGaAs", range_nm = [860.0, 1600.0] }},
]
[spectrometer.monochromator]
driver = "cs260"
address = "{monochromator}"
pipelined = true
drive_nm_s = 8000.0
grating_change_s = 0.05
filter_step_s = 0.01
port_change_s = 0.02
gratings = [{{ number = 1, range_nm = [200.0, 700.0] }}, {{ number = 2, range_nm = [700.0, 1600.0] }}]
filters = [{{ number = 1, range_nm = [200.0, 380.0] }}, {{ number = 2, range_nm = [380.0, 1600.0] }}]
[spectrometer.lockin]
driver = "sr830"
address = "{lockin}"
time_constant_s = 1e-4
"""


def foreign_rig(stage: str, addresses: Mapping[str, str], *, word_order: str = "big") -> RigConfig:
    return parse_rig((_REST + stage).format(**addresses, word_order=word_order))
