"""What weather leaves on surfaces: a film of water, and snow. Both are functions of a hit, so no label changes.

A film darkens what it soaks (scene/surfaces.py) and mirrors as water. Leaves and litter have it on their upper side. On
wood and stones it lies where rain falls on them, aslant in wind, and runs down stems in streaks: bands around the
stem, other ones on each plant, that wander slowly along it and get 60% of a stem wet in still air. Bark beside them is
damp. Water stands in hollows of the ground, level and smooth.

Snow is carried by shoots and branches, as loads of some neighbouring facets together. A load is a cushion: from above
and, where it is thick, from the side it hides what bears it, from below it does not: green shows under white. On stems
it sticks to the windward side, in thin strips that come and go, and thins out towards their edges in grains.

All numbers below, of bands, shares, slopes, cushions and strips, are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from forestgen.core.parts import Part
from forestgen.render.identity.interpolation import Places, shading_normal, weighted_sum
from forestgen.render.identity.tracer import Hits, SceneTracer
from forestgen.render.surfaces import LEAFLIKE
from forestgen.render.variant import dr, mi
from forestgen.scene.surfaces import film_reflectances

_BANDS = (2, 3, 5, 9)  # of water, around a stem
_WANDER, _WANDER_PER_TILE = 1.2, 1.7  # radians, and how fast along the bark's texture
# In standard deviations of bands: streaks are above this, 60% of a normal distribution, with edges of half this width.
_ABOVE, _EDGE = -0.25, 0.5
_ASLANT, _UPPER = 6.0, 3.0  # how much surer rain that falls on a surface wets it than streaks do
_DAMP, _RELIEF = 0.2, 0.6  # share of the darkening beside streaks; share of what soaks that mirrors
_ROUGH = 0.15  # share of painted ground that mirrors: what lies there is too uneven for more
_POOL_EDGE_M = 0.004  # depth below which grains stand out of a puddle
_SNOW_GROUPS = (12, 9)  # bits of a face's number that are alike for neighbours: of a load on a branch, of a shoot
# Vertical parts of normals: of the steepest wood that holds snow where all is under it; and of leaves, which together
# hold it however each one stands.
_STEEPEST, _LEVEL_LEAF = 0.15, 0.35
_ON_BRANCHES = 0.35  # by how much steeper the wood of branches may be: loads are as thick as they are
_CUSHION = (-0.25, 0.6)  # sine of the angle from below to which the thinnest and thickest loads hide what bears them
# Of snow on stems: how far strips reach around, in cosines, and how uneven their edges are, by long waves, by blotches
# and from grain to grain; radians of blotches, and grains, by a tile of the bark's texture.
_STRIP, _STRIP_EDGE, _BLOTCHES, _GRAINS = 0.3, (0.16, 0.06, 0.4), 2.0 * np.pi, 60.0
_UNLABELLED = 1 << 31  # added to the row of what is no plant: other numbers than plants'


@dataclass(frozen=True)
class Film:
    """Water on surfaces at hits."""

    share: Any  # Float, of the surface that mirrors
    soaked: Any  # Float, share of the darkening
    pool: Any  # Float, share of the ground under water that stands


@dataclass(frozen=True)
class UnderSnow:
    """Which hits of plants and things have snow on their upper side.

    Snow may be seen on a leaf too steep to be covered, for loads are cushions: light goes through neither.
    """

    covered: Any  # Bool, whatever side the ray comes from
    seen: Any  # Bool, from where the ray comes


def film_on(tracer: SceneTracer, hits: Hits, corners: Places, normal: Any, along: Any) -> Film:
    """`normal`: smooth, towards where the ray comes from. `along`: of the bark's texture, 0 where there is none."""
    rain, table = tracer.spec.film, tracer.table
    assert rain is not None
    ground = hits.valid & (hits.instance == 0)
    wet = dr.clip(weighted_sum(mi.Float, table.film_share, corners, ground), 0.0, 1.0)
    pool = dr.clip(weighted_sum(mi.Float, table.pool_m, corners, ground) / _POOL_EDGE_M, 0.0, 1.0)
    soaks = dr.gather(mi.Float, table.soaks, hits.organ, hits.valid)  # below 0: it is water itself
    share, up = dr.opaque(mi.Float, rain.share), normal.z
    slant = [dr.opaque(mi.Float, one) for one in rain.slant]
    aslant = dr.maximum(-(slant[0] * normal.x + slant[1] * normal.y), 0.0)
    part = dr.gather(mi.UInt32, table.part, hits.organ, hits.valid)
    running = _bands(dr.atan2(normal.y, normal.x), along, _plant_of(tracer, hits))
    running += _ASLANT * aslant + _UPPER * up
    running = _smooth_step((running - _ABOVE + _EDGE) / (2.0 * _EDGE))
    leaflike = _is_leaflike(part)
    film = dr.select(leaflike, dr.clip(5.0 * up, 0.0, 1.0), running) * dr.select(soaks > 0, _RELIEF, 1.0) * share
    soaked = dr.select(leaflike, 1.0, _DAMP + (1.0 - _DAMP) * running) * share
    soaked = dr.select(ground, dr.maximum(wet, pool), soaked)
    film = dr.select(ground, dr.maximum(_ROUGH * wet, pool), film)
    none = ~hits.valid | (soaks < 0)
    return Film(dr.select(none, 0.0, film), dr.select(none, 0.0, soaked * soaks), dr.select(ground, pool, 0.0))


