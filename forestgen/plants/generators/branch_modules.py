"""Plants of branch modules: how the wood that a community grew is clothed with twigs and leaves.

The community model `branch_modules` grows every plant's branches. What they look like, a species' file says in its
`plant:` block, or beside it in `modules_plant:` where its `plant:` block serves other communities.

Reference
---------
Makowski, M. (2023). Modelling plant ecosystems. Chapter 2, Synthetic Silviculture, sections 2.5.2 and 2.5.3: segments
are generalised cylinders, with diameters by the pipe model (Eq. 10).

Equations
---------
::

    l = longest_m * size_by_height(H) * age_length(a_b / mature_age) * light_length(Q_eff)
        * thick_length(d_b / thinner_than_m) * jitter                                         length of a twig
    d = diameter_m(1 - l / longest_m)                                                         its diameter at the foot

::

    z' = H (1 - (1 - z / H)^umbrella)                                                         heights of the wood

H is the plant's height, a_b the physiological age of the segment that bears the twig, d_b its diameter, Q_eff its
module's light.

Parameters: see below; wood, shapes and foliage as for every generator.

Branch orders, as `foliage` names them: **0 to 7 are the modules' wood** (0 the stem, 1 its branches, ...; what is of a
higher order counts as 7), **8, 9, 10 and 11 are the twigs** that are drawn on it. So leaves sit on `orders: [8, 9]`.

Recipe
------
::

    plant:
      generator: branch_modules
      wood: {material: bark, branch_material: twig, thick_branch_m: 0.08}
      bearing: {thinner_than_m: 0.04, spacing_m: 0.16, angle_deg: 55}
      twigs:
        - {longest_m: 0.7, internode_m: 0.09, diameter_m: [[0, 0.007], [1, 0.002]], branch_angle_deg: 50,
           branch_length: 0.6, wander_deg: 14}
        - {longest_m: 0.3, internode_m: 0.1, diameter_m: [[0, 0.003], [1, 0.0015]], wander_deg: 14}
      shapes: {leaf: {form: simple, material: leaf, length_m: 0.08, width_m: 0.06, detail: 0}}
      foliage: [{shape: leaf, orders: [8, 9], spacing_m: 0.05, within_m: 0.5}]

Decisions
---------
- Module prototypes have about ten segments, a metre long each; trees have thousands of twigs. So twigs are drawn on all
  wood that is thin enough, and one goes on from every free terminal. By the pipe model a segment's diameter counts the
  terminals beyond it, and with them its foliage: thick wood is old and bare.
- Twigs are no part of a plant's size: a plant is as tall as its modules.
- What the twigs look like is random, of the plant's own number, and stays with it through time.
- In communities of other models, and for `forestgen plant`, a plant grows by its species' `modules` as in community
  model branch_modules, alone, in the climate that it likes best, on a torus as wide as its allometric crown: its
  neighbours are its own copies, so it has the form of a tree in a closed stand. Its wood is taken when it is as high as
  the allometry has it, or at its greatest, and scaled to that height. Its crown is as wide as it grew.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.core.errors import RecipeError
from forestgen.geometry.mesh import Ints, unit
from forestgen.plants.branching import Assembly, Grown, Order, Shoots, around, grow, lateral_sites
from forestgen.plants.grown import ClothedWood, ModuleWood, wood_skeleton, woods_of
from forestgen.plants.parameters import Fit, PlantParameters
from forestgen.plants.skeleton import Skeleton, check_budget
from forestgen.recipe.curves import PositiveCurve, evaluate, evaluate_one
from forestgen.recipe.fields import Fraction, Section

if TYPE_CHECKING:
    from forestgen.community.population import Population
    from forestgen.recipe.species import Species


# For who writes a species' file: what matters most, in this order.
#   bearing.thinner_than_m   which wood bears twigs: 3 to 5 times a grown terminal segment's diameter, which is
#                            PlantType.thickening_cm times the root of shoots_per_terminal (of n terminals: sqrt(n)).
#   bearing.spacing_m        between twigs along it; 0.1 to 0.25 m. Every free terminal bears one more along its axis.
#   twigs[0].longest_m       length of a full twig: about 0.6 of a grown segment's length fills the space between.
#   twigs[1]                 side twigs on the twigs: branch_angle_deg and branch_length of twigs[0] rule where they go.
#   foliage.orders           needles on the wood itself: 1 to 7 with thinner_than_m: 0.02.
#   foliage.shape            aim at 50,000 to 200,000 triangles a tree: leaves twice as long and a quarter as many, or
#                            needle_twig shapes (spruce.yaml).
#   size_by_height           a seedling's leaves are small: [[0, 0.3], [0.5, 0.6], [3, 1.0]].

FIRST_TWIG_ORDER = 8  # branch orders below are wood of the modules
MOST_TWIG_ORDERS = 4
_TWIG_BYTES = 5000  # of a twig with its side twigs, while it is meshed
_DEAD_TWIG_YR = 4.0  # after which half of a dead plant's twigs have fallen
_FORKS = 0.5  # diameter over the bearer's, of what goes on or forks off, and is no mere branch
_LEAST_SIDE_M = 1.0  # of the torus: modules of seedlings would fill a smaller one
_NO_TALLER_YR = 60  # after which a plant that has not become taller is as tall as it gets


class Bearing(Section):
    """Where the wood of the modules bears twigs: at even steps along all segments that are thin enough."""

    thinner_than_m: float = Field(0.04, gt=0, le=10, description="only segments of a smaller diameter, metres")
    younger_than_yr: float = Field(1e4, gt=0, description="only on modules that began less than so long ago, years")
    orders: tuple[int, ...] = Field((0, 1, 2, 3, 4, 5, 6, 7), min_length=1, description="orders that bear them; 0 stem")
    spacing_m: float = Field(0.15, ge=0.005, le=10, description="distance between the twigs along the wood, metres")
    per_node: int = Field(1, ge=1, le=50, description="twigs at a node, evenly about the axis: 2 for opposite ones")
    angle_deg: float = Field(55.0, ge=0, le=180, description="angle from the wood, degrees")
    angle_jitter_deg: float = Field(10.0, ge=0, description="standard deviation of that angle, degrees")
    phyllotaxis_deg: float = Field(137.5, description="turn about the wood from one node to the next, degrees")
    phyllotaxis_jitter_deg: float = Field(15.0, ge=0, description="standard deviation of that turn, degrees")
    planar: bool = Field(False, description="the first stands out horizontally: with 180 degrees, flat sprays")
    age_length: PositiveCurve = Field(
        ((0.0, 0.35), (0.7, 1.0)), description="share of a twig's length over the age of its segment, 0 new to 1 grown"
    )
    light_length: PositiveCurve = Field(((0.0, 0.6), (0.5, 1.0)), description="share of length over its module's light")
    thick_length: PositiveCurve = Field(
        ((0.0, 1.0), (0.6, 0.85), (1.0, 0.4)), description="share of length over segment diameter / thinner_than_m"
    )
    length_jitter: float = Field(0.15, ge=0, lt=0.5, description="standard deviation of a twig's length, as a share")
    size_by_height: PositiveCurve = Field(
        ((0.0, 0.15), (0.5, 0.4), (3.0, 1.0)), description="factor on twigs' length and spacing over height in metres"
    )
    missing: float = Field(0.1, ge=0, lt=1, description="share of the places left empty")
    terminal: bool = Field(True, description="one more goes on from every free terminal, along its axis")


class Parameters(PlantParameters):
    """The `plant:` or `modules_plant:` block of a species' file."""

    generator: Literal["branch_modules"] = "branch_modules"
    crook: float = Field(0.03, ge=0, le=0.3, description="standard deviation of segments' middles, share of length")
    angular: Fraction = Field(
        0.0, description="share of the way from where the wood grew to straight lines between forks: axes bend at forks"
    )
    umbrella: float = Field(
        1.0,
        ge=1,
        le=4,
        description="above 1, branches rise steeply and end in a flat top, see above; 1: as grown",
    )
    smooth: bool = Field(True, description="whether axes run in curves through the modules' nodes, or straight")
    bearing: Bearing | None = Field(
        default_factory=lambda: Bearing.model_validate({}), description="where the wood bears twigs; null: nowhere"
    )
    twigs: tuple[Order, ...] = Field(
        (), max_length=MOST_TWIG_ORDERS, description="twigs on the wood, twigs on these, and so on: orders 8, 9, ..."
    )
    fit: Fit = Field("none", description="plants are as large as their modules")

    @model_validator(mode="after")
    def _grows_as_it_grew(self) -> Self:
        if self.variation is not None:
            raise ValueError("no variation: every plant has the branches that it grew")
        if self.fit != "none":
            raise ValueError(f"fit: none, since plants are as large as their modules; got {self.fit}")
        return self


