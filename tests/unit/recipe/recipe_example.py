"""A recipe and a species file that the tests of recipes start from."""

from __future__ import annotations

SPECIES = """\
description: a made-up tree
ecology:
  growth_m_per_yr: 0.06
  max_radius_m: 2.5
  shade_tolerance: 0.8
  old_age_survival: 0.98
  seedlings_per_ha_per_yr: 60
allometry:
  height_m: {scale: 9, exponent: 0.75}
  width_m: {scale: 1.9, exponent: 0.95}
plant:
  generator: pole
  leaves: 12
materials:
  leaf: {reflectance: [0.1, 0.2, 0.05], transmittance: [0.1, 0.1, 0.1]}
"""

RECIPE = """\
# An example.
forestgen: 1
seed: 7
site:
  size_m: [120, 80]
  terrain: rolling
species:
  oak: ./oak.yaml
  elm:
    from: ./oak.yaml
    height_m: {uniform: [18, 30]}
    ecology:
      growth_m_per_yr: 0.1
community: {model: lattice, program: succession, steps: {integers: [100, 300]}}
sky:
  turbidity: {normal: {mean: 3, sd: 1, low: 2, high: 6}}
  sun: {elevation_deg: {uniform: [20, 60]}, azimuth_deg: 140}
  clouds: noise
cameras:
  - {name: main, position_m: [60, 2, 1.7], look_at_m: [60, 70, 8], hfov_deg: {choice: [40, 60]}}
  - size_px: [320, 180]
"""
