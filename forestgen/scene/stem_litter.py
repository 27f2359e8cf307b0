"""Litter that lies heaped against stems: what wind and slope drive along the ground stays at their feet.

A heap is a wedge of a layer's things, highest at the bark. Heaps stand around a stem, with gaps, higher on its upper
side. Their size goes with the stem's; numbers are ours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.ground_layers.layer import Layer
from forestgen.scene.ground_tiles import anywhere, laid, number_per_m2
from forestgen.scene.ground_view import TILE_M

VARIANTS = 3
_WIDE_M, _OUT_M = 0.4, 0.15  # along the bark; away from it, at 1/e of the height
_INTO_M = 0.08  # the stem, where its foot has hollows
_LAYERS = 3.0  # things above one another at the bark
_LEAN_DEG = 30.0  # standard deviation of a thing's lean
_LEAST_DBH_M, _REFERENCE_M = 0.06, 0.35
_LOBES = 0.45  # mean of the widening above roots, over its peak
_MISSING = 0.1  # share of heaps that are not there
_UPHILL = 2.5  # growth of the height on the upper side, over the slope
_STEP_M = 0.15  # on which the slope is taken

Ints = NDArray[np.intp]
Cover = Callable[[Floats], Floats]
Height = Callable[[Floats, Floats], Floats]


def heap(layer: Layer, variant: int, seed: int) -> Exemplar:
    """A wedge of things: x away from the bark, y along it."""
    rng = child_rng(seed, "heap", layer.name, variant)
    mean = float(number_per_m2(layer, np.array(1.0 - np.exp(-_LAYERS))))
    count = max(int(rng.poisson(mean * _WIDE_M * _OUT_M * np.exp(_INTO_M / _OUT_M))), 8)
    away = rng.exponential(_OUT_M, count) - _INTO_M
    place = np.stack([away, rng.uniform(-0.5, 0.5, count) * _WIDE_M], axis=1)
    up_m = layer.heaped_m * rng.random(count) * np.exp(-np.maximum(away, 0.0) / _OUT_M)
    loose = replace(layer, spread=replace(layer.spread, tilt_deg=_LEAN_DEG))
    kind = rng.integers(len(layer.things), size=count)
    frames = anywhere(loose, kind, rng)
    frames[:, :, 3] = np.column_stack([place, up_m])
    return laid(layer, kind, frames, _WIDE_M)


def foot_factors(plants: Mapping[str, Any], names: Sequence[str]) -> Floats:
    """(S,) mean radius of stems at the ground over that at breast height, by species; `plants`: their parameters."""
    factors = np.ones(len(names))
    for k, wood in enumerate(plants[name].wood if name in plants else None for name in names):
        if wood is not None:
            roots = None if wood.years is None else wood.years.roots
            factors[k] += wood.flare + (0.0 if roots is None else _LOBES * roots.rise)
    return factors


def heaps(
    layer: Layer, at: Ints, cover: Cover, population: Population, foot: Floats, height: Height, seed: int
) -> tuple[list[Exemplar], Ints, Floats]:
    """Exemplars, (K,) which, and (K, 3, 4) where: around the stems that stand on tiles (T, 2) that have the layer.

    `cover`: of places (K, 2), the layer's share of the ground. `foot`: (S,) see `foot_factors`.
    """
    dbh_m = np.nan_to_num(population.columns.get("dbh_m", np.zeros(len(population))))
    stands = (dbh_m > _LEAST_DBH_M) & (population.status != Status.DEAD)
    tile = np.floor(population.position_m[:, :2] / TILE_M).astype(np.intp)
    known = set(map(tuple, at.tolist()))
    stems = [k for k in np.flatnonzero(stands).tolist() if tuple(tile[k].tolist()) in known]
    factor = foot[population.species]
    if not stems:
        return [], np.zeros(0, np.intp), np.zeros((0, 3, 4))
    share = (1.0 - _MISSING) * cover(population.position_m[stems, :2])
    made = [
        _around(population, k, float(dbh_m[k]), float(factor[k]), float(most), layer.name, height, seed)
        for k, most in zip(stems, share, strict=True)
    ]
    transform = np.concatenate(made)
    return [heap(layer, k, seed) for k in range(VARIANTS)], np.arange(len(transform)) % VARIANTS, transform


def _around(
    population: Population, row: int, dbh_m: float, factor: float, share: float, name: str, height: Height, seed: int
) -> Floats:
    """(K, 3, 4) of the heaps of one stem, of a share of the places around it."""
    rng = child_rng(seed, "heaps", name, int(population.plant_id[row]))
    radius_m = 0.5 * factor * dbh_m
    count = int(np.ceil(2.0 * np.pi * radius_m / (0.6 * _WIDE_M)))
    angle = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.35, 0.35, count) + rng.random()) / count
    foot = population.position_m[row, :2]
    angle = angle[rng.random(count) < share]
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place = foot + out * radius_m
    ground, beyond = height(*place.T), height(*(place + _STEP_M * out).T)
    rise = (beyond - ground) / _STEP_M
    size = np.clip(dbh_m / _REFERENCE_M, 0.4, 1.2) * rng.uniform(0.6, 1.3, len(angle))
    transform = np.zeros((len(angle), 3, 4))
    transform[:, :2, 0], transform[:, 2, 0] = out, rise
    transform[:, 0, 1], transform[:, 1, 1] = -out[:, 1], out[:, 0]
    transform[:, 2, 2] = size * np.clip(1.0 + _UPHILL * rise, 0.3, 2.0)
    transform[:, :2, 3], transform[:, 2, 3] = place, ground
    return transform
