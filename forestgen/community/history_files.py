"""A community's history -> files: the history itself, maps, an animation, curves, statistics, graphs of branches."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.architecture.geometry import skeletal_graph
from forestgen.architecture.graph_files import GRAPH_FORMATS, write_graph
from forestgen.community.animation import MOST_FRAMES, Film
from forestgen.community.capabilities import AskedDensities, OwnSkeletons, capability, models_with
from forestgen.community.history import write_history
from forestgen.community.placement.model import describe_densities
from forestgen.community.plan import CommunityPlan
from forestgen.community.plot_series import WaterSeries, plot_curves, plot_sizes, plot_thinning, plot_water
from forestgen.community.plots import map_figure, plot_densities, save_figure
from forestgen.community.population import Population, plant_mass
from forestgen.community.resume import origin
from forestgen.community.trajectory import Moment, Trajectory, describe_step, describe_thinning, moment, thinning_slope
from forestgen.core.errors import OutputError, RecipeError, writing

_CURVE_POINTS = 400
_DESCRIBED_STEPS = 40  # of which each costs the searches for nearest neighbours


def evenly(first: int, last: int, most: int) -> Callable[[int], bool]:
    """Whether a step is one of at most `most` evenly spaced ones from `first` on, or `last`, which always is.

    `most` must be 2 at least.
    """
    stride = max(1, -(-(last - first) // (most - 1)))
    return lambda step: step == last or (step - first) % stride == 0


class _Observer:
    """Keeps numbers and pictures of the snapshots that pass, and draws maps of some; obstacles are left out."""

    film: Film
    last: Population  # as it is
    plants: Population  # the same without obstacles

    def __init__(self, folder: Path, plan: CommunityPlan, map_steps: Sequence[int]) -> None:
        self.folder, self.plan, self.map_steps = folder, plan, set(map_steps) or {plan.steps}
        self.moments: list[Moment] = []
        self.described: list[dict[str, Any]] = []
        self.placement: dict[str, Any] | None = None  # of the plants of step 0
        self.water: list[tuple[float, Mapping[str, Any]]] = []  # of every snapshot with its time

    def watch(self, snapshots: Iterator[Population]) -> Iterator[Population]:
        """The snapshots on their way."""
        plan, site, obstacles = self.plan, self.plan.site, self.plan.obstacles
        periodic, colours = plan.parameters.periodic, map_colours(plan)
        for number, population in enumerate(snapshots):
            step = population.step
            self.last, self.plants = population, obstacles.left_out_of(population)
            if number == 0:
                names = self.plants.species_names
                self.film = Film(site, names, colours, periodic=periodic, obstacles=obstacles)
                on_curve, in_film, is_described = (
                    evenly(step, plan.steps, most) for most in (_CURVE_POINTS, MOST_FRAMES, _DESCRIBED_STEPS)
                )
                if step == 0:
                    self.placement = _placement(self.folder, plan, population)
            if "water" in population.state:
                self.water.append((population.time_yr, population.state["water"]))
            if on_curve(step):
                self.moments.append(moment(self.plants, site))
            if plan.steps and in_film(step):
                self.film.add(self.plants)
            if is_described(step):
                self.described.append(describe_step(self.plants, site, plan.drawn.image_seed))
            if step in self.map_steps:
                figure = map_figure(self.plants, site, colours, periodic=periodic, obstacles=obstacles)
                save_figure(figure, self.folder / f"map-{step:06d}.png")
            yield population


def write_community(
    folder: Path, plan: CommunityPlan, snapshots: Iterator[Population], map_steps: Sequence[int]
) -> Population:
    """Write all files of a simulation as its snapshots come; the last snapshot.

    history.parquet, a map for each of `map_steps` (by default the last), sizes.png of the last snapshot, and
    statistics.json; if there are steps, animation.gif, curves.png and thinning.png too; of a model that places plants
    by densities, densities.png; of one with water, maps.nc and water.png; on request, modules.parquet. No snapshot is
    held but the current one. With fellings and plantings there is no self-thinning line: they thin a stand as no
    crowding does. Obstacles are no plants in pictures and statistics. `check_map_steps` checks `map_steps`.
    """
    observer = _Observer(folder, plan, map_steps)
    skeletons = capability(plan.model, OwnSkeletons)
    modules = skeletons is not None and skeletons.keeps_skeletons(plan.parameters)
    watched = observer.watch(snapshots)
    write_history(folder / "history.parquet", watched, origin(plan), modules=modules, size_m=plan.site.size_m)
    thinning = _write_course(observer) if plan.steps else None
    plot_sizes(observer.plants, map_colours(plan), folder / "sizes.png")
    _write_statistics(folder / "statistics.json", observer, thinning)
    return observer.last


def _write_course(seen: _Observer) -> dict[str, Any] | None:
    """The pictures of a community in time; its self-thinning line as `describe_thinning` reports it."""
    plan, folder, colours = seen.plan, seen.folder, map_colours(seen.plan)
    trajectory = Trajectory.of(seen.moments, seen.plants.species_names, plan.site, plant_mass(seen.plants)[1])
    plot_curves(trajectory, colours, folder / "curves.png")
    slope = None if plan.parameters.disturbances else thinning_slope(trajectory)
    plot_thinning(trajectory, slope, colours, folder / "thinning.png")
    seen.film.write(folder / "animation.gif")
    if seen.water:
        plot_water(WaterSeries.of(seen.water), seen.last, plan.site, colours, folder / "water.png")
    return describe_thinning(trajectory, slope) if slope else None


def _placement(folder: Path, plan: CommunityPlan, placed: Population) -> dict[str, Any] | None:
    """Draw the densities of a model that has such under the plants of step 0, and report how well they agree."""
    placement = capability(plan.model, AskedDensities)
    if placement is None:
        return None
    densities = placement.densities(plan.parameters, plan.site, plan.ecologies, placed)
    if not densities.asked:
        return None
    plot_densities(densities, placed, plan.site, map_colours(plan), folder / "densities.png")
    return describe_densities(densities, placed, plan.site)


def _write_statistics(path: Path, seen: _Observer, thinning: dict[str, Any] | None) -> None:
    """JSON: statistics of some steps, of the whole course, and of the placement that was asked for."""
    document: dict[str, Any] = {
        "version": 1,
        "site_size_m": list(seen.plan.site.size_m),
        "species": list(seen.plants.species_names),
        "mass_unit": "kg" if plant_mass(seen.last)[1] == "kg" else "m3 (radius cubed)",
        "steps": seen.described,
        "self_thinning": thinning,
    }
    if seen.placement is not None:
        hopkins = seen.described[0]["hopkins"]
        document["placement"] = {name: {**one, "hopkins": hopkins[name]} for name, one in seen.placement.items()}
    for name in ("clustering", "water"):
        if name in seen.last.state:
            document[name] = seen.last.state[name]
    with writing(path, "the statistics cannot be written"):
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


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
        problem = "plants of this community have no branches of their own"
        expected, got = f"community.model: {models_with(OwnSkeletons)}", plan.drawn.recipe.community.model
        hint = "forestgen plant NAME --out exports a single plant"
        raise RecipeError(problem, parameter="graphs", expected=expected, got=got, hint=hint)
    for path in paths:
        if path.suffix.lower() not in GRAPH_FORMATS:
            expected = f"a name that ends with {', '.join(GRAPH_FORMATS)}"
            raise RecipeError("no format for skeletal graphs", parameter="graphs", expected=expected, got=str(path))
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            expected = "a file in a folder that there is, and that may be written to"
            got = "a folder" if path.is_dir() else "no such folder" if not path.parent.is_dir() else "no permission"
            raise OutputError("the graph cannot be written", where=str(path), expected=expected, got=got)


def write_graphs(plan: CommunityPlan, population: Population, paths: Sequence[Path]) -> None:
    """Write the graphs of a snapshot's plants, in the world; z counts from the ground. Raises `OutputError`."""
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