_Parameters = Parameters  # the generator's attribute hides the name


class BranchModulesGenerator:
    """Clothes the wood of plants of branch modules."""

    Parameters = Parameters
    has_crown = True

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """Refuse: its branches take more than a height and a width."""
        raise RecipeError("plants of branch modules grow by their species' modules", where="plant.generator")

    def clothe(self, parameters: _Parameters, wood: ModuleWood, height_m: float, rng: np.random.Generator) -> Skeleton:
        """The plant's wood with its twigs and leaves; see `plants.parameters.ClothesModules`."""
        wood_rng, twig_rng, foliage_rng = rng.spawn(3)
        bearing = parameters.bearing if parameters.twigs else None
        growth = 1.0 if bearing is None else max(evaluate_one(bearing.size_by_height, height_m), 1e-3)
        wood = _straightened(_flat_topped(wood, parameters.umbrella), parameters.angular)
        chosen = np.zeros(len(wood), dtype=bool)
        spacing_m = 1.0
        if bearing is not None:
            chosen = (wood.diameter_m < bearing.thinner_than_m) & (wood.age_yr < bearing.younger_than_yr)
            spacing_m = bearing.spacing_m * growth
            length = np.linalg.norm(wood.position_m - wood.position_m[np.maximum(wood.parent, 0)], axis=1)
            twigs = float(np.sum(length[chosen])) / spacing_m * bearing.per_node
            check_budget("twigs", twigs, _TWIG_BYTES, "a larger bearing.spacing_m, a smaller bearing.thinner_than_m")
        clothed = wood_skeleton(wood, chosen, spacing_m, smooth=parameters.smooth, crook=parameters.crook, rng=wood_rng)
        skeleton = clothed.skeleton
        if bearing is not None:
            left = 1.0 if wood.dead_yr is None else 0.5 ** (wood.dead_yr / _DEAD_TWIG_YR)
            skeleton = _with_twigs(clothed, bearing, parameters.twigs, growth, left, twig_rng)
        return replace(skeleton, organs=parameters.place_foliage(skeleton, height_m, foliage_rng))

    def wood_alone(self, species_name: str, species: Species, size_m: tuple[float, float], seed: int) -> ModuleWood:
        """The wood of a plant that grows without a community; see `plants.parameters.ClothesModules`."""
        from forestgen.community.model import simulate
        from forestgen.community.models.branch_modules import MODEL  # rarely needed
        from forestgen.community.population import Site, ecology_of

        assert species.modules is not None  # checked with the recipe
        modules = species.modules.model_copy(update={"seeds_per_yr": 0.0})
        lone = replace(ecology_of(species_name, species), modules=modules)
        parameters = MODEL.Parameters.model_validate({"initial_plants": 1, "steps": 100_000, "periodic": True})
        height_m, side_m = size_m[0], max(size_m[1], _LEAST_SIDE_M)
        best: Population | None = None
        for population in simulate(MODEL, parameters, Site((side_m, side_m)), [lone], seed, steps=parameters.steps):
            if not len(population):
                break
            if best is None or population.height_m[0] > best.height_m[0]:
                best = population
            if best.height_m[0] >= height_m or population.step - best.step >= _NO_TALLER_YR:
                break
        assert best is not None  # it stands in step 0
        [wood] = woods_of(best, MODEL.skeleton_tables(parameters, [lone], best), np.array([0]))
        scale = height_m / max(wood.height_m, 0.01)
        return replace(wood, position_m=wood.position_m * scale, diameter_m=wood.diameter_m * scale)


