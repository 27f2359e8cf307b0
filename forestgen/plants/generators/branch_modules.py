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

H is the plant's height, a_b the physiological age of the segment that bears the twig, d_b its diameter, Q_eff its
module's light.

Parameters
----------
=============== ========= ======= ====================================================================
name            unit      default meaning
=============== ========= ======= ====================================================================
wood            -         -       surface of stems and branches, as for every generator
crook           share     0.03    random bend of a segment's middle, share of its length
bearing         -         -       where the wood bears twigs, see `Bearing`; null: nowhere
twigs           -         none    orders of twigs, see `Order` in generators/silhouette.py; at most 4
shapes, foliage -         -       as for every generator
=============== ========= ======= ====================================================================

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
- Twigs are no part of a plant's size: a plant is as tall as its modules. They reach beyond by at most their length.
- What the twigs look like is random, of the plant's own number, and stays with it through time.
- In communities of other models, and for `forestgen plant`, a plant grows alone in the open by its species' `modules`
  until it has the height that its allometry asks for (plants/grown/alone.py).
"""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import BaseModel, Field, model_validator

from forestgen.core.errors import RecipeError
from forestgen.plants.generators.silhouette import Order
from forestgen.plants.parameters import STRICT, Fit, PlantParameters
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.curves import PositiveCurve

# For who writes a species' file: what matters most, in this order.
#   bearing.thinner_than_m   which wood bears twigs. A grown terminal segment has PlantType.thickening_cm (0.01 m) times
#                            the root of its shoots_per_terminal; where n terminals lie beyond, sqrt(n) times that.
#                            3 to 5 times a terminal is a good start.
#   bearing.spacing_m        between twigs along it; 0.1 to 0.25 m. Every free terminal bears one more along its axis.
#   twigs[0].longest_m       length of a full twig: about 0.6 of a grown segment's length fills the space between.
#   twigs[1]                 side twigs on the twigs: branch_angle_deg and branch_length of twigs[0] rule where they go.
#   foliage.orders           [8, 9] are these two; needles on the wood itself: 1 to 7 with thinner_than_m: 0.02.
#   foliage.shape            a large tree has some 50,000 to 300,000 leaves: draw them twice as long and a quarter as
#                            many, or needle_twig shapes (spruce.yaml). Aim at 50,000 to 200,000 triangles a tree.
#   size_by_height           a seedling's leaves are small: [[0, 0.3], [0.5, 0.6], [3, 1.0]].
# scenes/species/spruce.yaml and oak.yaml have working `modules_plant:` blocks.

FIRST_TWIG_ORDER = 8  # branch orders below are wood of the modules
MOST_TWIG_ORDERS = 4


class Bearing(BaseModel):
    """Where the wood of the modules bears twigs: at even steps along all segments that are thin enough."""

    model_config = STRICT

    thinner_than_m: float = Field(0.04, gt=0, le=10, description="only segments of a smaller diameter, metres")
    younger_than_yr: float = Field(1e4, gt=0, description="only on modules that began less than so long ago, years")
    orders: tuple[int, ...] = Field(
        (0, 1, 2, 3, 4, 5, 6, 7), min_length=1, description="orders of the wood that bear them; 0 is the stem"
    )
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
    light_length: PositiveCurve = Field(
        ((0.0, 0.6), (0.5, 1.0)), description="share of a twig's length over its module's light, 0 to 1"
    )
    thick_length: PositiveCurve = Field(
        ((0.0, 1.0), (0.6, 0.85), (1.0, 0.4)),
        description="share of a twig's length over its segment's diameter, as a share of thinner_than_m",
    )
    length_jitter: float = Field(0.15, ge=0, lt=0.5, description="standard deviation of a twig's length, as a share")
    size_by_height: PositiveCurve = Field(
        ((0.0, 0.15), (0.5, 0.4), (3.0, 1.0)),
        description="factor on the twigs' length and spacing over the plant's height in metres",
    )
    missing: float = Field(0.1, ge=0, lt=1, description="share of the places left empty")
    terminal: bool = Field(True, description="one more goes on from every free terminal, along its axis")


class Parameters(PlantParameters):
    """The `plant:` or `modules_plant:` block of a species' file."""

    generator: Literal["branch_modules"] = "branch_modules"
    crook: float = Field(
        0.03, ge=0, le=0.3, description="random bend of a segment's middle, share of its length (standard deviation)"
    )
    smooth: bool = Field(True, description="whether axes run in curves through the modules' nodes, or straight")
    bearing: Bearing | None = Field(
        default_factory=lambda: Bearing.model_validate({}), description="where the wood bears twigs; null: nowhere"
    )
    twigs: tuple[Order, ...] = Field(
        (),
        max_length=MOST_TWIG_ORDERS,
        description="twigs on the wood, the twigs on these, and so on: orders 8, 9, ...",
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
    clothes_modules = True

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """Refuse: its branches take more than a height and a width."""
        raise RecipeError(
            "plants of branch modules grow by their species' modules",
            where="plant.generator",
            expected="forestgen.plants.growing.grow_exemplar",
            got="a plant without modules",
        )


GENERATOR = BranchModulesGenerator()
