"""Pictures of placements, made by docs/pictures.py: kernels and fields, maps, models side by side, renders.

Patterns and fields are those that the recipes' own models give; only the renders take long.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from forestgen.community.history_files import map_colours
from forestgen.community.placement.densities import grid_shape
from forestgen.community.placement.kernels import KernelTable, kernel_matrix
from forestgen.community.placement.model import Densities, asked_densities, deformed
from forestgen.community.plots import colours_of, darker, draw_field, new_figure
from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Population, Site
from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
REPRODUCTIONS = ROOT / "recipes" / "reproductions"
DPI = 110
PANEL_IN = 2.5
PAPER, INK, LINE = "#FDFCF9", "#1F3D2B", "#B5472F"
FIELD_CELLS = 512
MOST_BYTES = 400_000
BRIGHTEST = 3.0  # of fields: κ at which the darkest colour is reached
SAMPLES = ("render.samples=32", "labels.samples=1")
MEADOW = """\
forestgen: 1
seed: 5
site: {size_m: [40, 30]}
species: {fireweed: , poplar: }
community:
  model: deformation_kernel
  kernels: {poplar: {poplar: inhibition, fireweed: inhibition}, fireweed: {fireweed: inhibition}}
  keep_out: [[0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1], [0, 0, 0, 1, 1, 0], [1, 1, 1, 1, 0, 0]]
  plants:
    poplar: {count: 30, radius_m: {median: 1.4, sigma: 0.2}}
    fireweed: {count: 700, radius_m: 0.25, map: [[4, 1, 0, 0], [3, 4, 1, 1], [0, 1, 2, 3]]}
cameras: [{position_m: [20, -8, 2]}]
"""


@dataclass(frozen=True)
class Stand:
    """A recipe's plan and its plants."""

    plan: Plan
    plants: Population

    @property
    def site(self) -> Site:
        return self.plan.community.site

    def first(self, n: int) -> Population:
        """The first n plants, in the order in which they were placed."""
        columns = ("plant_id", "species", "position_m", "radius_m", "height_m", "age_yr", "status")
        cut = {name: getattr(self.plants, name)[:n] for name in columns}
        return replace(self.plants, **cut, columns={})

    def points_m(self, species: int | None = None) -> NDArray[np.float64]:
        pick = slice(None) if species is None else self.plants.species == species
        return np.asarray(self.plants.position_m[pick, :2])

    @property
    def hopkins(self) -> float:
        return hopkins_index(self.points_m(), self.site.size_m, np.random.default_rng(0))

    @property
    def kernels(self) -> Sequence[Sequence[KernelTable]]:
        return kernel_matrix(self.plan.community.parameters.kernels, list(self.plants.species_names))

    def densities(self, placed: Population | None = None) -> Densities:
        """What was asked for; with some plants, the field that they leave too."""
        cells = grid_shape(self.site, FIELD_CELLS)
        parameters, species = self.plan.community.parameters, self.plan.community.ecologies
        asked = asked_densities(parameters, self.site, species, cells)
        if placed is None:
            return asked
        return deformed(asked, self.site, parameters.periodic, species, placed, self.kernels)

    @property
    def colours(self) -> Mapping[str, str]:
        return colours_of(map_colours(self.plan.community), self.plants.species_names)


@cache
def stand(name: str, *settings: str) -> Stand:
    """A reproduction's plants."""
    plan = check_plan(load_recipe(REPRODUCTIONS / f"{name}.yaml", list(settings)), simulate_only=True)
    return Stand(plan, final_population(plan.community, Silent()))


