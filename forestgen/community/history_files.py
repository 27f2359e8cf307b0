"""A community's history -> files: the history itself, maps, an animation, curves, statistics, graphs of branches."""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from forestgen.architecture.geometry import skeletal_graph
from forestgen.architecture.graph_files import GRAPH_FORMATS, write_graph
from forestgen.community.capabilities import AskedDensities, OwnSkeletons, capability, models_with
from forestgen.community.history import write_history
from forestgen.community.placement.model import describe_densities
from forestgen.community.plot_series import WaterSeries, plot_curves, plot_sizes, plot_thinning, plot_water
from forestgen.community.plots import OBSTACLE, colours_of, map_figure, plot_densities, save_figure
from forestgen.community.population import Population, Site, Status, plant_mass
from forestgen.community.resume import origin
from forestgen.community.simulation import NO_OBSTACLES, CommunityPlan, Obstacles
from forestgen.community.trajectory import Moment, Trajectory, describe_step, describe_thinning, moment, thinning_slope
from forestgen.core.errors import OutputError, RecipeError, writing

_CURVE_POINTS = 400
_DESCRIBED_STEPS = 40  # of which each costs the searches for nearest neighbours

MOST_FRAMES = 60
MOST_BYTES = 3_000_000
_LONGEST_PX = 440  # of the site's longer side
_CAPTION_PX = 24
_FINER = 2  # drawn so many times larger, then averaged: smooth edges
_GROUND = (250, 248, 243)
_INK = (60, 60, 60)
_FRAME_MS, _LAST_MS = 110, 2500
_MOST_COLOURS = 256
_LEAST_PX = 200  # wide: room for the caption
_SMALL_PX, _LEAST_RADIUS_PX = 5.0, 1.0  # before the averaging: circles without an edge; and the smallest
_OPACITY, _DARKER = 0.55, 0.7  # of fills, and of edges, as on the map


