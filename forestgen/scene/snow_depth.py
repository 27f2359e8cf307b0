"""How deep snow lies: less below crowns, in wells around stems, in drifts, and over what it hides.

Crowns. Under a spruce lay 34% of the snow beside it (Hardy and Albert 1995). Here crowns keep a share `_MOST_KEPT`
(1 - exp(-L / 2)) of it, L being the leaf area over a place, whose crowns are parabolas: about that much below the
middle of one spruce, and nothing below bare trees. Large spruces so stand in bowls (Sturm 1992). Mean depths over the
site are the recipe's: what lies in the open lies there instead of under crowns, and what crowns carry comes on top. But
no open place has more than `_MOST_OPEN` of the mean, drifts and mounds left out: in dense stands more is below crowns.

Wells. Around a stem it is 0.55 less deep at the bark, and by e less so a `_WELL_M` away: as far as wind and warmth of
stems work. Thin stems have shallow ones. Mounds stand over low plants and stumps. Drifts are waves. The numbers of
wells, mounds and drifts are ours, and so are those of bark around stems and of where the mesh is fine.

References
----------
Hardy, J. P., Albert, M. R. (1995): Snow-induced thermal variations around a single conifer tree. Hydrological
Processes 9, 923-933.
Sturm, M. (1992): Snow distribution and heat flow in the taiga. Arctic and Alpine Research 24, 145-152.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats
from forestgen.scene.far_mesh import SPECIES
from forestgen.scene.ground_layers.layer import GROUND
from forestgen.scene.spec import SceneSpec
from forestgen.scene.terrain import FINE_M, SITE_CELL_M, HeightField

_MOST_KEPT = 0.7  # by dense crowns
_MOST_OPEN = 1.0 / 0.6  # depth in the open over the mean
# Of the map of crowns: cells, how far from the site it goes, and the last of it, where it fades into its border's mean.
_CELL_M, _BEYOND_M, _FADE_M = 0.25, 20.0, 8.0
_MOST_POINTS, _AT_ONCE, _ROUNDS = 200_000, 50_000, 12  # of the site, for the mean; and towards it
_WELL, _WELL_M, _THIN_M = 0.55, 0.25, 0.06  # depth, width, and the radius of stems with the whole depth
_BARK_M = 0.6  # around stems, where bark and twigs lie
_LOW_M, _MOUND, _MOUND_M = 1.0, 0.6, 0.3  # height of what has a mound, the mound's over it, and its least radius
_DRIFT = 0.25  # of the depth: standard deviation
_WAVES, _WAVE_M = 32, (1.0, 12.0)  # of drifts
_NEAREST = 3  # stems or mounds that count at a place
# From cameras: how far the whole mesh is fine, and how far it is around stems; cells that are cut at most.
_CLOSE_M, _STEMS_M, MOST_FINE = 9.0, 35.0, 2500
FINE_TRIANGLES = 2 * MOST_FINE * round(SITE_CELL_M / FINE_M) ** 2
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Circles:
    """Middles (N, 2) and radii (N,) of what stands on the ground, metres."""

    place_m: Floats
    radius_m: Floats

    def shares(self, place_m: Floats, width_m: Floats, height: Floats, power: float) -> Floats:
        """(K, _NEAREST) of the nearest ones: `height` (N,) h at their edge, h exp(-(d / `width_m`)^power) beside it."""
        from scipy.spatial import cKDTree  # late: half a second

        if not len(self.radius_m):
            return np.zeros((len(place_m), 1))
        reach_m = float((self.radius_m + 4.0 / power * width_m).max())
        apart, row = cKDTree(self.place_m).query(place_m, k=_NEAREST, distance_upper_bound=reach_m)
        found = np.isfinite(apart)
        row = np.where(found, row, 0)
        beyond = np.maximum(np.where(found, apart, np.inf) - self.radius_m[row], 0.0) / width_m[row]
        return np.asarray(height[row] * np.exp(-(np.minimum(beyond, 30.0) ** power)))


@dataclass(frozen=True)
class SnowDepth:
    """Depth of snow by place."""

    depth_m: float  # mean over the site
    kept: Floats  # (rows, columns) share that crowns keep, of cells of `_CELL_M`, from -_BEYOND_M on
    stems: Circles
    low: Circles  # low plants and stumps
    low_m: Floats  # their heights
    waves: Waves
    scale: float = 1.0  # of the depth between stems and crowns over the mean, where it is not too deep

    @classmethod
    def of(
        cls, depth_m: float, spec: SceneSpec, stems: Circles, size_m: tuple[float, float], rng: np.random.Generator
    ) -> SnowDepth:
        """Of a scene's plants. `stems`: standing ones."""
        leaf, low, low_m = _plants(spec)
        first = cls(depth_m, _faded(_kept_by(leaf, size_m)), stems, low, low_m, Waves.of(rng))
        return replace(first, scale=first._scale(size_m))

    def _scale(self, size_m: tuple[float, float]) -> float:
        """With which the mean is 1 over a grid of at most about `_MOST_POINTS` points of the site."""
        step_m = max(_CELL_M, float(np.sqrt(size_m[0] * size_m[1] / _MOST_POINTS)))
        sides = [(np.arange(n) + 0.5) * side / n for side in size_m for n in [max(int(side / step_m), 1)]]
        places = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        parts = [places[k : k + _AT_ONCE] for k in range(0, len(places), _AT_ONCE)]
        crowns = np.concatenate([self._between_crowns(part) for part in parts])
        stems = np.concatenate([self._between_stems(part) for part in parts])
        scale = 1.0
        for _ in range(_ROUNDS):
            scale /= float(np.mean(np.minimum(scale * crowns, _MOST_OPEN) * stems))
        return scale

    def below_crowns(self, place_m: Floats) -> Floats:
        """(K,) share of the snow that crowns keep, over the most."""
        from scipy.ndimage import map_coordinates

        at = (place_m[:, ::-1].T + _BEYOND_M) / _CELL_M - 0.5
        return np.asarray(map_coordinates(self.kept, at, order=1, mode="constant", cval=self.kept[0, 0])) / _MOST_KEPT

    def wells(self, place_m: Floats, width_m: float = _WELL_M) -> Floats:
        """(K, _NEAREST) how far places lie in wells of such a width, 1 at the bark of stems that are not thin."""
        width = np.full(len(self.stems.radius_m), width_m)
        return self.stems.shares(place_m, width, np.clip(self.stems.radius_m / _THIN_M, 0.0, 1.0), 1.0)

    def littered(self, place_m: Floats) -> Floats:
        """(K,) how much fell from above, 1 below dense crowns and beside stems."""
        return np.asarray(np.maximum(self.below_crowns(place_m), self.wells(place_m, _BARK_M).max(axis=1)))

    def share(self, place_m: Floats) -> Floats:
        """(K,) depth at places over that in the open, without drifts and mounds."""
        return self._between_stems(place_m) * self._between_crowns(place_m)

    def _between_stems(self, place_m: Floats) -> Floats:
        return np.asarray(np.prod(1.0 - _WELL * self.wells(place_m), axis=1))

    def _between_crowns(self, place_m: Floats) -> Floats:
        return 1.0 - _MOST_KEPT * self.below_crowns(place_m)

    def at(self, place_m: Floats) -> Floats:
        """(K,) metres."""
        crowns = np.minimum(self.scale * self._between_crowns(place_m), _MOST_OPEN)
        deep = self.depth_m * crowns * self._between_stems(place_m) + drifts(place_m, self.depth_m, self.waves)
        most = 1.5 * self.depth_m  # higher ones stick out
        width_m = np.maximum(0.7 * self.low.radius_m, _MOUND_M)
        middles = Circles(self.low.place_m, np.zeros(len(width_m)))
        mounds = middles.shares(place_m, width_m, np.minimum(_MOUND * self.low_m, most), 2.0)
        return np.asarray(np.maximum(deep + mounds.max(axis=1), 0.0))


