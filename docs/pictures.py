"""Makes the documentation's pictures: `uv run python docs/pictures.py` (hours on two cores).

quickstart.jpg        the quickstart's view, larger and with more samples; the right half under its instance mask
branch_modules.jpg    recipes/branch_modules.yaml
succession.jpg        four stages of the quickstart's succession: maps, and the stand as a camera sees it
succession_maps.png   recipes/reproductions/succession.yaml at four steps (Lane 2002, Figure 4.5)
propagation_maps.png  recipes/reproductions/propagation.yaml at three steps (Lane 2002, Figure 4.6)
figures/*.jpg         the figures of plants that recipes/reproductions/*_fig*.yaml render, for docs/figures.md
water.png             what `forestgen simulate` draws of the first recipe of docs/ecoclimates.md
dryland_patterns.jpg  shrubs over rainfall, as benchmarks/ecoclimates.py draws them (a quarter of an hour)
droughts.jpg          three droughts, by the same
foehn.jpg             a ridge across the wind, by the same
clearing.jpg          clouds over a forest, its clearing and regrowth, by the same
self_thinning.png     the line of recipes/reproductions/self_thinning.yaml (Lane 2002, Figure 4.4)

and, by docs/placement_pictures.py, of recipes/reproductions/*_fig5_* (Lane 2002, chapter 5):

figures/kernels_fig5_4.png      kernels          four kernels above their patterns
figures/daisies_fig5_5.jpg      daisies          three renders of daisies
figures/map_fig5_6.png          map_placement    a painted map, two clusterings
figures/two_species_fig5_8.png  two_species      plants and fields at three moments
figures/forest_fig5_9.jpg       forest           a forest from above, and rendered
kernel_field.png                kernel_field     a field as plants deform it (Figure 5.3)
placement_models.png            placement_models all placement models
densities.png                   densities        what `forestgen simulate` shows

and, by docs/label_pictures.py, labels.jpg: a view and its labels; by docs/light_pictures.py, light.jpg: other skies,
a season and bands; by docs/weather_pictures.py, weather_profiles.png: the air in which four clouds form; by
docs/land_pictures.py, pond.jpg and forest_road.jpg; by docs/plant_types.py, plant_types.png: the sixteen types of
branch modules; by docs/biome_pictures.py, biomes.jpg: every biome; by docs/report_picture.py, report.jpg: the page that
`forestgen report` makes of a small data set.

With names behind it, `uv run python docs/pictures.py self_thinning succession_maps`, it makes these alone.
The plants' pictures, library.jpg and species/, are made by docs/species_sheet.py.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import biome_pictures
import label_pictures
import land_pictures
import light_pictures
import numpy as np
import placement_pictures
import plant_types
import report_picture
import weather_pictures
from PIL import Image

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
STAGES = (20, 150, 300, 1000)
CLUSTERS = (20, 500, 1000)
MAP_WIDTH, COLOURS = 400, 24  # of pictures in PNGs: pixels, and palette


def render(folder: Path, *settings: str) -> Path:
    """Render the quickstart with some settings; the frame's folder."""
    return render_recipe(ROOT / "recipes" / "quickstart.yaml", folder, *settings)


def quickstart(scratch: Path) -> None:
    frame = render(scratch / "quickstart", "cameras.0.size_px=[1280, 720]")
    picture = np.asarray(Image.open(frame / "preview.png")).copy()
    labels = np.asarray(Image.open(frame / "overlay.png"))
    half = picture.shape[1] // 2
    picture[:, half:] = labels[:, half:]
    picture[:, half - 1 : half + 1] = 255
    save(picture, "quickstart.jpg")


def branch_modules(scratch: Path) -> None:
    command = [sys.executable, "-m", "forestgen", "render", str(ROOT / "recipes" / "branch_modules.yaml")]
    subprocess.run([*command, "-o", str(scratch / "branch_modules")], check=True)
    save(np.asarray(Image.open(next((scratch / "branch_modules").glob("train/*/preview.png")))), "branch_modules.jpg")


def simulate(folder: Path, recipe: str, *options: str, steps: Sequence[int] = ()) -> list[Path]:
    """Simulate a recipe; its maps at some steps."""
    maps = [word for step in steps for word in ("--map-step", str(step))]
    command = [sys.executable, "-m", "forestgen", "simulate", str(ROOT / "recipes" / recipe), "-o", str(folder), *maps]
    subprocess.run([*command, *options], check=True)
    return [folder / f"map-{step:06d}.png" for step in steps]


def succession(scratch: Path) -> None:
    last = f"community.steps={STAGES[-1]}"
    charts = simulate(scratch / "community", "quickstart.yaml", "--set", last, steps=STAGES)
    rows = []
    for step, path in zip(STAGES, charts, strict=True):
        view = "cameras.0={position_m: [60, -34, 14], look_at_m: [60, 60, 4], size_px: [720, 360], hfov_deg: 62}"
        frame = render(scratch / f"stage-{step}", f"community.steps={step}", view, "render.samples=12")
        chart = Image.open(path).convert("RGB")
        chart = chart.resize((round(chart.width * 360 / chart.height), 360), Image.Resampling.LANCZOS)
        rows.append(np.concatenate([np.asarray(chart), np.asarray(Image.open(frame / "preview.png"))], axis=1))
    save(np.concatenate(rows, axis=0), "succession.jpg")


def succession_maps(scratch: Path) -> None:
    maps = simulate(scratch / "succession", "reproductions/succession.yaml", steps=STAGES)
    save_sheet(maps, 2, "succession_maps.png")


