"""A light meter at points of a recipe's site: illuminance, colour, photons for plants, spectra.

A flat meter with a cosine response, which sees all directions above it: the sun, the sky, and what plants and ground
scatter. Each value has the standard error of eight independent replicates.

| key | |
|---|---|
| at | points x, y, z in metres, z above the ground |
| normals | where the meter looks at each point: up, down, north, east, south, west, or a vector; default up |
| samples | light paths of each light at each wavelength; default 16384 |
| absolute_z | whether z counts from z = 0, not from the ground below |
| spectrum | steps, nm, in which the spectral irradiance is reported, 300 to 2500 nm |

Example: ``forestgen measure light_meter RECIPE --key "at=[[30, 40, 1.5]]"``; or, for short,
``forestgen light RECIPE --at 30 40 1.5``.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.atmosphere.clouds.source import cloud_source_of
from forestgen.atmosphere.daylight import illuminance
from forestgen.core.errors import RecipeError
from forestgen.core.figures import count, table_lines
from forestgen.core.progress import Progress, Timings
from forestgen.core.randomness import child_seed
from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.instruments.instrument import DirectionsKey, Instrument, Point, PointsKey, Reading
from forestgen.recipe.fields import Flag, Number, Section, Whole
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.render.cloud_shadow import check_far_clouds
from forestgen.render.irradiance import REPLICATES, PointLight, measure
from forestgen.scene.build import BuiltScene
from forestgen.scene.colour_checker import temperature_of
from forestgen.scene.plan import Plan
from forestgen.scene.site import height_field

MOST_POINTS = 1000
_FARTHEST_M = 5000.0
_PHOTONS_UMOL_PER_J_NM = 1e-9 / (6.62607015e-34 * 299_792_458.0 * 6.02214076e23) * 1e6  # over h c N_A
_PAR_NM = (400.0, 700.0)
_INSIDE_LUX = 1e-3
_STEP_NM = 10.0  # of the spectra in a file, where none is asked for
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Quantity:
    """A mean and its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class LightMeter:
    """What a meter at a point reads. Shares are of the illuminance."""

    point_m: Point  # world
    above_ground_m: float
    normal: Point  # unit, of the surface that the light falls on
    illuminance_lux: Quantity
    from_sun: Quantity  # share that comes straight from the sun
    from_sky: Quantity  # straight from the sky and its clouds; the rest was scattered by plants and ground
    illuminance_colour_mode_lux: Quantity  # by the renderer's colour mode instead of wavelengths
    cct_k: Quantity  # correlated colour temperature; NaN where the light is too far from a black body's
    duv: float  # distance from the Planckian locus, positive is greenish
    par_umol_per_m2_s: Quantity  # photons of 400 to 700 nm
    irradiance_w_per_m2: Quantity  # 300 to 2500 nm
    spectrum: Spectrum = field(repr=False)  # W/m²/nm
    spectrum_error: Spectrum = field(repr=False)
    note: str | None = None


class LightMeterKeys(Section):
    """Keys of a light meter."""

    at: PointsKey = Field(min_length=1, max_length=MOST_POINTS, description="Points, metres, z above ground.")
    normals: DirectionsKey = Field(((0.0, 0.0, 1.0),), min_length=1, description="Where the meter looks at each point.")
    samples: Whole = Field(16384, ge=512, le=100_000_000, description="Light paths of each light at each wavelength.")
    absolute_z: Flag = Field(False, description="Count z from z = 0, not from the ground below.")
    spectrum: Number | None = Field(
        None, ge=1, le=1100, description="Steps of the reported spectra, nm. None: none are reported."
    )


