"""Halftoning: error diffusion turns a density into points; then the points are jittered.

Reference: R. W. Floyd and L. Steinberg, An adaptive algorithm for spatial greyscale, SID Digest, 1975; O. Deussen et
al., Realistic modeling and rendering of plant ecosystems, SIGGRAPH 1998, after B. Lane, Models of Plant Communities
for Image Synthesis, University of Calgary, 2002, section 3.2.1.

The site is a raster of pixels; pixel (i, j) expects e = n f_ij / Σ f plants. Row after row, with the error v that came
to it from pixels before,

    plants = floor(e + v - t) + 1, at least 0,    error = e + v - plants,

that is one plant from a threshold t on, two from t + 1; and the error goes to the four pixels that come next: 7/16
ahead, 3/16 behind in the next row, 5/16 below, 1/16 ahead in the next row. Each plant then stands at

    centre of its pixel + J (u - 1/2) times the pixel's width, and so for its height,    u uniform in [0, 1).

Numbers of plants thus follow the density much more closely than random ones do, down to areas of a few plants, and
plants keep apart. Their distance cannot be set; other models have a key for it.

Parameters: see below; J is jitter. f and n are those of `plants`. Radii and heights follow from the
species' max_radius_m and height_m.

Recipe::

    community: {model: halftone, plants: {daisy: {count: 4000, map: [[0, 1], [1, 3]]}}}

Decisions
---------
- `pixels` is their number along the site's longer side. By default there are eight for each plant where the density is
  the greatest, at most 4096 along that side: more make plants less regular in rows and columns, and cost time.
- Floyd and Steinberg's threshold is 1/2. Then pixels that expect little collect errors of a positive mean, 0.2 for
  e = 1/8, 0.36 for 1/64: plants come late, the ground where the scan begins has too few, and what bare ground passes on
  makes too many behind it. So t is 1/2 less that mean, measured for e from 1/1000 to 1/2: t = 0.56 e^(1/3), between
  0.05 and 1/2; 1 - t(1 - e) for e from 1/2 to 1; and so on by the fraction of e.
- The first row starts with random errors, uniform within 3/4 t of 0, or its plants would come in step.
- Errors that would leave the raster sideways go to the pixels that remain, in the usual proportions; those of the last
  row are lost. The number is then a few from that asked for, which is reached exactly: plants too many are dropped at
  random, those too few are added at random, by the density.
- Barred pixels pass all their error on and never have a plant.
- `serpentine` scans odd rows backwards, which breaks up diagonal stripes; false: all rows from west to east. Rows run
  from south to north.
- The scan has a beginning and an end: opposite edges do not meet, `periodic` or not.
- Species are independent of one another, each with its own pixels. Sizes are independent of places.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.placement import densities
from forestgen.community.placement.model import PlacementModel
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.core.compiled import compiled
from forestgen.recipe.fields import Flag, Fraction, Whole

_PIXELS_PER_PLANT = 8
_FEWEST, _MOST = 128, 4096  # pixels along the longer side that are chosen by themselves


class HalftoneParameters(densities.PlacementParameters):
    """What a recipe says about the model besides its species."""

    memory_hint: ClassVar[str] = f"{densities.PlacementParameters.memory_hint}, or fewer community.pixels"

    pixels: Whole | None = Field(
        None, ge=16, le=16384, description="pixels along the site's longer side; null: eight a plant or more"
    )
    jitter: Fraction = Field(1.0, description="part of its pixel in which a plant may stand; 0: in the middle")
    serpentine: Flag = Field(True, description="whether every other row is scanned backwards")


@compiled
def _threshold(expected):  # type: ignore[no-untyped-def]
    """t of a pixel that expects so many plants."""
    part = expected - np.floor(expected)
    near = min(part, 1.0 - part)
    low = min(max(0.56 * near ** (1.0 / 3.0), 0.05), 0.5)
    return low if part < 0.5 else 1.0 - low


@compiled
def diffuse(expected, start, serpentine):  # type: ignore[no-untyped-def]
    """(rows, cols) int64 whole numbers of plants in pixels that expect (rows, cols) of them.

    `start` is (cols,) the errors that the first row begins with.
    """
    rows, cols = expected.shape
    plants = np.zeros((rows, cols), np.int64)
    error = start.copy()  # of the row
    below = np.zeros(cols)  # of the next one
    for i in range(rows):
        backwards = serpentine and i % 2 == 1
        step = -1 if backwards else 1
        for k in range(cols):
            j = cols - 1 - k if backwards else k
            value = expected[i, j] + error[j]
            if expected[i, j] > 0.0:
                plants[i, j] = max(0, int(np.floor(value - _threshold(expected[i, j]))) + 1)
                value -= plants[i, j]
            ahead, behind = k + 1 < cols, k > 0
            value /= 5.0 + (8.0 if ahead else 0.0) + (3.0 if behind else 0.0)
            below[j] += 5.0 * value
            if ahead:
                error[j + step] += 7.0 * value
                below[j + step] += value
            if behind:
                below[j - step] += 3.0 * value
        for j in range(len(error)):
            error[j], below[j] = below[j], 0.0
    return plants


def first_errors(expected: Floats, rng: np.random.Generator) -> Floats:
    """(cols,) errors that the first row of (rows, cols) begins with: few are plants at once."""
    threshold = np.array([_threshold(one) for one in expected[0]])
    return np.asarray(1.5 * threshold * (rng.random(len(threshold)) - 0.5))


def _corrected(plants: NDArray[np.int64], expected: Floats, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(n,) flat pixel of each plant: some dropped or added at random."""
    pixel = np.repeat(np.arange(plants.size), plants.ravel())
    if len(pixel) >= n:
        return rng.permutation(pixel)[:n]
    sums = np.cumsum(expected.ravel())
    more = np.searchsorted(sums, rng.random(n - len(pixel)) * sums[-1], side="right")
    return rng.permutation(np.concatenate([pixel, np.minimum(more, plants.size - 1)]))


