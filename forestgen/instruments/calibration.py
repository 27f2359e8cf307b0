"""What the colour chart measured: text, a sheet for people, numbers for programs, and the chart's picture."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum
from forestgen.dataset.files import write_bytes
from forestgen.dataset.manifest import package_versions
from forestgen.geometry.export import png
from forestgen.instruments.instrument import Point, Reading
from forestgen.instruments.light_meter import LightMeter
from forestgen.recipe.load import LoadedRecipe
from forestgen.scene import colour_checker as checker

SHEET, NUMBERS, PICTURE = "calibration.html", "calibration.json", "chart.png"
MODES = {"wavelengths": "81 wavelengths", "spectral": "spectral mode", "rgb": "rgb mode"}
BOUND_MODES = ("wavelengths", "spectral")
MEAN_BOUND, MAX_BOUND = 0.5, 1.5  # delta E 2000 of `BOUND_MODES`
CARD_BOUND = 0.02  # grey card against light meter, a share; and three standard errors
_PACKAGES = ("forestgen", "mitsuba", "drjit", "colour-science", "pvlib", "numpy")
_TEMPLATE = Path(__file__).with_name("calibration.html.jinja")
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PatchResult:
    """A patch: tristimulus values relative to a white of Y = 100, and by mode (see `MODES`) what became of them."""

    name: str
    expected_xyz: Floats  # (3,) by colour-science
    found_xyz: Mapping[str, Floats]  # (3,)
    delta_e: Mapping[str, float]
    error: Mapping[str, float]  # standard error of the luminance by the pixels' scatter, a share


@dataclass(frozen=True)
class Check:
    """A bound, and whether it holds."""

    name: str
    value: float
    bound: float

    @property
    def holds(self) -> bool:
        return bool(self.value < self.bound)


@dataclass(frozen=True, eq=False)
class Calibration(Reading):
    """All that was measured at a chart."""

    point_m: Point
    above_ground_m: float
    normal: Point
    patches: tuple[PatchResult, ...]
    light: Spectrum  # W/m²/nm on the board, by the grey card, at `chart_pass.WAVELENGTHS_NM`
    white: checker.White  # of that light
    illuminance_lux: float  # by the grey card
    meter: LightMeter  # at the board's middle, without the board
    unevenness: float  # of the light over the board: (highest - lowest) / mean of its 24 neighbourhoods
    checks: tuple[Check, ...]
    notes: tuple[str, ...]
    picture: NDArray[np.uint8]  # (H, W, 3) sRGB, of the spectral image
    samples: int  # light paths a pixel, of each light

    @property
    def holds(self) -> bool:
        return all(check.holds for check in self.checks)

    def delta_e(self, mode: str) -> Floats:
        """(24,) of a mode."""
        return np.array([patch.delta_e[mode] for patch in self.patches])

    @property
    def totals(self) -> dict[str, dict[str, float]]:
        """Mean and maximum of each mode's delta E."""
        return {
            mode: {"mean": float(self.delta_e(mode).mean()), "max": float(self.delta_e(mode).max())} for mode in MODES
        }

    def lines(self) -> Iterator[str]:
        x, y, _ = self.point_m
        yield f"chart at {x:g} {y:g}, {self.above_ground_m:.2f} m above the ground"
        yield f"{'delta E 2000':<24}" + "".join(f"{title:>16}" for title in MODES.values())
        for patch in self.patches:
            yield f"{patch.name:<24}" + "".join(f"{patch.delta_e[mode]:>16.2f}" for mode in MODES)
        for word in ("mean", "max"):
            yield f"{word:<24}" + "".join(f"{self.totals[mode][word]:>16.2f}" for mode in MODES)
        by_meter = self.meter.illuminance_lux
        yield (
            f"illuminance {self.illuminance_lux:,.0f} lux by the grey card, {by_meter.value:,.0f} ± "
            f"{by_meter.error:,.0f} by a light meter; {100 * self.meter.from_sun.value:.0f}% straight from the sun"
        )
        yield f"correlated colour temperature {_temperature(self.white)}, Duv {self.white.duv:+.4f}"
        for note in self.notes:
            yield f"note: {note}"

    def content(self, ending: str, loaded: LoadedRecipe) -> bytes:
        if ending == ".html":
            return _sheet(self, loaded).encode()
        text = json.dumps(_numbers(self, loaded), sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False)
        return (text + "\n").encode()


