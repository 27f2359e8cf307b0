"""Aerial perspective: the haze between the camera and what it sees.

A surface at the distance d is seen as L exp(-sigma d) + A (1 - exp(-sigma d)), channel by channel, where A is the
airlight: what haze without end would shine with in the ray's direction.

- Airlight is the light of sun, sky and ground that haze scatters once into the ray: the mean of their radiance,
  weighted by the phase function. The sky's radiance is that at the ground, so earlier scattering is in it.
- A long path must end in the horizon's colour, which the sky model has and the weighted mean meets only roughly (0.9
  under an overcast sky; 1.0, 1.3 and 1.4 in blue, green and red at a sun of 40 degrees). So A is multiplied by this
  ratio, by azimuth, in level directions, and less up and down: by a third of what it is beyond 1 at 10 degrees from
  the level. A black thing at the visibility is then as Koschmieder has it. Once the sun is down, the air around is in
  the earth's shadow, and the horizon's glow is of air far beyond it: the ratio goes to 1 by a degree below the horizon.
- sigma of a channel is the mean over its wavelengths, weighted by the daylight: exact for a grey surface nearby.
- The sky is seen through no haze but its own; a ray that leaves the world below the horizon sees the airlight alone.

Pixels that see surfaces and sky: with s the share of surfaces, T the mean of exp(-sigma d) over them and K the sky's
radiance there, the pixel becomes T L + (1 - T) (1 - s) K + (1 - T) s A, linear in L, so its variance is that of L times
T². s and T come from rays of the identity pass, much cheaper than light paths. Within a pixel, near and far surfaces
are taken to be equally bright. K is known under a clear or overcast sky; with clouds it is the mean of the neighbours
that see nothing but sky.

Haze in shadow, as between the stems of a forest, shines less: the sun's part of the airlight counts by the share of the
haze before a surface that the sun shines on, the rest by the share of the sky's upper half that is open there. Of the
identity pass' rays some ask at one place, chosen by what the haze there adds, one way: one in eight where the haze is
thin, all of them where it scatters 5% of the light or more. Where none of a pixel's rays asks, as at the edge of a
thing before the sky, its haze counts as lit. Light that surfaces nearby send into shaded haze is left out.

Valid while the haze is thin over the scene: light on its way to a plant is not dimmed, and blur is left out. Beyond an
optical depth of about 1 to the farthest plants, fog should be simulated (`sky.clouds`); `haze_notes` in
render/rendering.py says so.

Under clouds the airlight is that of the sky through them at the middle of the site and of the share of the sun that
their shadow lets through in the mean, by which the ratio at the horizon counts, too. One airlight serves all of the
haze, under clouds and between them. Clouds fade into the clear sky behind them, by the haze on the way to where half of
what they take of the light is taken; on this way the haze gets thinner with height, by e in 1500 m. Where clouds shade
the haze, its airlight stands in for the clear sky, by the share of the sun that they take.

Extinction
----------
Koschmieder (1924): a black thing at the meteorological range V is just seen against the horizon, with a contrast of
2%, so the extinction at 550 nm is 3.912 / V. At 50 km it falls as wavelength^-1.7 in the visible (Kruse: 1.6).

- Air's molecules: 1.16e-5 /m at 550 nm and sea level (V = 337 km), as wavelength^-4; Rayleigh's phase function.
- Aerosol: the rest, as wavelength^-q with q = 1.3, and 0.585 V^(1/3), V in kilometres, below 6 km, where particles are
  large (Kruse, McGlauchlin and McQuistan 1962); a Henyey-Greenstein lobe of g = 0.65. q and g as in
  atmosphere/daylight.py.

References
----------
Koschmieder, H. (1924): Theorie der horizontalen Sichtweite. Beitr. Phys. freien Atmos. 12, 33-53, 171-181.
Kruse, P. W., McGlauchlin, L. D., McQuistan, R. B. (1962): Elements of Infrared Technology. Wiley.
Bucholtz, A. (1995): Rayleigh-scattering calculations for the terrestrial atmosphere. Appl. Opt. 34, 2765-2773.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.extinction import KOSCHMIEDER
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import distance_into, optical_depth
from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import Spectrum
from forestgen.render.cloud_shadow import base_of, shadow_of
from forestgen.render.frame import Radiance
from forestgen.render.identity.surface import SAMPLES, Values, spread_rank
from forestgen.render.identity.tracer import Hits, SceneTracer
from forestgen.render.light import along, sky_map, sun_irradiance
from forestgen.render.paths.fog import Fog
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, daylight_of, map_directions
from forestgen.render.sky import SkyLight, baked_sky, level_irradiance, site_middle, traced_clouds_of
from forestgen.render.variant import SCALAR, dr, mi, using
from forestgen.render.wavelengths import ColourAtOnce, Mode, Quadrature, quadrature_of
from forestgen.scene.colour import Channels
from forestgen.scene.projection import world_rays
from forestgen.scene.spec import Camera, SceneSpec, Sky

REFERENCE_NM = 550.0
ASYMMETRY = 0.65
_MOLECULAR_PER_M = 1.16e-5
_ANGSTROM, _KRUSE, _MURKY_M = 1.3, 0.585, 6000.0
Floats = NDArray[np.float64]
_VIEW_ROWS, _VIEW_COLUMNS = 33, 64  # of the airlight's map, the sun's part left out
_DRAWS = 8  # of wavelengths
_DARK_AIR_DEG = 1.0  # below the horizon: the sun shines on no air nearby
_LEVEL_SINE = 0.17  # of the elevation at which airlight has nearly left the horizon's colour
_CLOUD_BLUR_PX = 3.0
_THIN = 1e-3  # of an optical depth, which is then the share that is scattered
_LEAST_ASKED, _ALL_ASK = 1 / 8, 0.05  # share of the rays that ask; share of light scattered from which on all do
_SCALE_HEIGHT_M = 1500.0  # of the haze on the way to clouds


@dataclass(frozen=True)
class Haze:
    """Haze by its meteorological range."""

    visibility_m: float

    def extinction_per_m(self, wavelength_nm: Floats) -> Floats:
        """Of molecules and aerosol, of the wavelengths' shape."""
        return self.molecular_per_m(wavelength_nm) + self._aerosol(wavelength_nm)

    def molecular_per_m(self, wavelength_nm: Floats) -> Floats:
        """Of molecules alone: never more than the visibility leaves."""
        reference = min(_MOLECULAR_PER_M, KOSCHMIEDER / self.visibility_m)
        return np.asarray(reference * (wavelength_nm / REFERENCE_NM) ** -4.0)

    def _aerosol(self, wavelength_nm: Floats) -> Floats:
        murky = self.visibility_m < _MURKY_M
        exponent = _KRUSE * (self.visibility_m / 1000.0) ** (1.0 / 3.0) if murky else _ANGSTROM
        rest = max(KOSCHMIEDER / self.visibility_m - _MOLECULAR_PER_M, 0.0)
        return np.asarray(rest * (wavelength_nm / REFERENCE_NM) ** -exponent)


