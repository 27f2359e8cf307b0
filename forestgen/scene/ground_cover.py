"""What lies and grows on the ground, as geometry: tiles of a metre, near the cameras, in place of paint.

A layer's things (`site.ground.layers`; scene/ground_layers) are laid at random on a few tiles, of several densities. A
tile is one mesh, instanced where the layer's cover asks for its density, turned by right angles and sheared to the
ground. N things a square metre, each hiding an area a of it, hide 1 - exp(-N a) together: so a tile has Poisson's
number of things for its cover. Large things, of which a tile would have less than `_FEWEST`, are instanced one by one.
The cover itself is uneven in patches (scene/ground_paint.py), and by where a layer grows.

Tiles are drawn where a thing of the layer is as long as `ground_view.LEAST_PX` pixels of the camera that sees it best,
in or near some camera's view: up to `ground_view.FAR_M` from it, or, where it looks down with all of its image from
higher, or its rays are parallel, on the ground that it sees, 400 m wide at most. Of all layers' tiles the `MOST_TILES`
nearest are drawn. Elsewhere the ground is painted (scene/ground_paint.py).

Reference
---------
Cook, R. L., Halstead, J., Planck, M., Ryu, D. (2007). Stochastic simplification of aggregate detail. ACM Transactions
on Graphics 26(3), article 79.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import SPLIT_MIX_STEP, child_rng, child_root, mixed
from forestgen.geometry.mesh import Floats
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.registries import GROUND_LAYERS
from forestgen.scene.blocks import sheared
from forestgen.scene.ground_layers.layer import GROUND, Layer, Places, Request
from forestgen.scene.ground_paint import LONGEST_PATCH_M, painted, patches_of, relative_cover
from forestgen.scene.ground_tiles import COVERS, MOST_THINGS, VARIANTS, number_per_m2, single, tile
from forestgen.scene.ground_view import MOST_TILES, TILE_M, best_pixel_m, nearest, seen_tiles
from forestgen.scene.plan import Plan
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec
from forestgen.scene.stem_litter import foot_factors, heaps
from forestgen.scene.terrain import HeightField

_FEWEST = 4.0  # things on a tile, in the mean
_MOST_SINGLE = 40  # large things on a square metre: at a mean of 4 none has as many
_NUMBERS = 6  # of a thing that lies by itself
_WAVES = 24  # of a field of patches
_EDGE_POINTS = 4  # along a tile, where it is asked for paths and water
_REACH_M = 2.5  # standard deviation of where leaves fall
_SPREAD = 0.35  # of the logistic curve that makes patches of waves

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class LaidGround:
    """What lies on the ground."""

    exemplars: tuple[Exemplar, ...]
    materials: Mapping[tuple[str, str], Material]
    exemplar: NDArray[np.uint32]  # (K,) of each tile, among `exemplars`
    transform: Floats  # (K, 3, 4)
    layers: tuple[Layer, ...]
    tiles: tuple[Ints, ...]  # (K, 2) columns and rows that have a layer as geometry, by layer
    patches: Mapping[int, NDArray[np.float32]] = field(default_factory=dict)  # ground_paint.patches_of
    seed: int = 0  # of the image
    notes: tuple[str, ...] = ()  # for people: what is not as the recipe says

    def on(self, spec: SceneSpec) -> SceneSpec:
        """The scene with its tiles, and paint of their colour where there are none."""
        if not self.layers:
            return spec
        old, first = spec.instances, len(spec.exemplars)
        instances = Instances(
            exemplar=np.concatenate([old.exemplar, self.exemplar + np.uint32(first)]),
            transform=np.concatenate([old.transform, self.transform]),
            plant_id=np.concatenate([old.plant_id, np.zeros(len(self.exemplar), np.uint32)]),
            outside=old.outside + len(self.exemplar),
        )
        return replace(
            spec,
            exemplars=(*spec.exemplars, *self.exemplars),
            materials={**spec.materials, **self.materials},
            instances=instances,
            terrain=painted(spec.terrain, *self._painted(), self.patches, self.seed),
        )

    def _painted(self) -> tuple[list[Layer], list[Ints]]:
        """Layers whose mean colour is painted, and their tiles."""
        pairs = [pair for pair in zip(self.layers, self.tiles, strict=True) if pair[0].is_painted]
        return [layer for layer, _ in pairs], [tiles for _, tiles in pairs]


def ground_cover(plan: Plan, population: Population, cameras: Sequence[Camera]) -> LaidGround:
    """The layers of a recipe's ground; `population`: of the site, its feet on the ground.

    Raises `RecipeError`: a thing that cannot be made, with the layer's line.
    """
    sections, height = plan.drawn.recipe.site.ground.layers, plan.views.height
    finest_m = best_pixel_m(cameras, height) if sections else 0.0
    shares = leaf_shares(population, height.size_m) if sections else {}
    patches = patches_of(sections, plan.drawn.image_seed)
    relative = relative_cover(sections, patches)
    layers: list[Layer] = []
    notes: list[str] = []
    for index, keys in enumerate(sections):
        kind: Any = GROUND_LAYERS.load(keys.what)
        where = ("site", "ground", "layers", index)
        request = Request(plan.drawn, plan.plants.generators, shares, finest_m, where)
        try:
            found = kind.layers(keys, request, child_rng(plan.drawn.image_seed, "ground", index))
        except RecipeError as cause:
            raise cause.at(plan.drawn.where(*where)) from cause
        named = [replace(one, name=f"{index}/{one.name}", relative=relative[index]) for one in found]
        layers += [_placed(one, keys.on, height) for one in named]
        notes += _notes(f"site.ground.layers.{index}: {keys.what}", found)
    stems = population, foot_factors(plan.plants.generators, population.species_names)
    laid = _laid([one for one in layers if one.things], cameras, height, stems, plan.drawn.image_seed)
    return replace(
        laid, layers=tuple(layers), tiles=_tiles_of_all(layers, laid.tiles), patches=patches, notes=tuple(notes)
    )


def _tiles_of_all(layers: Sequence[Layer], tiles: Sequence[Ints]) -> tuple[Ints, ...]:
    """Of layers that are painted alone too: none."""
    drawn = iter(tiles)
    return tuple(next(drawn) if one.things else np.zeros((0, 2), np.intp) for one in layers)


def _placed(layer: Layer, on: str, height: HeightField) -> Layer:
    """A layer less dense on paths, and nowhere in water; or, painted nowhere, in the places that `on` names alone."""
    if on == "ground" and height.fine_m2 == 0.0:
        return layer
    places = {
        "ground": height.open_share,
        "roadside": height.roadside,
        "path": height.trodden,
        "shore": height.shore,
        "water": height.under_water,
    }
    share = places[on]
    where = layer.where
    inside = TILE_M * ((np.arange(_EDGE_POINTS) + 0.5) / _EDGE_POINTS - 0.5)

    def density(x: Floats, y: Floats) -> Floats:
        mean = np.mean([share(x + east, y + north) for east in inside for north in inside], axis=0)
        return np.asarray(mean if where is None else mean * where(x, y))

    spread = replace(layer.spread, tilt_deg=0.0, depth_m=0.0) if on == "water" else layer.spread
    return replace(
        layer, where=density, is_painted=layer.is_painted and on == "ground", floats=on == "water", spread=spread
    )


def _notes(name: str, layers: Sequence[Layer]) -> list[str]:
    """What of a layer is not as the recipe says."""
    if not layers:
        return [f"{name}: nothing lies there, for no plant that sheds it stands on the site"]
    notes = []
    for one in (layer for layer in layers if layer.things and layer.is_painted):  # what is not painted is ours
        fully = float(number_per_m2(one, np.array(1.0 - np.exp(-1.0)))) * TILE_M**2  # on a tile that they cover once
        most = 1.0 - float(np.exp(-MOST_THINGS / fully))
        if most < one.cover:
            notes.append(f"{name}: things so small hide at most {most:.2f} of the ground, not {one.cover:.2f}")
    return notes


def _laid(
    layers: Sequence[Layer], cameras: Sequence[Camera], height: HeightField, stems: tuple[Population, Floats], seed: int
) -> LaidGround:
    exemplars: list[Exemplar] = []
    which, places = [np.zeros(0, np.intp)], [np.zeros((0, 3, 4))]
    seen = [seen_tiles(cameras, height, max(one.length_m for one in layer.things)) for layer in layers]
    kept = nearest([apart for _, apart in seen], MOST_TILES)
    for layer, (at, _), near in zip(layers, seen, kept, strict=True):
        mean = float(number_per_m2(layer, np.array(layer.cover))) * TILE_M**2
        lay = _lay_singly if mean < _FEWEST else _lay_tiles
        found = [lay(layer, at[near], height.surface if layer.floats else height, seed)]
        if layer.heaped_m > 0.0:
            found.append(heaps(layer, at[near], partial(local_cover, layer, seed=seed), *stems, height, seed))
        for made, index, transform in found:
            which.append(index + len(exemplars))
            places.append(transform)
            exemplars += made
    materials = {(GROUND, key): one for layer in layers for key, one in layer.materials.items()}
    return LaidGround(
        exemplars=tuple(exemplars),
        materials=materials,
        exemplar=np.concatenate(which).astype(np.uint32),
        transform=np.concatenate(places),
        layers=tuple(layers),
        tiles=tuple(at[near] for (at, _), near in zip(seen, kept, strict=True)),
        seed=seed,
    )


_Lying = tuple[list[Exemplar], Ints, Floats]  # exemplars, (K,) which, (K, 3, 4) where


def _lay_tiles(layer: Layer, at: Ints, height: Places, seed: int) -> _Lying:
    middle = np.asarray((at + 0.5) * TILE_M, dtype=np.float64)
    chosen, turn = _chosen(layer, middle, at, seed)
    some = chosen >= 0
    used, index = np.unique(chosen[some], return_inverse=True)
    return (
        [tile(layer, int(one), seed)[0] for one in used],
        index,
        sheared(middle[some], _slopes(height, middle[some]), turn[some]),
    )


def _lay_singly(layer: Layer, at: Ints, height: Places, seed: int) -> _Lying:
    """Things one by one: on each square metre Poisson's number of them."""
    from scipy.special import ndtri  # late: a third of a second

    middle = np.asarray((at + 0.5) * TILE_M, dtype=np.float64)
    mean = number_per_m2(layer, local_cover(layer, middle, seed)) * TILE_M**2
    count = _poisson(tile_numbers(at, child_root(seed, "number", layer.name))[:, 0], mean)
    tiles = np.repeat(np.arange(len(at)), count)
    order = np.arange(len(tiles)) - np.repeat(np.cumsum(count) - count, count)
    own = np.zeros((len(tiles), _NUMBERS))
    for number in range(int(count.max(initial=0))):
        rows, roots = order == number, (child_root(seed, "single", layer.name, number, part) for part in range(2))
        own[rows] = np.concatenate([tile_numbers(at[tiles[rows]], root) for root in roots], axis=1)
    place = (at[tiles] + own[:, :2]) * TILE_M
    angle = 2.0 * np.pi * own[:, 2]
    size = np.exp(layer.spread.size_sigma * ndtri(np.clip(own[:, 3], 1e-6, 1.0 - 1e-6)))
    transform = np.zeros((len(tiles), 3, 4))
    cos, sin = size * np.cos(angle), size * np.sin(angle)
    transform[:, 0, 0], transform[:, 0, 1], transform[:, 1, 0], transform[:, 1, 1] = cos, -sin, sin, cos
    transform[:, 2, 2] = size
    transform[:, :2, 3], transform[:, 2, 3] = place, height(*place.T)
    which = np.minimum((own[:, 4] * len(layer.things)).astype(np.intp), len(layer.things) - 1)
    return [single(layer, number) for number in range(len(layer.things))], which, transform


