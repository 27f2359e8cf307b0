"""One sheet of 24 views: near and far, all forest types, seasons and weathers.

uv run python docs/contact_sheet.py [NAME ...] [--out FOLDER] [--width 480] [--samples 64]

Renders the views into a folder, each with its recipe and files, and puts them on contact_sheet.jpg there: one to five
minutes a view. With names, it renders these again and takes the others from the folder as they are.
"""

from __future__ import annotations

import argparse
import math
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml
from PIL import Image, ImageDraw, ImageFont

RECIPES = Path(__file__).parents[1] / "recipes"
COLUMNS, CAPTION_PX = 4, 22
Keys = dict[str, Any]

FLOOR: list[Keys] = [
    {"what": "fallen_leaves", "cover": 0.9},
    {"what": "twigs", "cover": 0.04},
    {"what": "twigs", "cover": 0.04, "length_m": 0.9, "patch_m": 3},
    {"what": "stones", "cover": 0.005},
    {"what": "moss", "cover": 0.08, "patch_m": 2},
]
HEATH: list[Keys] = [  # floor of conifers
    {"what": "fallen_leaves", "cover": 0.9},
    {"what": "moss", "cover": 0.45, "patch_m": 2.5},
    {"what": "small_plants", "species": "shrub", "height_m": 0.4, "size_sigma": 0.2, "cover": 0.25, "patch_m": 2.5},
    {"what": "small_plants", "species": "grass", "height_m": 0.25, "size_sigma": 0.4, "cover": 0.08, "patch_m": 1.5},
    *FLOOR[1:4],
]
ROADSIDE: list[Keys] = [
    {"what": "moss", "cover": 0.45, "patch_m": 1.5},
    {"what": "small_plants", "species": "grass", "height_m": 0.2, "size_sigma": 0.5, "cover": 0.7, "on": "roadside"},
    {"what": "small_plants", "species": "bramble", "height_m": 0.35, "cover": 0.12, "patch_m": 2, "on": "roadside"},
    {"what": "stones", "size_m": 0.04, "cover": 0.2, "on": "path"},
    {"what": "fallen_leaves", "cover": 0.08, "on": "path"},
    {"what": "twigs", "length_m": 0.1, "cover": 0.01, "on": "path"},
]
DEAD_WOOD: Keys = {"type": "managed_beech", "lying_m3_per_ha": 12}
GRASS: Keys = {"what": "small_plants", "species": "grass", "height_m": 0.25, "cover": 0.3, "patch_m": 4}
UNDERGROWTH: list[Keys] = [  # where light comes through gaps
    {"what": "moss", "cover": 0.2, "patch_m": 1.5},
    {**GRASS, "height_m": 0.2, "size_sigma": 0.4, "patch_m": 2},
    {"what": "small_plants", "species": "bramble", "height_m": 0.4, "size_sigma": 0.3, "cover": 0.3, "patch_m": 3},
    {"what": "small_plants", "species": "bracken", "height_m": 0.7, "size_sigma": 0.3, "cover": 0.25, "patch_m": 4},
]
EYE: Keys = {"position_m": [32, 4, 1.7], "look_at_m": [29, 30, 4.5], "hfov_deg": 62}
EAST: Keys = {"position_m": [6, 28, 1.6], "look_at_m": [40, 33, 3], "hfov_deg": 54}
WEST: Keys = {"position_m": [52, 40, 1.7], "look_at_m": [20, 24, 6], "hfov_deg": 70}
SIDE = {"elevation_deg": 34, "azimuth_deg": 285}  # of the sun, beside and before DRONE: crowns have shaded sides
DRONE: Keys = {"position_m": [30, -60, 70], "look_at_m": [30, 60, 0], "hfov_deg": 62}


