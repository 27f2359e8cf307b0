"""The studio: one plant alone on plain ground, under a fixed sun and sky, as a camera sees it.

The sun stands behind the photographer's left shoulder. Far out the ground takes on the colour of the sky above the
horizon, so that no edge is seen. Its grain, and how far it reaches before it pales, go by the plant's size: a daisy and
a spruce stand on ground of the same look.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from forestgen.core.arguments import listed, number_of, whole_of
from forestgen.core.errors import RecipeError
from forestgen.core.frames import look_at
from forestgen.core.progress import Progress, Timings
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Mesh, unit
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.schema import Recipe
from forestgen.render.identity import SceneTracer
from forestgen.render.rendering import render_frame
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Sky, Terrain

_SKY = Sky(sun_elevation_deg=45.0, sun_azimuth_deg=215.0, turbidity=3.0, ground_albedo=0.3)  # cameras look north
_NEAR_REFLECTANCE = np.array([0.140, 0.132, 0.098])
EXPOSURE = 5.4e-5  # of cd/m², the same for all plants: a dark spruce stays darker than a birch
_HORIZON_DEG, _HORIZON_WIDTH_DEG = 0.8, 50.0  # the sky above the northern horizon that the ground pales into
_GROUND_PX = 512
_GROUND_TILE = 2.0  # side of the ground's texture, in plant sizes
_PALES_FROM, _PALES_TO = 1.5, 40.0  # plant sizes
_HORIZON_M = 200_000.0
_RISE = 0.008  # slope of the pale ground: hides the half degree above the horizon, where the sky's colour turns
_RINGS, _SPOKES = 90, 64
_LENS_DEG = 34.0  # vertical
_WIDEST_DEG = 150.0  # horizontal
_FILL = 0.86  # share of the picture's height or width that a plant takes
_EYE_M = 1.7  # of a person
_STOOP = 0.3  # slope of the look at plants that are lower than that

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PictureSettings:
    """How a plant is photographed."""

    size_px: tuple[int, int] = (540, 720)  # width, height
    samples: int = 32  # light paths a pixel
    distance_m: float | None = None  # from the camera to the plant; None: as far as a normal lens asks for
    look_at_m: float | None = None  # height looked at through a normal lens; None: the whole plant
    window_m: float | None = None  # height of the window at that place, in place of a normal lens'

    def check(self) -> PictureSettings:
        """The same with Python's own numbers. Raises `RecipeError` for a picture or a view that is none."""
        sides = [whole_of(side, "size_px", 8, 8192) for side in listed(self.size_px, "size_px", "two numbers")]
        if len(sides) != 2:
            got = " ".join(map(str, sides))
            raise RecipeError("no such picture", parameter="size_px", expected="width and height, pixels", got=got)
        samples = whole_of(self.samples, "samples", 1, 65536)
        if self.distance_m is not None and not 1e-3 <= number_of(self.distance_m, "distance_m") <= 1e4:
            got = f"{self.distance_m:g}"
            raise RecipeError("no such distance", parameter="distance_m", expected="0.001 to 10000 m", got=got)
        if self.look_at_m is not None:
            number_of(self.look_at_m, "look_at_m")
        return replace(self, size_px=(sides[0], sides[1]), samples=samples)


def photograph(
    exemplar: Exemplar,
    materials: Mapping[tuple[str, str], Material],
    camera: Camera,
    recipe: Recipe,
    samples: int,
    seed: int,
    progress: Progress,
) -> NDArray[np.float32]:
    """(H, W, 3) linear Rec. 709 in cd/m², of a plant in the studio; `EXPOSURE` suits it."""
    recipe = recipe.model_copy(update={"render": recipe.render.model_copy(update={"samples": samples})})
    tracer = SceneTracer(studio(exemplar, materials, camera), Timings())
    frame = render_frame(tracer, camera, recipe, seed, progress, Timings())
    return frame.radiance.mean if frame.radiance.denoised is None else frame.radiance.denoised


def studio(exemplar: Exemplar, materials: Mapping[tuple[str, str], Material], camera: Camera) -> SceneSpec:
    """The plant alone on its ground."""
    return SceneSpec(
        exemplars=(exemplar,),
        materials=materials,
        instances=Instances(np.zeros(1, np.uint32), np.eye(4)[None, :3], np.ones(1, np.uint32)),
        terrain=ground(size_of_m(exemplar)),
        sky=_SKY,
        clouds=None,
        cameras=(camera,),
    )