def _poisson(uniform: Floats, mean: Floats) -> Ints:
    """(K,) Poisson's numbers of small means, by their inverse distribution."""
    chance = np.exp(-mean)
    below, count = chance.copy(), np.zeros(len(mean), dtype=np.intp)
    for number in range(1, _MOST_SINGLE):
        count += uniform > below
        chance = chance * mean / number
        below += chance
    return count


def _chosen(layer: Layer, middle: Floats, at: Ints, seed: int) -> tuple[Ints, Ints]:
    """(K,) tile at each place, cover and variant, or -1 for none; and (K,) right angles that it is turned by."""
    cover = local_cover(layer, middle, seed)
    draw = tile_numbers(at, child_root(seed, "tiles", layer.name))
    known = np.array([0.0, *COVERS])
    level = np.clip(np.searchsorted(known, cover, side="right"), 1, len(known) - 1)
    share = (cover - known[level - 1]) / (known[level] - known[level - 1])
    level = level - (draw[:, 0] >= share)  # of two neighbours, so that the mean cover is right
    index = (level - 1) * VARIANTS + (draw[:, 1] * VARIANTS).astype(np.intp)
    return np.where(level > 0, index, -1), (draw[:, 2] * 4).astype(np.intp)


def tile_numbers(at: Ints, seed: int) -> Floats:
    """(K, 3) random numbers of tiles by their column and row."""
    column, row = (at[:, k].astype(np.int64).view(np.uint64) for k in range(2))
    with np.errstate(over="ignore"):
        key = mixed(mixed(column + np.uint64(seed)) + row * SPLIT_MIX_STEP)
        bits = [mixed(key + np.uint64(k) * SPLIT_MIX_STEP) for k in range(1, 4)]
    return np.stack([(one >> np.uint64(11)).astype(np.float64) * 2.0**-53 for one in bits], axis=1)