def write_calibration(folder: Path, found: Calibration, loaded: LoadedRecipe) -> None:
    """Write all files into a folder that is there."""
    write_bytes(folder / SHEET, found.content(".html", loaded))
    write_bytes(folder / NUMBERS, found.content(".json", loaded))
    write_bytes(folder / PICTURE, png(_enlarged(found.picture)))


def _numbers(found: Calibration, loaded: LoadedRecipe) -> dict[str, Any]:
    """All that was measured, as plain values."""
    meter = found.meter
    return {
        "schema": "forestgen-calibration/1",
        "holds": found.holds,
        "recipe": loaded.path.name,
        "recipe_hash": loaded.hash,
        "samples": found.samples,
        "versions": {name: package_versions()[name] for name in _PACKAGES},
        "chart": {
            "patches": checker.CHART,
            "point_m": list(found.point_m),
            "above_ground_m": found.above_ground_m,
            "normal": list(found.normal),
        },
        "checks": [{**asdict(one), "holds": one.holds} for one in found.checks],
        "delta_e_2000": found.totals,
        "light": {
            "illuminance_lux": found.illuminance_lux,
            "illuminance_by_meter_lux": meter.illuminance_lux.value,
            "illuminance_by_meter_error_lux": meter.illuminance_lux.error,
            "from_sun": meter.from_sun.value,
            "from_sky": meter.from_sky.value,
            "unevenness": found.unevenness,
            "cct_k": _number(found.white.cct_k),
            "duv": _number(found.white.duv),
            "white_xy": found.white.xy.tolist(),
            "wavelength_nm": found.light.wavelength_nm.tolist(),
            "irradiance_w_per_m2_nm": found.light.value.tolist(),
        },
        "patches": [
            {
                "name": patch.name,
                "expected_xyz": patch.expected_xyz.tolist(),
                "found_xyz": {mode: xyz.tolist() for mode, xyz in patch.found_xyz.items()},
                "delta_e_2000": dict(patch.delta_e),
                "luminance_error": {mode: _number(error) for mode, error in patch.error.items()},
            }
            for patch in found.patches
        ],
        "notes": list(found.notes),
    }


def _sheet(found: Calibration, loaded: LoadedRecipe) -> str:
    """The page, with all it needs inside."""
    from jinja2 import Environment, StrictUndefined

    x, y, _ = found.point_m
    facing = "level" if found.normal == (0.0, 0.0, 1.0) else "facing " + ", ".join(f"{one:.2f}" for one in found.normal)
    white, versions = found.white, package_versions()
    facts = [(f"{found.totals[mode]['mean']:.2f}", f"mean ΔE 2000, {title}") for mode, title in MODES.items()]
    facts += [
        (f"{found.illuminance_lux:,.0f} lx", "illuminance of the board"),
        (_temperature(white), f"correlated colour temperature, Duv {white.duv:+.4f}"),
        (f"{100 * found.meter.from_sun.value:.0f}%", "of it straight from the sun"),
    ]
    white_x, white_y = white.xy
    white_xyz = np.array([white_x / white_y, 1.0, (1 - white_x - white_y) / white_y]) * 100.0
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    return environment.from_string(_TEMPLATE.read_text(encoding="utf-8")).render(
        found=found,
        recipe=loaded.path.name,
        recipe_hash=loaded.hash,
        place=f"x {x:g} m, y {y:g} m, {found.above_ground_m:.2f} m above the ground, {facing}",
        facts=facts,
        modes=MODES,
        delta_e=found.totals,
        grey=_hex(checker.shown(white_xyz * checker.GREY, white.xy)),
        patches=[_drawn(k, patch, white.xy) for k, patch in enumerate(found.patches)],
        widest=max(1.0, *(one["max"] for one in found.totals.values())),
        picture=base64.b64encode(png(_enlarged(found.picture))).decode(),
        plot=_plot(found),
        chart=checker.CHART,
        grey_percent=f"{100 * checker.GREY:.0f}",
        card_percent=f"{100 * CARD_BOUND:.0f}",
        luminance_error=max(patch.error["spectral"] for patch in found.patches),
        bound_modes=[MODES[mode] for mode in BOUND_MODES],
        mean_bound=MEAN_BOUND,
        max_bound=MAX_BOUND,
        versions=", ".join(f"{name} {versions[name]}" for name in _PACKAGES),
    )