def darkened(colour: Any, soaked: Any, kept: Any) -> Any:
    """Reflectance where a share of a surface's darkening by water is there; `kept`: what light's way in it leaves."""
    above, below = film_reflectances()
    dry = kept * colour
    return colour + soaked * ((1.0 - above) * (1.0 - below) * dry / (1.0 - below * dry) - colour)


def _bands(turn: Any, along: Any, plant: Any) -> Any:
    """Float of mean 0 and variance 1 around stems."""
    total = mi.Float(0.0)
    for index, count in enumerate(_BANDS):
        first, second = (2.0 * np.pi * one for one in _numbers(plant, index))
        total += dr.sin(count * turn + first + _WANDER * dr.sin(_WANDER_PER_TILE * along + second))
    return total * np.sqrt(2.0 / len(_BANDS))


def _plant_of(tracer: SceneTracer, hits: Hits) -> Any:
    """UInt32, of one plant or thing."""
    plant = dr.gather(mi.UInt32, tracer.table.plant_id, hits.instance, hits.valid)
    return dr.select(plant > 0, plant, hits.instance + _UNLABELLED)


def _numbers(key: Any, other: Any) -> tuple[Any, Any]:
    """Two numbers in [0, 1) of each pair of keys."""
    first, second = (mi.Float(one >> 8) * 2.0**-24 for one in mi.sample_tea_32(key, mi.UInt32(other), 4))
    return first, second


def _is_leaflike(part: Any) -> Any:
    found = mi.Bool(False)
    for one in LEAFLIKE:
        found |= part == int(one)
    return found


def _smooth_step(x: Any) -> Any:
    t = dr.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def under_snow(tracer: SceneTracer, hits: Hits, corners: Places, around: Any, along: Any) -> UnderSnow:
    """By the slope of facets, and of leaves by chance, alike for some neighbours: those of a shoot.

    Wood holds snow where its facets' normals rise above 1 - share (1 - _STEEPEST): with more snow on steeper wood.
    `around`, `along`: of the bark's texture, 0 where there is none.
    """
    snow = tracer.spec.snow
    assert snow is not None
    normal = tracer.geometric_normal(hits)
    smooth = shading_normal(tracer, hits, corners, normal)
    part = dr.gather(mi.UInt32, tracer.table.part, hits.organ, hits.valid)
    plant, share = _plant_of(tracer, hits), dr.opaque(mi.Float, snow.share)
    numbers = [_numbers(plant, hits.face >> size) for size in _SNOW_GROUPS]
    luck, thickness = (0.5 * (one + other) for one, other in zip(*numbers, strict=True))
    # Of the mean of two even numbers, the share below a number (Irwin and Hall's distribution).
    luck = dr.select(luck < 0.5, 2.0 * luck * luck, 1.0 - 2.0 * dr.square(1.0 - luck))
    up, from_below = normal.z, hits.rays.direction.z
    leaf_covered = luck < share * dr.minimum(dr.abs(up) / _LEVEL_LEAF, 1.0)
    leaf_seen = (luck < share) & (from_below < dr.lerp(*_CUSHION, thickness))
    least = 1.0 - share * (1.0 - _STEEPEST) - dr.select(part == int(Part.BRANCH), _ON_BRANCHES, 0.0)
    windward = sum(
        dr.opaque(mi.Float, one) * axis for one, axis in zip(snow.windward, (smooth.x, smooth.y), strict=True)
    )
    # Waves aslant, each way: such as run around and along make a lattice of dots.
    blotches = _bands(_BLOTCHES * (2.0 * around + along), along, plant) + _bands(
        _BLOTCHES * (along - around), around, plant
    )
    column, row = (mi.UInt32(mi.Int32(dr.floor(_GRAINS * one))) for one in (around, along))
    grain = _numbers(mi.sample_tea_32(plant, column, 4)[0], row)[0] - 0.5
    uneven = _STRIP_EDGE[0] * _bands(along, along, plant) + _STRIP_EDGE[1] * blotches + _STRIP_EDGE[2] * grain
    strip = windward > 1.0 - _STRIP * share + uneven
    on_wood = (up > least) | ((part == int(Part.TRUNK)) & strip)
    held, leaflike = hits.valid & (hits.instance > 0) & (part != int(Part.WATER)), _is_leaflike(part)
    return UnderSnow(held & dr.select(leaflike, leaf_covered, on_wood), held & dr.select(leaflike, leaf_seen, on_wood))
