"""The biomes that two numbers choose: biomes.jpg, the view of every recipe of recipes/biomes under its climate.

Run by `docs/pictures.py biomes`: ten minutes.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from forestgen.recipe.load import load_recipe

ROOT = Path(__file__).parents[1]
BIOMES = (
    "desert", "savanna", "grassland", "shrubland", "tundra",
    "boreal", "temperate_seasonal", "temperate_rain", "tropical_seasonal", "tropical_rain",
)  # fmt: skip
COLUMNS = 2
VIEW_PX = (640, 400)
CAPTION_PX = 26


def biomes(scratch: Path) -> None:
    tiles = [np.asarray(tile(name, scratch / name)) for name in BIOMES]
    rows = [np.concatenate(tiles[k : k + COLUMNS], axis=1) for k in range(0, len(tiles), COLUMNS)]
    path = ROOT / "docs" / "pictures" / "biomes.jpg"
    Image.fromarray(np.concatenate(rows, axis=0)).save(path, quality=85, optimize=True)
    sys.stdout.write(f"{path}\n")


def tile(name: str, folder: Path) -> Image.Image:
    """A biome's view under its name and climate."""
    recipe = ROOT / "recipes" / "biomes" / f"{name}.yaml"
    settings = ("--set", f"cameras.0.size_px=[{VIEW_PX[0]}, {VIEW_PX[1]}]")
    subprocess.run([sys.executable, "-m", "forestgen", "render", recipe, "-o", folder, *settings], check=True)
    climate = load_recipe(recipe).draw(0).data["community"]["biome"]
    out = Image.new("RGB", (VIEW_PX[0], VIEW_PX[1] + CAPTION_PX), "white")
    out.paste(Image.open(next(folder.glob("train/*/preview.png"))).convert("RGB"), (0, CAPTION_PX))
    warm, wet = climate["temperature_c"], climate["precipitation_mm_per_yr"]
    text = f"{name.replace('_', ' ')}: {warm:g} °C, {wet:,.0f} mm a year"
    ImageDraw.Draw(out).text((6, 5), text, fill="#222222", font=ImageFont.load_default(14))
    return out
