"""Light from a cloudy sky.

The canopy and the clouds want different estimators: one Monte Carlo path through both costs twenty times as much at
equal error (ADR 0003). So the cloud field is traced by `volpath` on its own, over bare ground, twice:
into an environment map at the camera's foot, which then lights the plants, and into the pixels that see the sky. The
sun reaches the plants through a transmittance map: a partly transparent sheet at the clouds' base, which leaves the
sun's disc, and so the penumbrae under the canopy, as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid, Phase
from forestgen.render.denoise import denoise
from forestgen.render.light import envmap, has_sun, sky_light, sun_beam
from forestgen.render.settings import CLOUD_DEPTH, CLOUD_ROULETTE_DEPTH, SAMPLER
from forestgen.render.sky_radiance import sky_map, sun_irradiance
from forestgen.render.tracing import interruptible
from forestgen.render.variant import BLOCK_PX, mitsuba
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.spec import SceneSpec, Sky

CLOUD_INTEGRATOR: dict[str, Any] = {
    "type": "volpath",
    "max_depth": CLOUD_DEPTH,
    "rr_depth": CLOUD_ROULETTE_DEPTH,
    "block_size": BLOCK_PX,
}
_BAKED_NM = (360.0, 430.0, 500.0, 570.0, 640.0, 720.0)
_GROUND_HALF_M = 200_000.0


def cloud_volume(clouds: CloudGrid, origin_m: NDArray[np.float64]) -> dict[str, Any]:
    """The cloud field as a heterogeneous medium inside a box."""
    mi = mitsuba()
    low, high = np.asarray(clouds.low_m) - origin_m, np.asarray(clouds.high_m) - origin_m
    box = mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist())
    grid = mi.VolumeGrid(np.ascontiguousarray(clouds.extinction_per_m[..., None]))
    return {
        "type": "cube",
        "to_world": box @ mi.ScalarTransform4f().translate([0.5] * 3).scale([0.5] * 3),
        "bsdf": {"type": "null"},
        "interior": {
            "type": "heterogeneous",
            "albedo": clouds.albedo,
            "sigma_t": {"type": "gridvolume", "grid": grid, "filter_type": "trilinear", "to_world": box},
            "phase": phase_function(clouds.phase),
        },
    }


def phase_function(phase: Phase) -> dict[str, Any]:
    """Of a medium."""
    forward = {"type": "hg", "g": phase.forward}
    if phase.forward_share >= 1.0:
        return forward
    return {
        "type": "blendphase",
        "weight": 1.0 - phase.forward_share,  # of the second
        "first": forward,
        "second": {"type": "hg", "g": phase.backward},
    }


def clouds_over_ground(spec: SceneSpec, origin_m: NDArray[np.float64], lights: dict[str, Any]) -> dict[str, Any]:
    """Clouds over a plain of the region's albedo, below every valley and the camera, without a plant."""
    mi = mitsuba()
    lowest_m = min(0.0, float(spec.terrain.mesh.vertices_m[:, 2].min() - origin_m[2]), -1.0)
    ground = mi.ScalarTransform4f().translate([0.0, 0.0, lowest_m]).scale([_GROUND_HALF_M, _GROUND_HALF_M, 1.0])
    scene: dict[str, Any] = {
        **lights,
        "ground": {
            "type": "rectangle",
            "to_world": ground,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [spec.sky.ground_albedo] * 3}},
        },
    }
    if spec.clouds is not None:
        scene["clouds"] = cloud_volume(spec.clouds, origin_m)
    return scene


def bake_sky(
    spec: SceneSpec, origin_m: NDArray[np.float64], channels: Channels, *, seed: int, size: int = 32, samples: int = 16
) -> dict[str, Any]:
    """The sky without the sun's disc, seen from the origin, as an `envmap` dictionary.

    Five faces of a cube (all but the ground) are traced, denoised and looked up by direction. Below the horizon the
    map is black: the terrain reaches the horizon, and no light sample is wasted on it. The sun lights
    the clouds as a direction here, so that its disc is not in the map; the plants meet the disc itself.
    """
    lights = {"sky": sky_light(spec.sky, channels)}
    if has_sun(spec.sky):
        lights["sun"] = sun_beam(spec.sky, channels)
    return envmap(_bake(spec, origin_m, lights, seed, size, samples))


