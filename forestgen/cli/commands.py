"""The commands behind forestgen.cli; imported when one runs."""

from __future__ import annotations

import inspect
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from forestgen.cli.console import Bars, count, output, seconds
from forestgen.community.registry import COMMUNITY_MODELS, ENVIRONMENTS
from forestgen.core.errors import RecipeError
from forestgen.core.forestry import BREAST_HEIGHT_M
from forestgen.core.registry import Registry
from forestgen.core.timing import Timings
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.assets import find_asset, list_assets, recipes_dir, scenes_dir
from forestgen.recipe.json_schema import recipe_json_schema
from forestgen.recipe.load import LoadedRecipe, load_recipe
from forestgen.recipe.sources import dotted
from forestgen.recipe.suggestions import did_you_mean
from forestgen.scene.exemplars import SizeError
from forestgen.stages.module_checks import notes_on_houses
from forestgen.stages.plan import Plan, check_plan, estimate_bytes, views_below_ground, why_barren

if TYPE_CHECKING:
    from forestgen.pipeline import RunSummary, Stems

_MOST_NOTES = 5
_REGISTRIES = (COMMUNITY_MODELS, ENVIRONMENTS, GENERATORS)
_ASSETS = ("species", "lsystems", "recipes")


def output_folder(chosen: Path | None, recipe: Path) -> Path:
    """The folder asked for; else the first of outputs/NAME, outputs/NAME-2, ... that is free."""
    if chosen is not None:
        return chosen
    stem, number = Path("outputs") / recipe.stem, 1
    target = stem
    while target.exists():
        number += 1
        target = stem.with_name(f"{stem.name}-{number}")
    return target


def render(
    recipe: Path, overrides: Sequence[str], target: Path | None, overwrite: bool, threads: int | None, bars: Bars
) -> None:
    from forestgen import pipeline  # loads every stage: seconds that `validate` need not take

    timings = Timings()
    with timings("recipe"):
        loaded = load_recipe(recipe, overrides)
    with bars.running():
        summary = pipeline.render(
            loaded, output_folder(target, recipe), overwrite=overwrite, threads=threads, progress=bars, timings=timings
        )
    out = output()
    if loaded.images > 1:
        _say(out, "The last image:")
    _say_counts(out, summary)
    _say_noise(out, summary.relative_errors)
    if summary.size_errors:
        _say_size_errors(out, summary.size_errors)
    _say_notes(out, summary.notes)
    inside = summary.timings_s.get("light paths", 0.0) / summary.total_s
    frames = count(summary.frames, "frame")
    _say(out, f"{frames} in {seconds(summary.total_s)}, {100 * inside:.0f}% of it on light paths")
    _say(out, f"files: {summary.folder}/")
    first = min(path for path in summary.folder.iterdir() if path.is_dir())
    _say(out, f"look at {first / 'preview.png'} and {first / 'overlay.png'}")


def _say(out: Console, text: str) -> None:
    out.print(Text(text))  # names may hold brackets, which are no markup


def _say_notes(out: Console, notes: Sequence[str]) -> None:
    for note in notes[:_MOST_NOTES]:
        _say(out, f"note: {note}")
    if len(notes) > _MOST_NOTES:
        _say(out, f"note: {len(notes) - _MOST_NOTES} more notes are in manifest.json")


def _say_counts(out: Console, summary: RunSummary) -> None:
    kinds = ", ".join(f"{number:,} {name}" for name, number in summary.counts.items())
    seen = f"; {summary.visible_plants:,} of them in view" if summary.frames else ""
    dead = f", {summary.standing_dead:,} of them standing dead" if summary.standing_dead else ""
    _say(out, f"{count(summary.plants, 'plant')} ({kinds}){dead}{seen}")


