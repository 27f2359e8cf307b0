"""The sixteen plant types of Makowski 2023, Table 1, each grown alone: the sheet plant_types.jpg (its Figure 6).

Each grew its own branches in the open, for so many years, and is photographed with its foliage; run by
`docs/pictures.py plant_types`, some minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent
from forestgen.dataset.tonemap import tone_map
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.biome import shipped_plant_types
from forestgen.recipe.load import load_recipe_data
from forestgen.render.studio import EXPOSURE, PictureSettings, camera_of, photograph
from forestgen.scene.growth import choose_exemplars, grow_planned
from forestgen.scene.plan import Plan, make_plan
from forestgen.scene.surfaces import materials_of

PICTURES = Path(__file__).parent / "pictures"
SEED = 2
COLUMNS = 4
VIEW_PX = (240, 270)
SAMPLES = 48
CAPTION_PX = 22
# Row of Table 1 -> species, and the age at which it is shown, years.
TYPES: dict[str, tuple[str, int]] = {
    "a": ("shrub", 18),
    "b": ("juniper", 80),
    "c": ("palm", 50),
    "d": ("cholla", 14),
    "e": ("kapok", 150),
    "f": ("cypress", 90),
    "g": ("eucalyptus", 140),
    "h": ("pine", 120),
    "i": ("oak", 200),
    "j": ("larch", 120),
    "k": ("hemlock", 120),
    "l": ("sequoia", 180),
    "m": ("acacia", 100),
    "n": ("willow", 40),
    "o": ("spruce", 110),
    "p": ("baobab", 350),
}


def plan_of(name: str, years: int) -> Plan:
    """One plant of a shipped species, alone on its site under the climate that it likes best, without seedlings."""
    one = shipped_plant_types()[name]
    recipe = {
        "forestgen": 1,
        "seed": SEED,
        "site": {"size_m": [100, 100]},
        "species": {name: {"from": name, "modules": {"seeds_per_yr": 0.0}}},
        "community": {
            "model": "branch_modules",
            "steps": years,
            "initial_plants": 1,
            "temperature_c": one.temperature_c,
            "precipitation_mm_per_yr": one.precipitation_mm_per_yr,
        },
        "plants": {"unique": "all"},
        "cameras": [{"position_m": [50, -100, 10], "look_at_m": [50, 50, 10]}],
    }
    return make_plan(load_recipe_data(recipe, name).draw(0))


def grown(name: str, years: int) -> tuple[Plan, Exemplar]:
    """The plant with the branches that it grew, and its foliage."""
    plan = plan_of(name, years)
    population = final_population(plan.community, Silent())
    chosen = choose_exemplars(plan, population, [])
    return plan, grow_planned(plan, chosen, Silent(), population)[0]


def picture(row: str) -> Image.Image:
    """A type's photograph with its caption."""
    name, years = TYPES[row]
    plan, plant = grown(name, years)
    camera = camera_of(plant, PictureSettings(VIEW_PX, samples=SAMPLES))
    materials, recipe = materials_of(plan.drawn.species), plan.drawn.recipe
    seen = tone_map(photograph(plant, materials, camera, recipe, SAMPLES, SEED, Silent()), EXPOSURE)
    tile = Image.new("RGB", (VIEW_PX[0], VIEW_PX[1] + CAPTION_PX), "white")
    tile.paste(Image.fromarray(np.asarray(seen)), (0, CAPTION_PX))
    text = f"{row}  {name}, {years} years: {plant.height_m:.1f} m"
    ImageDraw.Draw(tile).text((6, 4), text, fill="#222222", font=ImageFont.load_default(12))
    sys.stdout.write(f"{text}, {plant.triangles:,} triangles\n")
    sys.stdout.flush()
    return tile


def plant_types(_scratch: Path | None = None, rows: str = "".join(TYPES)) -> None:
    """Draw the sheet."""
    tiles = [picture(row) for row in rows]
    wide, tall = tiles[0].size
    lines = -(-len(tiles) // COLUMNS)
    sheet = Image.new("RGB", (min(COLUMNS, len(tiles)) * wide, lines * tall), "white")
    for place, tile in enumerate(tiles):
        sheet.paste(tile, (place % COLUMNS * wide, place // COLUMNS * tall))
    PICTURES.mkdir(exist_ok=True)
    sheet.save(PICTURES / "plant_types.jpg", quality=82, optimize=True)
    sys.stdout.write(f"{PICTURES / 'plant_types.jpg'}\n")


if __name__ == "__main__":
    plant_types(rows=sys.argv[1] if len(sys.argv) > 1 else "".join(TYPES))