def _flat_topped(wood: ModuleWood, umbrella: float) -> ModuleWood:
    """The wood with a flat top, see `Parameters`."""
    if umbrella <= 1.0:
        return wood
    place = wood.position_m.copy()
    top_m = max(float(place[:, 2].max()), 1e-6)
    place[:, 2] = np.where(place[:, 2] > 0.0, top_m * (1.0 - (1.0 - place[:, 2] / top_m) ** umbrella), place[:, 2])
    return replace(wood, position_m=place)


def _straightened(wood: ModuleWood, angular: float) -> ModuleWood:
    """The wood with straighter lines between its forks, see `Parameters`."""
    if angular <= 0.0:
        return wood
    place, parent = wood.position_m.copy(), wood.parent
    goes_on = wood.diameter_m >= _FORKS * wood.diameter_m[np.maximum(parent, 0)]
    forks = np.bincount(parent[1:], goes_on[1:], len(wood)) != 1.0  # or ends
    forks[0] = True
    begins = (forks[np.maximum(parent, 0)] | ~goes_on).tolist()
    length_m = np.linalg.norm(place - place[np.maximum(parent, 0)], axis=1)
    way_m, below, above = np.zeros(len(wood)), parent.copy(), np.arange(len(wood))
    for i, p in enumerate(parent.tolist()[1:], 1):  # parents first
        way_m[i] = length_m[i] + (0.0 if begins[i] else way_m[p])
        below[i] = p if begins[i] else below[p]
    for i in range(len(wood) - 1, 0, -1):
        if not begins[i]:
            above[parent[i]] = above[i]
    for i in np.flatnonzero(~forks).tolist():
        line = place[above[i]] - place[below[i]]
        place[i] += angular * (place[below[i]] + way_m[i] / max(way_m[above[i]], 1e-9) * line - place[i])
    return replace(wood, position_m=place)


