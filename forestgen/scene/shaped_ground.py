"""Ground that is shaped in the small: mounds and hollows, then paths, then ponds and streams (recipe/land.py).

Micro-relief
------------
Waves at random of a standard deviation `rms_m` and lengths between `longest_m` and a quarter of it, the long ones
higher as on `rolling` ground. Where fallen trees left pits and mounds, these differ by 0.5 to 2 m in height (USDA,
Glossary of landform and geologic terms, "tree-tip pit and mound topography"), so their standard deviation is 0.15 m and
more. The default, of ground without them, is ours.

Paths
-----
A path is level across, at its middle's height, and hollow by 4 cm. A forest road has two ruts 8 cm deep and 1.8 m
apart, as far as a car's wheels, a middle strip 3 cm higher, and a verge 1.6 m wide on either side, which the light of
the gap lets grow; its shoulders meet the ground beside it within 2 m. Strip and verge are painted as grass. Depths vary
along them by a third. What is bare is rough by 4 mm, and its borders are ragged. Numbers are ours. Blades of grass are
a layer of the recipe's, `on: roadside`, and loose stones one `on: path`.

Nothing of the community stands on a path and a quarter metre beside it, on a road and 1.5 m beside it, or in water.
Layers of the ground lie on what paths leave of it, and not in water; those `on: shore` stand in water that is less than
0.4 m deep and up to 0.8 m beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats
from forestgen.recipe import land
from forestgen.scene.courses import STEP_M, Course
from forestgen.scene.terrain import MARGIN_M, SITE_CELL_M, HeightField, smooth_step
from forestgen.scene.water import Body, pond, stream

_RELIEF_CELLS, _RELIEF_WAVES = 12.0, 48  # cells along the longest wave, three along the shortest
_SMOOTHED_M = 6.0  # of a path, over which its height is even
_RUT_APART_M, _RUT_WIDE_M, _RUT_M, _CROWN_M, _HOLLOW_M = 1.8, 0.22, 0.08, 0.03, 0.04
_STRIP_M, _VERGE_M, _GRASS = 0.4, 1.6, 0.85  # half the width of the strip; width of the verge; share that is grass
_SOFT_M, _RAGGED_M, _ROUGH_M = 0.1, 0.13, 0.004  # width of a path's border, how far it strays; height of roughness
_OCTAVES = 3  # of borders and roughness, of waves from 1.2 m down to 0.3 m
_SHOULDER_M, _FREE_M = {"path": 0.5, "forest_road": 2.0}, {"path": 0.25, "forest_road": 1.5}
_BLEND_M = 0.1  # heights over which the ground bends into a bank
_WET_M = 0.3  # from the shore, where nothing stands
_BARE_M = 0.8  # from the shore, where layers of the ground are as dense as elsewhere: what lay there floated off
SHALLOW_M, BESIDE_M = 0.4, 0.8  # depth of the water, and distance from it, where plants of the shore end
_MOUTH_M = 0.5  # from the shore, as far as water may stand
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Relief:
    """Waves of the ground."""

    wave_per_m: Floats  # (W, 2)
    amplitude_m: Floats  # (W,)
    phase: Floats  # (W,)
    longest_m: float

    @classmethod
    def of(cls, keys: land.MicroRelief, rng: np.random.Generator) -> Relief:
        length = keys.longest_m * 0.25 ** rng.random(_RELIEF_WAVES)
        angle = 2.0 * np.pi * rng.random(_RELIEF_WAVES)
        wave = 2.0 * np.pi / length * np.stack([np.cos(angle), np.sin(angle)])
        size = length * keys.rms_m * np.sqrt(2.0 / np.sum(length**2))
        return cls(wave.T, size, 2.0 * np.pi * rng.random(_RELIEF_WAVES), keys.longest_m)

    def at(self, x_m: Floats, y_m: Floats) -> Floats:
        """(N,) metres."""
        z = np.zeros(len(x_m))
        for (kx, ky), size, phase in zip(self.wave_per_m, self.amplitude_m, self.phase, strict=True):
            z += size * np.sin(kx * x_m + ky * y_m + phase)
        return z


@dataclass(frozen=True, eq=False)
class Track:
    """A path or forest road."""

    keys: land.Path
    course: Course
    height_m: Floats  # (K,) of its middle

    @property
    def half_m(self) -> float:
        return 0.5 * self.keys.wide_m

    def on(self, z_m: Floats, x_m: Floats, y_m: Floats) -> Floats:
        """(N,) height of the ground with it, of that without it."""
        shoulder = _SHOULDER_M[self.keys.what]
        rows, distance, where = self.course.nearest(x_m, y_m, self.half_m + shoulder)
        share = 1.0 - smooth_step((distance - self.half_m) / shoulder)
        across = np.maximum(1.0 - (distance / self.half_m) ** 2, 0.0)
        depth = np.clip(1.0 + 0.33 * self.course.between(self.course.uneven, where), 0.2, 2.0)
        if self.keys.what == "forest_road":
            rut = np.exp(-(((distance - 0.5 * _RUT_APART_M) / _RUT_WIDE_M) ** 2))
            relief = _CROWN_M * across - _RUT_M * depth * rut
        else:
            relief = -_HOLLOW_M * depth * across
        relief += _ROUGH_M * np.minimum(4.0 * across, 1.0) * ragged(x_m[rows], y_m[rows])
        z = z_m.copy()
        z[rows] += share * (self.course.between(self.height_m, where) - z_m[rows]) + relief
        return z

    def shares(self, x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
        """(N,) shares of the ground that are the path's, and of grass in the middle of a road and beside it."""
        whole, green = np.zeros((2, len(x_m)))
        is_road = self.keys.what == "forest_road"
        away_m = self.half_m + _SOFT_M + 3.0 * _RAGGED_M + (_VERGE_M if is_road else 0.0)
        rows, distance, where = self.course.nearest(x_m, y_m, away_m)
        strays = _RAGGED_M * (0.5 * self.course.between(self.course.uneven, where) + ragged(x_m[rows], y_m[rows]))
        whole[rows] = smooth_step((self.half_m - distance + strays) / _SOFT_M + 0.5)
        if is_road:
            strip = smooth_step((_STRIP_M - distance + strays) / _SOFT_M + 0.5)
            beyond = (distance - strays - self.half_m) / _VERGE_M
            verge = smooth_step(beyond * _VERGE_M / _SOFT_M + 0.5) * (1.0 - smooth_step(2.0 * beyond - 1.0))
            green[rows] = _GRASS * np.maximum(strip, verge)
        return whole, green

    def within(self, x_m: Floats, y_m: Floats, away_m: float) -> Bools:
        """(N,) whether points are on it or so near."""
        found = np.zeros(len(x_m), dtype=np.bool_)
        found[self.course.nearest(x_m, y_m, self.half_m + away_m)[0]] = True
        return found


