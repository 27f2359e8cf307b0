"""What every plant generator's parameters have in common: wood, organs, and the fit to the plant's size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from pydantic.json_schema import SkipJsonSchema

from forestgen.geometry.mesh import Mesh
from forestgen.plants.crown_twigs import TWIG_ORDER, CrownTwigs
from forestgen.plants.foliage import Foliage, place
from forestgen.plants.organs.flowers import Acorn, Berry, Bud, Catkin, Cone, Daisy, Disc, FourPetals, Lily
from forestgen.plants.organs.fronds import FanFrond, FernFrond, GrassBlade, GrassPanicle, PalmFrond
from forestgen.plants.organs.leaves import CompoundLeaf, LobedLeaf, PalmateLeaf, SimpleLeaf
from forestgen.plants.organs.needles import Fascicle, NeedleTwig
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.variation.model import Variation
from forestgen.recipe.fields import Section, violation
from forestgen.recipe.wood import Wood as YearsOfWood

if TYPE_CHECKING:
    from forestgen.plants.grown import ModuleWood
    from forestgen.plants.tree_size import TreeSize
    from forestgen.recipe.species import Species

Tile = Annotated[float, Field(ge=0.01, le=10)]

_Leaf = SimpleLeaf | LobedLeaf | PalmateLeaf | CompoundLeaf | Fascicle | NeedleTwig
_Frond = PalmFrond | FanFrond | FernFrond | GrassBlade | GrassPanicle
_Flower = Daisy | FourPetals | Lily | Catkin | Bud | Berry | Acorn | Cone

#: The form of one kind of organ, told apart by its key `form`.
OrganShape = Annotated[_Leaf | _Frond | _Flower | Disc, Field(discriminator="form")]

Fit = Literal["stretch", "scale", "scale_all", "none"]


class Wood(Section):
    """Surface of stems and branches."""

    material: str = Field(description="name of one of the species' materials")
    branch_material: str | None = Field(None, description="the same for branches; the trunk's if not given")
    thick_branch_m: float | None = Field(
        None, ge=0, description="branches at least so thick at the foot, metres, have the trunk's material and texture"
    )
    dead: bool = Field(False, description="labelled dead_wood rather than trunk and branch")
    flare: float = Field(0.35, ge=0, le=3, description="widening at the root collar, as a share of the radius")
    branch_height_ratio: float = Field(1.0, ge=0.3, le=3, description="a branch's height over width; the area stays")
    bark_tile_m: tuple[Tile, Tile] = Field(
        (0.5, 0.5),
        description="repeat of the bark's texture, round the stem and up, metres; a `bark`'s `tile_m` counts",
    )
    branch_tile_m: tuple[Tile, Tile] = Field((0.25, 0.5), description="the same for branches")
    years: SkipJsonSchema[YearsOfWood | None] = None  # the species' `wood`, see `plants.plan`; no key of recipes

    @field_validator("years", mode="before")
    @classmethod
    def _is_the_species_own(cls, given: object) -> None:
        if given is None:
            return
        hint = "dead branches, covers, roots and the like are keys of the species' own `wood`"
        raise violation("the keys of stems' and branches' surface", problem="not a key of recipes", hint=hint)


class PlantParameters(Section):
    """The `plant:` block of a species' file, less the generator's own keys."""

    generator: str
    wood: Wood = Field(description="surface of stems and branches")
    shapes: dict[str, OrganShape] = Field(default_factory=dict, description="forms of the organs, by name")
    foliage: tuple[Foliage, ...] = Field((), description="where organs sit, beside those that the generator places")
    crown_twigs: CrownTwigs | None = Field(None, description="twigs that fill the crown of a tree of given sizes")
    fullness: float = Field(
        0.4,
        ge=0.1,
        le=0.5,
        description="mean of (r / R)² of a tree's leaves, r from the axis, R half of the crown's width: branches near "
        "the axis are stretched until it is reached; an ellipsoid has 0.4, a cone 0.3",
    )
    pointed: float | None = Field(
        None,
        ge=0.1,
        le=2,
        description="outline of a tree's crown about a stem with a `sweep`, without `crown_twigs`: at the share x of "
        "its depth below the top it is x to this power as wide as at its widest, but at most twice as wide as it grew; "
        "forked trees, and null: as it grew",
    )
    variation: Variation | None = Field(None, description="growth responses that make plants of a base model differ")
    fit: Fit = Field(
        "scale",
        description="stretch: height and width apart until both fit, thickness and organs as they are; scale: the wood "
        "as a whole until the height fits; scale_all: wood and organs; none: as grown",
    )

    @model_validator(mode="after")
    def _names(self) -> Self:
        for rule in self.foliage:
            if rule.shape not in self.shapes:
                raise ValueError(f"foliage names the shape {rule.shape!r}; there are: {', '.join(self.shapes)}")
        on_twigs = any(TWIG_ORDER in rule.orders for rule in self.foliage)
        if on_twigs and self.crown_twigs is None:
            raise ValueError(f"foliage on twigs, order {TWIG_ORDER}, asks for crown_twigs")
        if self.crown_twigs is not None and not on_twigs:
            raise ValueError(f"crown_twigs bear no leaves: no rule of foliage has the order {TWIG_ORDER}")
        if self.pointed is not None and self.crown_twigs is not None:
            problem, hint = "it does not shape crowns of twigs", "take either of them away"
            raise violation("null beside crown_twigs", problem=problem, got=str(self.pointed), hint=hint, at="pointed")
        return self

    def templates(self) -> dict[str, Mesh]:
        """Each shape as one mesh, by name."""
        return {name: shape.template() for name, shape in self.shapes.items()}

    def place_foliage(
        self, skeleton: Skeleton, height_m: float, rng: np.random.Generator
    ) -> tuple[OrganPlacements, ...]:
        """Organs by the rules that suit a plant of this height."""
        return tuple(place(rule, skeleton, height_m, rng) for rule in self.foliage if rule.suits(height_m))


def with_detail(parameters: PlantParameters, detail: int) -> PlantParameters:
    """The same plant with its organs drawn at a level of detail, 0 to 2, where their forms have one."""
    shapes = {
        name: shape.model_copy(update={"detail": detail}) if hasattr(shape, "detail") else shape
        for name, shape in parameters.shapes.items()
    }
    return parameters.model_copy(update={"shapes": shapes})


class Generator(Protocol):
    """A plant generator: one file in plants/generators, one line in plants/registry.py.

    What it may offer besides are the protocols below; a generator has a capability if it has its methods.
    """

    Parameters: type[PlantParameters]
    has_crown: bool  # whether the species' crown width means anything to its plants: not to dead wood

    def grow(self, parameters: Any, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """A plant about `height_m` tall and `width_m` wide, with the organs that the generator itself places.

        Foliage rules and the fit to the exact size follow in `plants/build.py`.

        Raises `RecipeError`: the parameters lead nowhere, or to a plant too large for memory (`check_budget`).
        """
        ...


@runtime_checkable
class CrownProfile(Protocol):
    """A generator that knows the form of the crown."""

    def crown_profile(
        self, parameters: Any, height_m: float, width_m: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(K,) heights and (K,) radii of the crown, metres, from its base to its top."""
        ...


