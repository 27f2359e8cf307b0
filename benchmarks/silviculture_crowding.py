"""How branch modules make room: `uv run python benchmarks/silviculture_crowding.py [--quick] [--out DIR]`.

Numbers of figures are those of Makowski 2023. Draws a picture of each, prints what it measured, and exits with 1 where
a bound is missed. `--quick`: smaller stands, shorter courses.

    18a  share of the modules' volume that intersects, with modules turned to free space and without: a thousand pines
    15   trees in the open and trees among neighbours: crowns wide and round, or narrow and to one side
    7    a conifer and a broadleaved tree beside a house grow away from it
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from forestgen.architecture.geometry import spheres
from forestgen.architecture.prototypes import load_prototypes, tables_of
from forestgen.community.branch_modules.crowding import NO_BOXES, Boxes, SphereGrid, overlap_volumes
from forestgen.community.plots import save_figure
from forestgen.community.population import Population
from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.recipe.species import PlantType
from forestgen.scene.plan import check_plan
from support.module_spheres import intersection_ratio

MOST_RATIO = 0.05  # 18a
LEAST_WIDER, LEAST_ASYMMETRY = 1.3, 1.5  # 15: in the open over crowded; at a group's edge over in the open
LEAST_AWAY, MOST_INSIDE = 1.3, 0.02  # 7: reach from the house over reach to it; share of volume in the house
APART_M = 1.2  # least distance of the trees of 15
NONE = {"seeds_per_yr": 0}
Floats = NDArray[np.float64]


class Report:
    """What was found, line by line, and how many bounds were missed."""

    def __init__(self) -> None:
        self.missed = 0

    def check(self, name: str, value: float, held: bool, bound: str) -> None:
        self.missed += not held
        print(f"  {'kept  ' if held else 'MISSED'} {name:<64} {value:8.3f}   {bound}", flush=True)


@dataclass(frozen=True)
class Crown:
    """The spheres of one plant's modules, from its foot."""

    centre_m: Floats  # (K, 3)
    radius_m: Floats  # (K,)

    @property
    def middle_m(self) -> Floats:
        """(3,) mean of the spheres, by volume."""
        middle: Floats = np.average(self.centre_m, axis=0, weights=self.radius_m**3)
        return middle

    @property
    def offset_m(self) -> float:
        """Distance of the crown's centre from the foot, seen from above."""
        return float(np.hypot(*self.middle_m[:2]))

    @property
    def reach_m(self) -> float:
        """Mean over 16 directions of how far the crown reaches from its own centre."""
        bearing = np.arange(16) * np.pi / 8
        along = (self.centre_m[:, :2] - self.middle_m[:2]) @ np.stack([np.cos(bearing), np.sin(bearing)])
        return float((along + self.radius_m[:, None]).max(axis=0).mean())

    def reach_towards_m(self, side: float) -> float:
        """How far it reaches from the foot towards positive x (side 1) or negative (-1)."""
        return float((side * self.centre_m[:, 0] + self.radius_m).max())

    def below(self, height_m: float) -> Crown:
        """The modules with their centre below a height."""
        rows = self.centre_m[:, 2] < height_m
        return Crown(self.centre_m[rows], self.radius_m[rows])

    @property
    def height_m(self) -> float:
        return float((self.centre_m[:, 2] + self.radius_m).max())


@dataclass(frozen=True)
class Moment:
    """Spheres of all modules of a snapshot."""

    population: Population
    centre_m: Floats  # (M, 3) from each plant's foot
    radius_m: Floats  # (M,)
    period_m: tuple[float, float] | None

    @property
    def world_m(self) -> Floats:
        assert self.population.modules is not None
        foot = np.repeat(self.population.position_m, np.diff(self.population.modules.first), axis=0)
        return np.asarray(foot + self.centre_m)

    def ratio(self, *, joints: bool) -> float:
        """Intersection volume ratio of section 2.8."""
        assert self.population.modules is not None
        grid = SphereGrid.of(self.world_m, self.radius_m, self.period_m)
        return intersection_ratio(grid, None if joints else self.population.modules.parent_row())

    def crown(self, plant: int) -> Crown:
        assert self.population.modules is not None
        rows = slice(*self.population.modules.first[plant : plant + 2])
        return Crown(self.centre_m[rows], self.radius_m[rows])

    def nearest(self, x: float, y: float) -> int:
        """Row of the living plant with modules whose foot is nearest."""
        assert self.population.modules is not None
        distance = np.hypot(*(self.population.position_m[:, :2] - (x, y)).T)
        return int(np.where(np.diff(self.population.modules.first) > 0, distance, np.inf).argmin())


