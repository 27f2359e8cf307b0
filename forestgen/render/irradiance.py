"""Light at points of a scene, and colour charts in it: under each of its lights alone, wavelength by wavelength.

Light at a point is what a flat sensor with a cosine response would measure there. A white Lambertian patch of 2 mm lies
at the point and a camera 2 mm above looks at it: its radiance is E / pi. So the renderer's own path tracer measures
irradiance with the light samples that it takes on plants, the sun's disc included.

Sun and sky shine in scenes of their own. At a wavelength each gives its transfer factor

    T(lambda) = E(lambda) / S(lambda),    S the light's spectrum in the open

which varies slowly with the wavelength, as reflectances do, where E and S have the lines and bands of the atmosphere.
So T is measured at 33 wavelengths from 300 to 2500 nm, straight lines between them, and E = T_sun S_sun + T_sky S_sky
has the full resolution of the spectra. All wavelengths of a replicate follow the same random numbers: noise moves a
spectrum up and down and hardly bends it. Standard errors come from the scatter of independent replicates.

A colour chart is rendered at 81 wavelengths, and as images in both of the renderer's modes, sun and sky apart and
added. The image of the spectral mode is made of eight replicates with the nodes and weights of any image's
(render/wavelengths.py), whose places in the strata follow each other by the golden ratio: that all but removes the
noise of the choice of wavelengths. The image of the colour mode is one pass in linear Rec. 709.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng, child_seed
from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.render import sky as cloudy_sky
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import capture, film
from forestgen.render.cloud_shadow import shadow_rectangle
from forestgen.render.light import has_sun, sky_light, sun_disc
from forestgen.render.skies.model import daylight_of
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import BLOCK_PX, ROULETTE_DEPTH, SAMPLER, SCALAR, interruptible, mi, path_tracer, using
from forestgen.render.wavelengths import ColourBySpectrum
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.colour_checker import axes_of
from forestgen.scene.spec import Camera, SceneSpec

REPLICATES = 8  # of a measurement, and of a chart's spectral mode
NODES_NM = np.concatenate(
    [[300.0, 340.0], np.arange(380.0, 781.0, 20.0), [860, 950, 1050, 1250, 1450, 1650, 1800, 2000, 2250, 2500]]
)
_PATCH_M = 1e-3  # half its side
_PIXELS, _BLOCK_PX = 8, 2  # along the side of the picture of the patch; blocks are shared out to threads
Floats = NDArray[np.float64]
Emitter = Callable[[Channels], dict[str, Any]]
WAVELENGTHS_NM = np.arange(380.0, 781.0, 5.0)  # the colour matching functions' own table has steps of 5 nm (CIE 15)


@dataclass(frozen=True)
class Source:
    """One of the lights of a scene."""

    name: Literal["sun", "sky"]
    spectrum: Spectrum  # W/m²/nm, of the light in the open
    emitter: Emitter  # a dictionary of Mitsuba's
    beside: Mapping[str, Any] = field(default_factory=dict)  # what only this light meets: the shadow under clouds
    roulette_from: int = ROULETTE_DEPTH  # scattering from which on weak paths may be dropped


def sources_of(spec: SceneSpec, origin_m: Floats) -> list[Source]:
    """Sun and sky of a scene, as they are at a point. Call it in the scalar variant."""
    light = daylight_of(spec.sky)
    sky: Emitter = lambda channels: sky_light(spec.sky, channels)  # noqa: E731
    beside: dict[str, Any] = {}
    spectrum = light.sky
    if spec.clouds is not None:
        sky = cloudy_sky.baked_sky(cloudy_sky.traced_clouds_of(spec), origin_m).light
        shadow = shadow_rectangle(spec, origin_m)
        beside = {} if shadow is None else {"shadow": shadow}
        spectrum = light.on_level  # clouds pass on the sun's light
    sources = [Source("sky", spectrum, sky)]
    if has_sun(spec.sky):
        sources.append(Source("sun", light.sun, lambda channels: sun_disc(spec.sky, channels), beside))
    return sources


class Lit:
    """A scene under each of several lights alone, in the scalar variant; its channels change in place."""

    def __init__(
        self, spec: SceneSpec, origin_m: Floats, sources: Sequence[Source], more: Mapping[str, Any] | None = None
    ) -> None:
        self.sources = tuple(sources)
        bsdfs = SpectralBsdfs()
        self.show = bsdfs.repaint
        plants = scene_dict(spec, origin_m, bsdfs)  # meshes are shared, instances belong to one scene each
        self.scenes = [
            load({**plants, "light": bsdfs.add(source.emitter), **source.beside, **(more or {})}) for source in sources
        ]

    def integrator(self, row: int, *, max_depth: int, block_px: int) -> Any:
        """For the scene under `sources[row]`."""
        # `path` takes a partly transparent shadow for opaque when it looks for the sun; `volpath` sees through it.
        source = self.sources[row]
        kind = "volpath" if "shadow" in source.beside else "path"
        return path_tracer(kind, max_depth, rr_depth=source.roulette_from, block_size=block_px)


@dataclass(frozen=True, eq=False)
class PointLight:
    """Light on a small flat surface, by replicate (K)."""

    wavelength_nm: Floats  # (W,) 300 to 2500
    spectral: Floats  # (K, W) irradiance, W/m²/nm
    colour: Floats  # (K, 3) of the colour mode, linear Rec. 709 in lux
    sun_lux: Floats  # (K,) straight from the sun
    sky_lux: Floats  # (K,) straight from the sky and its clouds


def measure(
    spec: SceneSpec,
    point_m: Floats,
    normal: Floats,
    *,
    samples: int,
    max_depth: int,
    seed: int,
    progress: Progress,
) -> PointLight:
    """Light at one point (3,) of the world, on a surface with a normal (3,).

    `samples` are light paths of each light at each wavelength, all replicates together.
    """
    origin = np.asarray(point_m, dtype=np.float64)
    spp = max(1, round(samples / REPLICATES / _PIXELS**2))
    with using(SCALAR):
        sensor = _sensor(normal, spp)
        lights = sources_of(spec, origin)
        lit = Lit(spec, origin, lights, {"meter": _patch(normal)})

        def shoot(row: int, depth: int) -> Floats:
            """(K, 3) irradiance."""
            name = lights[row].name
            seeds = [child_seed(seed, name, k) for k in range(REPLICATES)]
            integrator = lit.integrator(row, max_depth=depth, block_px=_BLOCK_PX)
            images = [interruptible(integrator, lit.scenes[row], sensor, one, spp)[..., :3] for one in seeds]
            return np.asarray(np.pi * np.mean(images, axis=(1, 2), dtype=np.float64))

        passes = passes_at(NODES_NM)
        factor = np.empty((len(lights), REPLICATES, len(NODES_NM)))
        with progress.stage("light", (len(passes) + 2) * len(lights)) as advance:
            rows = range(len(lights))
            colour = sum((shoot(row, max_depth) for row in rows), np.zeros((REPLICATES, 3)))
            direct = {lights[row].name: shoot(row, 2) @ LUMINANCE for row in rows}
            advance(2 * len(lights))
            for nodes, channels in passes:
                lit.show(channels)
                for row in rows:
                    with np.errstate(divide="ignore", invalid="ignore"):
                        open_light = lights[row].spectrum.at(NODES_NM[nodes])
                        factor[row][:, nodes] = shoot(row, max_depth) / open_light
                    advance(1)
    grid = _grid(lights)
    parts = [_between(factor[row], grid) * lights[row].spectrum.at(grid) for row in rows]
    none = np.zeros(REPLICATES)
    return PointLight(grid, np.sum(parts, axis=0), colour, direct.get("sun", none), direct.get("sky", none))


def passes_at(wavelength_nm: Floats) -> list[tuple[NDArray[np.intp], Channels]]:
    """Rows of (3 N,) wavelengths, three by three, and the channels of these: short, middle and long ones in each."""
    passes = []
    for rows in np.arange(len(wavelength_nm)).reshape(3, -1).T:
        short, middle, long = wavelength_nm[rows].tolist()
        passes.append((rows, Channels((short, middle, long))))
    return passes


def _grid(lights: Sequence[Source]) -> Floats:
    """Wavelengths of all spectra and of the nodes, 300 to 2500 nm, no two further apart than 5 nm where eyes see."""
    every = np.concatenate([NODES_NM, WAVELENGTHS_NM, *(source.spectrum.wavelength_nm for source in lights)])
    return np.unique(every[(every >= NODES_NM[0]) & (every <= NODES_NM[-1])])


def _between(factor: Floats, wavelength_nm: Floats) -> Floats:
    """(K, W) straight lines between the nodes where the light in the open is not dark."""
    known = np.isfinite(factor).all(axis=0)
    if not known.any():
        return np.zeros((len(factor), len(wavelength_nm)))
    return np.stack([np.interp(wavelength_nm, NODES_NM[known], row[known]) for row in factor])


def _patch(normal: Floats) -> dict[str, Any]:
    """White above and black below."""
    matrix = np.eye(4)
    matrix[:3, :3] = axes_of(normal) * _PATCH_M
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": white}


def _sensor(normal: Floats, spp: int) -> Any:
    """A camera that sees the patch and nothing else."""
    right, up, towards = axes_of(normal).T
    matrix = np.eye(4)
    matrix[:3] = np.stack([-right, up, -towards, 2 * _PATCH_M * towards], axis=1)
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(0.45))),
            "near_clip": 1e-4,
            "far_clip": 1.0,
            "to_world": mi.ScalarTransform4f(matrix),
            "film": film((_PIXELS, _PIXELS), pixel_format="rgb"),
            "sampler": {"type": SAMPLER, "sample_count": spp},
        }
    )


@dataclass(frozen=True, eq=False)
class ChartImages:
    """What a camera sees."""

    wavelengths: NDArray[np.float32]  # (H, W, 81) W/m²/sr/nm
    spectral: NDArray[np.float32]  # (H, W, 3) of the spectral mode, linear Rec. 709 in cd/m²
    rgb: NDArray[np.float32]  # (H, W, 3) of the colour mode, likewise


def render_chart(
    spec: SceneSpec, camera: Camera, *, samples: int, max_depth: int, seed: int, progress: Progress
) -> ChartImages:
    """Render `camera`'s view under the scene's lights.

    `samples` are those of each pixel by each light in each mode's image; a quarter of them at each of 81 wavelengths.
    """
    origin = origin_of(camera)
    with using(SCALAR):
        lights = sources_of(spec, origin)
        lit = Lit(spec, origin, lights)
        integrators = [lit.integrator(row, max_depth=max_depth, block_px=BLOCK_PX) for row in range(len(lights))]
        threes, passes = passes_at(WAVELENGTHS_NM), ColourBySpectrum().passes
        fewer = max(1, samples // 4)

        def view(channels: Channels, count: int, name: str, *number: int) -> Floats:
            lit.show(channels)
            images = [
                capture(integrator, scene, camera, samples=count, seed=child_seed(seed, name, source.name, *number))
                for integrator, scene, source in zip(integrators, lit.scenes, lights, strict=True)
            ]
            advance(1)
            return np.asarray(np.sum(images, axis=0)[..., :3])

        with progress.stage("chart", 1 + REPLICATES * passes + len(threes)) as advance:
            rgb = view(RGB, samples, "rgb")
            spectral = np.zeros_like(rgb)
            for replicate in range(REPLICATES):
                for index, one in enumerate(ColourBySpectrum().draw(child_rng(seed, "wavelengths"), replicate)):
                    few = max(1, round(samples / REPLICATES / passes))
                    spectral += view(one.channels, few, "spectral", replicate, index) @ one.weight.T / REPLICATES
            wavelengths = np.empty((*rgb.shape[:2], len(WAVELENGTHS_NM)), dtype=np.float32)
            for rows, channels in threes:
                # All wavelengths follow the same random numbers: noise does not bend spectra.
                wavelengths[..., rows] = view(channels, fewer, "wavelengths")
    return ChartImages(wavelengths, spectral.astype(np.float32), rgb.astype(np.float32))
