"""Stands by what foresters know of them: species, stems, basal area, heights, storeys, gaps, cover, leaf area.

The model places trees that meet the targets of a recipe, and says what it reached. A step of Δt years makes them
older, and nothing else.

For each storey, from the top down: N stems per hectare, basal area G, mean diameter D and its coefficient of variation
v are bound by

    G = N π/4 D² (1 + v²).

Two of N, G and D give the third; with one of them alone, D is the diameter at which the storey's 100 thickest trees per
hectare have its dominant height by the allometry of their species (`tree` of the species). Diameters follow a Weibull
or a normal law, drawn from every part of it, and are scaled so that the sum is exact. A tree's height follows from its
diameter by the allometry, from its own numbers and its neighbours: crowded trees are slender, trees at gaps stout. The
heights of a storey are scaled to its dominant height, by which crowns become longer or shorter; those of a species by a
factor of its own, so that at the diameters of the storey's thickest trees all its species are equally tall. Widths of
all crowns are multiplied by one factor to meet `canopy_cover`, leaf areas by another to meet `leaf_area_index`.

`dead_wood` adds dead trees of the stand's own species and sizes: standing, lying (uprooted with a root plate, or
snapped off a high stump) and stumps, each of a decay class from 1, fresh, to 5, rotten. They have the skeleton of a
living tree of their species without its leaves; with each class twigs, branches, bark and the top go. Amounts are trees
or m³ of stems per hectare, or published ones by name:

| type | standing, m³/ha | lying, m³/ha | stumps/ha | source |
|---|---|---|---|---|
| managed_beech | 3.6 | 5.4 | 150 | Meyer and Schmidt 2011: 9 m³/ha when management ended, 40% standing |
| beech_reserve | 33 | 97 | 0 | Christensen et al. 2005: 86 reserves, 130 m³/ha, in lowlands 25% standing |
| boreal_managed | 3.2 | 7.3 | 200 | Siitonen et al. 2000: 14 m³/ha, 25% of it cut stumps and residues |
| boreal_old_growth | 33 | 78 | 0 | Siitonen et al. 2000: 111 m³/ha, 70% logs |

The numbers of stumps, and the share that stands in the managed boreal forest, which is that of the old one, are ours.
Decay classes: Domke et al. 2011, Carbon Balance and Management 6:14, table 1 (standing, USDA Forest Service); Maser et
al. 1979, Agriculture Handbook 553, and Woodall and Monleon 2008, USDA Forest Service GTR NRS-22 (lying).

References: Christensen et al. 2005, Forest Ecology and Management 210, 267; Meyer and Schmidt 2011, ibid. 261, 342;
Siitonen et al. 2000, ibid. 128, 211 (dead wood); Clark and Evans 1954, Ecology 35 (pattern); Bailey and Dell 1973,
Forest Science 19 (diameters by Weibull's law); Gustavsen 1980, Folia Forestalia 454 (height by age and site index);
Runkle 1982, Ecology 63 (gaps, from stem to stem); Donnelly 1978 (edges). Trees of one storey: those of a Finnish stand
of about 50 years measured by Machacova et al. 2019, Nature Communications 10:4989, table 1, are 22.1 m (birch), 21.2 m
(spruce) and 20.6 m (pine) tall and have 21, 24 and 19 cm at breast height. The allometries have the sources that the
species say.

Parameters: see below.

Recipe::

    community:                           # an old spruce stand with beech coming up
      model: stand
      storeys:
        - species: {spruce: 0.8, pine: 0.2}
          stems_per_ha: 600
          basal_area_m2_per_ha: 42
          dominant_height_m: 26
        - species: {beech: 1}
          stems_per_ha: 500
          dominant_height_m: 7
          clark_evans: 0.8
      canopy_cover: 0.85
      leaf_area_index: 6
      gaps: {share: 0.06, diameter_m: 14}

    community:                           # a planted stand, by age and site index
      model: stand
      storeys:
        - {species: {pine: 1}, stems_per_ha: 900, age_yr: 60, site_index_m: 24, height_curve: pine, clark_evans: 1.3}

    community:                           # an old beech forest with dead trees
      model: stand
      storeys:
        - {species: {beech: 0.9, spruce: 0.1}, stems_per_ha: 250, basal_area_m2_per_ha: 34}
      dead_wood: {standing_per_ha: 20, lying_m3_per_ha: 60, decay: [0.1, 0.3, 0.3, 0.2, 0.1]}

    community:                           # a managed one
      model: stand
      storeys:
        - {species: {beech: 1}, stems_per_ha: 250, basal_area_m2_per_ha: 30}
      dead_wood: managed_beech

    community:                           # an open birch wood over bracken
      model: stand
      storeys:
        - species: {birch: 1}
          basal_area_m2_per_ha: 12
          dbh: {mean_cm: 18, cv: 0.3, law: normal}
      ground: {bracken: {cover: 0.3, clump_m: 8}}

Decisions
---------
- Targets are means over the whole site, those of a storey over that storey. `map` and `keep_out` say where trees stand,
  and change no numbers.
- A target is feasible where the trees of the stand differ in the mean by at most three standard deviations from their
  species' allometry: in height for a dominant height, in crown width for a cover, in leaf mass for a leaf area index.
  Beyond that the recipe is refused, with what these trees could have.
- A storey has one law of diameters and one dominant height, that of its 100 thickest trees per hectare of whatever
  species. Its species differ in height by the scatter of their trees and by the slope of their curves. A species whose
  tallest trees (0.95 tree.tallest_m) are lower than the storey stays below. A taller species is a storey of its own.
- canopy_cover is the share of ground under crowns as discs of their radius. Rays find less: real crowns have gaps.
- Crowns may interlock. Stems are apart by the sum of their diameters at least, from pith to pith.
- A gap is a disc without stems of the first storey, from stem to stem of its edge; crowns lean into it. Its diameter
  changes a little so that a whole number of gaps has the share.
- Species of a lower storey stand below the crowns above as readily as in the open if their ecology.shade_tolerance is
  1, and half as readily if it is 0.5. In a storey, tolerant species have more of the thin trees.
- Whole trees: on a small site the number of stems is rounded; the basal area is met with those.
- Heights by age are those of spruce or pine in Finland, whatever the species; say dominant_height_m where you know it.
- Trees may be taller than their species' height_m; radius_m, the neighbourhood of other models, is then its largest.
- Plants of `ground` are placed independently, or in clumps of a width (Thomas 1949): sigma is a fourth of it; in the
  middle as many discs stand as cover the ground once. Clumps are below crowns as readily as trees of a lower storey.
  The cover of these plants is that of discs of radius_m on even, open ground: where a map or the light presses as many
  into part of the site, more of them overlap and less is covered. Trees among them are seedlings: of the sizes that
  their allometry and their neighbours give.
- A dead tree's species, diameter and height are those of a living tree of at least min_dbh_cm, drawn at random. For a
  volume trees are drawn until it is reached; one factor of diameters and heights makes it exact. Volumes are of stems
  over bark, of the taper of `forestgen.core.stem_form`, of what the decay class has left.
- height_m of a dead tree is that of what stands, or the length of the stem that lies. Its status is DEAD; columns
  `dead_form` (1 standing, 2 uprooted, 3 snapped, 4 stump) and `decay_class` say more.
- A stem falls downwind, give or take a standard deviation of 60 degrees; of up to 64 places it takes the one where it
  meets no other stem and lies on straight ground. It follows the slope as a whole, and does not bend.
- What was asked for and reached is in the snapshot's state (`targets`, `reached`) and in a note.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.community.arrivals import radii_m
from forestgen.community.model import none_is
from forestgen.community.models.thomas import TRIAL_BYTES
from forestgen.community.placement.densities import (
    check_sizes,
    grid_shape,
    heights_asked_m,
    plant_counts,
    tree_density,
)
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.population import Ecologies, Floats, Site, ecology_of
from forestgen.community.stand import spacing
from forestgen.community.stand.build import MOST_LEAVES, StandBuilder, StandTrees, measured
from forestgen.community.stand.cover import crown_ratios
from forestgen.community.stand.dead_wood import DeadTrees, DeadWood, dead_report, dead_trees, with_dead
from forestgen.community.stand.ground_plants import GroundModel, GroundParameters, GroundPlants
from forestgen.community.stand.targets import TOLERANCE, Storey, check_trees, height_range_m, stocking
from forestgen.community.static_model import Placement, StaticModel, StaticParameters
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Flag, Name, Positive, Section, shorthand, violation
from forestgen.recipe.sources import Keys

if TYPE_CHECKING:
    from forestgen.recipe.load import DrawnRecipe

_CELLS = 1024  # of the density, along the longer side
_CELL_M = 0.5
_TRIED_M2, _TRIED_PLANTS = 40_000, 50_000  # a site of at most so much is built when a recipe is checked
_MOST_GAPS = 20_000
_BYTES_PER_TREE = 300  # beside those of any static model; measured with 100,000 trees
_GRID_BYTES = 40_000_000  # of cover and density


class Gaps(Section):
    """Openings of the upper storey."""

    share: Positive = Field(le=0.5, description="Share of the ground, from stem to stem.")
    diameter_m: Positive = Field(le=200, description="Diameter of a gap, metres.")


class StandParameters(StaticParameters):
    """What a recipe says about the stand."""

    memory_hint: ClassVar[str] = "make the site smaller, or ask for fewer stems"

    storeys: Annotated[tuple[Storey, ...], none_is(())] = Field((), max_length=6, description="from the top down")
    canopy_cover: Positive | None = Field(None, lt=1, description="share of the ground under crowns as discs")
    leaf_area_index: Positive | None = Field(None, le=MOST_LEAVES, description="one side of all leaves over the ground")
    gaps: Gaps | None = Field(None, description="openings of the first storey")
    ground: Annotated[dict[Name, GroundPlants], none_is({})] = Field({}, description="herbs, shrubs and seedlings")
    dead_wood: Annotated[DeadWood | None, *shorthand("type")] = Field(None, description="dead trees; null: none")
    map: DensityMap | None = Field(None, description="relative density of trees over the site")
    keep_out: DensityMap | None = Field(None, description="where no plant may stand: any value above 0 bars")
    periodic: Flag = Field(True, description="the site is a torus, without edges; false: a bounded site")

    @model_validator(mode="after")
    def _dead_of_trees(self) -> Self:
        if self.dead_wood is not None and not self.storeys:
            raise violation("storeys, of whose trees the dead are", problem="dead wood of no trees", at="dead_wood")
        return self

    def for_trial(self) -> Self:
        """Without plants: all have the same columns."""
        none = dict.fromkeys(("canopy_cover", "leaf_area_index", "dead_wood"))
        return self.model_copy(update={"storeys": (), "ground": {}, **none})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        for index, storey in enumerate(self.storeys):
            yield from ((("storeys", index, "species", name), name) for name in storey.species)
        yield from ((("ground", name), name) for name in self.ground)

    def ground_parameters(self, site: Site, species: Ecologies) -> GroundParameters:
        """The ground's plants as another model places them."""
        own = [(one, self.ground[one.name]) for one in species if one.name in self.ground]
        clumps = {one.name: keys.clumps(one, site, periodic=self.periodic) for one, keys in own}
        return GroundParameters.model_construct(
            plants={one.name: keys.stand(one) for one, keys in own},
            clumps={name: found for name, found in clumps.items() if found is not None},
            keep_out=self.keep_out, periodic=self.periodic, cells=512, disturbances=(),
        )  # fmt: skip


