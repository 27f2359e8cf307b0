"""Pictures of the air, for docs/clouds.md; `docs/pictures.py` runs them.

weather_profiles.png    weather_profiles    four skies: a thermal and the air around it by height, and their cloud
weather_story.png       weather_story       recipes/weather_story.yaml: its eight skies, cut through and from below
weather_cumulus.jpg     weather_cumulus     recipes/weather_cumulus.yaml, rendered
cloud_detail.jpg        cloud_detail        its clouds from below, without detail and with it
"""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from support.parcel import FIG24, Profiles, Sky, thermal_profiles

PICTURES = Path(__file__).parent / "pictures"
DPI, MOST_BYTES, COLOURS = 110, 400_000, 64
INK, FAINT, AIR, THERMAL, LIMIT, CLOUD = "#22302A", "#8A938E", "#2F6DA8", "#C2452D", "#6B7A3A", "#DDE5EC"
SHOWN_M = {"fog": 60.0, "stratocumulus": 2500.0, "cumulus": 3000.0, "cumulonimbus": 10_000.0}


@dataclass(frozen=True)
class Column:
    """One quantity: what it is called, and its curves."""

    title: str
    curves: Callable[[Profiles], list[tuple[NDArray[np.float64], str, str]]]  # values, colour, dashes
    from_zero: bool = False


COLUMNS = (
    Column(
        "temperature, °C",
        lambda p: [(p.air_temperature_k - 273.15, AIR, "-"), (p.thermal_temperature_k - 273.15, THERMAL, "-")],
    ),
    Column(
        "density, kg/m³",
        lambda p: [(p.air_density_kg_per_m3, AIR, "-"), (p.thermal_density_kg_per_m3, THERMAL, "-")],
    ),
    Column("buoyancy, m/s²", lambda p: [(p.buoyancy_m_per_s2, THERMAL, "-")]),
    Column(
        "vapour, g/kg",
        lambda p: [
            (1000 * p.air_vapour, AIR, "-"),
            (1000 * p.thermal_vapour, THERMAL, "-"),
            (1000 * p.saturation, LIMIT, "--"),
        ],
        from_zero=True,
    ),
    Column(
        "relative humidity, %",
        lambda p: [(100 * p.air_relative_humidity, AIR, "-"), (100 * p.thermal_relative_humidity, THERMAL, "-")],
        from_zero=True,
    ),
)


def weather_profiles(_: Path) -> None:
    """Rows of skies, columns of quantities; a band where the cloud is (the seeds' Fig. 24)."""
    figure = Figure(figsize=(11.5, 12.2), facecolor="white")
    axes = figure.subplots(len(FIG24), len(COLUMNS), sharey="row")
    figure.subplots_adjust(left=0.05, right=0.985, top=0.94, bottom=0.04, wspace=0.13, hspace=0.37)
    for row, (name, sky) in zip(axes, FIG24.items(), strict=True):
        _draw_sky(row, name, sky)
    _draw_legend(figure)
    _save(figure, "weather_profiles.png")


def _draw_sky(row: NDArray[np.object_], name: str, sky: Sky) -> None:
    top = SHOWN_M[name]
    cloud = sky.prediction()
    profiles = thermal_profiles(sky.sounding(), sky.thermal(), latent_heat=sky.latent_heat, top_m=top)
    unit, per = ("km", 1000.0) if top > 1000.0 else ("m", 1.0)
    height = profiles.height_m / per
    assert cloud.base_m is not None
    assert cloud.top_m is not None
    risen = profiles.height_m <= cloud.top_m
    for axis, column in zip(row, COLUMNS, strict=True):
        axis.axhspan(cloud.base_m / per, cloud.top_m / per, color=CLOUD, lw=0)
        for values, colour, dashes in column.curves(profiles):
            of_thermal = colour != AIR
            axis.plot(values[risen] if of_thermal else values, height[risen] if of_thermal else height, dashes,
                      color=colour, lw=1.7, solid_capstyle="round", zorder=3 if of_thermal else 2)  # fmt: skip
        _dress(axis, column)
        if column.from_zero and name != "fog":  # which differs too little from its air
            axis.set_xlim(left=0.0)
        axis.set_ylim(0.0, top / per)
    row[0].set_ylabel(f"height, {unit}")
    spread = "spreads under the inversion" if cloud.spreads and name == "cumulonimbus" else ""
    heat = "with latent heat" if sky.latent_heat else "latent heat off"
    figures = f"base {cloud.base_m:.0f} m, top {cloud.top_m:.0f} m"
    words = ", ".join(text for text in (figures, spread, heat) if text)
    row[0].set_title(f"{name[0].upper()}{name[1:]}", loc="left", fontsize=12, fontweight="bold", color=INK, pad=9)
    row[1].set_title(words, loc="left", fontsize=9.5, color=INK, pad=9)


