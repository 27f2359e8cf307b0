"""Light from a cloudy sky.

The canopy and the clouds want different estimators: one Monte Carlo path through both costs twenty times as much at
equal error (DESIGN.md, "Clouds"). So the cloud field is traced by `volpath` on its own, over bare ground, twice:
into an environment map at the camera's foot, which then lights the plants, and into the pixels that see the sky. The
sun reaches the plants through a transmittance map: a partly transparent sheet at the clouds' base, which leaves the
sun's disc, and so the penumbrae under the canopy, as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.render.build import sky_emitter, sun_direction
from forestgen.render.denoise import denoise
from forestgen.render.tracing import interruptible
from forestgen.render.variant import BLOCK_PX, mitsuba
from forestgen.scene.spec import SceneSpec

CLOUD_INTEGRATOR: dict[str, Any] = {"type": "volpath", "max_depth": 64, "rr_depth": 64, "block_size": BLOCK_PX}
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
            "phase": {"type": "hg", "g": clouds.asymmetry},
        },
    }


def clouds_over_ground(spec: SceneSpec, origin_m: NDArray[np.float64], emitter: dict[str, Any]) -> dict[str, Any]:
    """Clouds over a plain of the region's albedo, below every valley and the camera, without a plant."""
    mi = mitsuba()
    lowest_m = min(0.0, float(spec.terrain.mesh.vertices_m[:, 2].min() - origin_m[2]), -1.0)
    ground = mi.ScalarTransform4f().translate([0.0, 0.0, lowest_m]).scale([_GROUND_HALF_M, _GROUND_HALF_M, 1.0])
    scene: dict[str, Any] = {
        "emitter": emitter,
        "ground": {
            "type": "rectangle",
            "to_world": ground,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [spec.sky.ground_albedo] * 3}},
        },
    }
    if spec.clouds is not None:
        scene["clouds"] = cloud_volume(spec.clouds, origin_m)
    return scene


def bake_sky(spec: SceneSpec, origin_m: NDArray[np.float64], *, seed: int, size: int = 32, samples: int = 16) -> Any:
    """The sky without the sun's disc, seen from the origin, as an `envmap` dictionary.

    Five faces of a cube (all but the ground) are traced, denoised and looked up by direction. Below the horizon the
    map is black: the terrain reaches the horizon, and no light sample is wasted on it. The sun lights
    the clouds as a direction here, so that its disc is not in the map; the plants meet the disc itself.
    """
    mi = mitsuba()
    scene_dict = clouds_over_ground(spec, origin_m, sky_emitter(spec, sun=False, sky=True))
    irradiance = sun_irradiance(spec)
    scene_dict["sun"] = {
        "type": "directional",
        "direction": [-float(x) for x in sun_direction(spec)],
        "irradiance": {"type": "rgb", "value": [float(x) for x in irradiance]},
    }
    scene = mi.load_dict({"type": "scene", **scene_dict})
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
                "sampler": {"type": "multijitter", "sample_count": samples},
            }
        )
        noisy = interruptible(integrator, scene, sensor, seed + number, samples)
        faces[name] = denoise(np.ascontiguousarray(noisy[..., :3]))
    return envmap(_equirectangular(faces, 4 * size, 2 * size))


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


def envmap(image: NDArray[np.float32]) -> dict[str, Any]:
    """An `envmap` dictionary of an equirectangular image by azimuth from x over y and zenith angle from z."""
    mi = mitsuba()
    # Mitsuba's map is y-up: its direction for (u, v) is (sin(2 pi u) sin(pi v), cos(pi v), -cos(2 pi u) sin(pi v)).
    # Rotating y to z by 90 degrees about x turns that into azimuth 90 degrees - 2 pi u, measured from x over y.
    columns = image.shape[1]
    turned = np.roll(image[:, ::-1], columns // 4, axis=1)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(turned)),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
    }


def sun_irradiance(spec: SceneSpec) -> NDArray[np.float64]:
    """(3,) irradiance of the bare sun on a surface that faces it: its radiance integrated over the disc."""
    mi = mitsuba()
    scene = mi.load_dict({"type": "scene", "sky": sky_emitter(spec, sun=True, sky=False)})
    axis = sun_direction(spec)
    helper = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.9 else np.array([0, 1.0, 0])
    a = np.cross(axis, helper)
    a /= np.linalg.norm(a)
    b = np.cross(axis, a)
    edge = np.radians(0.30)  # past the disc's rim
    rings, spokes = 96, 24
    radius = (np.arange(rings) + 0.5) / rings * edge
    total = np.zeros(3)
    emitter = scene.environment()
    for r in radius:
        for angle in (np.arange(spokes) + 0.5) / spokes * 2 * np.pi:
            direction = axis * np.cos(r) + np.sin(r) * (np.cos(angle) * a + np.sin(angle) * b)
            interaction = mi.SurfaceInteraction3f()
            interaction.wi = mi.Vector3f(*[float(-x) for x in direction])
            value = np.array(emitter.eval(interaction))
            total += value * np.sin(r) * (edge / rings) * (2 * np.pi / spokes)
    return total


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
    opacity = 1.0 - sun_transmittance(spec.clouds, sun_direction(spec))
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