def _with_twigs(
    clothed: ClothedWood,
    bearing: Bearing,
    orders: tuple[Order, ...],
    growth: float,
    left: float,
    rng: np.random.Generator,
) -> Skeleton:
    shoots = _first_shoots(clothed, bearing, orders[0].longest_m, growth, left, rng)
    assembly = Assembly(clothed.skeleton, axes=int(clothed.skeleton.axis[-1]) + 1)
    for number, rules in enumerate(orders):
        if not len(shoots.length_m):
            break
        grown = grow(shoots, rules, rng)
        index = assembly.add_branches(FIRST_TWIG_ORDER + number, grown, shoots, rules)
        if number + 1 < len(orders):
            shoots = _side_shoots(grown, rules, orders[number + 1].longest_m, index, rng)
    return assembly.skeleton()


def _first_shoots(
    clothed: ClothedWood, bearing: Bearing, longest_m: float, growth: float, left: float, rng: np.random.Generator
) -> Shoots:
    """Twigs along the wood, and those that go on from free terminals; the share `left` of them, always the same."""
    wood = clothed.skeleton
    side = np.flatnonzero(clothed.bears & np.isin(wood.order, bearing.orders))
    node = np.repeat(side, bearing.per_node)
    member = np.tile(np.arange(bearing.per_node), len(side))
    kept = rng.random(len(node)) >= bearing.missing
    node, member = node[kept], member[kept]
    position = wood.position_m.astype(np.float64)
    tangent = unit(position - position[np.maximum(wood.parent, 0)])
    axis, rank = wood.axis[node], np.repeat(_rank_on_axis(wood.axis[side].astype(np.int64)), bearing.per_node)[kept]
    phase = rng.uniform(0.0, 2.0 * np.pi, int(wood.axis[-1]) + 1)[axis]
    azimuth = np.where(bearing.planar, np.round(phase / (2.0 * np.pi)) * np.pi, phase)
    azimuth = azimuth + np.radians(bearing.phyllotaxis_deg) * rank + 2.0 * np.pi * member / bearing.per_node
    azimuth = azimuth + np.radians(bearing.phyllotaxis_jitter_deg) * rng.normal(size=len(node))
    angle = np.radians(bearing.angle_deg + bearing.angle_jitter_deg * rng.normal(size=len(node)))
    direction = around(tangent[node], azimuth, angle)
    if bearing.terminal:
        ends = np.flatnonzero(clothed.free)
        node, direction = np.concatenate([node, ends]), np.concatenate([direction, tangent[ends]])
    thick = np.clip(2.0 * wood.radius_m[node] / bearing.thinner_than_m, 0.0, 1.0)
    share = evaluate(bearing.age_length, clothed.age_share[node]) * evaluate(bearing.light_length, clothed.light[node])
    share = share * evaluate(bearing.thick_length, thick)
    share = share * np.clip(1.0 + bearing.length_jitter * rng.normal(size=len(node)), 0.3, 1.4)
    length = share * min(growth, 1.0) * longest_m
    if left < 1.0:
        stays = rng.random(len(node)) < left
        node, direction, length = node[stays], direction[stays], length[stays]
    return Shoots(position[node], direction, np.minimum(length, longest_m), node)


def _rank_on_axis(axis: Ints) -> Ints:
    """(N,) how many nodes of the same axis come before each: phyllotaxis counts those that bear, no others."""
    order = np.argsort(axis, kind="stable")
    ordered = axis[order]
    rank = np.empty(len(axis), dtype=np.int64)
    rank[order] = np.arange(len(axis)) - np.searchsorted(ordered, ordered)
    return rank


def _side_shoots(grown: Grown, rules: Order, longest_m: float, index: Ints, rng: np.random.Generator) -> Shoots:
    """Twigs on the twigs of one order, as L-system 6.1 has them."""
    sites = lateral_sites(grown, rules, rng)
    share = evaluate(rules.branch_length, grown.relative[sites.node])
    length = longest_m * share * np.clip(1.0 + rules.branch_length_jitter * rng.normal(size=len(share)), 0.3, 1.4)
    length = np.minimum(length, np.minimum(longest_m, 0.9 * grown.remaining_m[sites.node] + rules.shortest_m))
    chosen = (length >= rules.shortest_m) & (rng.random(len(length)) >= rules.missing)
    node = sites.node[chosen]
    return Shoots(grown.position_m[node], sites.direction[chosen], length[chosen], index[node])


GENERATOR = BranchModulesGenerator()
