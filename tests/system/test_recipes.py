"""Every shipped recipe renders or, of the reproductions, simulates; an image has the same bytes wherever it is made."""

from __future__ import annotations

from pathlib import Path

import pytest

import forestgen
from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent
from forestgen.recipe.assets import find_asset, list_assets, recipes_dir
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from support.tiers import slow_but

SMALL = (
    "render.samples=1",
    "labels.samples=1",
    "plants.exemplars_per_species=2",
    "site.size_m=[30, 30]",
    "site.ground=soil_wet",
    "cameras.0.size_px=[48, 32]",
    "cameras.0.position_m=[15, -8, 2]",
    "cameras.0.look_at_m=[15, 15, 3]",
)


COARSE = {  # of clouds, of a walk of eight frames, of a house on a larger site, and of large stands
    "branch_modules": ("site.buildings.0.position_m=[18, 20]",),
    "ecoclimates/aridity": ("community.steps=6", "community.initial_plants=20"),
    "ecoclimates/dieback": ("community.steps=6", "community.initial_plants=20"),
    "ecoclimates/drought": ("community.steps=6",),
    "ecoclimates/dryland": ("community.steps=6",),
    "ecoclimates/dying": ("community.steps=6",),
    "ecoclimates/edges": ("site.size_m=[100, 80]", "community.steps=56"),  # its patch has a place, its strip a year
    "ecoclimates/own_clouds": (
        "community.steps=3",
        "community.changes.0.at_yr=1.5",
        "sky.clouds={type: community, time_s: 600, cell_m: 400, cell_height_m: 300}",
    ),
    "ecoclimates/foehn": (  # some dozen seedlings on level ground
        "community.steps=2",
        "community.global_seeding.0.seeds_per_ha=1000",
        "community.weather.hours=0.1",
        "site.terrain={kind: flat}",
    ),
    "biomes/savanna": ("community.disturbances=[{at_yr: 2, burn: {survival: 0.5}}]",),
    "biomes/shrubland": ("community.disturbances=[{at_yr: 2, burn: {survival: 0.5}}]",),
    "biomes/temperate_seasonal": ("community.disturbances=[{at_yr: 2, plant: {species: maple, count: 2}}]",),
    "ecoclimates/stand": ("community.steps=6",),
    "ecoclimates/valleys": ("community.steps=6",),
    "kernel_growth": ("sky.clouds={type: noise, extent_m: 2000}",),
    "mixed_stand": ("sky.clouds.type={choice: [none]}", "community.cells=128"),
    "places/conifer_hdri": ("cameras.0.size_px=[64, 32]",),
    "places/neon_osbs": ("cameras.0.exposure=null", "community.canopy_cover=0.4"),
    "places/neon_soap": ("cameras.0.exposure=null",),
    "places/neon_yell": ("cameras.0.exposure=null",),
    "quickstart": ("sky.clouds={type: noise, extent_m: 2000}",),
    "sapling_stand": (
        "sky.clouds.type={choice: [none]}",
        "cameras.1.size_px=[48, 32]",
        "community.plants.grass.plants_per_ha=1000",
        "plants.variants_per_size=1",
    ),
    "training_set": ("sky.clouds.extent_m=2000",),
    "vista": (
        "sky.clouds.type={choice: [none]}",
        "community.cells=128",
        *(f"community.plants.{name}.count=8" for name in ("spruce", "beech", "pine", "birch", "shrub")),
    ),
    "walk_in_the_wind": ("cameras.0.path.frames=3",),
    "weather_cumulus": ("sky.clouds.time_s=600", "sky.clouds.domain={cell_m: 450, cell_height_m: 200}"),
    "weather_story": ("images=1", "sky.clouds.time_s=300", "sky.clouds.story.0.domain={cell_m: 75, cell_height_m: 10}"),
}


# Young plants, two of them with branches of their own.
MODULES = ("community.steps=4", "community.initial_plants=12", "plants.unique=2")
BIOMES = [name for name in list_assets("recipes") if name.startswith("biomes/")]
# One of each kind of community and sky; the others with the slow tests.
BY_DEFAULT = ("ecoclimates/dying", "quickstart")


def _render(recipe: Path, target: Path, *settings: str) -> Path:
    """Folder of the frames: that of the one split."""
    run = forestgen.load(recipe, set=settings).render(target, progress=False)
    assert not run.summary.missing
    return target / "train"


def _frames(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.glob("*/*"))}


REPRODUCTIONS = [name for name in list_assets("recipes") if name.startswith("reproductions/")]


@pytest.mark.parametrize(
    "name", slow_but(REPRODUCTIONS, "reproductions/kernels_fig5_4", "reproductions/size_hierarchy")
)
def test_reproduction_simulates(name: str) -> None:
    plan = check_plan(load_recipe(find_asset("recipes", name)), simulate_only=True)
    assert len(final_population(plan.community, Silent()))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in BY_DEFAULT else pytest.mark.slow)
        for name in list_assets("recipes")
        if name not in REPRODUCTIONS
    ],
)
def test_shipped_recipe_renders(name: str, tmp_path: Path) -> None:
    one_each = [one.replace("per_species=2", "per_species=1") for one in SMALL]
    coarse = (*(MODULES if name in (*BIOMES, "branch_modules") else ()), *COARSE.get(name, ()))
    made = _frames(_render(recipes_dir() / f"{name}.yaml", tmp_path / "out", *one_each, *coarse))
    kinds = {Path(path).name for path in made}
    assert kinds == {
        "frame.exr", "preview.png", "overlay.png", "instance.png", "semantic.png", "plants.parquet", "camera.json",
        "annotations.json", "recipe.yaml",
    }  # fmt: skip


@pytest.mark.slow
def test_an_image_is_the_same_alone_among_others_and_from_its_stored_recipe(tmp_path: Path) -> None:
    recipe = recipes_dir() / "training_set.yaml"
    # Young stands under few clouds: the same draws in less time.
    settings = (*SMALL, *COARSE["training_set"], "community.steps={integers: [20, 60]}")
    among = _frames(_render(recipe, tmp_path / "among", *settings, "images=2"))
    alone = _frames(_render(recipe, tmp_path / "alone", *settings, "first_image=1"))
    second = {path: data for path, data in among.items() if path.startswith("000001-")}
    assert second.keys() == alone.keys()
    assert second == alone
    stored = tmp_path / "among" / "train" / "000001-eye" / "recipe.yaml"
    assert _frames(_render(stored, tmp_path / "again")) == alone