@runtime_checkable
class ShapesTrees(Protocol):
    """A generator that can place the crown of a tree."""

    def shaped(self, parameters: Any, size: TreeSize) -> Any:
        """The parameters of a tree whose crown begins about at `size.crown_base_m`; `plants.tree_fit` does the rest."""
        ...


@runtime_checkable
class Lifeless(Protocol):
    """A generator of what does not grow, such as dead wood."""

    instead: str  # what communities that grow their plants have in its place, for messages


@runtime_checkable
class ClothesModules(Protocol):
    """A generator of twigs and leaves on branches that a community grew."""

    def clothe(self, parameters: Any, wood: ModuleWood, height_m: float, rng: np.random.Generator) -> Skeleton:
        """The plant's wood with its twigs and leaves.

        `wood`: the plant's skeletal graph. `height_m`: of the plant, by which rules of foliage and sizes are chosen.
        Raises `RecipeError`: more twigs or leaves than memory holds.
        """
        ...

    def wood_alone(self, species_name: str, species: Species, size_m: tuple[float, float], seed: int) -> ModuleWood:
        """The wood of a plant of a height and width, metres, without a community; another seed is another plant."""
        ...


@runtime_checkable
class Sways(Protocol):
    """A generator that knows poses of its plants in the wind."""

    def in_wind(self, parameters: Any) -> Any:
        """The parameters with a wind that moves the plant, if their own does not."""
        ...

    def poses(
        self,
        parameters: Any,
        height_m: float,
        width_m: float,
        rng: np.random.Generator,
        times_s: Iterable[float],
        tree: TreeSize | None = None,
    ) -> Iterator[Skeleton]:
        """The plant that `plants.build.build_exemplar` makes of the same `rng`, at each time, ready to be meshed.

        Raises `RecipeError`: the plant has a `variation`, whose bends a pose would have to carry along; or as `grow`
        does.
        """
        ...