def forest(species: Mapping[str, float], top_m: float, camera: Keys, young: str = "", **more: Any) -> Keys:
    """A closed stand of 23 to 30 m2 of basal area over lower trees, with young ones of a species, in forest."""
    main: Keys = {
        "species": dict(species),
        "basal_area_m2_per_ha": round(1.15 * top_m),
        "stems_per_ha": round(1500 - 40 * top_m),
    }
    storeys: list[Keys] = [
        {**main, "dominant_height_m": top_m, "dbh": {"cv": 0.45}, "clark_evans": 0.9},
        {"species": dict(species), "stems_per_ha": 220, "dominant_height_m": top_m / 2, "clark_evans": 0.7},
    ]
    if young:
        storeys.append({"species": {young: 1}, "stems_per_ha": 350, "dominant_height_m": 4, "clark_evans": 0.6})
    names = [*species, *([young] if young else []), "bramble", "bracken", "grass", "shrub"]
    ground = {
        "bramble": {"cover": 0.05, "radius_m": {"median": 0.45, "sigma": 0.3}, "clump_m": 5},
        "bracken": {"cover": 0.08, "clump_m": 7},
    }
    conifers = species.get("spruce", 0) + species.get("pine", 0) > 0.5
    recipe: Keys = {
        "forestgen": 1,
        "seed": 5,
        "site": {
            "size_m": [60, 60],
            "terrain": {"kind": "rolling", "amplitude_m": 0.6, "wavelength_m": 60, "hills_m": 70},
            "surroundings": "forest",
            "ground": {"kind": "litter", "layers": HEATH if conifers else FLOOR},
        },
        "species": dict.fromkeys(names),
        "community": {"model": "stand", "storeys": storeys, "dead_wood": DEAD_WOOD, "ground": ground},
        "plants": {"exemplars_per_species": 6, "levels": True, "phenology_classes": 1},
        "sky": {"sun": {"elevation_deg": 48, "azimuth_deg": 215}, "turbidity": 3, "visibility_m": 25000},
        "cameras": [{"obstructed": "note", **camera}],
    }
    if not conifers:
        recipe["community"]["leaf_area_index"] = 5
    return _merged(recipe, more)


def tree(species: str, height_m: float, camera: Keys, **more: Any) -> Keys:
    """One tree in a glade of grass, near the camera."""
    recipe = forest({species: 1.0}, 20, camera)
    recipe["site"]["ground"] = {"kind": "litter", "layers": [*FLOOR, GRASS]}
    recipe["species"] = dict.fromkeys((species, "spruce", "birch", "grass"))
    plants = [{"species": species, "position_m": [30, 30], "height_m": height_m}]
    for k in range(2, 60):  # around it, by the golden angle
        away_m, turn = 3.7 * k**0.5 + 4, 2.39996 * k
        kind, height = ("birch", 15 + k % 5) if k % 3 else ("spruce", 12 + k % 9)
        place = [round(30 + away_m * math.sin(turn), 2), round(30 + away_m * math.cos(turn), 2)]
        if max(abs(x - 30) for x in place) < 29:
            plants.append({"species": kind, "position_m": place, "height_m": height})
    return _merged({**recipe, "community": {"model": "placed", "plants": plants}}, more)


