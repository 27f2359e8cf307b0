"""A community's history -> files: the history itself, maps, an animation, curves, statistics, graphs of branches."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.architecture.graph_files import GRAPH_FORMATS, write_graph
from forestgen.architecture.skeletal_graph import skeletal_graph
from forestgen.community.animation import MOST_FRAMES, Film
from forestgen.community.capabilities import AskedDensities, OwnSkeletons, capability, models_with
from forestgen.community.history import write_history
from forestgen.community.placement.asked_and_placed import describe_densities
from forestgen.community.plan import CommunityPlan
from forestgen.community.plot_densities import plot_densities
from forestgen.community.plot_series import plot_curves, plot_thinning
from forestgen.community.plot_sizes import plot_sizes
from forestgen.community.plot_water import WaterSeries, plot_water
from forestgen.community.plots import plot_map
from forestgen.community.population import Population
from forestgen.community.resume import origin
from forestgen.community.statistics import plant_mass
from forestgen.community.trajectory import Moment, Trajectory, describe_step, describe_thinning, moment, thinning_slope
from forestgen.core.errors import OutputError, RecipeError

_CURVE_POINTS = 400
_DESCRIBED_STEPS = 40  # of which each costs the searches for nearest neighbours


def evenly(first: int, last: int, most: int) -> Callable[[int], bool]:
    """Whether a step is one of at most `most` evenly spaced ones from `first` on, or `last`, which always is.

    `most` must be 2 at least.
    """
    stride = max(1, -(-(last - first) // (most - 1)))
    return lambda step: step == last or (step - first) % stride == 0


@dataclass
class _Told:
    """What is kept of the snapshots that have passed."""

    film: Film
    moments: list[Moment]
    described: list[dict[str, Any]]
    last: Population  # as it is
    plants: Population  # the same without obstacles
    placement: dict[str, Any] | None = None  # of the plants of step 0
    water: list[tuple[float, Mapping[str, Any]]] = field(default_factory=list)  # of every snapshot with its time


def write_community(
    folder: Path, plan: CommunityPlan, snapshots: Iterator[Population], map_steps: Sequence[int]
) -> Population:
    """Write all files of a simulation as its snapshots come; the last snapshot.

    history.parquet, a map for each of `map_steps` (by default the last), sizes.png of the last snapshot, and
    statistics.json; if there are steps, animation.gif, curves.png and thinning.png too; of a model that places plants
    by densities, densities.png; of one with water, maps.nc and water.png; on request, modules.parquet. No snapshot is
    held but the current one. Fellings and plantings thin a stand as no crowding does: with them there is no
    self-thinning line. Obstacles, which are in the history, are no plants in pictures and statistics.

    `check_map_steps` tells whether the simulation reaches `map_steps`.
    """
    told: list[_Told] = []
    skeletons = capability(plan.model, OwnSkeletons)
    modules = skeletons is not None and skeletons.keeps_skeletons(plan.parameters)
    watched = _watched(folder, plan, snapshots, map_steps, told)
    write_history(folder / "history.parquet", watched, origin(plan), modules=modules, size_m=plan.site.size_m)
    (end,) = told
    thinning = _write_course(folder, plan, end) if plan.steps else None
    plot_sizes(end.plants, map_colours(plan), folder / "sizes.png")
    _write_statistics(folder / "statistics.json", plan, end, thinning)
    return end.last


def _write_course(folder: Path, plan: CommunityPlan, end: _Told) -> dict[str, Any] | None:
    """The pictures of a community in time; its self-thinning line as `describe_thinning` tells it."""
    colours, unit = map_colours(plan), plant_mass(end.plants)[1]
    trajectory = Trajectory.of(end.moments, end.plants.species_names, plan.site, unit)
    plot_curves(trajectory, colours, folder / "curves.png")
    slope = None if plan.parameters.disturbances else thinning_slope(trajectory)
    plot_thinning(trajectory, slope, colours, folder / "thinning.png")
    end.film.write(folder / "animation.gif")
    if end.water:
        plot_water(WaterSeries.of(end.water), end.last, plan.site, colours, folder / "water.png")
    return describe_thinning(trajectory, slope) if slope else None


def _watched(
    folder: Path, plan: CommunityPlan, snapshots: Iterator[Population], map_steps: Sequence[int], told: list[_Told]
) -> Iterator[Population]:
    """The snapshots, of which `told` takes notes and maps are drawn on their way."""
    wanted, site, seed = set(map_steps) or {plan.steps}, plan.site, plan.drawn.image_seed
    periodic, colours = plan.parameters.periodic, map_colours(plan)
    obstacles = plan.obstacles
    for population in snapshots:
        step, plants = population.step, obstacles.left_out_of(population)
        if not told:
            film = Film(site, plants.species_names, colours, periodic=periodic, obstacles=obstacles)
            told.append(_Told(film, [], [], population, plants))
            on_curve, in_film, is_described = (
                evenly(step, plan.steps, most) for most in (_CURVE_POINTS, MOST_FRAMES, _DESCRIBED_STEPS)
            )
            if step == 0:
                told[0].placement = _placement(folder, plan, population)
        told[0].last, told[0].plants = population, plants
        if "water" in population.state:
            told[0].water.append((population.time_yr, population.state["water"]))
        if on_curve(step):
            told[0].moments.append(moment(plants, site))
        if plan.steps and in_film(step):
            told[0].film.add(plants)
        if is_described(step):
            told[0].described.append(describe_step(plants, site, seed))
        if step in wanted:
            path = folder / f"map-{step:06d}.png"
            plot_map(plants, site, colours, path, periodic=periodic, obstacles=obstacles)
        yield population


def _placement(folder: Path, plan: CommunityPlan, placed: Population) -> dict[str, Any] | None:
    """Draw the densities of a model that has such under the plants of step 0, and tell how well they agree."""
    placement = capability(plan.model, AskedDensities)
    if placement is None:
        return None
    densities = placement.densities(plan.parameters, plan.site, plan.ecologies, placed)
    if not densities.asked:
        return None
    plot_densities(densities, placed, plan.site, map_colours(plan), folder / "densities.png")
    return describe_densities(densities, placed, plan.site)


def _write_statistics(path: Path, plan: CommunityPlan, end: _Told, thinning: dict[str, Any] | None) -> None:
    """JSON: what is told of some steps, of all, and of the placement that was asked for."""
    document: dict[str, Any] = {
        "version": 1,
        "site_size_m": list(plan.site.size_m),
        "species": list(end.plants.species_names),
        "mass_unit": "kg" if plant_mass(end.last)[1] == "kg" else "m3 (radius cubed)",
        "steps": end.described,
        "self_thinning": thinning,
    }
    if end.placement is not None:
        hopkins = end.described[0]["hopkins"]
        document["placement"] = {name: {**one, "hopkins": hopkins[name]} for name, one in end.placement.items()}
    for name in ("clustering", "water"):
        if name in end.last.state:
            document[name] = end.last.state[name]
    try:
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError("the statistics cannot be written", where=str(path), got=str(error)) from error


def check_map_steps(plan: CommunityPlan, map_steps: Sequence[int], first: int = 0) -> None:
    """Raise `RecipeError` unless all of `map_steps` are steps of the simulation, which begins at step `first`."""
    for step in map_steps:
        if not first <= step <= plan.steps:
            expected = f"a step from {first} to {plan.steps}"
            raise RecipeError("no such step", parameter="map_steps", expected=expected, got=str(step))


def map_colours(plan: CommunityPlan) -> dict[str, str]:
    """Colours of species on maps, as their files give them; the plots choose for the others."""
    return {name: species.map_colour for name, species in plan.drawn.species.items() if species.map_colour}


def check_graphs(plan: CommunityPlan, paths: Sequence[Path]) -> None:
    """Refuse, before anything is simulated, graphs of plants without branches and files that cannot be written."""
    if paths and capability(plan.model, OwnSkeletons) is None:
        raise RecipeError(
            "plants of this community have no branches of their own",
            parameter="graphs",
            expected=f"community.model: {models_with(OwnSkeletons)}",
            got=plan.drawn.recipe.community.model,
            hint="forestgen plant NAME --out exports a single plant",
        )
    for path in paths:
        if path.suffix.lower() not in GRAPH_FORMATS:
            raise RecipeError(
                "no format for skeletal graphs",
                parameter="graphs",
                expected=f"a name that ends with {', '.join(GRAPH_FORMATS)}",
                got=str(path),
            )
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            raise OutputError(
                "the graph cannot be written",
                where=str(path),
                expected="a file in a folder that there is, and that may be written to",
                got="a folder" if path.is_dir() else "no such folder" if not path.parent.is_dir() else "no permission",
            )


def write_graphs(plan: CommunityPlan, population: Population, paths: Sequence[Path]) -> None:
    """Write the graphs of all plants of a snapshot, at their places in the world; z counts from the ground's height.

    Raises
    ------
    OutputError : a file cannot be written.
    """
    skeletons, modules = capability(plan.model, OwnSkeletons), population.modules
    if not paths or modules is None or skeletons is None:
        return
    tables = skeletons.skeleton_tables(plan.parameters, plan.ecologies, population)
    graph = skeletal_graph(tables, modules, population.species, np.flatnonzero(np.diff(modules.first)))
    foot_m = population.position_m.copy()
    if plan.site.height is not None:
        foot_m[:, 2] = plan.site.height(foot_m[:, 0], foot_m[:, 1])
    columns = {
        "plant_id": population.plant_id,
        "species": np.array(population.species_names, dtype=np.str_)[population.species],
    }
    for path in paths:
        write_graph(path, graph, foot_m=foot_m, columns=columns)