class Halftone(PlacementModel[HalftoneParameters]):
    Parameters = HalftoneParameters

    def grid(self, parameters: HalftoneParameters, site: Site, name: str, n: int) -> tuple[int, int]:
        """Rows and columns of pixels for n plants of a species."""
        if parameters.pixels is not None:
            return densities.grid_shape(site, parameters.pixels)
        density = densities.species_density(
            parameters, site, name, densities.grid_shape(site, densities.COUNTING_CELLS)
        )
        mean = float(density.mean())
        peak = float(density.max()) / mean if mean > 0 else 1.0
        longer, shorter = max(site.size_m), min(site.size_m)
        pixels = math.ceil(math.sqrt(min(1e9, _PIXELS_PER_PLANT * n * peak) * longer / shorter))
        return densities.grid_shape(site, min(_MOST, max(_FEWEST, pixels)))

    def place_species(
        self, parameters: HalftoneParameters, site: Site, density: Floats, n: int, rng: np.random.Generator
    ) -> Floats:
        """(n, 2) places of a species, metres."""
        rows, cols = density.shape
        expected = density * (n / float(density.sum()))
        plants = diffuse(expected, first_errors(expected, rng), parameters.serpentine)
        pixel = _corrected(plants, expected, n, rng)
        col_row = np.stack([pixel % cols, pixel // cols], axis=1) + 0.5
        col_row += parameters.jitter * (rng.random((n, 2)) - 0.5)
        return np.asarray(col_row * (site.size_m[0] / cols, site.size_m[1] / rows))

    def estimate_bytes(self, parameters: HalftoneParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants and the largest raster at once."""
        raster = 0
        for one, n in zip(species, densities.plant_counts(parameters, site, species), strict=True):
            rows, cols = self.grid(parameters, site, one.name, int(n)) if n else (1, 1)
            raster = max(raster, 8 * 6 * rows * cols)
        return super().estimate_bytes(parameters, site, species) + raster


MODEL = Halftone()