def _say_noise(out: Console, errors: Sequence[float]) -> None:
    """The relative error of the frames' radiance, as far as it is known."""
    known = [100 * error for error in errors if math.isfinite(error)]
    if known:
        least, most = f"{min(known):.2g}", f"{max(known):.2g}"
        _say(out, f"noise: relative error {least if least == most else f'{least} to {most}'} % before denoising")


def _say_size_errors(out: Console, errors: Sequence[SizeError]) -> None:
    """How well the exemplars stand for the plants: root mean squares of relative errors."""
    table = Table("species", box=None, pad_edge=False, header_style="")
    for title in ("plants", "exemplars", "rms size error", "rms crown width error"):
        table.add_column(title, justify="right")
    for error in errors:
        rms = ("-" if value is None else f"{100 * value:.1f} %" for value in (error.radius_rms, error.crown_width_rms))
        table.add_row(Text(error.species), f"{error.plants:,}", f"{error.exemplars:,}", *rms)
    out.print(table)


def simulate(
    recipe: Path,
    overrides: Sequence[str],
    map_steps: Sequence[int],
    resume: Path | None,
    from_step: int | None,
    graphs: Sequence[Path],
    target: Path | None,
    overwrite: bool,
    bars: Bars,
) -> None:
    from forestgen import pipeline  # loads every stage: seconds that `validate` need not take

    if from_step is not None and resume is None:
        raise RecipeError("no history to go on from", where="--from-step", expected="--resume history.parquet with it")
    timings = Timings()
    loaded = load_recipe(recipe, overrides)
    folder = output_folder(target, recipe.with_name(f"{recipe.stem}-community"))
    with bars.running():
        summary = pipeline.simulate(
            loaded,
            folder,
            map_steps=map_steps,
            resume=resume,
            from_step=from_step,
            graphs=graphs,
            overwrite=overwrite,
            progress=bars,
            timings=timings,
        )
    out = output()
    _say_counts(out, summary)
    _say_stems(out, summary.stems)
    _say_biome(out, loaded)
    _say_notes(out, summary.notes)
    _say(out, f"simulated in {seconds(summary.timings_s['community'])}")
    _say(out, f"files: {summary.folder}/ ({', '.join(sorted(path.name for path in summary.folder.iterdir()))})")


def _say_stems(out: Console, stems: Sequence[Stems]) -> None:
    """What a forester counts, by species: living plants over breast height."""
    if not any(one.plants for one in stems):
        return
    table = Table("living", box=None, pad_edge=False, header_style="")
    for title in ("plants", f"stems over {BREAST_HEIGHT_M} m", "stems per ha"):
        table.add_column(title, justify="right")
    for one in stems:
        table.add_row(Text(one.species), f"{one.plants:,}", f"{one.stems:,}", f"{one.per_ha:,.0f}")
    if len(stems) > 1:
        sums = (sum(one.plants for one in stems), sum(one.stems for one in stems), sum(one.per_ha for one in stems))
        table.add_row("all", *(f"{value:,.0f}" for value in sums))
    out.print(table)


def _say_biome(out: Console, loaded: LoadedRecipe) -> None:
    """What people call land of the climate that chose a recipe's species."""
    from forestgen.recipe.biome import biome_name

    biome = loaded.draw(0).recipe.community.parameters.get("biome")
    if biome:
        t, p = biome["temperature_c"], biome["precipitation_mm_per_yr"]
        _say(out, f"biome: {biome_name(t, p)}, of {t:g} deg C and {p:g} mm a year")


def validate(recipe: Path, overrides: Sequence[str]) -> None:
    loaded = load_recipe(recipe, overrides)
    plan = check_plan(loaded)
    out = output()
    _say(out, f"{recipe}: valid")
    for name, text in _described(loaded, plan):
        _say(out, f"  {name:<10} {text}")
    reason = why_barren(plan)
    below = [f"the camera {name} stands below the ground" for name in views_below_ground(plan)]
    inside = notes_on_houses(plan.drawn, plan.model_parameters)
    _say_notes(out, [*([reason] if reason else []), *below, *inside])