def local_cover(layer: Layer, middle: Floats, seed: int) -> Floats:
    """(K,) share of the ground that a layer hides around places (K, 2)."""
    relative = np.ones(len(middle)) if layer.where is None else layer.where(*middle.T)
    cover = np.asarray(1.0 - (1.0 - layer.cover) ** relative)
    if layer.relative is not None:
        row, column = (np.floor(middle[:, k] / TILE_M).astype(np.intp) % len(layer.relative) for k in (1, 0))
        cover = np.asarray(np.clip(cover * layer.relative[row, column], 0.0, COVERS[-1]))
    if layer.patch_m is None or (layer.patch_m <= LONGEST_PATCH_M and layer.relative is not None):
        return cover
    waves = _waves(middle, layer.patch_m, child_rng(seed, "patches", layer.name))
    threshold = _threshold(layer.cover)
    patchy = 1.0 / (1.0 + np.exp((threshold - waves) / _SPREAD))
    return np.asarray(np.clip(patchy * cover / layer.cover, 0.0, COVERS[-1]))


def _waves(middle: Floats, patch_m: float, rng: np.random.Generator) -> Floats:
    """(K,) field of mean 0 and variance 1 whose hills and valleys are as wide as patches."""
    way, phase = rng.random((2, _WAVES)) * 2.0 * np.pi
    number = 2.0 * np.pi / (2.0 * patch_m * np.exp(rng.normal(0.0, 0.5, _WAVES)))
    angle = middle @ (number * np.stack([np.cos(way), np.sin(way)])) + phase
    return np.asarray(np.sqrt(2.0 / _WAVES) * np.cos(angle).sum(axis=1))