def size_of_m(exemplar: Exemplar) -> float:
    """The larger of a plant's height and width, metres."""
    low, high = exemplar.bounds_m()
    return max(float(high[2]), float((high - low)[:2].max()), 1e-3)


def camera_of(exemplar: Exemplar, settings: PictureSettings) -> Camera:
    """A camera south of the plant that looks north at it.

    It stands so that the whole plant fills the picture; at `distance_m`, if given, from the stem's axis, at most as
    high as a person's eye, with the lens that this takes. With `look_at_m` a normal lens looks at that height from
    `distance_m`, counted from the nearest leaf or bark there.

    Raises `RecipeError`: `look_at_m` is above the plant; `distance_m` is so small that no lens holds the plant.
    """
    if settings.look_at_m is not None or settings.window_m is not None:
        return _close(exemplar, settings)
    low, high = exemplar.bounds_m()
    aspect = settings.size_px[0] / settings.size_px[1]
    width, height = float((high - low)[0]), float(high[2])
    if settings.distance_m is None:
        distance = max(height, width / aspect) / _FILL / 2 / math.tan(math.radians(_LENS_DEG) / 2) - float(low[1])
        eye = 0.55 * height + (_STOOP * distance if height < _EYE_M else 0.0)
    else:
        distance, eye = settings.distance_m, min(_EYE_M, 0.55 * height + 0.1 * settings.distance_m)
    return _fitted((0.0, -distance, eye), _points(exemplar), settings)


def _points(exemplar: Exemplar) -> Floats:
    """(V, 3) vertices above the ground, and the stem's foot."""
    points = np.concatenate([organ.mesh.vertices_m for organ in exemplar.organs]).astype(np.float64)
    return np.concatenate([points[points[:, 2] >= 0.0], np.zeros((1, 3))])


def _fitted(position: tuple[float, float, float], points: Floats, settings: PictureSettings) -> Camera:
    """The camera at `position` whose picture the points fill."""
    way = points - np.array(position)
    if not np.all(way[:, 1] > 0.0):
        expected, got = f"more than {-points[:, 1].min():.3g} m, or `look_at_m` with it", f"{-position[1]:g}"
        raise RecipeError("the camera stands in the plant", parameter="distance_m", expected=expected, got=got)
    bearing = np.arctan2(way[:, 0], way[:, 1])
    lift = np.arctan2(way[:, 2], np.hypot(way[:, 0], way[:, 1]))
    turn, tilt = (0.5 * (angle.min() + angle.max()) for angle in (bearing, lift))
    aim = np.array([math.tan(turn), 1.0, math.tan(tilt) / math.cos(turn)])
    axes = look_at(position, tuple(position + aim))
    seen = way @ axes
    across, up = (float(np.abs(seen[:, k] / seen[:, 2]).max()) / _FILL for k in (0, 1))
    half = max(across, up * settings.size_px[0] / settings.size_px[1])
    widest = 2 * math.degrees(math.atan(half))
    if not (np.all(seen[:, 2] > 0.0) and widest < _WIDEST_DEG):
        problem, expected = "no lens holds the whole plant from there", "a larger distance, or `look_at_m` with it"
        raise RecipeError(problem, parameter="distance_m", expected=expected, got=f"{-position[1]:g}")
    return Camera("plant", position, axes, settings.size_px, widest)


def _close(exemplar: Exemplar, settings: PictureSettings) -> Camera:
    height = float(exemplar.bounds_m()[1, 2])
    level = 0.6 * height if settings.look_at_m is None else settings.look_at_m
    if not 0 <= level <= height:
        expected, got = f"0 to {height:.4g} m", f"{level:g}"
        raise RecipeError("the plant is not so tall", parameter="look_at_m", expected=expected, got=got)
    size_m, points = size_of_m(exemplar), _points(exemplar)
    off = np.abs(points[:, 2] - level)
    near = points[off <= max(0.03 * size_m, float(off.min()))]
    x, y, z = (float(value) for value in near[np.argmin(near[:, 1])])  # the southernmost vertex about that height
    distance = settings.distance_m or (3.5 * settings.window_m if settings.window_m else 0.35 * size_m)
    lens = _LENS_DEG if settings.window_m is None else 2 * math.degrees(math.atan(settings.window_m / 2 / distance))
    above = (_STOOP if height < _EYE_M else 0.08) * distance
    position, (width_px, height_px) = (x, y - distance, max(z, 0.0) + above), settings.size_px
    half = math.tan(math.radians(min(lens, _LENS_DEG)) / 2) * width_px / height_px
    wide_deg = 2 * math.degrees(math.atan(half))
    return Camera("plant", position, look_at(position, (x, y, z)), settings.size_px, wide_deg)


