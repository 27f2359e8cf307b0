"""The commands behind forestgen.cli; imported when one runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from forestgen import pipeline
from forestgen.cli.console import Bars, seconds
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import RecipeError
from forestgen.core.registry import Registry
from forestgen.core.timing import Timings
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.assets import find_asset, list_assets, recipes_dir
from forestgen.recipe.json_schema import recipe_json_schema
from forestgen.recipe.load import load_recipe
from forestgen.stages.plan import check_plan, estimate_bytes


def _target(output: Path | None, recipe: Path) -> Path:
    """The folder asked for; else the first of outputs/NAME, outputs/NAME-2, ... that is free."""
    if output is not None:
        return output
    stem, number = Path("outputs") / recipe.stem, 1
    target = stem
    while target.exists():
        number += 1
        target = stem.with_name(f"{stem.name}-{number}")
    return target


def _out() -> Console:
    return Console(highlight=False, soft_wrap=True)


def render(
    recipe: Path, overrides: Sequence[str], output: Path | None, overwrite: bool, threads: int | None, bars: Bars
) -> None:
    timings = Timings()
    with timings("recipe"):
        loaded = load_recipe(recipe, overrides)
    with bars.running():
        summary = pipeline.render(
            loaded, _target(output, recipe), overwrite=overwrite, threads=threads, progress=bars, timings=timings
        )
    out = _out()
    _print_counts(out, summary)
    if summary.size_errors:
        table = Table("species", "plants", "exemplars", "size error (rms)", "crown width error (rms)", box=None)
        for error in summary.size_errors:
            table.add_row(
                error.species,
                f"{error.plants:,}",
                str(error.exemplars),
                f"{100 * error.radius_rms:.1f}%",
                f"{100 * error.crown_width_rms:.1f}%",
            )
        out.print(table)
    for note in summary.notes:
        out.print(f"note: {note}")
    frames = "1 frame" if summary.frames == 1 else f"{summary.frames} frames"
    inside = summary.timings_s.get("mitsuba", 0.0)
    out.print(f"{frames} in {seconds(summary.total_s)}, {100 * inside / summary.total_s:.0f}% of it inside the renderer")
    out.print(f"files: {summary.folder}/")
    first = sorted(path for path in summary.folder.iterdir() if path.is_dir())[0]
    out.print(f"look at {first / 'preview.png'} and {first / 'overlay.png'}")


def _print_counts(out: Console, summary: pipeline.RunSummary) -> None:
    kinds = ", ".join(f"{count:,} {name}" for name, count in summary.counts.items())
    seen = f", {summary.visible_plants:,} of them visible" if summary.frames else ""
    out.print(f"{summary.plants:,} plants ({kinds}){seen}")


def simulate(
    recipe: Path, overrides: Sequence[str], map_steps: Sequence[int], output: Path | None, overwrite: bool, bars: Bars
) -> None:
    timings = Timings()
    loaded = load_recipe(recipe, overrides)
    target = _target(output, recipe.with_name(f"{recipe.stem}-community"))
    with bars.running():
        summary = pipeline.simulate(
            loaded, target, map_steps=map_steps, overwrite=overwrite, progress=bars, timings=timings
        )
    out = _out()
    _print_counts(out, summary)
    out.print(f"simulated in {seconds(summary.timings_s['community'])}")
    out.print(f"files: {summary.folder}/ (history.parquet, map-*.png, curves.png)")


def validate(recipe: Path, overrides: Sequence[str]) -> None:
    loaded = load_recipe(recipe, overrides)
    plan = check_plan(loaded)
    out = _out()
    cameras = plan.drawn.recipe.cameras
    sizes = ", ".join(f"{camera.name} {camera.size_px[0]} x {camera.size_px[1]}" for camera in cameras)
    out.print(f"{recipe}: valid")
    out.print(f"  makes      {loaded.images * len(cameras)} frames: {loaded.images} images x {len(cameras)} cameras ({sizes})")
    out.print(f"  community  {plan.drawn.recipe.community.model}, {plan.steps} steps, species {', '.join(plan.drawn.species)}")
    out.print(f"  drawn      {len(loaded.distributions)} values anew for each image")
    out.print(f"  memory     up to about {sum(estimate_bytes(plan).values()) / 1e9:.1f} GB")
    out.print(f"  hash       {loaded.hash}")


def schema() -> None:
    def parameters(registry: Registry, discriminator: str) -> dict[str, dict[str, object]]:
        found = {name: registry.load(name).Parameters.model_json_schema() for name in registry.ids()}
        for one in found.values():
            one.get("properties", {}).pop(discriminator, None)
        return found

    described = recipe_json_schema(parameters(COMMUNITY_MODELS, "model"), parameters(GENERATORS, "generator"))
    sys.stdout.write(json.dumps(described, indent=2) + "\n")


def models(name: str | None) -> None:
    out = _out()
    registries = (COMMUNITY_MODELS, GENERATORS)
    if name is not None:
        for registry in registries:
            if name in registry.ids():
                module = sys.modules[type(registry.load(name)).__module__]
                out.print((module.__doc__ or "").strip(), markup=False)
                return
        known = [one for registry in registries for one in registry.ids()]
        raise RecipeError("no such model or generator", expected="one of " + ", ".join(known), got=repr(name))
    for registry in registries:
        out.print(f"{registry.kind}s", style="bold")
        for one in registry.ids():
            out.print(f"  {one:<18} {registry.describe(one)}", markup=False)
    out.print("species", style="bold")
    for one in list_assets("species"):
        first = find_asset("species", one).read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        out.print(f"  {one:<18} {first}", markup=False)
    out.print(f"recipes in {recipes_dir()}", style="bold")
    for one in list_assets("recipes"):
        out.print(f"  {one}", markup=False)


def plant(
    species: str, height_m: float | None, seed: int, output: Path | None, overwrite: bool, bars: Bars
) -> None:
    from forestgen.stages.single_plant import grow_single_plant

    target = output or Path("outputs") / f"{Path(species).stem}.glb"
    with bars.running():
        made = grow_single_plant(species, height_m, seed, target, overwrite=overwrite, progress=bars)
    out = _out()
    out.print(f"{made.species}: {made.height_m:.2f} m tall, crown {made.crown_width_m:.2f} m wide")
    out.print(f"  {made.triangles:,} triangles: " + ", ".join(f"{count:,} {part}" for part, count in made.by_part.items()))
    out.print(f"  leaf area {made.leaf_area_m2:.2f} m2 (one side)")
    out.print(f"files: {made.mesh_path}, {made.picture_path}")