def _threshold(cover: float) -> float:
    """The height above which a field of variance 1 is patch, for a mean cover."""
    node, weight = np.polynomial.hermite_e.hermegauss(61)
    weight = weight / weight.sum()
    low, high = -6.0, 6.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        mean = float(weight @ (1.0 / (1.0 + np.exp((middle - node) / _SPREAD))))
        low, high = (middle, high) if mean > cover else (low, middle)
    return 0.5 * (low + high)


def leaf_shares(population: Population, size_m: tuple[float, float]) -> dict[str, tuple[float, Places]]:
    """By species, its share of the leaf area, and a map of where that is, of mean 1, periodic as the site repeated."""
    from scipy.ndimage import gaussian_filter

    columns = population.columns
    own = np.nan_to_num(columns["leaf_area_m2"]) if "leaf_area_m2" in columns else population.radius_m**2
    total = float(own.sum())
    found: dict[str, tuple[float, Places]] = {}
    if total <= 0.0:
        return found
    cells = np.maximum(np.ceil(np.asarray(size_m)), 1).astype(np.intp)
    cell = np.clip((population.position_m[:, :2] / size_m * cells).astype(np.intp), 0, cells - 1)
    maps = []
    for index in range(len(population.species_names)):
        rows = population.species == index
        grid = np.zeros(cells)
        np.add.at(grid, tuple(cell[rows].T), own[rows])
        maps.append(gaussian_filter(grid, _REACH_M / np.asarray(size_m) * cells, mode="wrap"))
    every = np.maximum(np.sum(maps, axis=0), 1e-9 * total / float(np.prod(cells)))
    for name, grid in zip(population.species_names, maps, strict=True):
        relative = grid / every
        mean = float(relative.mean())
        if mean > 0.0:
            found[name] = mean, _looked_up(relative / mean, size_m)
    return found


def _looked_up(grid: Floats, size_m: tuple[float, float]) -> Places:
    def at(x_m: Floats, y_m: Floats) -> Floats:
        rows, cols = grid.shape
        row = np.floor(np.mod(x_m / size_m[0], 1.0) * rows).astype(np.intp)
        col = np.floor(np.mod(y_m / size_m[1], 1.0) * cols).astype(np.intp)
        return np.asarray(grid[np.minimum(row, rows - 1), np.minimum(col, cols - 1)])

    return at


def _slopes(height: Places, middle: Floats) -> Floats:
    """(K, 3) rise east and north over a tile, and height at its middle."""
    half, (x, y) = 0.5 * TILE_M, middle.T
    east = (height(x + half, y) - height(x - half, y)) / TILE_M
    north = (height(x, y + half) - height(x, y - half)) / TILE_M
    return np.stack([east, north, height(x, y)], axis=1)