def _dress(axis: Axes, column: Column) -> None:
    axis.set_xlabel(column.title, color=INK, fontsize=9.5)
    axis.tick_params(labelsize=8.5, colors=INK, length=3)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(FAINT)
    axis.yaxis.label.set(color=INK, fontsize=9.5)
    axis.locator_params(axis="x", nbins=5)
    if "buoyancy" in column.title:
        axis.axvline(0.0, color=FAINT, lw=0.9, zorder=1)
        axis.locator_params(axis="x", nbins=4)
    if "humidity" in column.title:
        axis.axvline(100.0, color=LIMIT, lw=1.3, ls="--", zorder=1)


def _draw_legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=THERMAL, lw=1.7, label="thermal, up to where it comes to rest"),
        Line2D([], [], color=AIR, lw=1.7, label="air at rest"),
        Line2D([], [], color=LIMIT, lw=1.5, ls="--", label="saturation of the thermal"),
        Patch(color=CLOUD, label="cloud"),
    ]
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.035, 0.995),
        ncols=4,
        frameon=False,
        fontsize=10,
        labelcolor=INK,
    )


def _save(figure: Figure, name: str) -> None:
    stream = io.BytesIO()
    figure.savefig(stream, dpi=DPI)
    _save_few_colours(Image.open(stream), name)


def _save_few_colours(image: Image.Image, name: str) -> None:
    picture = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    path = PICTURES / name
    picture.save(path, optimize=True)
    assert path.stat().st_size <= MOST_BYTES, f"{name}: {path.stat().st_size:,} bytes"
    sys.stdout.write(f"{path}\n")


def weather_story(scratch: Path) -> None:
    """Some ten minutes the first time."""
    path = scratch / "story.png"
    recipe = PICTURES.parents[1] / "recipes" / "weather_story.yaml"
    subprocess.run([sys.executable, "-m", "forestgen", "weather", recipe, "--picture", path], check=True)
    save_story(path)


def save_story(path: Path) -> None:
    picture = Image.open(path)
    _save_few_colours(
        picture.resize((1100, round(picture.height * 1100 / picture.width)), Image.Resampling.LANCZOS),
        "weather_story.png",
    )


def weather_cumulus(scratch: Path) -> None:
    """Some four minutes the first time."""
    recipe = PICTURES.parents[1] / "recipes" / "weather_cumulus.yaml"
    subprocess.run([sys.executable, "-m", "forestgen", "render", recipe, "-o", scratch / "cumulus"], check=True)
    preview = next((scratch / "cumulus").glob("train/*/preview.png"))
    path = PICTURES / "weather_cumulus.jpg"
    Image.open(preview).convert("RGB").save(path, quality=88, optimize=True)
    sys.stdout.write(f"{path}\n")


def cloud_detail(scratch: Path) -> None:
    """Side by side; some three minutes the first time."""
    recipe = PICTURES.parents[1] / "recipes" / "weather_cumulus.yaml"
    camera = "{position_m: [40, 40, 30], look_at_m: [-10, 70, 85], size_px: [400, 300], hfov_deg: 45}"
    common = ["--set", f"cameras=[{camera}]", "--set", "community.steps=4", "--set", "render.samples=48"]
    parts = []
    for detail in ("false", "true"):
        out = scratch / f"detail-{detail}"
        clouds = f"sky.clouds={{type: cumulus, detail: {detail}}}"
        command = [sys.executable, "-m", "forestgen", "render", recipe, "-o", out, *common, "--set", clouds]
        subprocess.run(command, check=True)
        parts.append(np.asarray(Image.open(next(out.glob("train/*/preview.png"))).convert("RGB")))
    path = PICTURES / "cloud_detail.jpg"
    Image.fromarray(np.hstack(parts)).save(path, quality=88, optimize=True)
    sys.stdout.write(f"{path}\n")


PICTURES_OF = {one.__name__: one for one in (weather_profiles, weather_story, weather_cumulus, cloud_detail)}


if __name__ == "__main__":
    weather_profiles(Path())