@dataclass(frozen=True, eq=False)
class FinerGround(HeightField):
    """Another ground whose mesh is fine before cameras and around the stems that they see from near."""

    base: HeightField
    stems: Circles
    eyes_m: Floats  # (C, 3) of cameras

    @property
    def cell_m(self) -> float:
        return self.base.cell_m

    @property
    def coarsest_m(self) -> tuple[float, float]:
        return self.base.coarsest_m

    @property
    def fine_m2(self) -> float:
        """Above 0, so that the mesh asks for fine cells; estimates count them apart, by `FINE_TRIANGLES`."""
        return self.base.fine_m2 + 1.0

    def _height(self, x_m: Floats, y_m: Floats) -> Floats:
        return self.base._height(x_m, y_m)

    def fine(self, x_m: Floats, y_m: Floats, cell_m: Floats) -> Bools:
        from scipy.spatial import cKDTree

        places = np.column_stack([x_m, y_m])
        apart, _ = cKDTree(self.eyes_m).query(np.column_stack([places, self.base(x_m, y_m)]))
        wanted = apart < _CLOSE_M
        if len(self.stems.radius_m):
            from_stem, _ = cKDTree(self.stems.place_m).query(places)
            wanted |= (apart < _STEMS_M) & (from_stem < 2.0 * _WELL_M + cell_m)
        apart = np.where(wanted, apart, np.inf)
        farthest = np.partition(apart, MOST_FINE)[MOST_FINE] if len(apart) > MOST_FINE else np.inf
        return self.base.fine(x_m, y_m, cell_m) | (wanted & (apart < farthest))