@dataclass(frozen=True)
class SpectralBake:
    """What `bake_sky` gives, for any wavelengths at once.

    Clouds and the plain below them are grey here. So the light of the sun comes through the same at all wavelengths,
    and that of the sky differs only by how it spreads over the sky: of the light on a level plane, the share by
    direction is baked at six wavelengths, and changes in a straight line between them.
    """

    sky: Sky
    of_sky: NDArray[np.float32]  # (6, rows, columns), 1/sr
    of_sun: NDArray[np.float32]  # (rows, columns), 1/sr, for the sun's light on a plane that faces it

    def light(self, channels: Channels) -> dict[str, Any]:
        """An `envmap` dictionary for three wavelengths."""
        assert channels.wavelength_nm is not None
        level = level_irradiance(sky_map(self.sky, channels))
        facing = sun_irradiance(self.sky, channels)
        result = np.empty((*self.of_sun.shape, 3), dtype=np.float32)
        for k, wavelength in enumerate(channels.wavelength_nm):
            share = np.array([np.interp(wavelength, _BAKED_NM, one) for one in np.eye(len(_BAKED_NM))])
            result[..., k] = level[k] * np.tensordot(share, self.of_sky, 1) + facing[k] * self.of_sun
        return envmap(result)


def bake_spectral_sky(
    spec: SceneSpec, origin_m: NDArray[np.float64], *, seed: int, size: int = 32, samples: int = 16
) -> SpectralBake:
    """As `bake_sky`, once for all passes."""
    shares = []
    for first in range(0, len(_BAKED_NM), 3):
        short, middle, long = _BAKED_NM[first : first + 3]
        channels = Channels((short, middle, long))
        lights = {"sky": sky_light(spec.sky, channels)}
        level = level_irradiance(sky_map(spec.sky, channels))
        shares.append(_bake(spec, origin_m, lights, seed + 16 * first, size, samples) / np.maximum(level, 1e-30))
    of_sky = np.moveaxis(np.concatenate(shares, axis=-1), -1, 0).astype(np.float32)
    of_sun = np.zeros(of_sky.shape[1:], dtype=np.float32)
    if has_sun(spec.sky):
        beam = sun_beam(spec.sky, RGB) | {"irradiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
        of_sun = _bake(spec, origin_m, {"sun": beam}, seed + 7, size, samples).mean(axis=-1)
    return SpectralBake(spec.sky, of_sky, of_sun)


def level_irradiance(radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """(3,) light of a `sky_map` on a level plane."""
    rows, columns = radiance.shape[:2]
    theta = np.arange(rows) / (rows - 1) * np.pi
    weight = np.maximum(np.cos(theta), 0.0) * np.sin(theta) * (np.pi / (rows - 1)) * (2 * np.pi / columns)
    return np.asarray(np.einsum("rck,r->k", radiance.astype(np.float64), weight))


def _bake(
    spec: SceneSpec, origin_m: NDArray[np.float64], lights: dict[str, Any], seed: int, size: int, samples: int
) -> NDArray[np.float32]:
    mi = mitsuba()
    scene = mi.load_dict({"type": "scene", **clouds_over_ground(spec, origin_m, lights)})
    integrator = mi.load_dict(CLOUD_INTEGRATOR)
    faces = {}
    for number, (name, (forward, up)) in enumerate(_FACES.items()):
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb",
                "component_format": "float32"}  # fmt: skip
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": 90.0,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], forward, up),
                "film": film,
                "sampler": {"type": SAMPLER, "sample_count": samples},
            }
        )
        noisy = interruptible(integrator, scene, sensor, seed + number, samples)
        faces[name] = denoise(np.ascontiguousarray(noisy[..., :3]))
    return _equirectangular(faces, 4 * size, 2 * size)