class LightReadings(list[LightMeter], Reading):
    """Meters in the order of the points, and at each in that of the directions.

    `step_nm`: of the spectra in the text; None: it has none.
    `samples`: light paths of each light at each wavelength.
    """

    def __init__(self, meters: Iterable[LightMeter], step_nm: float | None = None, samples: int = 0) -> None:
        super().__init__(meters)
        self.step_nm, self.samples = step_nm, samples

    def __repr__(self) -> str:
        return f"<LightReadings: {count(len(self), 'meter')}>"

    def lines(self) -> Iterator[str]:
        """The table, what its columns mean, and notes."""
        yield from table_lines(_rows(self), names_left=False)
        yield "x, y and z (above ground) in metres; PAR: µmol/m²/s of 400 to 700 nm; W/m² of 300 to 2500 nm"
        yield "sun, sky: their direct shares of the lux; the rest was scattered by plants and ground; ± standard error"
        if self.step_nm is not None:
            yield from _spectra(self, self.step_nm)
        for number, meter in enumerate(self, start=1):
            if meter.note:
                yield f"note: point {number}: {meter.note}"

    def content(self, ending: str, loaded: LoadedRecipe) -> bytes:
        return _as_csv(self, self.step_nm) if ending == ".csv" else _as_json(self, loaded)


class LightAtPoints(Instrument[LightMeterKeys, LightReadings]):
    """Light meters at points."""

    name = "light_meter"
    Parameters = LightMeterKeys
    endings = (".csv", ".json")

    def check(self, plan: Plan, keys: LightMeterKeys) -> None:
        for point in keys.at:
            place(plan.drawn, point, above_ground=not keys.absolute_z)

    def measure(self, scene: BuiltScene, keys: LightMeterKeys, progress: Progress, timings: Timings) -> LightReadings:
        drawn = scene.drawn
        places = [place(drawn, point, above_ground=not keys.absolute_z) for point in keys.at]
        for world_m, _ in places:
            check_far_clouds(scene.spec, world_m)
        meters = []
        with progress.stage("points", len(places) * len(keys.normals)) as advance:
            for number, (world_m, above_m) in enumerate(places):
                for normal in keys.normals:
                    with timings("light"):
                        light = measure(
                            scene.spec,
                            np.array(world_m),
                            np.array(normal),
                            samples=keys.samples,
                            max_depth=drawn.recipe.render.max_depth,
                            seed=child_seed(drawn.image_seed, "light", number),
                            progress=progress,
                        )
                    meters.append(read(light, world_m, above_m, normal))
                    advance(1)
        return LightReadings(meters, keys.spectrum, keys.samples)


def place(drawn: DrawnRecipe, point: Point, *, above_ground: bool) -> tuple[Point, float]:
    """A point in the world, and its height above ground.

    Raises `RecipeError`: it lies far away, below the ground or in the clouds.
    """
    said = " ".join(f"{value:g}" for value in point)
    recipe = drawn.recipe
    width, depth = recipe.site.size_m
    beyond = max(-point[0], point[0] - width, -point[1], point[1] - depth, 0.0)
    if not (all(math.isfinite(value) for value in point) and max(beyond, abs(point[2])) <= _FARTHEST_M):
        expected = f"metres, within {_FARTHEST_M:,.0f} m of the site, which is {width:g} x {depth:g} m"
        raise RecipeError("this is no point of the site", parameter="at", expected=expected, got=said)
    ground_m = float(height_field(drawn)(np.array(point[0]), np.array(point[1])))
    z = point[2] + (ground_m if above_ground else 0.0)
    if z <= ground_m:
        problem = "this point does not lie above the ground"
        expected = "z above 0" if above_ground else f"z above {ground_m:.3f} m"
        hint = "z counts from the ground below; with `absolute_z` from z = 0"
        raise RecipeError(problem, parameter="at", expected=expected, got=said, hint=hint)
    base_m = cloud_source_of(drawn).known_base_m(drawn)
    if base_m is not None and z >= base_m:
        expected = f"z below {base_m:g} m"
        raise RecipeError("this point lies in or above the clouds", parameter="at", expected=expected, got=said)
    return (point[0], point[1], z), z - ground_m


