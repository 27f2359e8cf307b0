"""What lies and grows on the ground, as geometry: tiles of a metre, near the cameras, in place of paint.

A layer's things (`site.ground.layers`; scene/ground_layers) are laid at random on a few tiles, of several densities. A
tile is one mesh, instanced where the layer's cover asks for its density, turned by right angles and sheared to the
ground. N things a square metre, each hiding a area a of it, hide 1 - exp(-N a) together: so a tile has Poisson's number
of things for its cover. The cover itself is uneven by a field of random waves (`patch_m`), and by where a layer grows.

Tiles are drawn where a thing of the layer is as long as `LEAST_PX` pixels of the camera that sees it best, in or near
some camera's view, up to `MOST_TILES` and `FAR_M`. Elsewhere the ground is painted, with the mean reflectance of the
ground and the layers on it: so both look alike where one gives way to the other.

Reference
---------
Cook, R. L., Halstead, J., Planck, M., Ryu, D. (2007). Stochastic simplification of aggregate detail. ACM Transactions
on Graphics 26(3), article 79.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.parts import Part
from forestgen.core.randomness import SPLIT_MIX_STEP, child_rng, child_root, mixed
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Floats, concatenate, instance
from forestgen.plants.bark.texture import with_mean
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.registries import GROUND_LAYERS
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.ground_layers.layer import GroundLayerKind, Layer, Places, Request, Thing
from forestgen.scene.plan import Plan
from forestgen.scene.projection import project, projection_of
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Terrain
from forestgen.scene.surfaces import wet_spectrum
from forestgen.scene.terrain import HeightField

GROUND = "(ground)"  # species of the tiles: no species' name has brackets
TILE_M = 1.0
COVERS = (0.06, 0.2, 0.4, 0.6, 0.8, 0.92, 0.98)  # of the tiles that are made
VARIANTS = 5
LEAST_PX = 1.0
MOST_TILES = 24_000
FAR_M = 120.0
_NEAR_M = 3.0  # around a camera, tiles are drawn behind it, too: their light and shadow may be in view
_MOST_THINGS = 6000  # on a tile
_WAVES = 24  # of a field of patches
_REACH_M = 2.5  # standard deviation of where leaves fall
_SPREAD = 0.35  # of the logistic curve that makes patches of waves

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class GroundCover:
    """Tiles on the ground."""

    exemplars: tuple[Exemplar, ...]
    materials: Mapping[tuple[str, str], Material]
    exemplar: NDArray[np.uint32]  # (K,) of each tile, among `exemplars`
    transform: Floats  # (K, 3, 4)
    layers: tuple[Layer, ...]
    things: int = 0  # on all tiles

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
            terrain=painted(spec.terrain, self.layers),
        )


def ground_cover(plan: Plan, population: Population, cameras: Sequence[Camera]) -> GroundCover:
    """The layers of a recipe's ground; `population`: of the site, its feet on the ground."""
    sections, height = plan.drawn.recipe.site.ground.layers, plan.views.height
    best_m = _best_pixel_m(cameras, height)
    shares = leaf_shares(population, height.size_m)
    layers: list[Layer] = []
    for index, keys in enumerate(sections):
        kind: GroundLayerKind[object] = GROUND_LAYERS.load(keys.what)  # type: ignore[type-var]
        request = Request(plan.drawn, plan.plants.generators, shares, best_m, ("site", "ground", "layers", index))
        rng = child_rng(plan.drawn.image_seed, "ground", index)
        layers += [replace(one, name=f"{index}/{one.name}") for one in kind.layers(keys, request, rng)]
    return _laid(layers, cameras, height, plan.drawn.image_seed)


def _laid(layers: Sequence[Layer], cameras: Sequence[Camera], height: HeightField, seed: int) -> GroundCover:
    exemplars: list[Exemplar] = []
    which, places, things = [], [], 0
    seen = [_seen_tiles(cameras, height, max(one.length_m for one in layer.things)) for layer in layers]
    most = _fitting(seen)
    for layer, (at, apart) in zip(layers, seen, strict=True):
        at = at[apart <= most]
        middle = np.asarray((at + 0.5) * TILE_M, dtype=np.float64)
        chosen, turn = _chosen(layer, middle, at, seed)
        kept = chosen >= 0
        used, index = np.unique(chosen[kept], return_inverse=True)
        made = [_tile(layer, int(one), seed) for one in used]
        which.append(index + len(exemplars))
        places.append(_sheared(height, middle[kept], turn[kept]))
        exemplars += [tile for tile, _ in made]
        things += int(np.array([count for _, count in made], dtype=np.int64)[index].sum()) if len(made) else 0
    materials = {(GROUND, key): one for layer in layers for key, one in layer.materials.items()}
    return GroundCover(
        tuple(exemplars),
        materials,
        np.concatenate([np.zeros(0, np.intp), *which]).astype(np.uint32),
        np.concatenate([np.zeros((0, 3, 4)), *places]),
        tuple(layers),
        things,
    )