@dataclass(frozen=True)
class Waves:
    """Of drifts."""

    wave_per_m: Floats  # (2, W)
    phase: Floats  # (W,)

    @classmethod
    def of(cls, rng: np.random.Generator) -> Waves:
        shortest, longest = np.log(_WAVE_M)
        length, turn = np.exp(rng.uniform(shortest, longest, _WAVES)), rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
        return cls(2.0 * np.pi / length * np.stack([np.cos(turn[0]), np.sin(turn[0])]), turn[1])


def drifts(place_m: Floats, depth_m: float, waves: Waves) -> Floats:
    """(K,) by how much snow is deeper at places (K, 2) than its mean, metres."""
    size_m = depth_m * _DRIFT * np.sqrt(2.0 / _WAVES)
    return np.asarray(size_m * np.sin(place_m @ waves.wave_per_m + waves.phase).sum(axis=1))


@dataclass(frozen=True)
class _Leaves:
    crowns: Circles
    area_m2: Floats  # (N,)


def _plants(spec: SceneSpec) -> tuple[_Leaves, Circles, Floats]:
    """Crowns with leaves; and low plants, with their heights."""
    exemplars, instances = spec.exemplars, spec.instances
    plant = np.array([one.species not in (SPECIES, GROUND) for one in exemplars], dtype=bool)
    rows = np.flatnonzero(plant[instances.exemplar])
    which, linear = instances.exemplar[rows], instances.transform[rows, :, :3]
    place, across = instances.transform[rows, :2, 3], np.linalg.norm(linear[:, :, 0], axis=1)
    sizes = [(0.5 * one.crown_width_m, one.height_m, one.leaf_area_m2, one.lying_m3) for one in exemplars]
    wide, tall, leaf, lies = np.array(sizes, dtype=np.float64).reshape(-1, 4)[which].T
    radius, height = wide * across, tall * np.linalg.norm(linear[:, :, 2], axis=1)
    leafy = (leaf > 0) & (height > _LOW_M)
    low = (height <= _LOW_M) & (lies == 0)
    crowns = _Leaves(Circles(place[leafy], radius[leafy]), (leaf * across**2)[leafy])
    return crowns, Circles(place[low], radius[low]), height[low]


def _kept_by(leaves: _Leaves, size_m: tuple[float, float]) -> Floats:
    """(rows, columns) share of the snow that crowns keep."""
    columns, rows = (int(np.ceil((side + 2.0 * _BEYOND_M) / _CELL_M)) for side in size_m)
    index = np.zeros((rows, columns))
    for (x, y), radius, area in zip(leaves.crowns.place_m, leaves.crowns.radius_m, leaves.area_m2, strict=True):
        radius = max(float(radius), _CELL_M)
        low = [max(int((at - radius + _BEYOND_M) / _CELL_M), 0) for at in (x, y)]
        high = [int((at + radius + _BEYOND_M) / _CELL_M) + 1 for at in (x, y)]
        part = index[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
        east = (low[0] + np.arange(part.shape[1]) + 0.5) * _CELL_M - _BEYOND_M - x
        north = (low[1] + np.arange(part.shape[0]) + 0.5) * _CELL_M - _BEYOND_M - y
        near = 1.0 - (east**2 + north[:, None] ** 2) / radius**2
        part += 2.0 * area / (np.pi * radius**2) * np.maximum(near, 0.0)
    return _MOST_KEPT * (1.0 - np.exp(-0.5 * index))


def _faded(kept: Floats) -> Floats:
    """A map of crowns that ends in one number, its border's mean."""
    border = np.concatenate([kept[0], kept[-1], kept[:, 0], kept[:, -1]]).mean()
    row, column = (np.minimum(np.arange(n), np.arange(n)[::-1]) * _CELL_M / _FADE_M for n in kept.shape)
    return np.asarray(border + np.clip(np.minimum(row[:, None], column), 0.0, 1.0) * (kept - border))
