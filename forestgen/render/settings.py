"""How light paths are spent: what changes the noise or the time of an image, and not its mean.

One place, so that a benchmark of efficiency, 1 / (variance x CPU seconds), can tune them together.
"""

from __future__ import annotations

SAMPLER = "multijitter"  # of Mitsuba's sensors: stratified over a pixel and a path's first choices
ROULETTE_DEPTH = 2  # scatterings before a path may end by chance
SKY_BESIDE_SUN_WEIGHT = 0.0  # share of light samples that go to a clear sky, against the sun's 1: it is found by chance
CLOUD_ROULETTE_DEPTH = 4096  # earlier, a few long paths carry the light: of a cloud 100 deep, from 64 on, a third of it
SLICES = 2  # replicates of an image, at least: the larger a stratified slice, the less noise
MOST_SLICE_SAMPLES = 32  # of a replicate's pass, a pixel: how far apart are the places where work can stop