def propagation_maps(scratch: Path) -> None:
    maps = simulate(scratch / "propagation", "reproductions/propagation.yaml", steps=CLUSTERS)
    save_sheet(maps, 3, "propagation_maps.png")


def self_thinning(scratch: Path) -> None:
    simulate(scratch / "thinning", "reproductions/self_thinning.yaml")
    save_sheet([scratch / "thinning" / "thinning.png"], 1, "self_thinning.png", width=560)


def water(scratch: Path) -> None:
    recipe = scratch / "wood.yaml"
    text = (ROOT / "docs" / "ecoclimates.md").read_text(encoding="utf-8")
    recipe.write_text(text.split("```yaml\n")[1].split("```")[0], encoding="utf-8")
    simulate(scratch / "water", str(recipe))
    save_sheet([scratch / "water" / "water.png"], 1, "water.png", width=1100, colours=160)


def dryland_patterns(scratch: Path) -> None:
    save_benchmark(scratch, "forests", "dryland_patterns.jpg")


def droughts(scratch: Path) -> None:
    save_benchmark(scratch, "drought", "droughts.jpg")


def foehn(scratch: Path) -> None:
    save_benchmark(scratch, "foehn", "foehn.jpg")


def clearing(scratch: Path) -> None:
    save_benchmark(scratch, "clearing", "clearing.jpg")


def save_benchmark(scratch: Path, figure: str, name: str, width: int = 1400) -> None:
    """The figure of an ecoclimate; bounds that it misses do not keep it from being drawn."""
    script = ROOT / "benchmarks" / "ecoclimates.py"
    subprocess.run([sys.executable, script, figure, "--out", scratch], check=False)
    drawn = Image.open(scratch / f"{figure}.png").convert("RGB")
    size = width, round(drawn.height * width / drawn.width)
    save(np.asarray(drawn.resize(size, Image.Resampling.LANCZOS)), name)


def figures(scratch: Path) -> None:
    """Each plant figure of docs/figures.md, as its recipe renders it with more samples."""
    for recipe in figure_recipes():
        frame = render_recipe(recipe, scratch / recipe.stem, "render.samples=48")
        save(np.asarray(Image.open(frame / "preview.png").convert("RGB")), f"figures/{recipe.stem}.jpg")
    both = [np.asarray(Image.open(PICTURES / "figures" / "silhouettes_fig6_2.jpg"))]
    plants = render_recipe(figure_recipe("silhouettes_fig6_2"), scratch / "6_2_b", "plants.geometry=plants")
    both.append(np.asarray(Image.open(plants / "preview.png").convert("RGB")))
    save(np.concatenate(both, axis=1), "figures/silhouettes_fig6_2.jpg")


def figure_recipe(name: str) -> Path:
    return ROOT / "recipes" / "reproductions" / f"{name}.yaml"


def figure_recipes() -> list[Path]:
    """Recipes that reproduce figures of plants, in the order of their names; communities have commands of their own."""
    return sorted(path for path in figure_recipe("x").parent.glob("*_fig*.yaml") if "_fig5_" not in path.name)


def render_recipe(recipe: Path, folder: Path, *settings: str) -> Path:
    """Render a recipe with some settings; its only frame's folder."""
    options = [word for setting in settings for word in ("--set", setting)]
    subprocess.run([sys.executable, "-m", "forestgen", "render", recipe, "-o", folder, *options], check=True)
    return min(path.parent for path in folder.glob("train/*/preview.png"))


def save_sheet(
    pictures: Sequence[Path], columns: int, name: str, width: int = MAP_WIDTH, colours: int = COLOURS
) -> None:
    """Pictures of one size side by side, scaled, as a PNG of few colours."""
    scaled = []
    for path in pictures:
        one = Image.open(path).convert("RGB")
        height = round(one.height * width / one.width)
        scaled.append(np.asarray(one.resize((width, height), Image.Resampling.LANCZOS)))
    rows = [np.concatenate(scaled[k : k + columns], axis=1) for k in range(0, len(scaled), columns)]
    sheet = Image.fromarray(np.concatenate(rows, axis=0))
    sheet = sheet.quantize(colours, kmeans=2, dither=Image.Dither.NONE)
    PICTURES.mkdir(exist_ok=True)
    sheet.save(PICTURES / name, optimize=True)
    sys.stdout.write(f"{PICTURES / name}\n")


def save(picture: np.ndarray, name: str) -> None:
    (PICTURES / name).parent.mkdir(exist_ok=True, parents=True)
    Image.fromarray(picture).save(PICTURES / name, quality=88, optimize=True)
    sys.stdout.write(f"{PICTURES / name}\n")


PICTURES_OF = {
    **{
        one.__name__: one
        for one in (
            quickstart,
            succession,
            succession_maps,
            propagation_maps,
            self_thinning,
            water,
            dryland_patterns,
            droughts,
            clearing,
            foehn,
            figures,
        )
    },
    **placement_pictures.PICTURES_OF,
    **weather_pictures.PICTURES_OF,
    "branch_modules": branch_modules,
    "biomes": biome_pictures.biomes,
    "labels": label_pictures.labels,
    "light": light_pictures.light,
    "weather_views": light_pictures.weather_views,
    "land": land_pictures.land,
    "plant_types": plant_types.plant_types,
    "report": report_picture.report,
}


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        for name in sys.argv[1:] or PICTURES_OF:
            PICTURES_OF[name](Path(scratch))


if __name__ == "__main__":
    main()