def meadow() -> Keys:
    """A hay meadow in flower; trees stand in its far corner, and in groups beyond."""
    recipe = shipped("biomes/grassland", sky__clouds=CUMULUS, sky__visibility_m=20000)
    own: list[Keys] = [
        {**GRASS, "height_m": 0.15, "size_sigma": 0.4, "cover": 0.6, "patch_m": 1.5},
        {**GRASS, "height_m": 0.45, "size_sigma": 0.4, "cover": 0.35},
        {**GRASS, "species": "redgrass", "height_m": 0.5, "size_sigma": 0.25, "cover": 0.08, "patch_m": 8},
        {**GRASS, "species": "daisy", "size_sigma": 0.4, "cover": 0.15, "patch_m": 3},
        {**GRASS, "species": "fireweed", "height_m": 0.7, "size_sigma": 0.25, "cover": 0.01, "patch_m": 3},
    ]
    recipe["site"] |= {"size_m": [120, 120], "ground": {"kind": "grass", "layers": own}}
    recipe["site"]["terrain"] |= {"amplitude_m": 0.8, "wavelength_m": 150, "hills_m": 70}
    recipe["species"] = dict.fromkeys(("grass", "redgrass", "daisy", "fireweed", "beech", "maple", "shrub"))
    kinds = (("beech", 16.0), ("shrub", 2.5), ("maple", 13.0), ("shrub", 2.0))
    plants: list[Keys] = []
    for k in range(40):
        kind, height_m = kinds[k % 4]
        place = [round(62 + 1.4 * k, 2), round(116 - 22 * (0.618 * k % 1.0) ** 2, 2)]
        tall_m = round(height_m * (0.7 + 0.6 * (0.414 * k % 1.0)), 2)
        plants.append({"species": kind, "position_m": place, "height_m": tall_m})
    recipe["community"] = {"model": "placed", "plants": plants}
    return camera_of(recipe, position_m=[50, 6, 1.2], look_at_m=[60, 60, 1.6])


def shipped(name: str, **more: Any) -> Keys:
    """A recipe of the package."""
    return _merged(yaml.safe_load((RECIPES / f"{name}.yaml").read_text(encoding="utf-8")), more)


def camera_of(recipe: Keys, **more: Any) -> Keys:
    """The recipe with other keys of its first camera, and that camera alone."""
    return {**recipe, "cameras": [{**recipe["cameras"][0], **more}]}


def _merged(keys: Keys, more: Mapping[str, Any]) -> Keys:
    """With other values; mappings are merged, also those of keys such as site__ground."""
    merged = dict(keys)
    for path, value in more.items():
        key, _, rest = path.partition("__")
        if rest:
            merged[key] = _merged(merged.get(key, {}), {rest: value})
        elif isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = _merged(merged[key], value)
        else:
            merged[key] = value
    return merged


BEECH, SPRUCE, PINE, BIRCH = {"beech": 1.0}, {"spruce": 1.0}, {"pine": 0.9, "birch": 0.1}, {"birch": 1.0}
MIXED = {"beech": 0.4, "spruce": 0.35, "maple": 0.15, "birch": 0.1}
AUTUMN = "2026-10-15"  # two fifths of the beeches' leaves are coloured, most of the birches'
CUMULUS = {"type": "cumulus", "seed": 7}  # of one seed: it is simulated once
OVERCAST = {"kind": "overcast", "sun": {"elevation_deg": 40, "azimuth_deg": 215}}
ROAD = {"what": "forest_road", "points_m": [[-20, 22], [10, 27.5], [30, 31], [55, 30], [80, 40]]}
POND = {"what": "pond", "position_m": [31, 20], "radius_m": 9, "depth_m": 1.2, "dissolved_per_m": 7}
SEDGE_BLADES = {"blade": 60, "upright_blade": 25, "broken_blade": 20, "old_blade": 90, "dead_blade": 140}
SEDGE: Keys = {
    "from": "grass",
    "plant": {
        "shapes": {
            name: {"length_m": 0.8, "width_m": 0.009, "arch_deg": arch_deg, "twist_deg": 30}
            for name, arch_deg in SEDGE_BLADES.items()
        }
    },
}
SHORE: list[Keys] = [
    {**GRASS, "species": "sedge", "height_m": 0.7, "size_sigma": 0.4, "cover": 0.2, "patch_m": 2, "on": "shore"},
    {"what": "twigs", "length_m": 0.5, "cover": 0.05, "on": "shore"},
    {"what": "fallen_leaves", "cover": 0.04, "patch_m": 2, "on": "water"},
]
LEAF = {"position_m": [30, 26.6, 1.8], "look_at_m": [30, 30, 2.2], "hfov_deg": 40}

