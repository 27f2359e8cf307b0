"""How light paths are spent: what changes the noise or the time of an image, and not its mean.

One place, so that a benchmark of efficiency, 1 / (variance x CPU seconds), can tune them together.
"""

from __future__ import annotations

SAMPLER = "multijitter"  # of sensors: stratified over a pixel and a path's first choices
ROULETTE_DEPTH = 2  # scatterings before a path may end by chance
SKY_BESIDE_SUN_WEIGHT = 0.0  # share of light samples that go to a clear sky, against the sun's 1: it is found by chance
CLOUD_DEPTH = 64  # scatterings in clouds at most: 64 loses 1% of their light, 16 loses 15%
CLOUD_ROULETTE_DEPTH = 64  # earlier, a few long paths carry most of the light
SLICES = 2  # replicates of an image, at least: the larger a stratified slice, the less noise
MOST_SLICE_SAMPLES = 32  # of a replicate's pass, a pixel: how far apart are the places where work can stop
