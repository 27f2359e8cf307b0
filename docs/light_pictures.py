"""Pictures of light and cameras, for docs/light.md; `docs/pictures.py` runs them.

light.jpg    light    one stand under other skies, in another season, in other bands, a panel each
weather_views.jpg    weather_views    one stand at dusk, by moonlight, in fog, rain and snow, a panel each
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from label_pictures import GAP_PX, PICTURES, ROOT, titled
from PIL import Image

from forestgen.dataset.exr import read_exr
from forestgen.dataset.tonemap import tone_map

HEIGHT_PX, COLUMNS = 300, 2
INFRARED = "near infrared, red, green as red, green, blue"
VIEW = "position_m: [60, -10, 3.2], look_at_m: [62, 60, 8], size_px: [450, 300], hfov_deg: 60"
PANELS = {
    "clear, noon": (f"{{{VIEW}}}", ("sky.sun={elevation_deg: 60, azimuth_deg: 180}",)),
    "overcast": (f"{{{VIEW}}}", ("sky.kind=overcast",)),
    "autumn, a low sun": (f"{{{VIEW}}}", ("plants.season=autumn", "sky.sun={elevation_deg: 12, azimuth_deg: 250}")),
    INFRARED: (f"{{{VIEW}, bands: drone_multispectral}}", ()),
}


SMALL = VIEW.replace("[450, 300]", "[240, 160]")
WEATHER_PANELS = {
    "dusk": ("sky.sun={elevation_deg: -5, azimuth_deg: 300}",),
    "moon": ("sky.sun={elevation_deg: -30}", "sky.moon={elevation_deg: 30, azimuth_deg: 120, illuminated: 1}"),
    "ground_fog": ("sky.sun={elevation_deg: 18, azimuth_deg: 10}", "weather=[{what: ground_fog, depth_m: 25}]"),
    "rain": ("sky.kind=overcast", "weather=[{what: rain, rate_mm_per_h: 25}]"),
    "snow_cover": ("plants.season=winter", "weather=[{what: snow_cover, depth_m: 0.2}]"),
}


def weather_views(scratch: Path) -> None:
    """One stand in other weather and light, a row."""
    panels = [
        titled(_preview(_rendered(scratch / f"weather-{name}", f"{{{SMALL}}}", settings)), name)
        for name, settings in WEATHER_PANELS.items()
    ]
    sheet = Image.new("RGB", (sum(one.width + GAP_PX for one in panels) - GAP_PX, panels[0].height), "white")
    left = 0
    for one in panels:
        sheet.paste(one, (left, 0))
        left += one.width + GAP_PX
    sheet.save(PICTURES / "weather_views.jpg", quality=86)
    sys.stdout.write(f"{PICTURES / 'weather_views.jpg'}\n")


def light(scratch: Path) -> None:
    """One stand, many ways to look at it."""
    rows: list[list[Image.Image]] = [[]]
    for k, (title, (camera, settings)) in enumerate(PANELS.items()):
        if len(rows[-1]) == COLUMNS:
            rows.append([])
        frame = _rendered(scratch / f"light-{k}", camera, settings)
        rows[-1].append(titled(_infrared(frame) if title == INFRARED else _preview(frame), title))
    width = max(sum(picture.width + GAP_PX for picture in row) for row in rows) - GAP_PX
    sheet = Image.new("RGB", (width, len(rows) * (HEIGHT_PX + GAP_PX) - GAP_PX), "white")
    for j, row in enumerate(rows):
        left = 0
        for picture in row:
            sheet.paste(picture, (left, j * (HEIGHT_PX + GAP_PX)))
            left += picture.width + GAP_PX
    sheet.save(PICTURES / "light.jpg", quality=86)
    sys.stdout.write(f"{PICTURES / 'light.jpg'}\n")


def _preview(frame: Path) -> np.ndarray:
    return np.asarray(Image.open(frame / "preview.png").convert("RGB"))


def _infrared(frame: Path) -> np.ndarray:
    light = read_exr(frame / "frame.exr")["radiance.denoised"]
    return tone_map(np.stack([light[name] for name in ("nir", "red", "green")], axis=-1))


def _rendered(folder: Path, camera: str, settings: tuple[str, ...]) -> Path:
    """The frame's folder."""
    every = (f"cameras=[{camera}]", "sky.clouds=none", "render.samples=32", *settings)
    words = [word for one in every for word in ("--set", one)]
    recipe = ROOT / "recipes" / "quickstart.yaml"
    subprocess.run([sys.executable, "-m", "forestgen", "render", str(recipe), "-o", str(folder), *words], check=True)
    return min(path.parent for path in folder.glob("train/*/preview.png"))
