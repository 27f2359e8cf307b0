"""A colour chart and a grey card in the recipe's own scene and light: is the renderer's colour right?

A board of 24 patches with known reflectances is rendered at 81 wavelengths, in the spectral and in the rgb mode. CIE
delta E 2000 compares each patch with colour-science; a light meter at the board's middle checks the grey card.

| key | |
|---|---|
| at | the board's middle x, y, z, metres, z above the ground; default over the site's middle, above all plants |
| normal | where the board looks: up, north, east, south, west, or a vector; default up |
| width_px | width of the chart's picture; default 96 |
| samples | light paths a pixel, of each light; default 64 |
| absolute_z | whether z counts from z = 0, not from the ground below |

Example: ``forestgen measure colour_chart RECIPE --out sheet.html``, or ``forestgen calibrate RECIPE``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress, Timings
from forestgen.core.randomness import child_seed
from forestgen.core.spectrum import Spectrum
from forestgen.instruments.calibration import (
    BOUND_MODES,
    CARD_BOUND,
    MAX_BOUND,
    MEAN_BOUND,
    MODES,
    Calibration,
    Check,
    PatchResult,
)
from forestgen.instruments.instrument import DirectionKey, Instrument, Point, PointKey
from forestgen.instruments.light_meter import LightMeter, place, read
from forestgen.recipe.fields import Flag, Section, Whole
from forestgen.render.cloud_shadow import check_far_clouds, near_base_of
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.irradiance import WAVELENGTHS_NM, ChartImages, measure, render_chart
from forestgen.render.skies.model import casts_shadows
from forestgen.scene import colour_checker as checker
from forestgen.scene.build import BuiltScene
from forestgen.scene.plan import Plan
from forestgen.scene.spec import Camera, Instances, SceneSpec

EVEN_BOUND = 0.05  # spread of the light over the board, above which a note reports its shadows
_ABOVE_PLANTS_M = 2.0
_IDENTITY_SAMPLES = 4
_FEWEST_PX = 16  # of a region
Floats = NDArray[np.float64]


class ColourChartKeys(Section):
    """Keys of a colour chart."""

    at: Annotated[PointKey | None, Field(description="The board's middle, metres. None: above all plants.")] = None
    normal: Annotated[DirectionKey, Field(description="Where the board looks.")] = (0.0, 0.0, 1.0)
    width_px: Annotated[Whole, Field(ge=64, le=1024, description="Width of the chart's picture.")] = 96
    samples: Annotated[Whole, Field(ge=4, le=65536, description="Light paths a pixel, of each light.")] = 64
    absolute_z: Annotated[Flag, Field(description="Count z from z = 0, not from the ground below.")] = False


class ColourChart(Instrument[ColourChartKeys, Calibration]):
    """A colour chart and a grey card."""

    name = "colour_chart"
    Parameters = ColourChartKeys
    endings = (".json", ".html")

    def check(self, plan: Plan, keys: ColourChartKeys) -> None:
        if keys.at is not None:
            place(plan.drawn, keys.at, above_ground=not keys.absolute_z)

    def measure(self, scene: BuiltScene, keys: ColourChartKeys, progress: Progress, timings: Timings) -> Calibration:
        drawn, at, above_ground = scene.drawn, keys.at, not keys.absolute_z
        if at is None:
            at, above_ground = _over_the_plants(scene.spec, drawn.recipe.site.size_m), False
        point, above_m = place(drawn, at, above_ground=above_ground)
        check_far_clouds(scene.spec, point)
        with timings("calibrate"):
            return measure_chart(
                scene.spec,
                point,
                keys.normal,
                above_ground_m=above_m,
                width_px=keys.width_px,
                samples=keys.samples,
                max_depth=drawn.recipe.render.max_depth,
                seed=child_seed(drawn.image_seed, "calibrate"),
                progress=progress,
            )


def measure_chart(
    spec: SceneSpec,
    point_m: Point,
    normal: Point,
    *,
    above_ground_m: float,
    width_px: int,
    samples: int,
    max_depth: int,
    seed: int,
    progress: Progress,
) -> Calibration:
    """The chart at a point of a scene."""
    point, towards = np.array(point_m), np.array(normal)
    camera = checker.camera(point, towards, width_px)
    charted = with_chart(spec, point, towards, camera)
    regions, notes = find_regions(charted, camera, progress)
    images = render_chart(charted, camera, samples=samples, max_depth=max_depth, seed=seed, progress=progress)
    paths = samples * width_px * 32
    light = measure(spec, point, towards, samples=paths, max_depth=max_depth, seed=seed, progress=progress)
    meter = read(light, point_m, above_ground_m, normal)
    return judge(images, regions, meter, notes, samples)


def with_chart(spec: SceneSpec, point_m: Floats, normal: Floats, camera: Camera) -> SceneSpec:
    """The scene with the chart as one more instance, the last one on the site, and the chart's camera alone."""
    old = spec.instances
    row, last = len(old) - old.outside, int(old.plant_id.max(initial=0))
    instances = Instances(
        exemplar=np.insert(old.exemplar, row, len(spec.exemplars)),
        transform=np.insert(old.transform, row, checker.transform(point_m, normal), axis=0),
        plant_id=np.insert(old.plant_id, row, last + 1),
        outside=old.outside,
    )
    return replace(
        spec,
        exemplars=(*spec.exemplars, checker.chart()),
        materials={**spec.materials, **checker.materials()},
        instances=instances,
        cameras=(camera,),
    )