class Film:
    """A small animated picture of circles (Lane 2002, Figures 4.3, 4.5 and 4.6), drawn as snapshots come.

    It keeps the frames, a byte a pixel, and no snapshot.

    `periodic` circles that reach over an edge continue at the opposite one. Obstacles are drawn as their ground plans,
    below the circles; the snapshots must not hold them as plants.
    """

    def __init__(
        self,
        site: Site,
        species_names: Sequence[str],
        species_colours: Mapping[str, str],
        *,
        periodic: bool,
        obstacles: Obstacles = NO_OBSTACLES,
    ) -> None:
        self._site, self._periodic, self._obstacles = site, periodic, obstacles
        colours = colours_of(species_colours, species_names)
        self._rgb = [_rgb(colours[name]) for name in species_names]
        scale = _LONGEST_PX / max(site.size_m)
        self._size_px = max(1, round(site.size_m[0] * scale)), max(1, round(site.size_m[1] * scale))
        self._palette = _palette([*self._rgb, _rgb(OBSTACLE)] if obstacles.entries else self._rgb)
        self._frames: list[Image.Image] = []

    def add(self, population: Population) -> None:
        """Draw a frame."""
        width, height = self._size_px
        frame = Image.new("RGB", (max(width, _LEAST_PX), height + _CAPTION_PX), "white")
        frame.paste(self._ground(population).reduce(_FINER), (0, _CAPTION_PX))
        n = int(np.count_nonzero(population.status != Status.DEAD))
        text = f"{population.time_yr:g} years   {n:,} plants"
        ImageDraw.Draw(frame).text((6, 4), text, fill=_INK, font=ImageFont.load_default(13))
        self._frames.append(frame.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def _ground(self, population: Population) -> Image.Image:
        """Circles, small ones above large ones as on the map."""
        width, height = (side * _FINER for side in self._size_px)
        scale = width / self._site.size_m[0]
        alive = np.flatnonzero(population.status != Status.DEAD)
        order = alive[np.argsort(-population.radius_m[alive], kind="stable")]
        centre = population.position_m[order, :2] * (scale, -scale) + (0, height)
        radius, kind = population.radius_m[order] * scale, population.species[order]
        ground = Image.new("RGB", (width, height), _GROUND)
        for one in self._obstacles.entries:
            corners = one.corners_m() * (scale, -scale) + (0, height)
            ImageDraw.Draw(ground).polygon([(x, y) for x, y in corners.tolist()], fill=_rgb(OBSTACLE))
        draw = ImageDraw.Draw(ground)
        fills = [_mixed(rgb, _GROUND, _OPACITY) for rgb in self._rgb]
        edges = [_mixed(rgb, (0, 0, 0), _DARKER) for rgb in self._rgb]
        for (x, y), r, k in zip(centre.tolist(), radius.tolist(), kind.tolist(), strict=True):
            fill, outline = (fills[k], edges[k]) if r >= _SMALL_PX else (self._rgb[k], None)
            r = max(r, _LEAST_RADIUS_PX)
            for dx in self._shifts(x, r, width):
                for dy in self._shifts(y, r, height):
                    draw.ellipse((x + dx - r, y + dy - r, x + dx + r, y + dy + r), fill, outline, _FINER)
        return ground

    def _shifts(self, at: float, radius: float, size: float) -> tuple[float, ...]:
        """How far to move a circle so that all of it is seen."""
        if self._periodic and at < radius:
            return (0.0, size)
        if self._periodic and at + radius > size:
            return (0.0, -size)
        return (0.0,)

    def write(self, path: Path) -> None:
        """Write the frames as a GIF of at most `MOST_BYTES`, with fewer frames where that takes it."""
        if not self._frames:
            raise ValueError("an animation needs at least one frame")
        frames = self._frames
        data = _gif(frames)
        while len(data) > MOST_BYTES and len(frames) > 2:
            stride = math.ceil(len(data) / MOST_BYTES) if len(frames) > 4 else 2
            frames = [*frames[:-1][:: max(2, stride)], frames[-1]]
            data = _gif(frames)
        with writing(path, "the animation cannot be written"):
            path.write_bytes(data)


def _gif(frames: Sequence[Image.Image]) -> bytes:
    stream = io.BytesIO()
    duration = [_FRAME_MS] * (len(frames) - 1) + [_LAST_MS]
    frames[0].save(
        stream, format="GIF", save_all=True, append_images=frames[1:], duration=duration, loop=0, optimize=False
    )
    return stream.getvalue()


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = ImageColor.getrgb(colour)[:3]
    return red, green, blue


def _mixed(one: tuple[int, int, int], other: tuple[int, int, int], share: float) -> tuple[int, int, int]:
    red, green, blue = (round(share * a + (1 - share) * b) for a, b in zip(one, other, strict=True))
    return red, green, blue


def _palette(species: Sequence[tuple[int, int, int]]) -> Image.Image:
    """The colours of all frames: ground, caption, and each species with the steps between its edge, fill and ground."""
    colours = [_GROUND, (255, 255, 255), *(_mixed(_INK, (255, 255, 255), share) for share in (0.25, 0.5, 0.75, 1.0))]
    for rgb in species:
        fill, edge = _mixed(rgb, _GROUND, _OPACITY), _mixed(rgb, (0, 0, 0), _DARKER)
        for one, other in ((fill, _GROUND), (edge, fill), (edge, _GROUND), (rgb, _GROUND)):
            colours += [_mixed(one, other, share) for share in (1.0, 0.66, 0.33)]
    distinct = list(dict.fromkeys(colours))[:_MOST_COLOURS]
    flat: NDArray[np.uint8] = np.array(distinct + [distinct[0]] * (256 - len(distinct)), dtype=np.uint8)
    image = Image.new("P", (1, 1))
    image.putpalette(flat.tobytes())
    return image


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