def moments(
    species: tuple[str, ...],
    community: dict[str, Any],
    size_m: tuple[float, float],
    *,
    seed: int,
    every: int,
    buildings: Sequence[dict[str, Any]] = (),
) -> Iterator[Moment]:
    """Snapshots of a simulation, every so many steps and the last."""
    recipe = {
        "forestgen": 1,
        "seed": seed,
        "site": {"size_m": list(size_m), "buildings": list(buildings)},
        "species": {name: {"from": name, "modules": NONE} for name in species},
        "community": {"model": "branch_modules", **community},
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stand.yaml"
        path.write_text(json.dumps(recipe))
        plan = check_plan(load_recipe(path, []), simulate_only=True)
    # A house has no modules, and so none in any row: any type stands in for it.
    types = [one.modules for one in plan.community.ecologies if one.modules is not None]
    held: list[PlantType] = [one.modules or types[0] for one in plan.community.ecologies]
    tables = tables_of(load_prototypes(), held)
    period = size_m if community.get("periodic") else None
    for population in snapshots(plan.community, Silent()):
        if population.modules is not None and (population.step % every == 0 or population.step == plan.community.steps):
            centre, radius = spheres(tables, population.modules, population.species)
            yield Moment(population, centre.astype(np.float64), radius.astype(np.float64), period)


def last(*arguments: Any, **keys: Any) -> Moment:
    """The last snapshot alone."""
    *_, moment = moments(*arguments, every=10**9, **keys)
    return moment


def planted(species: str, at_m: Floats, years: int) -> dict[str, Any]:
    """Plants of one age at given places, (N, 2) metres."""
    planting = {"at_step": 0, "plant": {"species": species, "positions_m": at_m.tolist()}}
    return {"initial_plants": 0, "steps": years, "disturbances": [planting]}


def spaced(count: int, side_m: float, least_m: float, rng: np.random.Generator) -> Floats:
    """(N, 2) random points of a torus, none nearer to another than `least_m`."""
    kept = np.empty((0, 2))
    while len(kept) < count:
        point = rng.uniform(0, side_m, 2)
        offset = kept - point
        offset -= side_m * np.round(offset / side_m)
        if np.all(np.hypot(*offset.T) >= least_m):
            kept = np.vstack([kept, point])
    return kept


def intersections(report: Report, quick: bool) -> Figure:
    """Figure 18 (a): a thousand pines planted on a hectare, at random but 2 m apart, on a torus.

    Two that stand nearer keep root modules that intersect, whatever the branches do: a root module does not turn.
    The naive forest of the figure's caption knows nothing of its neighbours' space: modules neither turn from others
    (Eq. 3) nor have less light for them (Eq. 1). Without turning alone crowded modules still starve and fall.
    """
    plants, years = (250, 120) if quick else (1000, 200)
    side = 100.0 * (plants / 1000) ** 0.5
    at = spaced(plants, side, 2.0, np.random.default_rng(1))
    figure = Figure((6, 4), layout="constrained")
    axes = figure.subplots()
    ways = {
        "turned to free space": {},
        "not turned": {"orient": False},
        "naive: nothing of the neighbours' space": {"orient": False, "crowding": 0},
    }
    curves = []
    for name, keys in ways.items():
        course = {**planted("pine", at, years), "periodic": True, **keys}
        curve = [
            (one.population.time_yr, one.ratio(joints=False), one.ratio(joints=True), len(one.radius_m))
            for one in moments(("pine",), course, (side, side), seed=1, every=5)
        ]
        curves.append(np.array(curve))
        axes.plot(curves[-1][:, 0], 100 * curves[-1][:, 1], label=name)
        axes.plot(curves[-1][:, 0], 100 * curves[-1][:, 2], ":", lw=1, label=f"{name}, pairs at a joint too")
        print(f"  {name}: year, ratio, with pairs at a joint, modules")
        for year, alone, joined, modules in curve[:: max(1, len(curve) // 10)]:
            print(f"    {year:5.0f} {alone:7.4f} {joined:7.4f} {modules:8.0f}")
    axes.axhline(5, color="black", lw=0.8)
    axes.set(xlabel="time (years)", ylabel="intersection volume ratio (%)", ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)
    largest = float(curves[0][:, 1].max())
    report.check("18a largest ratio of any year, turned", largest, largest < MOST_RATIO, f"below {MOST_RATIO}")
    mean = [float(curve[curve[:, 0] >= 20, 1].mean()) for curve in curves]
    report.check("18a mean ratio from year 20, naive over turned", mean[2] / mean[0], mean[2] > 5 * mean[0], "over 5")
    report.check("18a the same, not turned over turned", mean[1] / mean[0], mean[1] > 1.2 * mean[0], "over 1.2")
    return figure


def draw(axes: Any, crown: Crown, title: str) -> None:
    """A crown from the side, its spheres as discs; the line is its axis."""
    for centre, radius in zip(crown.centre_m, crown.radius_m, strict=True):
        axes.add_patch(Circle((centre[0], centre[2]), radius, color="tab:green", alpha=0.25, lw=0))
    axes.plot([0, 0], [0, crown.height_m], color="black", lw=0.8)
    axes.set(title=title, xlim=(-9, 9), ylim=(0, 26), aspect="equal")


def adapting(report: Report, quick: bool) -> Figure:
    """Figure 15: the same tree alone, among others at random distances, and at the edge of such a group."""
    species, years, seeds = "maple", 60, range(4 if quick else 10)
    stands: dict[str, list[Crown]] = {"alone": [], "crowded": [], "at the edge": []}
    for seed in seeds:
        others = spaced(48, 17.5, APART_M, np.random.default_rng(seed)) - 17.5 / 2
        others = others[np.hypot(*others.T) >= APART_M]
        groups = {"alone": others[:0], "crowded": others, "at the edge": others[others[:, 0] > 0.5]}
        for name, group in groups.items():
            course = planted(species, 20 + np.vstack([np.zeros((1, 2)), group]), years)
            moment = last((species,), course, (40.0, 40.0), seed=seed)
            # The one in the middle may have died; its nearest neighbours grew among others too.
            stands[name].append(moment.crown(moment.nearest(20, 20)))
    measures = {
        name: np.array([[c.reach_m / c.height_m, c.offset_m / c.reach_m, c.height_m, len(c.radius_m)] for c in crowns])
        for name, crowns in stands.items()
    }
    for name, values in measures.items():
        middle = np.median(values, axis=0)
        print(f"  {name}: crown radius / height {middle[0]:.3f}, offset / crown radius {middle[1]:.3f}, ", end="")
        print(f"height {middle[2]:.1f} m, modules {middle[3]:.0f} (medians of {len(values)})")
    wide = float(np.median(measures["alone"][:, 0]) / np.median(measures["crowded"][:, 0]))
    report.check("15 crown radius over height, alone over crowded", wide, wide > LEAST_WIDER, f"over {LEAST_WIDER}")
    for name, least in (("crowded", 1.0), ("at the edge", LEAST_ASYMMETRY)):
        aside = float(np.median(measures[name][:, 1]) / np.median(measures["alone"][:, 1]))
        report.check(f"15 offset over crown radius, {name} over alone", aside, aside > least, f"over {least}")
    figure = Figure((9, 5), layout="constrained")
    for axes, (name, crowns) in zip(figure.subplots(1, 3), stands.items(), strict=True):
        draw(axes, crowns[0], name)
    return figure


def beside_a_house(report: Report, quick: bool) -> Figure:
    """Figure 7: each tree 1.5 m from the middle of a wall, and the same tree without the house.

    Compared is the part of the crown that is not above the roof.
    """
    years, seeds = (50 if quick else 70), range(3 if quick else 8)
    size = (10.0, 8.0, 9.0)
    house = Boxes(np.array([[20.0, 20.0, 0.0]]), np.array([size]), np.zeros(1))
    figure = Figure((9, 5), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, species, side in zip(panels, ("spruce", "maple"), (1.0, -1.0), strict=True):
        away, free, inside = [], [], []
        for seed in seeds:
            for built in (True, False):
                at = np.array([20 + side * (size[0] / 2 + 1.5), 20.0])
                course = planted(species, at[None], years)
                houses = [{"position_m": [20, 20], "size_m": list(size)}] if built else []
                moment = last((species,), course, (40.0, 40.0), seed=seed, buildings=houses)
                crown = moment.crown(moment.nearest(*at))
                low = crown.below(size[2])
                (away if built else free).append(low.reach_towards_m(side) / low.reach_towards_m(-side))
                if built:
                    inside.append(_share_within(moment, house))
                    if seed == 0:
                        draw(axes, crown, species)
                        corner = -side * 1.5 - (size[0] if side > 0 else 0)
                        axes.add_patch(Rectangle((corner, 0), size[0], size[2], color="tab:brown", alpha=0.5))
        middle = float(np.median(away)), float(np.median(free))
        print(f"  {species}: reach from the house over reach to it {middle[0]:.2f}; without it {middle[1]:.2f}")
        gain = middle[0] / middle[1]
        report.check(
            f"7 {species}: that, over the same without the house", gain, gain > LEAST_AWAY, f"over {LEAST_AWAY}"
        )
        most = float(np.median(inside))
        report.check(
            f"7 {species}: share of its volume within the house", most, most < MOST_INSIDE, f"below {MOST_INSIDE}"
        )
    return figure


def _share_within(moment: Moment, house: Boxes) -> float:
    """Share of all spheres' volume that lies in boxes."""
    grid = SphereGrid.of(moment.world_m, moment.radius_m)
    roots = np.full(len(grid), -1)
    both, free = (overlap_volumes(grid, roots, boxes).sum() for boxes in (house, NO_BOXES))
    return float((both - free) / grid.volume_m3.sum())


FIGURES = {"18a": intersections, "15": adapting, "7": beside_a_house}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", nargs="*", choices=[*FIGURES, []], default=[], help="these alone")
    parser.add_argument("--quick", action="store_true", help="smaller stands")
    parser.add_argument("--out", type=Path, default=Path("outputs/silviculture"), help="folder of the pictures")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    report = Report()
    for name in arguments.figures or FIGURES:
        print(f"figure {name}", flush=True)
        save_figure(FIGURES[name](report, arguments.quick), arguments.out / f"figure_{name}.png")
    return 1 if report.missed else 0


if __name__ == "__main__":
    sys.exit(main())