def ground(size_m: float) -> Terrain:
    """Level ground in rings around the plant, each wider than the last, out to the horizon."""
    radius = size_m * np.geomspace(0.05, _HORIZON_M / size_m, _RINGS)
    turn = np.arange(_SPOKES) / _SPOKES * 2 * np.pi
    ring = np.stack(
        [np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn)), np.zeros((_RINGS, _SPOKES))], axis=-1
    )
    vertices = np.concatenate([np.zeros((1, 3)), ring.reshape(-1, 3)])
    spoke = np.arange(_SPOKES)
    after = (spoke + 1) % _SPOKES
    hub = np.stack([np.zeros(_SPOKES, dtype=np.int64), 1 + spoke, 1 + after], axis=1)
    first = 1 + _SPOKES * np.arange(_RINGS - 1)[:, None]
    inner, beside = (first + spoke).ravel(), (first + after).ravel()
    faces = [
        hub,
        np.stack([inner, inner + _SPOKES, beside + _SPOKES], axis=1),
        np.stack([inner, beside + _SPOKES, beside], axis=1),
    ]
    away = np.hypot(vertices[:, 0], np.maximum(vertices[:, 1], 0.0)) / size_m  # the camera's side stays as it is
    vertices[:, 2] = _RISE * size_m * np.maximum(away - _PALES_TO, 0.0)
    pale = np.clip(np.log(np.maximum(away, 1e-9) / _PALES_FROM) / math.log(_PALES_TO / _PALES_FROM), 0.0, 1.0)
    rise = np.where(away > _PALES_TO, _RISE / np.maximum(away * size_m, 1e-9), 0.0)
    slope = rise[:, None] * np.stack([vertices[:, 0], np.maximum(vertices[:, 1], 0.0)], axis=1)
    normal = unit(np.concatenate([-slope, np.ones((len(vertices), 1))], axis=1))
    mesh = Mesh(
        vertices_m=vertices.astype(np.float32),
        faces=np.concatenate(faces).astype(np.uint32),
        normals=normal.astype(np.float32),
        uv=(vertices[:, :2] / (_GROUND_TILE * size_m)).astype(np.float32),
    )
    share = (pale * pale * (3 - 2 * pale)).astype(np.float32)
    return Terrain(mesh, _ground_texture(), share, _horizon_reflectance())


@cache
def _horizon_reflectance() -> tuple[float, float, float]:
    """What a level surface must reflect to look like the sky above the northern horizon, linear Rec. 709."""
    from forestgen.render.light import sky_map, sun_irradiance
    from forestgen.render.skies.model import map_directions
    from forestgen.render.sky import level_irradiance
    from forestgen.render.variant import SCALAR, using

    with using(SCALAR):
        radiance = sky_map(_SKY, RGB)
        sun = sun_irradiance(_SKY, RGB) * _SKY.to_sun[2]
    irradiance = level_irradiance(radiance) + sun
    directions = map_directions(*radiance.shape[:2])
    level_row = directions[len(directions) // 2]
    azimuth_deg = np.degrees(np.arctan2(level_row[:, 0], level_row[:, 1]))
    north = np.abs(azimuth_deg) < _HORIZON_WIDTH_DEG / 2
    height_deg = np.degrees(np.arcsin(np.clip(directions[:, 0, 2], -1.0, 1.0)))
    profile = radiance[:, north].mean(axis=1, dtype=np.float64)
    level = [float(np.interp(_HORIZON_DEG, height_deg[::-1], profile[::-1, k])) for k in range(3)]
    red, green, blue = (float(min(np.pi * value / one, 1.0)) for value, one in zip(level, irradiance, strict=True))
    return red, green, blue


@cache
def _ground_texture() -> NDArray[np.float32]:
    """(P, P, 3) reflectance, periodic: plain ground with a soft grain."""
    rng = child_rng(0, "studio")
    frequency = np.fft.fftfreq(_GROUND_PX, 1 / _GROUND_PX)
    wave = np.hypot(frequency[:, None], frequency[None, : _GROUND_PX // 2 + 1])
    spectrum = np.where(wave > 0, np.maximum(wave, 14.0) ** -1.0, 0.0)  # no wave is so long that it shows as a pattern
    grain = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((_GROUND_PX, _GROUND_PX))) * spectrum)
    grain = 1 + 0.13 * np.clip(grain / grain.std(), -2.5, 2.5)
    return np.asarray(grain[..., None] * _NEAR_REFLECTANCE, dtype=np.float32)
