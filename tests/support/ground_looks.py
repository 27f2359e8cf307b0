"""Radiance of ground whose cover is geometry over that of ground painted with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent, Timings
from forestgen.recipe.load import load_recipe_data
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.rendering import render_radiance
from forestgen.scene.build import build_scene
from forestgen.scene.ground_cover import LaidGround, ground_cover
from forestgen.scene.ground_paint import painted
from forestgen.scene.plan import check_plan
from forestgen.scene.spec import SceneSpec

BANDS = ("B2", "B3", "B4", "B8", "B11")
MIDDLES_NM = (492.0, 560.0, 665.0, 833.0, 1614.0)
LEAST, MOST = 0.75, 1.28  # of all bands, covers and suns: green grass is the worst
#: A layer of each kind, and the species whose leaves fall or that grow.
LAYERS: Mapping[str, dict[str, Any]] = {
    "fallen leaves of beech": {"what": "fallen_leaves"},
    "fallen needles of spruce": {"what": "fallen_leaves", "of": "spruce"},
    "twigs": {"what": "twigs"},
    "stones": {"what": "stones"},
    "moss": {"what": "moss"},
    "grass": {"what": "small_plants", "species": "grass"},
}


@dataclass(frozen=True)
class Looks:
    """What one layer looks like."""

    ratio: NDArray[np.float64]  # (5,) radiance of geometry over that of paint, in `BANDS`
    trapped: float  # p at which the mean of the ratios would be 1


def looks(layer: Mapping[str, Any], sun_deg: float, samples: int, size_px: int = 160) -> Looks:
    """Of one layer on wet soil, seen straight down; its cover is even."""
    keys = dict(layer)
    species = keys.pop("of", "beech")
    recipe = {
        "forestgen": 1,
        "species": {species: species, "grass": "grass"},
        "site": {"size_m": [12, 12], "ground": {"kind": "soil_wet", "layers": [keys]}},
        "community": {"model": "placed", "plants": [{"species": species, "position_m": [0.5, 0.5], "radius_m": 0.2}]},
        "sky": {"sun": {"elevation_deg": sun_deg, "azimuth_deg": 160}, "clouds": "none"},
        "cameras": [
            {
                "name": "down", "kind": "orthographic", "size_px": [size_px, size_px], "width_m": 4.0,
                "position_m": [7, 7, 30], "look": "down", "bands": "sentinel2a",
            }
        ],
    }  # fmt: skip
    plan = check_plan(load_recipe_data(recipe, "ground"))
    population = plan.community.with_tree_sizes(final_population(plan.community, Silent()))
    spec = build_scene(plan, population, Silent(), Timings()).spec
    on_site = spec.instances.at(slice(0, len(spec.instances) - spec.instances.outside))
    flat = replace(spec, instances=on_site, terrain=replace(spec.terrain, bare=None))
    ratio = _radiance(spec, samples) / _radiance(flat, samples)
    return Looks(ratio, _trapped(spec, ground_cover(plan, population, spec.cameras), ratio))


def _trapped(spec: SceneSpec, laid: LaidGround, ratio: NDArray[np.float64]) -> float:
    """p at which paint has the mean brightness of geometry; NaN: none has."""
    assert spec.terrain.bare is not None
    ground = replace(spec.terrain, spectrum=spec.terrain.bare.spectrum)

    def of(trapped: float | None) -> NDArray[np.float64]:
        layers = [one if trapped is None else replace(one, trapped=trapped) for one in laid.layers]
        spectrum = painted(ground, layers, laid.tiles).spectrum
        assert spectrum is not None
        return np.asarray(spectrum.at(np.array(MIDDLES_NM)))

    now = of(None)

    def off(trapped: float) -> float:
        return float(np.mean(np.log(of(trapped) / now / ratio)))

    return float(brentq(off, -1.0, 0.95)) if off(-1.0) * off(0.95) < 0.0 else float("nan")


def _radiance(spec: SceneSpec, samples: int) -> NDArray[np.float64]:
    job = RenderJob(spec=spec, camera=spec.cameras[0], until=StoppingCriterion(samples), seed=5)
    found = render_radiance(job, progress=Silent(), timer=Timings())
    columns = [found.channels.index(band) for band in BANDS]
    return np.asarray(found.mean.mean(axis=(0, 1))[columns], dtype=np.float64)
