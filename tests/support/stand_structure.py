"""Gaps, clumping and leaf profiles of closed stands of one species, and what foresters have measured of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.geometry.mesh import surface_area_m2
from forestgen.pipeline import assemble_image
from forestgen.recipe.load import load_recipe_data
from forestgen.render.identity import SceneTracer
from forestgen.render.variant import mi, using
from forestgen.scene.build import BuiltScene
from forestgen.scene.plan import check_plan
from forestgen.scene.plant_measures import PlantMeter

Floats = NDArray[np.float64]
SIDE_M = 30.0
EYE_M = 1.3  # height of the instrument
HINGE_DEG = 57.5
_SECTORS = 24  # of 15 degrees of azimuth: segments of the logarithmic mean
_PLACES, _RAYS = 6, 400  # along a side of the site; rays a sector
_LAYERS = 20  # of a crown's profile


@dataclass(frozen=True)
class Stand:
    """A closed stand of one species, and its targets."""

    species: str
    stems_per_ha: float
    basal_area_m2_per_ha: float
    dominant_height_m: float
    canopy_cover: float  # of crowns as discs
    leaf_area_index: float  # one side, or half of a needle's surface


# Stems, basal areas and heights as of yield tables for middle-aged stands. Leaf area indices of closed stands of each
# species: Breuer, Eckhardt and Frede 2003 (Ecological Modelling 169, 237-293), Iio et al. 2014 (Global Ecology and
# Biogeography 23, 274-285).
STANDS = {
    "spruce": Stand("spruce", 1100, 38.0, 21.0, 0.75, 6.0),
    "pine": Stand("pine", 1000, 28.0, 18.0, 0.62, 3.0),
    "birch": Stand("birch", 1000, 20.0, 19.0, 0.80, 4.6),
    "beech": Stand("beech", 400, 28.0, 23.0, 0.92, 6.5),
}


@dataclass(frozen=True)
class Structure:
    """Of a stand, as instruments see it from below and as its geometry is."""

    leaf_area_index: float
    wood_area_index: float  # half of the wood's surface
    gap_fraction: float  # at 57.5 degrees
    vertical_gap_fraction: float
    clumping: float  # effective over true plant area index at 57.5 degrees, G = 1/2
    crown_clumping: float  # by logarithmic means over azimuth sectors, Lang and Xiang 1986
    leaf_area_density: float  # m2/m3 in ellipsoids of the crowns' sizes, median of trees
    peak: float  # height of the most leaf area within crowns, 0 base to 1 top
    mean_height: float  # of leaf area within crowns


# Clumping of conifers: 4 STAR of shoots, 0.59 (Scots pine) and 0.64 (Norway spruce; Majasalmi et al. 2016, as Hadi and
# Rautiainen 2018 use it, Remote Sensing Letters 9, 666-675), times 0.7 to 1 between shoots. Of broad-leaved stands:
# effective plant area at 57 degrees over leaves of litter traps and wood, 0.41 below broad-leaved trees near Freiburg
# (hemispherical photos; Lotz et al. 2026, Biogeosciences 23, 1949-1963, its data at github.com/GeoSense-Freiburg/
# LittervsLens); LAI-2000 over litter traps 0.85 in beech and 0.94 in maple (Černý, Haninec and Pokorný 2020, Journal of
# Forestry Research 31, 827-836, abstract) and 0.60 to 0.87 in mixed forests (Liu, Jin and Zhou 2015, iForest 9, 55-62,
# abstract), times 0.87 for the wood: 0.41 to 0.82. Leaves at random in the same crowns would give 0.66 (beech) and 0.55
# (birch): the rest is between crowns.
# By logarithmic means: 0.7 of conifers and aspen (Chen et al. 1997, Journal of Geophysical Research 102, 29429-29443,
# from memory) to 0.98 of birch (Ryu et al. 2010, Agricultural and Forest Meteorology 150).
# Gap fraction at 57 degrees of broad-leaved stands: 0.009 by the LAI-2000's greatest index (Černý et al.) to 0.145 by
# photos (Lotz et al.).
# Leaf area density: by crown sizes and leaf masses of Hyytiälä's stands (github.com/mottus/f_art_python) 0.75 to 0.92;
# by BAAD (Falster et al. 2015), 10th to 90th percentile: Pinus of 13 to 18 m 0.35 to 1.7, Fagus of 18 to 26 m 0.15 to
# 0.37. Mean height of needles, of birches' crown biomass: 0.55 pine, 0.58 spruce, 0.46 birch, by the curves of
# Tahvanainen and Forss 2008 (Forest Ecology and Management 255, 455-467, tables 7 and 8), +- 0.1 between stands.
RANGES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "spruce": {
        "clumping": (0.45, 0.70),
        "crown_clumping": (0.70, 0.98),
        "leaf_area_density": (0.5, 1.0),
        "mean_height": (0.48, 0.68),
    },
    "pine": {
        "clumping": (0.41, 0.70),
        "crown_clumping": (0.70, 0.98),
        "leaf_area_density": (0.35, 1.7),
        "mean_height": (0.45, 0.65),
    },
    "birch": {
        "gap_fraction": (0.009, 0.145),
        "clumping": (0.41, 0.82),
        "crown_clumping": (0.70, 0.98),
        "leaf_area_density": (0.5, 1.0),
        "mean_height": (0.36, 0.56),
    },
    "beech": {
        "gap_fraction": (0.009, 0.145),
        "clumping": (0.41, 0.82),
        "crown_clumping": (0.70, 0.98),
        "leaf_area_density": (0.15, 0.37),
    },
}


def misses(name: str, found: Structure) -> list[str]:
    """What of a stand lies outside of the measured ranges."""
    ranges = RANGES[name].items()
    return [key for key, (low, high) in ranges if not low <= getattr(found, key) <= high]


def grown(stand: Stand, **more: object) -> BuiltScene:
    """The stand, without end, on flat litter; recipe sections beside its own in `more`."""
    storey = {
        "species": {stand.species: 1},
        "stems_per_ha": stand.stems_per_ha,
        "basal_area_m2_per_ha": stand.basal_area_m2_per_ha,
        "dominant_height_m": stand.dominant_height_m,
        "clark_evans": 1.2,
    }
    middle = SIDE_M / 2
    recipe = {
        "forestgen": 1,
        "seed": 3,
        "site": {"size_m": [SIDE_M, SIDE_M], "surroundings": "repeat"},
        "species": {stand.species: stand.species},
        "community": {
            "model": "stand",
            "storeys": [storey],
            "canopy_cover": stand.canopy_cover,
            "leaf_area_index": stand.leaf_area_index,
        },
        "plants": {"exemplars_per_species": 8},
        "sky": {"sun": {"elevation_deg": 60, "azimuth_deg": 180}},
        "cameras": [
            {
                "kind": "orthographic",
                "position_m": [middle, middle, 80.0],
                "look_at_m": [middle, middle, 0.0],
                "width_m": SIDE_M,
                "size_px": [32, 32],
                "bands": "sentinel2a",
            }
        ],
        **more,
    }
    return assemble_image(check_plan(load_recipe_data(recipe, "test")), Silent(), Timings())


def gap_fractions(tracer: SceneTracer, zenith_deg: tuple[float, float]) -> Floats:
    """(P, S) share of sky at places on a grid, by sector of azimuth, between two zenith angles."""
    rng = np.random.default_rng(11)
    shape = (_PLACES**2, _SECTORS, _RAYS)
    zenith = np.radians(rng.uniform(*zenith_deg, shape))
    azimuth = 2.0 * np.pi * (np.arange(_SECTORS)[:, None] + rng.random(shape)) / _SECTORS
    way = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=-1)
    place = (np.stack(np.meshgrid(*[np.arange(_PLACES) + 0.5] * 2), axis=-1).reshape(-1, 2)) * SIDE_M / _PLACES
    start = np.broadcast_to(np.column_stack([place, np.full(len(place), EYE_M)])[:, None, None], (*shape, 3))
    with using(tracer.variant):
        origin = (start - tracer.origin_m).reshape(-1, 3).T
        rays = mi.Ray3f(
            mi.Point3f(*(mi.Float(one) for one in origin)),
            mi.Vector3f(*(mi.Float(one) for one in way.reshape(-1, 3).T)),
        )
        met = np.array(tracer.scene.ray_test(rays), dtype=bool).reshape(shape)
    return np.asarray(1.0 - met.mean(axis=-1))


def structure(scene: BuiltScene) -> Structure:
    """The structure of a stand."""
    spec = scene.spec
    own = spec.instances.at(slice(0, len(scene.population)))
    meter = PlantMeter(spec.exemplars)
    plants = meter.measure(own)
    scale = np.cbrt(np.linalg.det(own.transform[:, :, :3].astype(np.float64)))
    wood = np.array([_wood_area_m2(one) for one in spec.exemplars])[own.exemplar] * scale**2
    leaf_index, wood_index = float(plants.leaf_area_m2.sum()) / SIDE_M**2, float(wood.sum()) / 2 / SIDE_M**2
    tracer = SceneTracer(spec, Timings())
    sectors = gap_fractions(tracer, (HINGE_DEG - 2.5, HINGE_DEG + 2.5))
    gap = float(sectors.mean())
    depth = -np.log(np.maximum(sectors, 0.5 / _RAYS))
    crown_m = scene.population.height_m - plants.crown_base_m
    volume_m3 = np.pi / 6.0 * plants.crown_width_m**2 * crown_m
    profile = crown_profile(scene)
    middle = (np.arange(_LAYERS) + 0.5) / _LAYERS
    return Structure(
        leaf_area_index=leaf_index,
        wood_area_index=wood_index,
        gap_fraction=gap,
        vertical_gap_fraction=float(gap_fractions(tracer, (0.0, 5.0)).mean()),
        clumping=float(-np.log(gap)) * 2.0 * float(np.cos(np.radians(HINGE_DEG))) / (leaf_index + wood_index),
        crown_clumping=float(-np.log(gap) / depth.mean()),
        leaf_area_density=float(np.median(plants.leaf_area_m2 / volume_m3)),
        peak=float(middle[np.argmax(np.convolve(profile, [0.25, 0.5, 0.25], "same"))]),
        mean_height=float(np.sum(profile * middle) / profile.sum()),
    )


def _wood_area_m2(exemplar) -> float:  # type: ignore[no-untyped-def]
    return sum(surface_area_m2(one.mesh) for one in exemplar.organs if one.part in (Part.TRUNK, Part.BRANCH))


def crown_profile(scene: BuiltScene) -> Floats:
    """(20,) share of leaf area by height within the crown, base to top; the mean of the trees, by leaf area."""
    own = scene.spec.instances.at(slice(0, len(scene.population)))
    count = np.bincount(own.exemplar, minlength=len(scene.spec.exemplars))
    total = np.zeros(_LAYERS)
    for exemplar, number in zip(scene.spec.exemplars, count, strict=True):
        leaves = [one.mesh for one in exemplar.organs if one.part == Part.LEAF]
        if not number or not leaves:
            continue
        corners = np.concatenate([one.vertices_m[one.faces] for one in leaves]).astype(np.float64)
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        height = corners[:, :, 2].mean(axis=1)
        order = np.argsort(height)
        base = height[order][np.searchsorted(np.cumsum(area[order]), 0.02 * area.sum())]
        share = (height - base) / (float(corners[:, :, 2].max()) - base)
        total += number * np.histogram(share, bins=_LAYERS, range=(0.0, 1.0), weights=area)[0]
    return np.asarray(total / total.sum())