VIEWS: Mapping[str, Callable[[], Keys]] = {
    "beech leaves": lambda: tree("beech", 7, LEAF),
    "spruce shoots": lambda: tree("spruce", 6, {**LEAF, "position_m": [30, 27.2, 1.3]}),
    "forest floor": lambda: forest(
        BEECH, 26, {**EYE, "position_m": [30, 4, 1.2], "look_at_m": [30, 5.4, 0]}, sky=OVERCAST
    ),
    "beech, noon": lambda: forest(BEECH, 26, EYE, "beech"),
    "spruce, noon, road": lambda: forest(
        SPRUCE, 26, EAST, "spruce", site__paths=[ROAD], site__ground__layers=[*HEATH, *ROADSIDE]
    ),
    "pine, low sun": lambda: forest(PINE, 22, WEST, "birch", sky__sun={"elevation_deg": 16, "azimuth_deg": 150}),
    "birch, spring": lambda: forest(BIRCH, 20, EAST, plants__season="spring"),
    "mixed, autumn": lambda: forest(MIXED, 24, {**WEST, "position_m": [50, 43, 1.7]}, "beech", site__date=AUTUMN),
    "beech, winter": lambda: forest(
        BEECH,
        26,
        {**EAST, "look_at_m": [40, 25, 3]},
        "spruce",
        plants__season="winter",
        sky__sun={"elevation_deg": 14, "azimuth_deg": 210},
    ),
    "pond, overcast": lambda: forest(
        MIXED,
        24,
        EYE,
        "spruce",
        sky=OVERCAST,
        species__sedge=SEDGE,
        site__water=[POND],
        site__ground__layers=[*FLOOR, *SHORE],
    ),
    "rain": lambda: forest(
        MIXED,
        24,
        {**EYE, "position_m": [36.4, 3.4, 1.7]},
        "spruce",
        sky=OVERCAST,
        site__ground__layers=[*FLOOR, *ROADSIDE],
        site__paths=[{**ROAD, "ground": "soil_moist", "points_m": [[-20, 4], [20, 9], [42, 15], [80, 18]]}],
        wind__speed_m_per_s=2,
        weather=[{"what": "rain", "rate_mm_per_h": 15}, {"what": "ground_fog", "visibility_m": 600, "depth_m": 40}],
    ),
    "fog": lambda: forest(
        SPRUCE,
        24,
        WEST,
        sky__sun={"elevation_deg": 25, "azimuth_deg": 30},
        weather=[{"what": "ground_fog", "visibility_m": 90, "depth_m": 5, "fade_m": 4, "patch_m": 40}],
    ),
    "snow": lambda: forest(
        {"spruce": 0.8, "birch": 0.2},
        22,
        EYE,
        plants__season="winter",
        sky=OVERCAST,
        weather=[{"what": "snow_cover", "depth_m": 0.35, "on_plants": 0.85}],
    ),
    "dusk": lambda: forest(
        PINE,
        22,
        {**DRONE, "position_m": [30, -60, 50], "look_at_m": [30, 120, 42]},
        site__terrain__hills_m=150,
        sky__sun={"elevation_deg": -2.5, "azimuth_deg": 335},
        sky__visibility_m=60000,
    ),
    "moonlit night": lambda: forest(
        PINE,
        22,
        {**WEST, "look_at_m": [20, 24, 4]},
        sky__sun={"elevation_deg": -30},
        sky__moon={"elevation_deg": 40, "azimuth_deg": 125, "illuminated": 1},
    ),
    "drone, conifers": lambda: forest(
        {"spruce": 0.6, "pine": 0.4}, 24, DRONE, community__canopy_cover=0.75, sky__sun=SIDE
    ),
    "drone, autumn": lambda: forest(MIXED, 24, DRONE, site__date=AUTUMN, plants__phenology_classes=3, sky__sun=SIDE),
    "nadir, mixed": lambda: forest(
        MIXED,
        24,
        {"position_m": [30, 30, 90], "look": "down", "hfov_deg": 40},
        "beech",
        site__ground__layers=[*FLOOR, *UNDERGROWTH],
    ),
    "nadir, open pines": lambda: camera_of(shipped("places/neon_osbs")),
    "vista, cumulus": lambda: camera_of(
        {
            **shipped("vista", site__surroundings="forest", site__terrain__hills_m=110, plants__season="summer"),
            "sampling": {"variables": {"conifers": 0.5}},
            "sky": {
                "sun": {"elevation_deg": 36, "azimuth_deg": 255},
                "turbidity": 2.5,
                "clouds": CUMULUS,
                "visibility_m": 30000,
            },
        },
        position_m=[200, -60, 75],
        look_at_m=[200, 180, 55],
    ),
    "meadow": meadow,
    "savanna": lambda: camera_of(
        shipped("biomes/savanna", site__terrain__hills_m=60, sky__clouds=CUMULUS, sky__visibility_m=25000),
        position_m=[34, 1, 1.1],
        look_at_m=[31, 30, 3.2],
    ),
    "tropical rain forest": lambda: shipped("biomes/tropical_rain"),
    "fisheye": lambda: forest(
        BEECH, 26, {"kind": "fisheye", "position_m": [30, 30, 1.3], "look": "up"}, sky__clouds="noise"
    ),
}