def read(light: PointLight, point_m: Point, above_m: float, normal: Point) -> LightMeter:
    """Quantities of a measured light, each with the standard error of its replicates."""
    wavelength = light.wavelength_nm
    spectra = [Spectrum(wavelength, row) for row in light.spectral]
    lux = np.array([illuminance(one) for one in spectra])
    mean = Spectrum(wavelength, light.spectral.mean(axis=0))
    dark = not lux.mean() > _INSIDE_LUX
    cct, duv = (math.nan, math.nan) if dark else temperature_of(mean)
    scatter = np.array([temperature_of(one)[0] for one in spectra] if math.isfinite(cct) else [math.nan] * 2)
    length = math.sqrt(sum(value * value for value in normal))
    visible = (wavelength >= _PAR_NM[0]) & (wavelength <= _PAR_NM[1])
    photons = light.spectral * wavelength * _PHOTONS_UMOL_PER_J_NM
    return LightMeter(
        point_m=point_m,
        above_ground_m=above_m,
        normal=(normal[0] / length, normal[1] / length, normal[2] / length),
        illuminance_lux=quantity(lux),
        from_sun=_share(light.sun_lux, np.asarray(light.colour @ LUMINANCE)),
        from_sky=_share(light.sky_lux, np.asarray(light.colour @ LUMINANCE)),
        illuminance_colour_mode_lux=quantity(np.asarray(light.colour @ LUMINANCE)),
        cct_k=Quantity(cct, quantity(scatter).error),
        duv=duv,
        par_umol_per_m2_s=quantity(_integral(photons[:, visible], wavelength[visible])),
        irradiance_w_per_m2=quantity(_integral(light.spectral, wavelength)),
        spectrum=mean,
        spectrum_error=Spectrum(wavelength, light.spectral.std(axis=0, ddof=1) / math.sqrt(REPLICATES)),
        note="no light reaches this point: it lies inside of something" if dark else None,
    )


def quantity(replicates: NDArray[Any]) -> Quantity:
    """Mean and standard error of (K,) replicates."""
    return Quantity(float(replicates.mean()), float(replicates.std(ddof=1) / math.sqrt(len(replicates))))


def _integral(rows: Floats, wavelength_nm: Floats) -> Floats:
    """(K,) of each row over wavelength."""
    return np.asarray(np.trapezoid(rows, wavelength_nm, axis=1))


def _share(part: Floats, whole: Floats) -> Quantity:
    """A ratio of means; its error by the delta method, since both come from the same replicates."""
    mean = float(whole.mean())
    if mean <= 0:
        return Quantity(0.0, 0.0)
    ratio = float(part.mean()) / mean
    return Quantity(ratio, quantity(part - ratio * whole).error / mean)


def sampled(meter: LightMeter, step_nm: float) -> list[tuple[float, float, float]]:
    """Wavelength, spectral irradiance and its error at equal steps: means over each step, so that sums are kept."""
    edges = np.arange(300.0, 2500.0 + 1e-9, step_nm)
    rows = []
    for low, high in itertools.pairwise(edges):
        inside = meter.spectrum.wavelength_nm
        grid = np.unique(np.concatenate([[low, high], inside[(inside > low) & (inside < high)]]))
        value, error = (
            float(np.trapezoid(one.at(grid), grid) / (high - low)) for one in (meter.spectrum, meter.spectrum_error)
        )
        rows.append(((low + high) / 2, value, error))
    return rows