_FACES = {
    "up": ([0, 0, 1], [0, 1, 0]),
    "east": ([1, 0, 0], [0, 0, 1]),
    "west": ([-1, 0, 0], [0, 0, 1]),
    "north": ([0, 1, 0], [0, 0, 1]),
    "south": ([0, -1, 0], [0, 0, 1]),
}


def _equirectangular(faces: dict[str, NDArray[np.float32]], width: int, height: int) -> NDArray[np.float32]:
    """(height, width, 3) radiance by azimuth (columns, from x over y) and zenith angle (rows, from +z to -z).

    As Mitsuba's `envmap` reads it: directions of columns' centres, but the first and last row are the poles themselves.
    """
    theta = np.arange(height) / (height - 1) * np.pi
    phi = (np.arange(width) + 0.5) / width * 2 * np.pi
    up_rows = theta < np.pi / 2
    theta_, phi_ = np.meshgrid(theta[up_rows], phi, indexing="ij")
    directions = np.stack([np.sin(theta_) * np.cos(phi_), np.sin(theta_) * np.sin(phi_), np.cos(theta_)], axis=-1)
    upper = np.zeros((*directions.shape[:2], 3), dtype=np.float32)
    best = np.full(directions.shape[:2], -np.inf)
    for name, (forward, up) in _FACES.items():
        f, u = np.asarray(forward, float), np.asarray(up, float)
        left = np.cross(u, f)  # Mitsuba's +x points left
        along = directions @ f
        better = along > best + 1e-9
        size = len(faces[name])
        with np.errstate(divide="ignore", invalid="ignore"):
            column = np.clip(((1 - (directions @ left) / along) / 2 * size).astype(int), 0, size - 1)
            row = np.clip(((1 - (directions @ u) / along) / 2 * size).astype(int), 0, size - 1)
        upper[better] = faces[name][row, column][better]
        best = np.where(better, along, best)
    image = np.zeros((height, width, 3), dtype=np.float32)
    image[up_rows] = upper
    return image


def sun_transmittance(clouds: CloudGrid, direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """(Y, X) share of the sun's light that comes through to each cell of the clouds' base.

    The field is cut off, not periodic: light that enters at its sides passes through what it meets. Each layer is
    shifted along the sun's direction and its optical thickness added: O(cells).
    """
    from scipy.ndimage import shift

    layers, rows, columns = clouds.extinction_per_m.shape
    low, high = np.asarray(clouds.low_m), np.asarray(clouds.high_m)
    cell = (high - low) / np.array([columns, rows, layers])
    slope = direction[:2] / direction[2]
    depth = np.zeros((rows, columns))
    for layer in range(layers):
        height = (layer + 0.5) * cell[2]
        dx, dy = slope * height / cell[:2]
        if abs(dx) >= columns or abs(dy) >= rows:
            break  # a sun so low that it shines under the field's far edge
        depth += shift(clouds.extinction_per_m[layer].astype(np.float64), (-dy, -dx), order=1, cval=0.0) * cell[2]
    return np.asarray(np.exp(-depth / direction[2]))


def sun_sheet(spec: SceneSpec, origin_m: NDArray[np.float64]) -> dict[str, Any]:
    """The partly transparent sheet at the clouds' base that the sun shines through."""
    mi = mitsuba()
    assert spec.clouds is not None
    opacity = 1.0 - sun_transmittance(spec.clouds, spec.sky.to_sun)
    low, high = np.asarray(spec.clouds.low_m) - origin_m, np.asarray(spec.clouds.high_m) - origin_m
    centre, half = (low + high) / 2, (high - low) / 2
    place = mi.ScalarTransform4f().translate([centre[0], centre[1], low[2]]).scale([half[0], half[1], 1.0])
    bitmap = mi.Bitmap(np.ascontiguousarray(opacity[..., None].astype(np.float32)))
    return {
        "type": "rectangle",
        "to_world": place,
        "bsdf": {
            "type": "mask",
            "opacity": {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"},
            "nested": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}},
        },
    }