def rendered(name: str, folder: Path, width: int, samples: int) -> Path:
    """The preview of a view, rendered if it is not there yet."""
    place = folder / name.replace(",", "").replace(" ", "_")
    if not (found := sorted(place.glob("set/train/*/preview.png"))):
        recipe = camera_of(VIEWS[name](), size_px=[width, width * 2 // 3])
        recipe["seed"] = 5 + list(VIEWS).index(name)  # no two views of one stand
        recipe["render"] = {"samples": samples}
        recipe["labels"] = {"samples": 4}
        place.mkdir(parents=True, exist_ok=True)
        (place / "view.yaml").write_text(yaml.safe_dump(recipe, sort_keys=False), encoding="utf-8")
        command = [sys.executable, "-m", "forestgen", "render", place / "view.yaml", "-o", place / "set", "--overwrite"]
        subprocess.run(command, check=True)
        found = sorted(place.glob("set/train/*/preview.png"))
    return found[0]


def sheet(views: Mapping[str, Path], width: int) -> Image.Image:
    """The views side by side under their names."""
    tall = width * 2 // 3 + CAPTION_PX
    drawn = Image.new("RGB", (COLUMNS * width, -(-len(views) // COLUMNS) * tall), "white")
    for k, (name, path) in enumerate(views.items()):
        corner = k % COLUMNS * width, k // COLUMNS * tall
        view = Image.open(path).convert("RGB")
        drawn.paste(view, (corner[0] + (width - view.width) // 2, corner[1] + CAPTION_PX))
        text = corner[0] + 5, corner[1] + 4
        ImageDraw.Draw(drawn).text(text, f"{k + 1} {name}", fill="#222222", font=ImageFont.load_default(13))
    return drawn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(VIEWS))
    parser.add_argument("--out", type=Path, default=Path("outputs/contact_sheet"))
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--samples", type=int, default=64)
    arguments = parser.parse_args()
    for name in arguments.names:
        if name not in VIEWS:
            parser.error(f"no view {name!r}; there are: {', '.join(VIEWS)}")
        shutil.rmtree(arguments.out / name.replace(",", "").replace(" ", "_"), ignore_errors=True)
    views = {name: rendered(name, arguments.out, arguments.width, arguments.samples) for name in VIEWS}
    sheet(views, arguments.width).save(arguments.out / "contact_sheet.jpg", quality=88)
    sys.stdout.write(f"{arguments.out / 'contact_sheet.jpg'}\n")


if __name__ == "__main__":
    main()