def _as_json(meters: LightReadings, loaded: LoadedRecipe) -> bytes:
    """All that was measured, spectra included."""
    from forestgen.dataset.manifest import package_versions

    def plain(meter: LightMeter) -> dict[str, Any]:
        rows = sampled(meter, meters.step_nm or _STEP_NM)
        data = asdict(meter)
        for name in ("spectrum", "spectrum_error"):
            del data[name]
        data["spectral_irradiance"] = {
            "unit": "W m-2 nm-1, mean over each step",
            "wavelength_nm": [row[0] for row in rows],
            "value": [row[1] for row in rows],
            "error": [row[2] for row in rows],
        }
        return dict(_without_nan(data))

    content = {
        "schema": "forestgen-light/1",
        "recipe_hash": loaded.hash,
        "samples": meters.samples,
        "versions": package_versions(),
        "points": [plain(meter) for meter in meters],
    }
    return (json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


def _without_nan(value: Any) -> Any:
    """JSON has no NaN: null stands for it."""
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _as_csv(meters: Sequence[LightMeter], step_nm: float | None) -> bytes:
    """A row a point; with `step_nm` a column for each step of the spectrum, in W/m²/nm."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [one.name for one in fields(LightMeter) if one.type == "Quantity"]
    header = ["x_m", "y_m", "z_m", "above_ground_m", "normal_x", "normal_y", "normal_z", "duv"]
    header += [column for name in names for column in (name, f"{name}_error")]
    if step_nm is not None and meters:
        header += [f"e_{row[0]:g}_nm" for row in sampled(meters[0], step_nm)]
    writer.writerow(header)
    for meter in meters:
        row = [*meter.point_m, meter.above_ground_m, *meter.normal, meter.duv]
        for name in names:
            one: Quantity = getattr(meter, name)
            row += [one.value, one.error]
        if step_nm is not None:
            row += [value for _, value, _ in sampled(meter, step_nm)]
        writer.writerow(["" if math.isnan(value) else f"{value:.7g}" for value in row])
    return text.getvalue().encode()


def _rows(meters: Sequence[LightMeter]) -> list[list[str]]:
    turned = {meter.normal for meter in meters} != {(0.0, 0.0, 1.0)}
    rows = [
        ["x", "y", "z", *(["normal"] if turned else []), "lux", "sun", "sky", "scattered", "CCT (K)", "PAR", "W/m²"]
    ]
    for meter in meters:
        scattered = 1.0 - meter.from_sun.value - meter.from_sky.value
        shares = (meter.from_sun.value, meter.from_sky.value, scattered)
        rows.append(
            [
                *(f"{value:g}" for value in meter.point_m[:2]),
                f"{meter.above_ground_m:.2f}",
                *([",".join(f"{value:.2g}" for value in meter.normal)] if turned else []),
                with_error(meter.illuminance_lux),
                *(f"{100 * max(share, 0.0):.1f}%" for share in shares),
                "none" if math.isnan(meter.cct_k.value) else with_error(meter.cct_k),
                with_error(meter.par_umol_per_m2_s),
                with_error(meter.irradiance_w_per_m2),
            ]
        )
    return rows


def _spectra(meters: Sequence[LightMeter], step_nm: float) -> Iterator[str]:
    columns = [sampled(meter, step_nm) for meter in meters]
    rows = [["nm", *(f"point {number + 1}" for number in range(len(meters)))]]
    rows += [[f"{row[0][0]:g}", *(f"{value:.4g}" for _, value, _ in row)] for row in zip(*columns, strict=True)]
    yield ""
    yield from table_lines(rows, names_left=False)
    yield "W/m²/nm, means over each step"


def with_error(one: Quantity) -> str:
    """A value to at most five digits and no more than its error leaves, and that error."""
    value, error = one.value, one.error
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    places = 4 - math.floor(math.log10(abs(value)))
    if not (math.isfinite(error) and error > 0):
        return _plain(value, places)
    places = min(places, 1 - math.floor(math.log10(error)))
    return f"{_plain(value, places)} ± {_plain(max(error, 10.0**-places), places)}"


def _plain(value: float, places: int) -> str:
    """Rounded to decimal places; a negative number of them rounds to tens, hundreds, ..."""
    return f"{round(value, places):,.{max(places, 0)}f}"


INSTRUMENT = LightAtPoints()