class StandModel(StaticModel[StandParameters]):
    Parameters = StandParameters
    state_keys: ClassVar[tuple[str, ...]] = ("targets", "reached")
    knows_trees: ClassVar[bool] = True

    def place(self, parameters: StandParameters, site: Site, species: Ecologies, rng: np.random.Generator) -> Placement:
        """The trees, then the plants of the ground."""
        tree_rng, gap_rng, ground_rng, dead_rng = rng.spawn(4)
        trees, dead, found = None, None, {}
        if parameters.storeys:
            for index, storey in enumerate(parameters.storeys):
                check_trees(storey, species, f"community.storeys.{index}")
            opened, gap = _density(parameters, site, gap_rng)
            builder = StandBuilder(parameters.storeys, site, species, tree_rng, periodic=parameters.periodic)
            trees = builder.trees(opened, gap, parameters.canopy_cover, parameters.leaf_area_index)
            found = _report(parameters, trees, site, species)
            if parameters.dead_wood is not None:
                own = parameters.dead_wood, trees, site, opened, dead_rng
                dead = dead_trees(*own, periodic=parameters.periodic)
                found["reached"]["dead_wood"] = dead_report(dead, site)
        plants = parameters.ground_parameters(site, species)
        crowns: NDArray[np.bool_] | None = None
        if trees is not None and plants.clumps:
            discs = trees.position_m, trees.crown_radius_m
            crowns = np.asarray(crown_ratios(*discs, site, 1.0, periodic=parameters.periodic) <= 1.0)
        ground = GroundModel(crowns).place(plants, site, species, ground_rng)
        return _joined(trees, dead, ground, species, parameters, found)

    def most_plants(self, parameters: StandParameters, site: Site, species: Ecologies) -> float:
        """The trees and the ground's plants."""
        return sum(self._counts(parameters, site, species))

    def _counts(self, parameters: StandParameters, site: Site, species: Ecologies) -> tuple[float, float]:
        trees = 0
        for index, storey in enumerate(parameters.storeys):
            where = f"community.storeys.{index}"
            check_trees(storey, species, where)
            trees += round(stocking(storey, species, where).stems_per_ha * site.area_ha)
        if parameters.dead_wood is not None:
            trees += math.ceil(parameters.dead_wood.most_trees(site))
        ground = parameters.ground_parameters(site, species)
        check_sizes(ground, species)
        return float(trees), float(plant_counts(ground, site, species).sum())

    def asked_heights_m(
        self, parameters: StandParameters, site: Site, species: Ecologies
    ) -> Mapping[str, tuple[float, float]]:
        """By the storeys' diameters and dominant heights, and the radii of the ground's plants."""
        found = heights_asked_m(parameters.ground_parameters(site, species), species)
        for index, storey in enumerate(parameters.storeys):
            low, high = height_range_m(storey, species, f"community.storeys.{index}")
            for name in storey.species:
                least, most = found.get(name, (low, high))
                found[name] = (min(least, low), max(most, high))
        return found

    def empty_reason(self, parameters: StandParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        if parameters.storeys or parameters.ground:
            return "no plant is placed: the numbers per hectare are less than one plant on this site"
        return "no plant is placed: community.storeys and community.ground are empty"

    def estimate_bytes(self, parameters: StandParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all trees and grids at once."""
        trees = self._counts(parameters, site, species)[0]
        trials = TRIAL_BYTES if parameters.ground_parameters(site, species).clumps else 0
        own = math.ceil(_BYTES_PER_TREE * trees) + _GRID_BYTES + trials
        return super().estimate_bytes(parameters, site, species) + own

    def check_recipe(self, drawn: DrawnRecipe, parameters: StandParameters) -> None:
        """Build the stand of a small site, so that targets which contradict each other are refused at once."""
        site = Site(drawn.recipe.site.size_m)
        species = [ecology_of(name, one) for name, one in drawn.species.items()]
        if {name for _, name in parameters.named_species()} - {*drawn.species}:
            return  # refused already
        if site.area_m2 <= _TRIED_M2 and sum(self._counts(parameters, site, species)) <= _TRIED_PLANTS:
            self.place(parameters, site, species, child_rng(drawn.image_seed, "community", 0))


def _density(parameters: StandParameters, site: Site, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(rows, cols) relative density of trees, at most 1, and 1 in gaps; row 0 at y = 0."""
    cells = min(_CELLS, max(64, math.ceil(max(site.size_m) / _CELL_M)))
    shape = grid_shape(site, cells)
    density, gap = tree_density(parameters.map, parameters.keep_out, site, shape), np.zeros(shape)
    if parameters.gaps is not None:
        centre_m, radius_m = _gaps(parameters.gaps, site, parameters.periodic, rng)
        y, x = (((np.arange(n) + 0.5) * side / n) for n, side in zip(shape, reversed(site.size_m), strict=True))
        for at in centre_m:
            dx, dy = np.abs(x - at[0]), np.abs(y - at[1])
            if parameters.periodic:
                dx, dy = np.minimum(dx, site.size_m[0] - dx), np.minimum(dy, site.size_m[1] - dy)
            rows, cols = np.flatnonzero(dy < radius_m), np.flatnonzero(dx < radius_m)
            inside = dy[rows, None] ** 2 + dx[None, cols] ** 2 < radius_m**2
            gap[np.ix_(rows, cols)] = np.maximum(gap[np.ix_(rows, cols)], inside)
    return density, gap


def _gaps(gaps: Gaps, site: Site, periodic: bool, rng: np.random.Generator) -> tuple[Floats, float]:
    """(K, 2) middles of gaps that do not overlap, and their radius."""
    count = round(gaps.share * site.area_m2 / (0.25 * math.pi * gaps.diameter_m**2))
    radius_m = math.sqrt(gaps.share * site.area_m2 / (math.pi * max(count, 1)))
    got = f"share {gaps.share:g} of gaps {gaps.diameter_m:g} m wide on {site.size_m[0]:g} x {site.size_m[1]:g} m"
    if not 1 <= count <= _MOST_GAPS or min(site.size_m) < 2 * radius_m:
        low, high = (math.sqrt(8 * gaps.share * site.area_m2 / (math.pi * k)) for k in (2 * _MOST_GAPS, 1))
        problem = "so large gaps have no room on the site" if count <= _MOST_GAPS else "so many gaps"
        expected = f"a diameter of {low:.2g} to {min(high, min(site.size_m)):.3g} m, for this share; or a larger site"
        raise RecipeError(problem, where="community.gaps", expected=expected, got=got)
    grid = spacing.empty_grid(count, 2 * radius_m, site.size_m, periodic=periodic)
    ground = (np.ones((1, 1)), np.zeros((1, 1)))
    placed = spacing.place_storey(grid, 0, np.full(count, radius_m), np.ones(count), 1.0, ground, rng)
    if placed < count:
        problem = "the gaps have no room on the site"
        expected = f"a share of at most about {placed * math.pi * radius_m**2 / site.area_m2:.2g}, or smaller gaps"
        raise RecipeError(problem, where="community.gaps", expected=expected, got=got)
    return np.stack([grid.x, grid.y], axis=1), radius_m


def _joined(
    trees: StandTrees | None,
    dead: DeadTrees | None,
    ground: Placement,
    species: Ecologies,
    parameters: StandParameters,
    found: dict[str, Any],
) -> Placement:
    """Trees first, then the ground's plants, then the dead."""
    n = len(ground.species)
    assert ground.height_m is not None
    if trees is None:
        return Placement(ground.species, ground.position_m, ground.radius_m, ground.height_m, notes=ground.notes)
    age = np.array([storey.age_yr or 0.0 for storey in parameters.storeys])[trees.storey]
    living = Placement(
        np.concatenate([trees.species, ground.species]),
        np.concatenate([trees.position_m, ground.position_m]),
        np.concatenate([radii_m(species, trees.species, trees.height_m), ground.radius_m]),
        np.concatenate([trees.height_m, ground.height_m]),
        tree_sizes={name: np.append(values, np.full(n, np.nan)) for name, values in trees.columns.items()},
        age_yr=np.concatenate([age, np.zeros(n)]),
        notes=(*_notes(found), *ground.notes),
        found=found,
    )
    return living if dead is None else with_dead(living, dead, species)


def _report(parameters: StandParameters, trees: StandTrees, site: Site, species: Ecologies) -> dict[str, Any]:
    """What was asked for and what was reached, plain as in JSON."""
    names = ("stems_per_ha", "basal_area_m2_per_ha", "clark_evans")
    storeys = []
    for one in parameters.storeys:
        asked = {name: getattr(one, name) for name in names}
        asked |= {"mean_dbh_cm": one.dbh.mean_cm, "dominant_height_m": one.top_height_m}
        storeys.append({name: value for name, value in asked.items() if value is not None})
    whole = {"canopy_cover": parameters.canopy_cover, "leaf_area_index": parameters.leaf_area_index}
    targets = {"storeys": storeys, **{name: value for name, value in whole.items() if value is not None}}
    reached = measured(trees, len(parameters.storeys), site, species, periodic=parameters.periodic)
    return {"targets": targets, "reached": reached}


def _notes(found: dict[str, Any]) -> Iterator[str]:
    """The stand in a line, and the targets that whole trees do not meet."""
    targets, reached = found["targets"], found["reached"]
    parts = [
        f"storey {k}: {one['stems_per_ha']:,.0f} stems/ha, basal area {one.get('basal_area_m2_per_ha', 0):.1f} m²/ha, "
        f"dominant height {one.get('dominant_height_m', 0):.1f} m"
        for k, one in enumerate(reached["storeys"], start=1)
    ]
    parts.append(f"cover {reached['canopy_cover']:.2f}, leaf area index {reached['leaf_area_index']:.1f}")
    yield f"placed: {'; '.join(parts)}"
    if "dead_wood" in reached:
        dead = reached["dead_wood"]
        standing, lying = (f"{dead[f'{kind}_per_ha']:,.0f} {kind}" for kind in ("standing", "lying"))
        volumes = f"{dead['standing_m3_per_ha']:.1f} and {dead['lying_m3_per_ha']:.1f} m³/ha"
        yield f"dead trees: {standing} and {lying} per hectare, {volumes}; {dead['stumps_per_ha']:,.0f} stumps/ha"
    if reached["leaf_area_index"] > MOST_LEAVES:
        yield f"no forest has a leaf area index above {MOST_LEAVES:g}: ask for a leaf_area_index, or for fewer stems"
    pairs = [
        (f"storey {k}: ", *both) for k, both in enumerate(zip(targets["storeys"], reached["storeys"], strict=True), 1)
    ]
    for place, asked, got in [*pairs, ("", targets, reached)]:
        for name, value in asked.items():
            if name in ("storeys", "clark_evans") or (got.get(name) and abs(got[name] / value - 1) <= TOLERANCE):
                continue
            yield f"{place}{name} is {got.get(name, 0):.4g}, not {value:g}: a site holds whole trees"


MODEL = StandModel()