@dataclass(frozen=True, eq=False)
class ShapedGround(HeightField):
    """Another ground with micro-relief, paths and water."""

    base: HeightField
    relief: Relief | None
    tracks: tuple[Track, ...] = ()
    bodies: tuple[Body, ...] = ()

    @property
    def cell_m(self) -> float:
        return SITE_CELL_M if self.relief is None else self.relief.longest_m / _RELIEF_CELLS

    @property
    def coarsest_m(self) -> tuple[float, float]:
        return self.base.coarsest_m

    @property
    def fine_m2(self) -> float:
        area = sum(len(one.course.places_m) * STEP_M * (one.keys.wide_m + 2.0 * _VERGE_M) for one in self.tracks)
        for body in self.bodies:
            keys = body.keys
            if isinstance(keys, land.Pond):
                area += 2.0 * np.pi * keys.radius_m * 4.0
            else:
                length_m = float(np.linalg.norm(np.diff(keys.points_m, axis=0), axis=1).sum())
                area += length_m * (keys.width_m + 4.0)
        return float(area)

    def _height(self, x_m: Floats, y_m: Floats) -> Floats:
        z = self.base._height(x_m, y_m)
        if self.relief is not None:
            away = self.distance_m(x_m, y_m)
            z = z + (1.0 - smooth_step(away / MARGIN_M)) * self.relief.at(x_m, y_m)
        for track in self.tracks:
            z = track.on(z, x_m, y_m)
        for body in self.bodies:
            near = body.near(x_m, y_m)
            z[near.rows] = _lower(z[near.rows], near.bed_m)
        return z

    def level(self, x_m: Floats, y_m: Floats) -> Floats:
        level = np.full(len(x_m), -np.inf)
        shore = np.full(len(x_m), np.inf)
        for body in self.bodies:
            near = body.near(x_m, y_m)
            closer = near.shore_m < np.minimum(shore[near.rows], _MOUTH_M)
            level[near.rows[closer]], shore[near.rows[closer]] = near.level_m[closer], near.shore_m[closer]
        return level

    def surface(self, x_m: Floats, y_m: Floats) -> Floats:
        return np.maximum(self(x_m, y_m), self.level(x_m, y_m))

    def barred(self, x_m: Floats, y_m: Floats) -> Bools:
        found = np.zeros(len(x_m), dtype=np.bool_)
        for track in self.tracks:
            found |= track.within(x_m, y_m, _FREE_M[track.keys.what])
        return found | self._shore_within(x_m, y_m, _WET_M)

    def open_share(self, x_m: Floats, y_m: Floats) -> Floats:
        bare, green = self.bare_and_green(x_m, y_m)
        share = (1.0 - bare) * (1.0 - green)
        for body in self.bodies:
            near = body.near(x_m, y_m)
            share[near.rows] *= smooth_step(near.shore_m / _BARE_M)
        return share

    def roadside(self, x_m: Floats, y_m: Floats) -> Floats:
        green = self.bare_and_green(x_m, y_m)[1] / _GRASS
        return np.where(self._shore_within(x_m, y_m, 0.0), 0.0, green)

    def trodden(self, x_m: Floats, y_m: Floats) -> Floats:
        bare = self.bare_and_green(x_m, y_m)[0]
        return np.where(self._shore_within(x_m, y_m, 0.0), 0.0, bare)

    def bare_and_green(self, x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
        """(N,) shares of the ground that are bare on paths, and that are roads' strips and verges, on no other path."""
        found = [track.shares(x_m, y_m) for track in self.tracks]
        bare, own = [whole * (1.0 - green) for whole, green in found], [green for _, green in found]
        none = np.zeros(len(x_m))
        for index, green in enumerate(own):
            for other in bare[:index] + bare[index + 1 :]:
                green *= 1.0 - other
        return np.max([none, *bare], axis=0), np.max([none, *own], axis=0)

    def shore(self, x_m: Floats, y_m: Floats) -> Floats:
        beside = np.full(len(x_m), np.inf)
        for body in self.bodies:
            near = body.near(x_m, y_m)
            beside[near.rows] = np.minimum(beside[near.rows], near.shore_m / BESIDE_M)
        some = np.flatnonzero(beside < 1.0)
        deep = (self.level(x_m[some], y_m[some]) - self(x_m[some], y_m[some])) / SHALLOW_M
        share = np.zeros(len(x_m))
        share[some] = np.clip(2.0 - 2.0 * np.maximum(deep, np.maximum(beside[some], 0.0)), 0.0, 1.0)
        return share

    def fine(self, x_m: Floats, y_m: Floats, cell_m: Floats) -> Bools:
        found = np.zeros(len(x_m), dtype=np.bool_)
        for track in self.tracks:
            reach_m = track.half_m + (_VERGE_M if track.keys.what == "forest_road" else 0.6)
            rows, apart, _ = track.course.nearest(x_m, y_m, reach_m + float(cell_m.max()))
            found[rows] |= apart < reach_m + cell_m[rows]
        for body in self.bodies:
            near = body.near(x_m, y_m)
            cell = cell_m[near.rows]
            inner_m = np.inf if isinstance(body.keys, land.Stream) else 1.5
            found[near.rows] |= (near.shore_m < 0.6 + cell) & (near.shore_m > -inner_m - cell)
        return found

    def _shore_within(self, x_m: Floats, y_m: Floats, away_m: float) -> Bools:
        found = np.zeros(len(x_m), dtype=np.bool_)
        for body in self.bodies:
            near = body.near(x_m, y_m)
            found[near.rows[near.shore_m < away_m]] = True
        return found


def ragged(x_m: Floats, y_m: Floats) -> Floats:
    """(N,) about of mean 0 and variance 1, alike in all directions."""
    height = np.zeros(len(x_m))
    for octave in range(_OCTAVES):
        k, turn = 5.1 * 1.9**octave, 2.4 * octave
        cos, sin = k * np.cos(turn), k * np.sin(turn)
        height += 0.7**octave * np.sin(cos * x_m + sin * y_m + turn) * np.sin(cos * y_m - sin * x_m - 2.0 * turn)
    return 1.5 * height


def _lower(ground_m: Floats, bed_m: Floats) -> Floats:
    """(N,) the lower of both, without an edge between them."""
    near = np.maximum(_BLEND_M - np.abs(ground_m - bed_m), 0.0) / _BLEND_M
    return np.asarray(np.minimum(ground_m, bed_m) - 0.25 * _BLEND_M * near**2)


def shaped(
    base: HeightField, relief: land.MicroRelief | None, paths: land.Paths, water: land.Waters, seed: int
) -> ShapedGround:
    """A ground with what its site's recipe adds.

    Raises `RecipeError`: a stream that would run uphill, by its number.
    """
    rngs = child_rng(seed, "terrain", "land").spawn(3)
    tracks = [_track(keys, base, rng) for keys, rng in zip(paths, rngs[1].spawn(len(paths)), strict=True)]
    waves = None if relief is None else Relief.of(relief, rngs[0])
    ground = ShapedGround(base.size_m, base, waves, tuple(tracks))
    parts = zip(water, rngs[2].spawn(len(water)), strict=True)
    for keys, rng in sorted(parts, key=lambda part: isinstance(part[0], land.Stream)):  # streams run into ponds
        made: Body
        if isinstance(keys, land.Pond):
            made = pond(keys, ground.surface, rng)
        else:
            try:
                made = stream(keys, ground.surface, ground.level, rng)
            except RecipeError as cause:
                raise cause.at(str(len(ground.bodies))) from cause
        ground = replace(ground, bodies=(*ground.bodies, made))
    return ground


def _track(keys: land.Path, base: HeightField, rng: np.random.Generator) -> Track:
    from scipy.ndimage import uniform_filter1d

    course = Course.through(keys.points_m, rng)
    height = uniform_filter1d(base(*course.places_m.T), max(1, int(_SMOOTHED_M / STEP_M)), mode="nearest")
    return Track(keys, course, np.asarray(height))