def molecular_phase(cosine: Floats) -> Floats:
    """Rayleigh's phase function by the cosine of the scattering angle; its mean over the sphere is 1."""
    return np.asarray(0.75 * (1.0 + cosine * cosine))


def aerosol_phase(cosine: Floats) -> Floats:
    """Henyey and Greenstein's; its mean over the sphere is 1."""
    g = ASYMMETRY
    return np.asarray((1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5)


@dataclass(frozen=True)
class Seen:
    """What the pixels of a camera see through the haze; means over their samples."""

    inside: Floats  # (H, W) share of the samples that see anything: those in a fisheye's circle
    surface: Floats  # (H, W) of these, the share that sees a surface, or nothing below the horizon
    transmittance: Floats  # (H, W, C) mean over the latter; 1 where there are none
    # (H, W) of the light of the sun, and of the sky's upper half, the share that haze before these sends to the camera
    sunny: Floats = field(default_factory=lambda: np.ones((1, 1)))
    open: Floats = field(default_factory=lambda: np.ones((1, 1)))


@dataclass(frozen=True, eq=False)
class Airlight:
    """What haze without end shines with, by direction and channel; maps as `sky_radiance.map_directions`."""

    diffuse: Floats  # (R, Q, C) of the light of sky and ground
    sun: Floats  # (2, C) irradiance of the sun times the part of the scattering that molecules do, and aerosol
    to_sun: Floats  # (3,)
    open_sky: Floats  # (MAP_ROWS, MAP_COLUMNS, C) radiance of the sky without its sun, behind all clouds
    horizon: Floats  # (MAP_COLUMNS, C) ratio of the sky's radiance at the horizon to the airlight there

    def towards(self, direction: Floats, sunny: Floats | float = 1.0, seen_sky: Floats | float = 1.0) -> Floats:
        """(..., C) by (..., 3) unit directions, world, and the shares (...) of the light of sun and sky that arrive."""
        level = np.exp(-((direction[..., 2:3] / _LEVEL_SINE) ** 2))
        ratio = 1.0 + level * (along(self.horizon[None], direction) - 1.0)
        return np.asarray(self.unjoined(direction, sunny, seen_sky) * ratio)

    def unjoined(self, direction: Floats, sunny: Floats | float = 1.0, seen_sky: Floats | float = 1.0) -> Floats:
        """The same, not fitted to the horizon."""
        cosine = direction @ self.to_sun
        phases = np.stack([molecular_phase(cosine), aerosol_phase(cosine)], axis=-1)
        sun, sky = phases @ self.sun / (4.0 * np.pi), along(self.diffuse, direction)
        return np.asarray(np.asarray(seen_sky)[..., None] * sky + np.asarray(sunny)[..., None] * sun)


@dataclass(frozen=True, eq=False)
class UnderClouds:
    """Light below the clouds of a scene."""

    sky: SkyLight
    sun_share: float  # of the sun's own light that comes down, in the mean

    def on_level(self, radiance: NDArray[np.float32], sky: Sky, channels: Channels) -> Floats:
        """(3,) of all light on a level plane, with `radiance` of the sky."""
        sun = self.sun_share * max(float(sky.to_light[2]), 0.0) * sun_irradiance(sky, channels)
        return np.asarray(level_irradiance(radiance) + sun)


def under_clouds(spec: SceneSpec) -> UnderClouds | None:
    """Light below a scene's clouds; None where there are none. Call it in the scalar variant."""
    base_m = None if spec.clouds is None else base_of(spec.clouds)
    if spec.clouds is None or base_m is None:
        return None
    share = float(shadow_of(spec.clouds, spec.sky.to_light, base_m)[0].mean()) if spec.sky.to_light[2] > 0 else 0.0
    return UnderClouds(baked_sky(traced_clouds_of(spec), site_middle(spec)), share)


def through_haze(
    radiance: Radiance, spec: SceneSpec, camera: Camera, seen: Seen, extinction_per_m: Floats, mode: Mode
) -> Radiance:
    """The image as the sky's haze shows it; `seen` is through its extinction (C,), see `extinction_towards`."""
    assert spec.sky.visibility_m is not None
    haze, quadrature = Haze(spec.sky.visibility_m), quadrature_of(camera, mode, daylight_of(spec.sky).on_level)
    with using(SCALAR):
        light = airlight_of(haze, quadrature, spec.sky, under_clouds(spec))
    veil = None if spec.clouds is None else cloud_veil(spec.clouds, camera, extinction_per_m)
    return hazed(radiance, seen, light, camera, veil)


def extinction_towards(camera: Camera, sky: Sky, mode: Mode) -> Floats | None:
    """(C,) per metre by the channels of the camera's image; None: the sky has no haze."""
    if sky.visibility_m is None:
        return None
    return extinction_of(Haze(sky.visibility_m), quadrature_of(camera, mode, daylight_of(sky).on_level), sky)


def extinction_of(haze: Haze, quadrature: Quadrature, sky: Sky) -> Floats:
    """(C,) per metre by the image's channels."""
    light = daylight_of(sky).on_level
    taken = Spectrum(light.wavelength_nm, light.value * haze.extinction_per_m(light.wavelength_nm))
    return np.array(quadrature.of_light(taken)) / np.maximum(quadrature.of_light(light), np.finfo(float).tiny)


def airlight_of(haze: Haze, quadrature: Quadrature, sky: Sky, under: UnderClouds | None = None) -> Airlight:
    """Airlight of a haze under a sky, and under its clouds where there are any."""
    own = _airlight(haze, quadrature, sky, under)
    clear = own if under is None else _airlight(haze, quadrature, sky, None)
    level = map_directions()[MAP_ROWS // 2]
    ratio = own.open_sky[MAP_ROWS // 2] / np.maximum(clear.unjoined(level), np.finfo(float).tiny)
    ratio = 1.0 + float(np.clip(1.0 + sky.sun_elevation_deg / _DARK_AIR_DEG, 0.0, 1.0)) * (ratio - 1.0)
    if under is None:
        return replace(own, horizon=ratio)
    joined = replace(own, horizon=1.0 + under.sun_share * (ratio - 1.0))
    veil = (1.0 - under.sun_share) * joined.towards(map_directions())
    return replace(joined, open_sky=under.sun_share * own.open_sky + veil)


def _airlight(haze: Haze, quadrature: Quadrature, sky: Sky, under: UnderClouds | None) -> Airlight:
    """The same, not fitted to the horizon."""
    draws = 1 if isinstance(quadrature, ColourAtOnce) else _DRAWS
    passes = [one for number in range(draws) for one in quadrature.draw(child_rng(0, "haze"), number)]
    count = len(quadrature.names)
    open_sky, sun = np.zeros((MAP_ROWS, MAP_COLUMNS, count)), np.zeros((2, count))
    around = np.zeros((2, _VIEW_ROWS * _VIEW_COLUMNS, count))
    for one in passes:
        weight = one.weight.T / draws
        radiance, share = sky_map(sky, one.channels), _molecular_share(haze, one.channels, sky)
        open_sky += radiance @ weight
        level, shine = one.channels.of_light(daylight_of(sky).on_level), sun_irradiance(sky, one.channels)
        if under is not None:
            radiance = under.sky.radiance(one.channels)
            level, shine = under.on_level(radiance, sky, one.channels), under.sun_share * shine
        light = _surroundings(radiance, level * sky.ground_albedo / np.pi)
        for k, part in enumerate((share, 1.0 - share)):
            around[k] += (light * part) @ weight
            sun[k] += (shine * part) @ weight
    diffuse = np.sum([kernel @ light for kernel, light in zip(_kernels(), around, strict=True)], axis=0)
    return Airlight(
        diffuse.reshape(_VIEW_ROWS, _VIEW_COLUMNS, count), sun, sky.to_light, open_sky, np.ones_like(open_sky[0])
    )


def _molecular_share(haze: Haze, channels: Channels, sky: Sky) -> Floats:
    """(3,) of what the haze scatters of the daylight in a pass' channels, the part of the molecules."""
    light = daylight_of(sky).on_level
    parts = [
        channels.of_light(Spectrum(light.wavelength_nm, light.value * taken(light.wavelength_nm)))
        for taken in (haze.molecular_per_m, haze.extinction_per_m)
    ]
    return np.asarray(parts[0] / np.maximum(parts[1], np.finfo(float).tiny))


def _surroundings(radiance: NDArray[np.float32], ground: Floats) -> Floats:
    """(N, 3) radiance that arrives from the directions of a view's map: the sky's, and (3,) of even ground below."""
    rows, columns = (MAP_ROWS - 1) // (_VIEW_ROWS - 1), MAP_COLUMNS // _VIEW_COLUMNS
    # Rows are averaged with their neighbours as hats, columns as blocks; the horizon's row has the sky's half alone.
    hat = 1.0 - np.abs(np.arange(1 - rows, rows)) / rows
    at = np.arange(_VIEW_ROWS // 2 + 1)[:, None] * rows + np.arange(1 - rows, rows)
    kept = hat * (at >= 0) * (at <= MAP_ROWS // 2)
    up = np.einsum("rk,rkcx->rcx", kept / kept.sum(axis=1)[:, None], radiance[np.clip(at, 0, MAP_ROWS - 1)])
    up = up.reshape(len(at), _VIEW_COLUMNS, columns, 3).mean(axis=2)
    result = np.broadcast_to(ground, (_VIEW_ROWS, _VIEW_COLUMNS, 3)).copy()
    result[: len(up)] = up
    result[len(up) - 1] = (up[-1] + ground) / 2.0
    return result.reshape(-1, 3)


@lru_cache(maxsize=1)
def _kernels() -> tuple[Floats, Floats]:
    """(N, N) share of the light from each direction in what molecules, and aerosol, scatter towards each other one."""
    direction = map_directions(_VIEW_ROWS, _VIEW_COLUMNS).reshape(-1, 3)
    angle = np.sqrt(np.maximum(1.0 - direction[:, 2] ** 2, 0.0))  # solid angle, of any scale
    cosine = np.clip(direction @ direction.T, -1.0, 1.0)
    molecules, aerosol = (
        weighed / weighed.sum(axis=1, keepdims=True)
        for weighed in (molecular_phase(cosine) * angle, aerosol_phase(cosine) * angle)
    )
    return molecules, aerosol


def seen_values(tracer: SceneTracer, camera: Camera, extinction_per_m: Floats) -> Values:
    """Whether a ray sees anything, whether a surface, the transmittances (C,) of the haze before that; and how much
    light the haze there scatters, by rays that ask for the sky and those that ask for the sun: all, and what comes.
    """
    mean_per_m = float(np.mean(extinction_per_m))
    with using(tracer.variant):
        fog = Fog(tracer.spec.fog, tracer.origin_m) if tracer.spec.fog else None

    def values(hits: Hits) -> list[Any]:
        good = mi.Bool(True) if hits.rays.valid is None else hits.rays.valid
        surface = hits.valid | (good & (hits.rays.direction.z < 0))
        ray = dr.zeros(mi.Float, dr.width(hits.distance_m))
        through = [dr.exp(-dr.opaque(mi.Float, float(value)) * hits.distance_m) for value in extinction_per_m]
        seen = [dr.select(good, 1.0, 0.0) + ray, dr.select(surface, 1.0, 0.0) + ray]
        weight, to_sun, comes = _light_between(tracer, camera, hits, fog, dr.opaque(mi.Float, mean_per_m))
        weight = dr.select(hits.valid, weight, dr.select(surface, 1.0, 0.0)) + ray
        light = [dr.select(asks, weight, 0.0) for asks in (~to_sun, to_sun)]
        light += [dr.select(hits.valid, one * comes, one) for one in light]
        return seen + [dr.select(hits.valid, one, 0.0) for one in through] + light

    return values


def _light_between(
    tracer: SceneTracer, camera: Camera, hits: Hits, fog: Fog | None, extinction_per_m: Any
) -> tuple[Any, Any, Any]:
    """Of rays. Float: the share of light that haze scatters before the hit, over the share of rays like it that ask; 0
    for those that do not. Bool: whether a place there is asked for the sun, not the sky. Float: the share of that
    light that comes there and on to the camera, past what stands in the way and through fog.
    """
    direction, start = hits.rays.direction, tracer.start_of(camera, hits.rays) + mi.Vector3f(0.0)
    bits = [dr.reinterpret_array(mi.UInt32, one) for one in (direction.x, direction.y, start.x, start.y)]
    first = mi.sample_tea_32(bits[0], bits[1], 4)
    first = mi.sample_tea_32(first[0] ^ bits[2], first[1] ^ bits[3], 4)
    place, rise, turn = (mi.Float(one >> 8) * 2.0**-24 for one in (*first, mi.sample_tea_32(*first, 4)[0]))
    depth = extinction_per_m * hits.distance_m
    thin = depth < _THIN
    scattered = dr.select(thin, depth, 1.0 - dr.exp(-depth))
    into_m = dr.select(thin, place * hits.distance_m, -dr.log(1.0 - place * scattered) / extinction_per_m)
    into_m = dr.minimum(into_m, hits.distance_m)
    rank = spread_rank(dr.arange(mi.UInt32, dr.width(hits.distance_m)))
    asked = dr.clip(scattered / _ALL_ASK, _LEAST_ASKED, 1.0)
    asks = hits.valid & (mi.Float(rank) + 0.5 < SAMPLES * asked)
    sine, (turn_sine, turn_cosine) = dr.safe_sqrt(1.0 - rise * rise), dr.sincos(2.0 * np.pi * turn)
    to_sun = (rank & 1) == 1
    towards = dr.select(to_sun, tracer.to_light, mi.Vector3f(sine * turn_cosine, sine * turn_sine, rise))
    at = start + direction * into_m
    hidden = tracer.scene.ray_test(mi.Ray3f(at, towards), coherent=False, active=asks)
    comes = dr.select(hidden, 0.0, mi.Float(1.0))
    if fog is not None:
        comes *= fog.kept(start, direction, into_m) * fog.through(at, towards)
    return dr.select(asks, scattered / asked, 0.0), to_sun, comes


def seen_of(sums: NDArray[np.float32]) -> Seen:
    """Of the sums (6 + C, H, W) of `seen_values`."""
    rays, surfaces, through, light = (
        np.asarray(one, dtype=np.float64) for one in (sums[0], sums[1], np.moveaxis(sums[2:-4], 0, -1), sums[-4:])
    )
    some = (surfaces > 0)[..., None]
    mean = np.where(some, through / np.maximum(surfaces, 1.0)[..., None], 1.0)
    least = np.finfo(float).tiny
    sky, sun = (np.where(light[k] > 0, light[k + 2] / np.maximum(light[k], least), 1.0) for k in range(2))
    return Seen(rays / SAMPLES, surfaces / np.maximum(rays, 1.0), mean, sunny=sun, open=sky)


def cloud_veil(clouds: CloudGrid, camera: Camera, extinction_per_m: Floats) -> Floats:
    """(H, W, C) share of the sky's light, by pixel, that haze takes from clouds and gives to the clear sky's colour."""
    rays = world_rays(camera)
    opacity = -np.expm1(-optical_depth(clouds, rays.origin_m, rays.direction, np.inf))
    distance = distance_into(clouds, rays.origin_m, rays.direction)
    rise = np.maximum(np.abs(rays.direction[..., 2]), 1e-4) / _SCALE_HEIGHT_M
    path = -np.expm1(-np.where(opacity > 0, distance, 0.0) * rise) / rise
    return np.asarray(opacity[..., None] * -np.expm1(-path[..., None] * extinction_per_m))


def hazed(radiance: Radiance, seen: Seen, light: Airlight, camera: Camera, veil: Floats | None) -> Radiance:
    """The image through the haze and a `cloud_veil`; None: there are no clouds, and the sky is the sky model's."""
    direction = world_rays(camera).direction
    above = np.maximum(direction, [-1.0, -1.0, 0.0])
    clear = along(light.open_sky, above / np.maximum(np.linalg.norm(above, axis=-1, keepdims=True), 1e-9))
    kept = through = seen.transmittance
    surface, behind = seen.surface[..., None], clear
    if veil is not None:
        only_sky = surface == 0
        behind = _filled(radiance.mean, (seen.surface == 0) & (seen.inside == 1), clear)
        kept = np.where(only_sky, 1.0 - veil, through)
    added = (1.0 - through) * ((1.0 - surface) * behind + surface * light.towards(direction, seen.sunny, seen.open))
    if veil is not None:
        added += (1.0 - surface) * veil * np.where(only_sky, clear, clear - behind)
    added *= seen.inside[..., None]
    return replace(
        radiance,
        # Where fewer of the paths than of these rays saw the sky, more would be taken off than there is.
        mean=np.maximum(kept * radiance.mean + added, np.minimum(radiance.mean, 0.0)).astype(np.float32),
        variance=(kept**2 * radiance.variance).astype(np.float32),
    )


def _filled(image: NDArray[np.float32], known: NDArray[np.bool_], otherwise: Floats) -> Floats:
    """(H, W, C) mean of the known pixels nearby, or `otherwise` where there are none."""
    from scipy.ndimage import gaussian_filter

    blur = (_CLOUD_BLUR_PX, _CLOUD_BLUR_PX)
    weight = gaussian_filter(known.astype(np.float64), blur)[..., None]
    total = gaussian_filter(np.where(known[..., None], image, 0.0).astype(np.float64), (*blur, 0.0))
    some = weight > 1e-3
    return np.where(some, total / np.where(some, weight, 1.0), otherwise)