def _drawn(number: int, patch: PatchResult, white_xy: Floats) -> dict[str, Any]:
    """A patch as the sheet shows it: its place in the drawing, and colours as made and as they should be."""
    return {
        "name": patch.name,
        "x": 10 + 46 * (number % checker.COLUMNS),
        "y": 10 + 46 * (number // checker.COLUMNS),
        "made": _hex(checker.shown(patch.found_xyz["spectral"], white_xy)),
        "right": _hex(checker.shown(patch.expected_xyz, white_xy)),
        "delta_e": patch.delta_e,
        "y_expected": patch.expected_xyz[1],
        "y_made": patch.found_xyz["spectral"][1],
    }


def _plot(found: Calibration) -> str:
    """The light's spectrum as an inline SVG; wavelengths in their own colours below the visible part."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    spectrum, error = found.meter.spectrum, found.meter.spectrum_error
    with rc_context(
        {"svg.hashsalt": "forestgen", "font.family": "DejaVu Sans", "font.size": 10, "svg.fonttype": "path"}
    ):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        FigureCanvasSVG(figure)
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        wavelength, value, width = spectrum.wavelength_nm, spectrum.value, error.value
        for axes, (low, high) in ((left, (300, 2500)), (right, (380, 780))):
            axes.fill_between(wavelength, value - width, value + width, color="#2c7a4b", alpha=0.25, linewidth=0)
            axes.plot(wavelength, value, color="#2c7a4b", linewidth=1.2, label="light meter")
            axes.set(xlim=(low, high), ylim=(0, None), xlabel="wavelength (nm)")
            axes.spines[["top", "right"]].set_visible(False)
        right.plot(found.light.wavelength_nm, found.light.value, ".", color="#1d2521", markersize=3, label="grey card")
        right.legend(frameon=False)
        left.set_ylabel("W m$^{-2}$ nm$^{-1}$")
        top = float(np.max(spectrum.at(np.arange(380.0, 781.0)))) * 1.1
        right.set_ylim(-0.06 * top, top)
        right.imshow(_rainbow()[None], extent=(380, 780, -0.06 * top, 0), aspect="auto", interpolation="bilinear")
        right.set_xlim(380, 780)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _rainbow() -> NDArray[np.float64]:
    """(N, 3) sRGB of the wavelengths 380 to 780 nm, as a mark."""
    grid = np.arange(380.0, 781.0, 2.0)
    peak_nm, peak = np.array([-3.0, 0.0, 3.0]), np.array([0.0, 1.0, 0.0])
    xyz = np.array([checker.xyz_of_light(Spectrum(one + peak_nm, peak)) for one in grid])
    xyz /= xyz.sum(axis=1).max()
    rgb = np.clip(checker.shown(100 * np.clip(xyz, 0, None), np.array([0.3127, 0.329])) / 255.0, 0.0, 1.0)
    return np.asarray(rgb)


def _hex(code: NDArray[np.uint8]) -> str:
    return "#" + "".join(f"{int(one):02x}" for one in code)


def _enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(np.repeat(picture, 4, axis=0), 4, axis=1)


def _temperature(white: checker.White) -> str:
    return "none" if math.isnan(white.cct_k) else f"{white.cct_k:,.0f} K"


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