def stand_of(community: str, size_m: float = 20.0, seed: int = 4) -> Stand:
    """Plants of a community section, on a square site."""
    text = (
        f"forestgen: 1\nseed: {seed}\nsite: {{size_m: [{size_m}, {size_m}]}}\nspecies: {{spruce: }}\n"
        f"community: {community}\ncameras: [{{position_m: [0, 0, 2]}}]\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recipe.yaml"
        path.write_text(text, encoding="utf-8")
        plan = check_plan(load_recipe(path), simulate_only=True)
        return Stand(plan, final_population(plan.community, Silent()))


def sheet(columns: int, heights: Sequence[float], width_in: float = PANEL_IN) -> tuple[Figure, NDArray[Any]]:
    """A figure of panels; heights in inches."""
    figure = new_figure(columns * width_in, sum(heights))
    axes = figure.subplots(len(heights), columns, squeeze=False, height_ratios=list(heights))
    figure.get_layout_engine().set(w_pad=0.04, h_pad=0.04, wspace=0.02, hspace=0.02)  # type: ignore[union-attr]
    return figure, axes


def bare(axes: Axes, site: Site) -> None:
    """A panel that is the site alone, without numbers at its edges."""
    axes.set(xlim=(0, site.size_m[0]), ylim=(0, site.size_m[1]), aspect="equal", xticks=[], yticks=[])
    axes.set_facecolor(PAPER)
    for spine in axes.spines.values():
        spine.set(color="#777777", linewidth=0.6)


def draw_points(axes: Axes, points_m: NDArray[np.float64], site: Site, colour: object = INK, size: float = 5.0) -> None:
    bare(axes, site)
    axes.scatter(points_m[:, 0], points_m[:, 1], s=size, color=[colour], linewidths=0, zorder=3)


def draw_kernel(axes: Axes, kernel: KernelTable, most: float, reach: float) -> None:
    """κ by distance, on both sides of the plant, as Lane draws it."""
    r = np.linspace(-reach, reach, 801)
    axes.axhline(1, color="#BBBBBB", lw=0.8, ls=(0, (3, 3)))
    axes.plot(r, kernel(np.abs(r), 1.0), color=LINE, lw=1.8, solid_joinstyle="round")
    axes.set(xlim=(-reach, reach), ylim=(-0.08, most), xlabel="distance, radii")
    axes.tick_params(labelsize=8, length=2.5)
    axes.xaxis.label.set_size(8)
    axes.spines[["top", "right"]].set_visible(False)


def save_png(figure: Figure, name: str) -> None:
    path = PICTURES / name
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png", dpi=DPI, facecolor="white", metadata={"Software": None})
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(96, kmeans=1, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    told(path)


def save_jpg(picture: NDArray[np.uint8], name: str) -> None:
    """The best quality that keeps the file small."""
    path = PICTURES / name
    path.parent.mkdir(parents=True, exist_ok=True)
    for quality in (90, 85, 80, 74, 68):
        Image.fromarray(picture).save(path, quality=quality, optimize=True)
        if path.stat().st_size < MOST_BYTES:
            break
    told(path)


def told(path: Path) -> None:
    size = path.stat().st_size
    sys.stdout.write(f"{path} {size / 1000:.0f} kB\n")
    if size >= MOST_BYTES:
        raise SystemExit(f"{path} is too large")


def rendered(name: str, folder: Path, *settings: str) -> NDArray[np.uint8]:
    """The preview of a reproduction's only frame."""
    options = [word for setting in settings for word in ("--set", setting)]
    recipe = REPRODUCTIONS / f"{name}.yaml"
    subprocess.run([sys.executable, "-m", "forestgen", "render", recipe, "-o", folder, *options], check=True)
    return np.asarray(Image.open(min(folder.glob("train/*/preview.png"))).convert("RGB"))


MODELS = {
    "uniform": "{model: uniform, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "jittered_grid": "{model: jittered_grid, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "poisson_disc": "{model: poisson_disc, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "halftone": "{model: halftone, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "height_field": "{model: height_field, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "strauss": "{model: strauss, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "thomas": "{model: thomas, plants: {spruce: {count: 400, radius_m: 0.4}}}",
    "deformation_kernel": "{model: deformation_kernel, kernels: {hopkins: 1.6}, "
    "plants: {spruce: {count: 400, radius_m: 0.4}}}",
}


def placement_models(scratch: Path) -> None:
    """Every placement model, 400 plants on even ground."""
    columns = 4
    rows = -(-len(MODELS) // columns)
    figure, axes = sheet(columns, [PANEL_IN + 0.35] * rows)
    for panel, (name, community) in zip(axes.flat, MODELS.items(), strict=False):
        one = stand_of(community)
        draw_points(panel, one.points_m(), one.site)
        panel.set_title(f"{name}\nH = {one.hopkins:.2f}", fontsize=9.5)
    save_png(figure, "placement_models.png")


def kernel_field(scratch: Path) -> None:
    """The field in three moments: under one plant, five and thirty (after Lane 2002, Figure 5.3)."""
    one = stand_of("{model: deformation_kernel, kernels: clustering, plants: {spruce: {count: 30, radius_m: 1.6}}}")
    figure, axes = sheet(3, [PANEL_IN + 0.25, PANEL_IN])
    for column, plants in enumerate((1, 5, 30)):
        placed = one.first(plants)
        draw_points(axes[0, column], placed.position_m[:, :2], one.site, size=12)
        axes[0, column].set_title("one plant" if plants == 1 else f"{plants} plants", fontsize=9.5)
        draw_left(axes[1, column], one.densities(placed), "spruce", one.site)
    axes[0, 0].set_ylabel("plants", fontsize=9.5)
    axes[1, 0].set_ylabel("the field", fontsize=9.5)
    save_png(figure, "kernel_field.png")


def draw_left(axes: Axes, densities: Densities, species: str, site: Site) -> None:
    """A field as plants have left it; untouched ground has the same colour in every moment, barred ground is paper."""
    assert densities.left_per_ha is not None
    top = BRIGHTEST * float(densities.asked_per_ha[species].max())
    draw_field(axes, np.minimum(densities.left_per_ha[species], top), site, least_top=top)
    bare(axes, site)


def kernels(scratch: Path) -> None:
    """Four kernels above the patterns that they generate (Lane 2002, Figure 5.4)."""
    one = stand("kernels_fig5_4")
    columns = len(one.plants.species_names)
    quarter = Site((one.site.size_m[0] / columns, one.site.size_m[1]))
    own = [one.kernels[k][k] for k in range(columns)]
    figure, axes = sheet(columns, [1.35, PANEL_IN + 0.25])
    most, reach = 1.15 * max(float(kernel.values.max()) for kernel in own), 1.15 * max(kernel.reach for kernel in own)
    for column, kernel in enumerate(own):
        draw_kernel(axes[0, column], kernel, most, reach)
        points_m = one.points_m(column) - (column * quarter.size_m[0], 0.0)
        draw_points(axes[1, column], points_m, quarter, size=7)
        index = hopkins_index(points_m, quarter.size_m, np.random.default_rng(0))
        axes[1, column].set_title(f"({'abcd'[column]})  H = {index:.2f}", fontsize=9.5)
    axes[0, 0].set_ylabel("κ", rotation=0, labelpad=8)
    save_png(figure, "figures/kernels_fig5_4.png")


def map_placement(scratch: Path) -> None:
    """A painted map, and plants that follow it less and more clustered (Lane 2002, Figure 5.6)."""
    stands = [stand(name) for name in ("map_fig5_6b", "map_fig5_6c")]
    figure, axes = sheet(3, [PANEL_IN + 0.25])
    (density,) = stands[0].densities().asked_per_ha.values()
    draw_field(axes[0, 0], density, stands[0].site)
    bare(axes[0, 0], stands[0].site)
    axes[0, 0].set_title("the map", fontsize=9.5)
    for panel, one in zip(axes[0, 1:], stands, strict=True):
        draw_points(panel, one.points_m(), one.site, size=3.0)
        panel.set_title(f"{len(one.plants):,} plants, H = {one.hopkins:.2f}", fontsize=9.5)
    save_png(figure, "figures/map_fig5_6.png")


def two_species(scratch: Path) -> None:
    """Plants and fields of two species at three moments (Lane 2002, Figure 5.8)."""
    one = stand("two_species_fig5_8")
    names = one.plants.species_names
    second = int(np.flatnonzero(one.plants.species != one.plants.species[0])[0]) + 1
    later = names[one.plants.species[second - 1]]
    moments = {1: "the first plant", second: f"the first {later}", len(one.plants): f"all {len(one.plants)} plants"}
    figure, axes = sheet(3, [PANEL_IN + 0.25] + [PANEL_IN] * len(names))
    for column, (plants, title) in enumerate(moments.items()):
        placed = one.first(plants)
        bare(axes[0, column], one.site)
        for index in reversed(range(len(names))):
            points_m, size = placed.position_m[placed.species == index, :2], (16, 4)[min(index, 1)]
            draw_points(axes[0, column], points_m, one.site, (LINE, INK)[index % 2], size)
        axes[0, column].set_title(title, fontsize=9.5)
        densities = one.densities(placed)
        for row, name in enumerate(names, start=1):
            draw_left(axes[row, column], densities, name, one.site)
            axes[row, 0].set_ylabel(f"field of {name}", fontsize=9.5)
    axes[0, 0].set_ylabel(f"{names[0]} red, {names[1]} green", fontsize=9.5)
    save_png(figure, "figures/two_species_fig5_8.png")


def daisies(scratch: Path) -> None:
    """Three fields of daisies, apart, at random and in clusters (Lane 2002, Figure 5.5)."""
    names = sorted(path.stem for path in REPRODUCTIONS.glob("daisies_fig5_5*.yaml"))
    # A lawn is slow: some blades stand in front of every other. Denoised, ten samples are enough.
    views = [rendered(name, scratch / name, "render.samples=10") for name in names]
    save_jpg(side_by_side(views), "figures/daisies_fig5_5.jpg")


def side_by_side(pictures: Sequence[NDArray[np.uint8]], gap_px: int = 6) -> NDArray[np.uint8]:
    """Pictures of one height in a row, with white between them."""
    gap = np.full((pictures[0].shape[0], gap_px, 3), 255, dtype=np.uint8)
    parts = [part for one in pictures for part in (gap, one)][1:]
    return np.concatenate(parts, axis=1)


def forest(scratch: Path) -> None:
    """A forest community from above as circles, and as a camera sees it (Lane 2002, Figure 5.9)."""
    one = stand("forest_fig5_9")
    view = rendered("forest_fig5_9", scratch / "forest", *SAMPLES, "cameras.0.size_px=[640, 360]")
    height_in = view.shape[0] / DPI
    figure = new_figure(height_in * one.site.size_m[0] / one.site.size_m[1], height_in)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    draw_crowns(axes, one)
    figure.savefig(scratch / "forest.png", dpi=DPI)
    with Image.open(scratch / "forest.png") as image:
        chart = image.convert("RGB").resize((round(view.shape[0] * image.width / image.height), view.shape[0]))
    save_jpg(side_by_side([np.asarray(chart), view]), "figures/forest_fig5_9.jpg")


def draw_crowns(axes: Axes, one: Stand) -> None:
    """Circles to scale in their species' colours, small ones on top."""
    from matplotlib.collections import EllipseCollection

    bare(axes, one.site)
    order = np.argsort(-one.plants.radius_m, kind="stable")
    names, diameter = one.plants.species_names, 2 * one.plants.radius_m[order]
    colours = [darker(one.colours[names[k]]) for k in one.plants.species[order]]
    axes.add_collection(
        EllipseCollection(
            diameter, diameter, np.zeros(len(order)), units="xy", offsets=one.points_m()[order],
            offset_transform=axes.transData, facecolors=[(*rgb, 0.55) for rgb in colours], edgecolors=colours,
            linewidths=0.4,
        )
    )  # fmt: skip


def densities(scratch: Path) -> None:
    """What `forestgen simulate` draws of a placement, for docs/placement.md."""
    recipe = scratch / "meadow.yaml"
    recipe.write_text(MEADOW, encoding="utf-8")
    command = [sys.executable, "-m", "forestgen", "simulate", recipe, "-o", scratch / "meadow"]
    subprocess.run(command, check=True)
    with Image.open(scratch / "meadow" / "densities.png") as image:
        shown = image.convert("RGB").resize((880, round(880 * image.height / image.width)), Image.Resampling.LANCZOS)
    small = shown.quantize(96, kmeans=1, dither=Image.Dither.NONE)
    small.save(PICTURES / "densities.png", optimize=True)
    told(PICTURES / "densities.png")


PICTURES_OF = {
    one.__name__: one
    for one in (placement_models, kernel_field, kernels, map_placement, two_species, daisies, forest, densities)
}