def find_regions(spec: SceneSpec, camera: Camera, progress: Progress) -> tuple[NDArray[np.int64], list[str]]:
    """(H, W) region of each pixel that lies well inside of one, else -1; and notes.

    Raises `RecipeError`: something hides a patch from its camera.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    with progress.stage("identity", camera.size_px[1]) as advance:
        identity, surface = trace_identity(
            SceneTracer(spec, Timings()),
            camera,
            samples=_IDENTITY_SAMPLES,
            timer=Timings(),
            advance=advance,
            faces=True,
        )
    assert identity.exemplar is not None
    assert identity.face is not None
    board = len(spec.exemplars)  # the chart is the last; the pass counts from 1
    faces = checker.region_of_face()
    on_board = identity.exemplar == board
    region = np.where(on_board, faces[np.where(on_board, identity.face, 0)], -1)
    # A pixel and its neighbours, all of their samples; beyond the picture's edge lies no board.
    low = minimum_filter(region.min(axis=2), size=3, mode="constant", cval=-1)
    high = maximum_filter(region.max(axis=2), size=3, mode="constant", cval=-1)
    inside = np.where(low == high, low, -1)
    names = checker.region_names()
    pixels = np.bincount(inside[inside >= 0], minlength=len(names))
    hidden = float(1 - on_board[1:-1, 1:-1].mean())
    if (pixels < _FEWEST_PX).any():
        few = [names[k] for k in np.flatnonzero(pixels < _FEWEST_PX)]
        problem = "the colour chart is hidden from its camera, 0.8 m in front of it"
        got = f"{100 * hidden:.0f}% of it hidden, among it {', '.join(few[:3])}"
        hint = "choose another `at`, higher or in a gap; without `at` it lies above all plants"
        raise RecipeError(problem, parameter="at", expected="a place with free sight", got=got, hint=hint)
    notes = []
    if hidden > 0.001:
        notes.append(f"{100 * hidden:.1f}% of the chart is hidden from its camera; the rest of each patch was measured")
    lit = float(surface.sun_visible[inside >= 0].mean())
    if lit < 1 and casts_shadows(spec.sky):
        notes.append(
            "the sun does not reach the chart" if lit == 0 else f"the sun reaches {100 * lit:.0f}% of the chart"
        )
    return inside, notes


def judge(
    images: ChartImages, regions: NDArray[np.int64], meter: LightMeter, notes: Sequence[str], samples: int
) -> Calibration:
    """Compare the images with what the table and the light on the grey card ask for."""
    grey = checker.GREY_REGION
    radiance, _ = _means(images.wavelengths, regions)
    light = Spectrum(WAVELENGTHS_NM, np.pi * radiance[grey] / checker.GREY)
    white = checker.white_of(light)
    if not white.luminance_cd_per_m2 > 0:
        raise RecipeError("no light reaches the colour chart", parameter="at", hint="choose another place")
    scale = 100.0 / white.luminance_cd_per_m2
    pictures = {
        "wavelengths": scale * checker.xyz_of_radiance(WAVELENGTHS_NM, images.wavelengths),
        "spectral": scale * checker.xyz_of_colour(images.spectral),
        "rgb": scale * checker.xyz_of_colour(images.rgb),
    }
    measured = {mode: _means(picture, regions) for mode, picture in pictures.items()}
    expected = checker.expected_xyz(light)
    differences = {mode: checker.delta_e(xyz, expected, white.xy) for mode, (xyz, _) in measured.items()}
    patches = tuple(
        PatchResult(
            name,
            expected[k],
            {mode: xyz[k] for mode, (xyz, _) in measured.items()},
            {mode: float(difference[k]) for mode, difference in differences.items()},
            {mode: float(error[k, 1] / xyz[k, 1]) for mode, (xyz, error) in measured.items()},
        )
        for k, name in enumerate(checker.patches())
    )
    lux = float(np.pi * white.luminance_cd_per_m2)
    noise = 3 * meter.illuminance_lux.error / max(meter.illuminance_lux.value, 1e-9)
    checks = []
    for mode in BOUND_MODES:
        own = differences[mode][:grey]
        checks.append(Check(f"mean delta E 2000, {MODES[mode]}", float(own.mean()), MEAN_BOUND))
        checks.append(Check(f"max delta E 2000, {MODES[mode]}", float(own.max()), MAX_BOUND))
    apart = abs(lux / meter.illuminance_lux.value - 1)
    checks.append(Check("grey card and light meter differ by a share of", apart, CARD_BOUND + noise))
    unevenness, noise = _unevenness(pictures["wavelengths"][..., 1], regions)
    seen = list(notes)
    if unevenness > EVEN_BOUND + 4 * noise:
        seen.append(
            f"the light differs by {100 * unevenness:.0f}% over the chart, which shows as differences of colour"
        )
    return Calibration(
        point_m=meter.point_m,
        above_ground_m=meter.above_ground_m,
        normal=meter.normal,
        patches=patches,
        light=light,
        white=white,
        illuminance_lux=lux,
        meter=meter,
        unevenness=unevenness,
        checks=tuple(checks),
        notes=tuple(seen),
        picture=checker.shown(pictures["spectral"], white.xy),
        samples=samples,
    )


def _means(image: NDArray[Any], regions: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """(25, C) mean of each region, and its standard error by the scatter of pixels."""
    mean = np.empty((checker.GREY_REGION + 1, image.shape[-1]))
    error = np.empty_like(mean)
    for k in range(len(mean)):
        pixels = image[regions == k].astype(np.float64)
        mean[k] = pixels.mean(axis=0)
        error[k] = pixels.std(axis=0, ddof=1) / math.sqrt(len(pixels))
    return mean, error


def _unevenness(image: NDArray[Any], regions: NDArray[np.int64]) -> tuple[float, float]:
    """(highest - lowest) / mean of the grey card's light in six by four parts of the board, and a part's noise."""
    rows, columns = np.nonzero(regions == checker.GREY_REGION)
    height, width = regions.shape
    part = rows * checker.ROWS // height * checker.COLUMNS + columns * checker.COLUMNS // width
    values = [image[rows[part == k], columns[part == k]] for k in np.unique(part)]
    means = np.array([value.mean() for value in values])
    errors = [value.std() / math.sqrt(len(value)) for value in values]
    return float((means.max() - means.min()) / means.mean()), float(np.mean(errors) / means.mean())


def _over_the_plants(spec: SceneSpec, size_m: tuple[float, float]) -> Point:
    """Over the site's middle, above all plants."""
    width, depth = size_m
    top = float(spec.terrain.mesh.vertices_m[spec.terrain.far_share == 0, 2].max(initial=0.0))
    for index in np.unique(spec.instances.exemplar):
        low, high = spec.exemplars[index].bounds_m()
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1)
        rows = spec.instances.transform[spec.instances.exemplar == index][:, 2]
        top = max(top, float((rows[:, :3] @ corners + rows[:, 3:]).max()))
    base_m = near_base_of(spec)
    if base_m is not None:
        top = min(top, max(base_m - 2 * _ABOVE_PLANTS_M, 0.0))
    return width / 2, depth / 2, top + _ABOVE_PLANTS_M


INSTRUMENT = ColourChart()