def _described(loaded: LoadedRecipe, plan: Plan) -> Iterator[tuple[str, str]]:
    drawn = plan.drawn.recipe
    cameras, width, height = drawn.cameras, drawn.site.size_m[0], drawn.site.size_m[1]
    images, frames = count(loaded.images, "image"), sum(camera.frames for camera in cameras)
    yield "makes", f"{count(loaded.images * frames, 'frame')}: {images} x {count(len(cameras), 'camera')}"
    for camera in cameras[:_MOST_NOTES]:
        along = f", {camera.frames} images" if camera.frames > 1 else ""
        yield "", f"{camera.name}, {camera.size_px[0]} x {camera.size_px[1]} px{along}"
    if len(cameras) > _MOST_NOTES:
        yield "", "..."
    yield "site", f"{width:g} x {height:g} m, {drawn.site.terrain.kind}"
    yield "community", f"{drawn.community.model}, {count(plan.steps, 'step')}"
    yield "species", ", ".join(drawn.species)
    yield "drawn anew", ", ".join(dotted(keys) for keys in loaded.distributions) or "nothing but the random numbers"
    if loaded.draws.sampler is not None:
        yield "sampling", loaded.draws.sampler.describe()
    community, whole = (sum(estimate_bytes(plan, simulate_only=only).values()) for only in (True, False))
    yield "memory", f"up to about {whole / 1e9:.1f} GB to render, {community / 1e9:.1f} GB to simulate alone"
    yield "hash", loaded.hash


def schema() -> None:
    def parameters(registry: Registry, discriminator: str) -> dict[str, dict[str, object]]:
        found = {name: registry.load(name).Parameters.model_json_schema() for name in registry.ids()}
        for one in found.values():
            one.get("properties", {}).pop(discriminator, None)
        return found

    described = recipe_json_schema(parameters(COMMUNITY_MODELS, "model"), parameters(GENERATORS, "generator"))
    sys.stdout.write(json.dumps(described, indent=2) + "\n")


def models(name: str | None) -> None:
    out = output()
    if name is not None:
        _say(out, _page(name))
        return
    for registry in _REGISTRIES:
        _say_list(out, f"{registry.kind}s", {one: registry.describe(one) for one in registry.ids()})
    for kind in _ASSETS:
        _say_list(out, kind, {one: _first_comment(find_asset(kind, one)) for one in list_assets(kind)})
    _say(out, f"species and lsystems lie in {scenes_dir()}, recipes in {recipes_dir()}")


def _say_list(out: Console, title: str, entries: Mapping[str, str]) -> None:
    _say(out, title)
    width = max((len(name) for name in entries), default=0)
    for name, text in entries.items():
        _say(out, f"  {name:<{width}}  {text}".rstrip())


def _first_comment(path: Path) -> str:
    first = path.read_text(encoding="utf-8").partition("\n")[0]
    return first.lstrip("#/").strip() if first.startswith(("#", "//")) else ""


def _pages(name: str) -> Iterator[str]:
    """Manual pages of the models, environments and generators of a name; then files of species, programs, recipes."""
    for registry in _REGISTRIES:
        if name in registry.ids():
            module = sys.modules[type(registry.load(name)).__module__]
            yield inspect.cleandoc(module.__doc__ or f"{name} has no manual page")
    for kind in _ASSETS:
        if name in list_assets(kind):
            path = find_asset(kind, name)
            yield f"{path}\n\n{path.read_text(encoding='utf-8').rstrip()}"


def _page(name: str) -> str:
    pages = list(_pages(name))
    if pages:
        return "\n\n".join(pages)
    known = [one for registry in _REGISTRIES for one in registry.ids()]
    known += [one for kind in _ASSETS for one in list_assets(kind)]
    raise RecipeError(
        "there is no page of this name",
        expected="one of " + ", ".join(known),
        got=repr(name),
        hint=did_you_mean(name, known),
    )