# ---------------------------------------------------------------------------------------------------------- what lies


def _tile(layer: Layer, index: int, seed: int) -> tuple[Exemplar, int]:
    """One tile with the things of a layer, its middle in the origin, and their number; `index`: cover and variant."""
    cover, rng = COVERS[index // VARIANTS], child_rng(seed, "tile", layer.name, index)
    share = np.array([one.share for one in layer.things])
    share = share / share.sum()
    growth = np.exp(2.0 * layer.spread.size_sigma**2)  # mean square of sizes of median 1
    hidden = float(share @ np.array([one.hidden_m2 for one in layer.things])) * growth
    count = min(int(rng.poisson(-np.log(1.0 - cover) / hidden * TILE_M**2)), _MOST_THINGS)
    kind = rng.choice(len(share), count, p=share)
    frames = _frames(layer, count, rng)
    meshes: dict[tuple[Part, str], list[OrganMesh]] = {}
    for number, thing in enumerate(layer.things):
        mine = frames[kind == number]
        if not len(mine):
            continue
        mine = _sunk(mine, thing, layer.spread.sunk)
        for organ in thing.organs:
            laid = replace(organ, mesh=instance(organ.mesh, mine.astype(np.float32)))
            meshes.setdefault((organ.part, organ.material), []).append(laid)
    organs = tuple(
        OrganMesh(part, material, replace(concatenate([one.mesh for one in group]), uv=None))
        for (part, material), group in meshes.items()
    )
    if not organs:  # a tile needs a surface
        first = layer.things[0].organs[0]
        buried = instance(first.mesh, np.hstack([0.01 * np.eye(3), [[0.0], [0.0], [-1.0]]])[None].astype(np.float32))
        organs = (OrganMesh(first.part, first.material, replace(buried, uv=None)),)
    top_m = max(float(one.mesh.vertices_m[:, 2].max()) for one in organs)
    return Exemplar(GROUND, organs, 0.5 * TILE_M, max(top_m, 1e-3), TILE_M, 0.0, 0.0), count


def _frames(layer: Layer, count: int, rng: np.random.Generator) -> Floats:
    """(N, 3, 4) of things anywhere on a tile, turned, leaning, of random sizes, lying on each other."""
    spread = layer.spread
    turn, way = rng.random((2, count)) * 2.0 * np.pi
    lean = np.abs(rng.normal(0.0, np.radians(spread.tilt_deg), count))
    size = np.exp(rng.normal(0.0, spread.size_sigma, count))
    cos, sin, zero, one = np.cos(turn), np.sin(turn), np.zeros(count), np.ones(count)
    turned = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)
    x, y, c, s = np.cos(way), np.sin(way), np.cos(lean), np.sin(lean)  # lean about the level axis (x, y)
    leant = np.array(
        [
            [c + x * x * (1 - c), x * y * (1 - c), y * s],
            [x * y * (1 - c), c + y * y * (1 - c), -x * s],
            [-y * s, x * s, c],
        ]
    ).transpose(2, 0, 1)
    frames = np.zeros((count, 3, 4))
    frames[:, :, :3] = size[:, None, None] * leant @ turned
    frames[:, :2, 3] = (rng.random((count, 2)) - 0.5) * TILE_M
    frames[:, 2, 3] = rng.random(count) * spread.depth_m
    return frames


def _sunk(frames: Floats, thing: Thing, share: float) -> Floats:
    """The frames lowered by a share of the thing's height."""
    if share <= 0.0:
        return frames
    top_m = max(float(one.mesh.vertices_m[:, 2].max()) for one in thing.organs)
    lowered = frames.copy()
    lowered[:, 2, 3] -= share * top_m * frames[:, 2, 2]
    return lowered


# -------------------------------------------------------------------------------------------------------------- where


def _best_pixel_m(cameras: Sequence[Camera], height: HeightField) -> float:
    """The least that a pixel of any camera covers of the ground, metres."""
    best = np.inf
    for camera in cameras:
        x, y, z = camera.position_m
        above = max(z - float(height(np.array([x]), np.array([y]))[0]), 0.3)
        best = min(best, float(projection_of(camera).finest_pixel_m(camera, np.array([above]))[0]))
    return best


