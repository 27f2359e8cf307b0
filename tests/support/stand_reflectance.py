"""Reflectance of periodic stands of one species seen from above, and of measured forests in the same bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Silent, Timings
from forestgen.pipeline import assemble_image
from forestgen.recipe.load import load_recipe_data
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.rendering import render_radiance
from forestgen.scene.build import BuiltScene
from forestgen.scene.plan import check_plan
from forestgen.scene.spec import SceneSpec
from support.radiometry import even_numbers

BANDS = ("B3", "B4", "B5", "B8", "B11")
SIDE_M = 30.0
COPIES = 2  # of the stand, on each side
_PLACES = 200  # of trees, of which the first ones are taken
_JITTER_M = 0.6
Range = tuple[float, float]

# AVIRIS over plots of NASA's Forest Functional Types programme, midsummer 2008 to 2010, corrected for the atmosphere
# (Singh et al. 2015, Ecological Applications 25, 2180-2197; github.com/ashiklom/edr-da, aviris/NASA_FFT), averaged over
# the half-widths of Sentinel-2A's bands: 5th to 95th percentile of the images with NDVI above 0.7 of plots where at
# least three quarters of the sampled leaves were pine (21 images, 15 plots), spruce or fir (8, 4), or maple, beech or
# basswood (12, 9). Widened to stands of Hyytiälä, Finland, with their measured trees, needles, leaves and forest floor
# (seven of pine and spruce, two of birch), by the forest reflectance model FRT (Kuusk and Nilson 2000, Remote Sensing
# of Environment 72, 244-252; github.com/mottus/f_art_python, test_forests), the sun 30 degrees from the zenith.
_RANGES = {
    "pine": ((0.028, 0.055), (0.014, 0.043), (0.048, 0.110), (0.20, 0.37), (0.084, 0.186)),
    "spruce": ((0.020, 0.057), (0.011, 0.029), (0.037, 0.092), (0.18, 0.50), (0.070, 0.155)),
    "birch": ((0.032, 0.062), (0.014, 0.033), (0.057, 0.113), (0.37, 0.55), (0.148, 0.204)),
    "beech": ((0.032, 0.062), (0.013, 0.030), (0.057, 0.113), (0.40, 0.55), (0.148, 0.204)),
}
MEASURED: Mapping[str, Mapping[str, Range]] = {
    name: dict(zip(BANDS, ranges, strict=True)) for name, ranges in _RANGES.items()
}


@dataclass(frozen=True)
class Stand:
    """A stand of one species, of one age."""

    species: str
    leaf_area_index: float  # one side, or half of a needle's surface
    height_m: float


# Leaf area indices of closed stands of each species: Breuer, Eckhardt and Frede 2003 (Ecological Modelling 169,
# 237-293), Iio et al. 2014 (Global Ecology and Biogeography 23, 274-285).
STANDS = {
    "spruce": Stand("spruce", 6.0, 18.0),
    "pine": Stand("pine", 3.0, 16.0),
    "birch": Stand("birch", 3.5, 16.0),
    "beech": Stand("beech", 5.5, 20.0),
}


@dataclass(frozen=True)
class Reflectance:
    """Of a stand, seen straight down."""

    factor: dict[str, float]  # by band: bidirectional reflectance factor under sun and sky
    error: dict[str, float]  # standard error
    leaf_area_index: float
    stems_per_ha: float


def grown(stand: Stand) -> BuiltScene:
    """The stand's trees on flat litter; heights vary by a tenth. More trees than stand there in the end."""
    rng = np.random.default_rng(7)
    place = even_numbers(_PLACES, 2, rng) * SIDE_M + rng.normal(0.0, _JITTER_M, (_PLACES, 2))
    height_m = stand.height_m * (1 + 0.1 * np.clip(rng.normal(size=_PLACES), -2, 2))
    plants = [
        {"species": stand.species, "position_m": (at % SIDE_M).tolist(), "height_m": float(height)}
        for at, height in zip(place, height_m, strict=True)
    ]
    middle = SIDE_M / 2
    camera = {
        "kind": "orthographic",
        "position_m": [middle, middle, 80.0],
        "look_at_m": [middle, middle, 0.0],
        "width_m": SIDE_M,
        "size_px": [32, 32],
        "bands": "sentinel2a",
    }
    recipe = {
        "forestgen": 1,
        "seed": 3,
        "site": {"size_m": [SIDE_M, SIDE_M]},
        "species": {stand.species: stand.species},
        "community": {"model": "placed", "plants": plants},
        "plants": {"exemplars_per_species": 6},
        "sky": {"sun": {"elevation_deg": 60, "azimuth_deg": 180}},
        "cameras": [camera],
    }
    plan = check_plan(load_recipe_data(recipe, "test"))
    return assemble_image(plan, Silent(), Timings())


def leaf_areas_m2(spec: SceneSpec) -> NDArray[np.float64]:
    """(N,) of each instance."""
    scale = np.cbrt(np.linalg.det(spec.instances.transform[:, :, :3]))
    area = np.array([one.leaf_area_m2 for one in spec.exemplars])
    return np.asarray(area[spec.instances.exemplar] * scale**2)


def repeated(spec: SceneSpec, leaf_area_index: float) -> tuple[SceneSpec, int]:
    """The first trees that reach a leaf area index, without end in both directions; and their number."""
    total = np.cumsum(leaf_areas_m2(spec)) / SIDE_M**2
    count = min(int(np.searchsorted(total, leaf_area_index)) + 1, len(total))
    assert total[count - 1] >= 0.97 * leaf_area_index
    one = spec.instances
    steps = np.arange(-COPIES, COPIES + 1) * SIDE_M
    shift = np.array([(x, y, 0.0) for x in steps for y in steps])
    transform = np.repeat(one.transform[None, :count], len(shift), axis=0)
    transform[..., 3] += shift[:, None]
    tiled = replace(
        one,
        exemplar=np.tile(one.exemplar[:count], len(shift)),
        transform=transform.reshape(-1, 3, 4),
        plant_id=np.arange(1, count * len(shift) + 1, dtype=np.uint32),
    )
    endless = replace(spec.terrain, far_share=np.zeros_like(spec.terrain.far_share))
    return replace(spec, instances=tiled, terrain=endless), count


def measure(stand: Stand, samples: int = 64) -> Reflectance:
    """A stand's reflectance with the sun 30 degrees from the zenith."""
    scene = grown(stand)
    spec, count = repeated(scene.spec, stand.leaf_area_index)
    camera = spec.cameras[0]
    camera = replace(camera, bands=tuple(band for band in camera.bands if band.name in BANDS))
    job = RenderJob(spec=spec, camera=camera, until=StoppingCriterion(samples), seed=5)
    radiance = render_radiance(job, progress=Silent(), timer=Timings())
    scale = np.pi / np.array(radiance.open_irradiance)
    mean = radiance.mean.mean(axis=(0, 1)) * scale
    error = np.sqrt(radiance.variance.mean(axis=(0, 1)) / radiance.mean[..., 0].size) * scale
    return Reflectance(
        dict(zip(radiance.channels, mean.tolist(), strict=True)),
        dict(zip(radiance.channels, error.tolist(), strict=True)),
        float(leaf_areas_m2(spec)[:count].sum() / SIDE_M**2),
        count / SIDE_M**2 * 1e4,
    )