def _seen_tiles(cameras: Sequence[Camera], height: HeightField, length_m: float) -> tuple[Ints, Floats]:
    """(K, 2) columns and rows of the tiles where a thing of a length is seen, and (K,) metres to the nearest camera."""
    found, apart = [np.zeros((0, 2), np.intp)], [np.zeros(0)]
    for camera in cameras:
        at, away = _tiles_before(camera, height, length_m)
        found.append(at)
        apart.append(away)
    every, distance = np.concatenate(found), np.concatenate(apart)
    order = np.lexsort((distance, every[:, 1], every[:, 0]))
    every, distance = every[order], distance[order]
    first = np.ones(len(every), dtype=bool)
    first[1:] = (every[1:] != every[:-1]).any(axis=1)
    return every[first], distance[first]


def _tiles_before(camera: Camera, height: HeightField, length_m: float) -> tuple[Ints, Floats]:
    """The tiles that one camera sees."""
    projection, place = projection_of(camera), np.asarray(camera.position_m)
    reach_m = FAR_M
    if not projection.is_parallel:
        reach_m = min(FAR_M, length_m / LEAST_PX / float(projection.finest_pixel_m(camera, np.array([1.0]))[0]))
    elif float(projection.finest_pixel_m(camera, np.array([1.0]))[0]) * LEAST_PX > length_m:
        return np.zeros((0, 2), np.intp), np.zeros(0)
    half_m = reach_m if not projection.is_parallel else camera.width_m
    low, high = np.floor((place[:2] - half_m) / TILE_M), np.ceil((place[:2] + half_m) / TILE_M)
    columns, rows = np.arange(low[0], high[0]), np.arange(low[1], high[1])
    at = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.intp)
    middle = (at + 0.5) * TILE_M
    at = at[np.hypot(*(middle - place[:2]).T) < half_m]
    middle = (at + 0.5) * TILE_M
    points = np.column_stack([middle, height(*middle.T)])
    away = np.linalg.norm(points - place, axis=1) if not projection.is_parallel else np.zeros(len(points))
    image = project(camera, (points - place) @ camera.world_from_camera)
    pixel_m = np.maximum(projection.finest_pixel_m(camera, np.maximum(away, 1e-3)), 1e-9)
    margin = TILE_M / pixel_m
    width, tall = camera.size_px
    inside = (image.x_px > -margin) & (image.x_px < width + margin)
    inside &= (image.y_px > -margin) & (image.y_px < tall + margin)
    kept = (away < reach_m) & ((image.in_front & inside) | (away < _NEAR_M))
    return at[kept], away[kept]


def _fitting(seen: Sequence[tuple[Ints, Floats]]) -> float:
    """Distance within which at most `MOST_TILES` tiles lie."""
    every = np.sort(np.concatenate([np.zeros(0), *(apart for _, apart in seen)]))
    return float("inf") if len(every) <= MOST_TILES else float(every[MOST_TILES])


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
    if layer.patch_m is None:
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


def _sheared(height: HeightField, middle: Floats, turn: Ints) -> Floats:
    """(K, 3, 4) from the tiles' frame to the world: turned, upright things stay upright, feet follow the ground."""
    half = 0.5 * TILE_M
    x, y = middle.T
    east = (height(x + half, y) - height(x - half, y)) / TILE_M
    north = (height(x, y + half) - height(x, y - half)) / TILE_M
    cos, sin = np.array([1.0, 0.0, -1.0, 0.0])[turn], np.array([0.0, 1.0, 0.0, -1.0])[turn]
    transform = np.tile(np.eye(3, 4), (len(middle), 1, 1))
    transform[:, 0, 0], transform[:, 0, 1], transform[:, 1, 0], transform[:, 1, 1] = cos, -sin, sin, cos
    transform[:, 2, 0] = east * cos + north * sin
    transform[:, 2, 1] = -east * sin + north * cos
    transform[:, :2, 3], transform[:, 2, 3] = middle, height(x, y)
    return transform


# -------------------------------------------------------------------------------------------------------------- paint


def painted(terrain: Terrain, layers: Sequence[Layer]) -> Terrain:
    """The ground with the mean colour that it has under its layers, the first lowest."""
    spectrum = terrain.spectrum
    if spectrum is None or not layers:
        return terrain
    for layer in layers:
        grid = np.union1d(spectrum.wavelength_nm, layer.spectrum.wavelength_nm)
        below = spectrum.at(grid)
        spectrum = Spectrum(grid, below + layer.cover * (layer.spectrum.at(grid) - below))
    colour = colours_of_surface(spectrum, None)[0]
    wet = terrain.wet
    if wet is not None:
        film = wet_spectrum(spectrum)
        wet = replace(wet, reflectance=colours_of_surface(film, None)[0], spectrum=film)
    return replace(terrain, texture=with_mean(terrain.texture, colour), spectrum=spectrum, wet=wet)
